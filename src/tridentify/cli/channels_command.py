"""``tridentify channels``: what a file holds."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from tridentify.checks.names import LONGEST_NAME
from tridentify.cli.tables import make_table
from tridentify.cli.terminal import Activity, show, show_json
from tridentify.errors import DataError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.assemble import time_channels
from tridentify.record.formats.channels import SECONDS, OpenFile
from tridentify.record.formats.read import opened
from tridentify.writing.layout import short

MANY = 2000
"""Channels beyond which the table is laid out plainly: drawn, 80,000 of them take half a minute."""


def channels(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="CSV, Parquet, Feather, NPZ, MATLAB, ULog or MDF4."),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """List the channels of a file: names, units, samples, and rates where the file knows them.

    Example: tridentify channels flight.ulg
    """
    with Activity() as activity:
        activity.stage(f"reading {file.name or file}")
        with opened(file) as source:
            found = described(source)
    if as_json:
        show_json({"file": str(file), "channels": found})
        return
    groups: dict[str, list[tuple[str, ...]]] = {}
    for item in found:
        name, unit = (_plain(str(item[key])) for key in ("name", "unit"))
        row = (name, *map(_text, (item["samples"], item["rate"])), unit)
        groups.setdefault(item["clock"], []).append(row)
    titles = ("channel", "samples", "rate [1/s]", "unit")
    if len(found) > MANY:
        show(_plain_table([titles, *chain.from_iterable(groups.values())]))
    else:
        show(make_table(titles, groups.values()))


def _plain_table(rows: Sequence[tuple[str, ...]]) -> str:
    """Lay out rows as the table does, but for lines between groups."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    aligned = (
        f"{name:{widths[0]}}  {samples:>{widths[1]}}  {rate:>{widths[2]}}  {unit}".rstrip()
        for name, samples, rate, unit in rows
    )
    return "\n".join(aligned)


def described(source: OpenFile) -> list[dict[str, Any]]:
    """Describe every channel of an open file; what is not known is None.

    Parameters
    ----------
    source : OpenFile

    Returns
    -------
    list of dict
        ``name``, ``unit``, ``clock``, ``samples`` and mean ``rate`` [1/s].
    """
    times: dict[str, Array | None] = {}
    for channel in source.channels:
        if channel.clock not in times:
            times[channel.clock] = _instants(source, channel.clock)
    entries = []
    for channel in source.channels:
        time, samples = times[channel.clock], channel.samples
        if samples is None and time is not None and len(time):
            samples = len(time)
        same = time is not None and len(time) == samples
        entries.append(
            {
                "name": channel.header,
                "unit": channel.unit,
                "clock": channel.clock,
                "samples": samples,
                "rate": _rate(time) if same else None,
            }
        )
    return entries


def _instants(source: OpenFile, clock: str) -> Array | None:
    """Give the time of a clock, or the one column of its channels that is called t or time [s]."""
    try:
        if clock:
            return source.instants(clock)
        named = time_channels(source)
        if len(named) != 1 or named[0].unit not in SECONDS:
            return None
        return source.read([source.channels.index(named[0])])[0] * SECONDS[named[0].unit]
    except DataError:
        return None


def _plain(text: str) -> str:
    """Keep what a file calls its channels from steering the terminal, or filling it."""
    return short(text, LONGEST_NAME) if text.isprintable() else shown(text)


def _rate(time: Array | None) -> float | None:
    span = 0.0 if time is None or len(time) < 2 else float(time[-1] - time[0])
    return (len(time) - 1) / span if time is not None and np.isfinite(span) and span > 0 else None


def _text(number: float | None) -> str:
    return (
        "" if number is None else f"{number:,.6g}" if isinstance(number, float) else f"{number:,}"
    )
