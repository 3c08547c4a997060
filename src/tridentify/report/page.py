"""A page: what stands first, sections, and the one file that they become."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING

from tridentify.errors import OptionError
from tridentify.estimation.answer.finding import Finding
from tridentify.report.first_screen import KeyNumber
from tridentify.report.pictures import Picture
from tridentify.report.tables import ReportTable
from tridentify.writing.files import write_atomically

if TYPE_CHECKING:
    from jinja2 import Template

    from tridentify.report.figures import Chart


@dataclass(frozen=True)
class Block:
    """Pictures beside each other: one that takes the page's width, or two columns."""

    columns: tuple[tuple[Picture, ...], ...] = ()
    wide: Picture | None = None


@dataclass(frozen=True)
class Section:
    """A part of a page with a heading; ``folded`` is what stands on it while it is closed."""

    anchor: str
    heading: str
    folded: str = ""
    formulas: str = ""
    formulas_as_text: str = ""
    paragraphs: Sequence[str] = ()
    tables: Sequence[ReportTable] = ()
    figures: Sequence[Block] = ()
    notes: Sequence[str] = ()
    diagrams: Sequence[Chart] = ()
    settings: Sequence[tuple[str, str]] = ()
    code: str = ""
    keep: bool = False


@dataclass(frozen=True)
class Page:
    """All that a page says.

    Attributes
    ----------
    title, kind, subtitle : str
        Heading, what the page is, and of what.
    verdict : {"good", "caution", "bad"}
    headline, trust, to_do : str
        What was found, how far to trust it, what to do.
    numbers : sequence of KeyNumber
    fits : sequence of Picture
        Measured against model, an experiment each.
    findings : sequence of Finding
        Ranked; three are shown, the others folded.
    sections : sequence of Section
    document : str
        The estimate as JSON, to be saved from the page; may be empty.
    """

    title: str
    kind: str
    subtitle: str
    verdict: str
    headline: str
    trust: str = ""
    to_do: str = ""
    numbers: Sequence[KeyNumber] = ()
    fits: Sequence[Picture] = ()
    findings: Sequence[Finding] = ()
    sections: Sequence[Section] = field(default_factory=tuple)
    document: str = ""

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page as one file that needs nothing else.

        Raises
        ------
        OptionError
            The name is that of another kind of file.
        OutputPathError
            The file cannot be written; nothing is left behind.
        """
        if Path(path).suffix.lower() not in ("", ".html", ".htm"):
            raise OptionError.found(
                "the page ", Path(path).name, "a name that ends in .html", "print it from a browser"
            )
        script = _part("page.js")
        text = _template().render(
            {name: getattr(self, name) for name in self.__dataclass_fields__},
            more_fits=beside(self.fits[2:]),
            contents=[(section.anchor, section.heading) for section in self.sections],
            style=_part("page.css"),
            script=script,
            script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        )
        return write_atomically(path, text)


def beside(pictures: Sequence[Picture]) -> list[Block]:
    """Pictures in blocks: wide ones by themselves, others in two columns of like height.

    Parameters
    ----------
    pictures : sequence of Picture

    Returns
    -------
    list of Block
    """
    blocks: list[Block] = []
    waiting: list[Picture] = []
    for picture in (*pictures, None):
        if picture is not None and not picture.wide:
            waiting.append(picture)
            continue
        if waiting:
            blocks.append(Block(_columns(waiting)))
            waiting = []
        if picture is not None:
            blocks.append(Block(wide=picture))
    return blocks


def _columns(pictures: Sequence[Picture]) -> tuple[tuple[Picture, ...], ...]:
    """Each into the column that is shorter so far."""
    columns: tuple[list[Picture], list[Picture]] = ([], [])
    for picture in pictures:
        heights = [sum(one.height for one in column) for column in columns]
        columns[heights[1] < heights[0]].append(picture)
    return tuple(tuple(column) for column in columns if column)


def prepare() -> None:
    """Compile the page's frame, for who has to wait for something anyway."""
    _template()


@cache
def _template() -> Template:
    from jinja2 import Environment

    made = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    return made.from_string(_part("page.html.j2"))


def _part(name: str) -> str:
    """A file that belongs to the page."""
    return files("tridentify.report").joinpath(name).read_text(encoding="utf-8")
