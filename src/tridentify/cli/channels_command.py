"""``tridentify channels``: what a file holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from tridentify.cli.tables import make_table
from tridentify.cli.terminal import Activity, paragraph, show, show_json
from tridentify.errors import shown
from tridentify.record.checks.names import LONGEST_NAME
from tridentify.record.formats.channels import OpenFile
from tridentify.record.formats.read import opened
from tridentify.record.formats.summary import (
    ChannelSummary,
    ClockSummary,
    broken_lines,
    channel_summaries,
    clock_summaries,
)
from tridentify.writing.layout import short

MANY = 2000
"""Channels beyond which they are only listed: to read and draw 80,000 of them takes minutes."""

FEW = 3
"""Lines that are no rows of which each is told."""

TITLES = ("channel", "unit", "lowest", "highest", "mean", "missing", "taken for")


def channels(
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    as_json: Annotated[bool, typer.Option("--json")] = False,
) -> None:
    """List the channels of a file: time and its steps, units, ranges, means, missing samples.

    What each is taken for is a guess by its name and by how it moves; --input and --output decide.

    Example: tridentify channels flight.ulg

    Parameters
    ----------
    file
        CSV, Excel, Parquet, Feather, NPZ, MATLAB, ULog or MDF4.
    as_json
        Print JSON instead of a table.
    """
    with Activity() as activity:
        activity.stage(f"reading {file.name or file}")
        with opened(file) as source:
            clocks, found = described(source)
            problems = _problems(source, found)
    if as_json:
        listed = [_document(item, clocks.get(item.channel.clock)) for item in found]
        times = [asdict(clock) for clock in clocks.values()]
        wrong = {"problems": problems} if problems else {}
        show_json({"file": str(file), "clocks": times, "channels": listed, **wrong})
        return
    groups: dict[str, list[ChannelSummary]] = {}
    for item in found:
        groups.setdefault(item.channel.clock, []).append(item)
    blocks = (_blocks(file.name, clocks.get(clock), group) for clock, group in groups.items())
    show(*chain.from_iterable(blocks), *(paragraph(text, rest="  ") for text in problems))


def _problems(source: OpenFile, found: Sequence[ChannelSummary]) -> list[str]:
    """What other commands will refuse: lines that are no rows, and columns with text in them."""
    told = list(broken_lines(source))
    if len(told) > FEW:
        told = [*told[:FEW], f"found {len(told) - FEW:,} more lines that are no rows"]
    told = [f"{text} (left out here; other commands refuse the file)" for text in told]
    return [*told, *dict.fromkeys(item.problem for item in found if item.problem)]


def described(source: OpenFile) -> tuple[dict[str, ClockSummary], list[ChannelSummary]]:
    """Sum up an open file; of very many channels only what the file says of itself.

    Parameters
    ----------
    source : OpenFile

    Returns
    -------
    clocks : dict of str to ClockSummary
    channels : list of ChannelSummary
    """
    clocks = clock_summaries(source)
    if len(source.channels) > MANY:
        return clocks, [ChannelSummary(c, False, c.samples) for c in source.channels]
    return clocks, channel_summaries(source)


def _document(item: ChannelSummary, clock: ClockSummary | None) -> dict[str, Any]:
    numbers = asdict(item)
    channel: Mapping[str, Any] = numbers.pop("channel")
    del numbers["tried"], numbers["problem"]
    known = {"name": channel["header"], "unit": channel["unit"], "clock": channel["clock"]}
    if item.samples is None and clock is not None:
        numbers["samples"] = clock.samples
    same = clock is not None and clock.samples == numbers["samples"]
    return {**known, **numbers, "rate": clock.rate if clock is not None and same else None}


def _blocks(
    file: str, clock: ClockSummary | None, items: Sequence[ChannelSummary]
) -> tuple[str, str | Table]:
    """Time of one clock, and its channels as a table."""
    name = items[0].channel.clock
    head = f"{_plain(file)}{f', {_plain(name)}' if name else ''}: {_timing(clock, items)}"
    counted = len({item.samples for item in items if item.samples is not None}) > 1
    many = len(items) > MANY
    rows = [_row(item, counted) for item in items]
    titles = (*TITLES, "samples") if counted else TITLES
    table = _plain_table([titles, *rows]) if many else make_table(titles, [rows])
    return paragraph(head, rest="  "), table


def _timing(clock: ClockSummary | None, items: Sequence[ChannelSummary]) -> str:
    counts = [item.samples for item in items if item.samples is not None]
    if clock is None:
        known = f"{max(counts):,} samples; " if counts else ""
        if named := [item for item in items if item.role == "time"]:
            return f"{known}time unknown ({_why(named)}): see below, or give --time or --dt"
        return (
            f"{known}time unknown (no channel called t or time): give the commands that use it "
            "--time NAME or --dt SECONDS"
        )
    text = f"{clock.samples:,} samples, {clock.start:.6g} to {clock.stop:.6g} s"
    if clock.step is not None:
        return f"{text}, every {clock.step:.6g} s ({clock.rate:.6g} a second), evenly"
    return (
        f"{text}, unevenly: steps of {clock.shortest:.4g} to {clock.longest:.4g} s "
        f"({clock.rate:.4g} a second on the mean)"
    )


def _why(named: Sequence[ChannelSummary]) -> str:
    """Say why channels that are time by their name do not tell it."""
    if len(named) > 1:
        listed = " and ".join(_plain(item.channel.header) for item in named)
        return f"{listed} are called so"
    name = _plain(named[0].channel.header)
    if named[0].minimum is None or named[0].missing:
        return f"column {name} is no number throughout"
    return f"column {name} does not rise throughout"


def _row(item: ChannelSummary, counted: bool) -> tuple[str, ...]:
    numbers = [_text(value) for value in (item.minimum, item.maximum, item.mean)]
    if item.missing is None:
        numbers[0] = "no numbers" if item.tried else "not read"
    missing = "" if item.missing is None else f"{item.missing:,}"
    samples = ["" if item.samples is None else f"{item.samples:,}"] if counted else []
    head = (_plain(item.channel.header), _plain(item.channel.unit))
    return (*head, *numbers, missing, item.role, *samples)


def _plain_table(rows: Sequence[tuple[str, ...]]) -> str:
    """Lay out rows as the table does, but for lines between groups."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def _plain(text: str) -> str:
    """Keep what a file calls its channels from steering the terminal, or filling it."""
    return short(text, LONGEST_NAME) if text.isprintable() else shown(text)


def _text(number: float | None) -> str:
    return "" if number is None else f"{number:.5g}"
