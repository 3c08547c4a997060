"""What every command's help says of its options reaches the reader: nothing is taken for markup."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
import typer.main

from tridentify.cli.app import program

WIDE = {"COLUMNS": "400", "TERMINAL_WIDTH": "400"}


def options() -> Iterator[tuple[str, str]]:
    """Every command with the help of each of its options."""
    group = typer.main.get_command(program())
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        yield from ((name, one.help) for one in command.params if getattr(one, "help", None))


@pytest.mark.parametrize("name", sorted({name for name, _ in options()}))
@pytest.mark.fast("export", "study", "channels", "demo")
def test_help_shows_every_word(run, monkeypatch, name):
    for key, value in WIDE.items():
        monkeypatch.setenv(key, value)
    shown = re.sub(r"[\s│]+", " ", run(name, "--help").out)
    for command, said in options():
        if command == name:
            assert re.sub(r"\s+", " ", said) in shown
