"""The options that several commands share: what they are called, and what they say in the help."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

record_option = partial(typer.Option, rich_help_panel="The record")
model_option = partial(typer.Option, rich_help_panel="The model")
known_option = partial(typer.Option, rich_help_panel="What is known; each may be repeated")
result_option = partial(typer.Option, rich_help_panel="The result")


Choice = Literal["auto", "yes", "no"]
"""Whether a nuisance term is estimated along."""


def drift_of(choice: str | None) -> bool | int | str | None:
    """A drift as `Structure` wants it: yes, no, auto, or a degree."""
    if choice is None or choice == "auto":
        return choice
    known = {"yes": True, "no": False}
    return known[choice] if choice in known else (int(choice) if choice.isdecimal() else choice)


def answered(choice: Choice) -> bool | Literal["auto"]:
    """A choice as `Structure` wants it."""
    return "auto" if choice == "auto" else choice == "yes"


Missing = Annotated[
    list[str] | None,
    record_option(
        metavar="RULE",
        help='Output samples that do not count, such as "q>=9.99" of a saturated sensor; may be '
        "repeated.",
    ),
]


Units = Annotated[
    list[str] | None,
    record_option(
        "--unit",
        metavar="NAME=U",
        help="Unit of a column, before that of the file; may be repeated.",
    ),
]


Out = Annotated[
    Path | None,
    result_option(
        metavar="DIR", help="Write model.json, report.html and the figures into this folder."
    ),
]
Title = Annotated[str | None, result_option(metavar="TEXT", help="Heading of the report.")]
AsJson = Annotated[bool, result_option("--json", help="Print one JSON object instead of tables.")]
