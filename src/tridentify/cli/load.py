"""From files to records: which columns, which time, what does not count.

Stretches of time on the command line are experiments of one file, or what does not count.
"""

from __future__ import annotations

import math
import operator
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tridentify.cli.terminal import Activity
from tridentify.errors import (
    ChannelNameError,
    DataError,
    NonUniformTimeError,
    OptionError,
    SamplingError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.options import NUMBER
from tridentify.record.checks.names import did_you_mean
from tridentify.record.checks.times import time_slack
from tridentify.record.formats import assemble
from tridentify.record.formats.channels import SECONDS, OpenFile
from tridentify.record.formats.read import opened
from tridentify.record.formats.summary import channel_summaries
from tridentify.record.formats.time import clock
from tridentify.record.formats.time.rounded_time import raster_behind
from tridentify.record.record import Record
from tridentify.writing.layout import printable

_STRETCH = re.compile(rf"\s*({NUMBER})?\s*:\s*({NUMBER})?\s*")


class Stretch(NamedTuple):
    """From one time to another [s, on the clock of the file]; both ends belong to it."""

    start: float
    stop: float


def stretches_from(option: str, given: Sequence[str]) -> tuple[Stretch, ...]:
    """Read what ``--range`` and ``--mask`` say.

    Parameters
    ----------
    option : str
        Which of them, for what is said of it.
    given : sequence of str
        ``FROM:TO`` [s]; an end that is left out is the end of the record.

    Returns
    -------
    tuple of Stretch

    Raises
    ------
    OptionError
        A text is nothing of that kind, or ends before it begins.

    Examples
    --------
    >>> stretches_from("--range", ["2:14.5", "20:"])
    (Stretch(start=2.0, stop=14.5), Stretch(start=20.0, stop=inf))
    """
    return tuple(_stretch(option, text) for text in given)


def _stretch(option: str, text: str) -> Stretch:
    match = _STRETCH.fullmatch(text)
    start, stop = match.groups() if match else (None, None)
    found = Stretch(
        -math.inf if start is None else float(start), math.inf if stop is None else float(stop)
    )
    if match is None or (start is None and stop is None) or not found.start < found.stop:
        raise OptionError(
            f"found {option} {shown(text)}; expected two times in seconds, the later one last, "
            "such as 2:14.5 (20: is all from there on); correct it"
        )
    return found


def masked(record: Record, left_out: Sequence[Stretch]) -> Record:
    """The record without the output samples of some stretches.

    Parameters
    ----------
    record : Record
    left_out : sequence of Stretch

    Raises
    ------
    EmptyChannelError
        No sample of an output is left.
    """
    for one in left_out:
        record = record.mask((record.t >= one.start) & (record.t <= one.stop))
    return record


def pieces(record: Record, ranges: Sequence[Stretch]) -> list[Record]:
    """Ranges of a record as experiments; all of it where there are none.

    A sample at either end belongs to a range, but where another begins at that end: then to that.

    Parameters
    ----------
    record : Record
    ranges : sequence of Stretch

    Raises
    ------
    EmptyRangeError
        One of them holds no sample.
    """
    begun = np.array([one.start for one in ranges])
    slack = time_slack(record.t)
    found = []
    for one in ranges:
        piece = record.slice(one.start, one.stop)
        if np.any(np.abs(begun - one.stop) <= slack) and piece.t[-1] >= one.stop - slack:
            piece = piece.slice(None, float(piece.t[-2]))
        found.append(piece)
    return found or [record]


COMPARE: Mapping[str, Callable[[Any, float], Any]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    ">": operator.gt,
    "<": operator.lt,
}


@dataclass(frozen=True)
class MissingRule:
    """Output samples that do not count: those that compare so with a limit."""

    channel: str
    sign: str
    limit: float


@dataclass(frozen=True)
class RecordSource:
    """Which part of which files are the records.

    `usual_step` [s] is that of the model, for files of the same columns that have no time.
    """

    files: Sequence[Path]
    wanted: assemble.Wanted
    missing: tuple[MissingRule, ...] = ()
    masked: tuple[Stretch, ...] = ()
    ranges: tuple[Stretch, ...] = ()
    usual_step: float | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """All that are read but time."""
        wanted = self.wanted
        return (*wanted.inputs, *wanted.references, *wanted.outputs)

    def __post_init__(self) -> None:
        """Refuse to say of nothing what it does between samples.

        Raises
        ------
        OptionError
        """
        between = self.wanted.reference_intersample
        if between is not None and not self.wanted.references:
            raise OptionError(
                f"found --reference-intersample {between} without --reference; "
                "expected a column that it is about; give --reference NAME too, or leave it out"
            )


def rules_from(given: Sequence[str]) -> tuple[MissingRule, ...]:
    """Read what ``--missing`` says.

    Parameters
    ----------
    given : sequence of str
        An output, one of ``>= <= == > <``, and a number.

    Returns
    -------
    tuple of MissingRule

    Raises
    ------
    OptionError
        A text is nothing of that kind.

    Examples
    --------
    >>> rules_from(["q >= 9.99"])
    (MissingRule(channel='q', sign='>=', limit=9.99),)
    """
    found = []
    for text in given:
        match = re.fullmatch(rf"\s*(.+?)\s*(>=|<=|==|>|<)\s*({NUMBER})\s*", text)
        if match is None:
            raise OptionError(
                f"found --missing {shown(text)}; expected an output, a comparison and a number "
                'such as "q>=9.99"; correct it, in quotation marks'
            )
        found.append(MissingRule(match[1], match[2], float(match[3])))
    return tuple(found)


def units_from(given: Sequence[str]) -> dict[str, str]:
    """Read what ``--unit`` says.

    Parameters
    ----------
    given : sequence of str
        ``q=rad/s``; the last equals sign counts.

    Returns
    -------
    dict of str to str

    Raises
    ------
    OptionError
        A text has no name or no unit, or a name occurs twice.

    Examples
    --------
    >>> units_from(["q=rad/s"])
    {'q': 'rad/s'}
    """
    found: dict[str, str] = {}
    for text in given:
        name, sign, unit = (part.strip() for part in text.rpartition("="))
        if not (name and sign and unit) or name in found:
            raise OptionError.found(
                "--unit ", text, "a column and its unit such as q=rad/s, once for each column"
            )
        found[name] = unit
    return found


def asked_channels(
    files: Sequence[Path], inputs: Sequence[str] | None, outputs: Sequence[str] | None
) -> tuple[list[str], list[str]]:
    """The columns that are asked for.

    Parameters
    ----------
    files : sequence of Path
    inputs, outputs : sequence of str or None
        As ``--input`` and ``--output`` give them.

    Raises
    ------
    OptionError
        There is no input or no output; it says what the columns of the first file may be.
    UnreadableFileError
        That file cannot be read.
    """
    if inputs and outputs:
        return list(inputs), list(outputs)
    missing = " and no ".join(
        f"--{role}" for role, given in (("input", inputs), ("output", outputs)) if not given
    )
    with opened(files[0]) as table:
        found = channel_summaries(table)
    likely = {
        role: given or [item.channel.name for item in found if item.role == role]
        for role, given in (("input", inputs), ("output", outputs))
    }
    guess = " ".join(
        f"--{role} {shlex.quote(name)}" for role, names in likely.items() for name in names
    )
    raise OptionError(
        f"found no {missing}; expected the columns of {shown(files[0].name)} that were moved and "
        f"that answered; by their names perhaps {guess}; tridentify channels FILE lists them"
    )


def load(source: RecordSource, activity: Activity) -> list[Record]:
    """Read the records, one for each file, or for each range of each.

    Raises
    ------
    DataError
        A file or the record in it cannot be used.
    OptionError
        A file is named twice, or a column where a file is expected.
    """
    for number, file in enumerate(source.files):
        if number and not file.suffix and not file.exists() and source.files[0].exists():
            raise OptionError(
                f"found no file {shown(str(file))} beside {shown(source.files[0].name)}; expected "
                "files; if it is a column, write the option again before it: --input a --input b, "
                "--reference r --reference s"
            )
        if any(_same(file, other) for other in source.files[:number]):
            raise OptionError(
                f"found the file {shown(str(file))} twice; expected different experiments; drop "
                "one of the two"
            )
    records = [_load_one(source, file, activity) for file in source.files]
    return [piece for record in records for piece in pieces(record, source.ranges)]


def _same(file: Path, other: Path) -> bool:
    return file == other or (file.exists() and other.exists() and file.samefile(other))


def _load_one(source: RecordSource, file: Path, activity: Activity) -> Record:
    """Read one record; without a stated sampling, look for a column of time by its name."""
    activity.stage(f"reading {file.name or file}")
    with opened(file) as table:
        time, dt = source.wanted.time, source.wanted.dt
        if time is None and dt is None:
            how = "name"
            try:
                time = find_time(table, source.columns)
            except SamplingError:
                if source.usual_step is None:
                    raise
                dt = source.usual_step
                how = f"steps of {dt:.9g} s, as when the model was identified"
                time = _with_steps(table, source.columns, dt)
            if time is not None:
                dt = None
                activity.note(f"taking column {time!r} as time, by its {how}")
            elif dt is not None:
                source = replace(source, wanted=replace(source.wanted, dt=dt))
                activity.note(f"taking {how}")
        record = _read(table, source, time, file)
        if record.dt is None:
            activity.note(_uneven(record, time))
        elif time is not None and raster_behind(_stamps(table, time)) is not None:
            activity.note(
                f"the time stamps of {shown(time)} are rounded; taken as even steps of "
                f"{record.dt:.9g} s, which agree with all of them"
            )
    return masked(without(record, source.missing, activity), source.masked)


def without(record: Record, rules: Sequence[MissingRule], activity: Activity) -> Record:
    """Mark the samples that do not count as missing, and say how many there are.

    Raises
    ------
    ChannelNameError
        A rule is not about an output.
    EmptyChannelError
        No sample of an output is left.
    """
    check_rules(rules, record.output_names)
    for rule in rules:
        column = record.output_names.index(rule.channel)
        where = np.zeros(record.y.shape, dtype=np.bool_)
        where[:, column] = COMPARE[rule.sign](record.y[:, column], rule.limit)
        record = record.mask(where)
        activity.note(
            f"{int(where.sum())} of {record.n_samples} samples of {rule.channel} in {record.name} "
            f"do not count, by {rule.channel} {rule.sign} {rule.limit:g}"
        )
    return record


def check_rules(rules: Sequence[MissingRule], outputs: Sequence[str]) -> None:
    """Refuse rules about what is no output.

    Raises
    ------
    ChannelNameError
    """
    for rule in rules:
        if rule.channel not in outputs:
            raise ChannelNameError(
                f"found --missing for {shown(rule.channel)}; expected an output, one of "
                f"{', '.join(outputs)}; correct the name{did_you_mean(rule.channel, outputs)}"
            )


def _read(table: OpenFile, source: RecordSource, time: str | None, file: Path) -> Record:
    wanted = replace(source.wanted, time=time)
    clocks = {assemble.find_channel(table, name).clock for name in source.columns}
    if len(clocks) > 1 and "band-limited" in (wanted.intersample, wanted.reference_intersample):
        raise OptionError(
            f"found --intersample band-limited and channels of {len(clocks)} clocks in "
            f"{shown(file.name)}; expected one clock, since only held inputs and lines are "
            "evaluated between their samples; choose zoh or foh"
        )
    try:
        return assemble.record_from(table, wanted, printable(file.stem))
    except NonUniformTimeError as error:
        if wanted.dt is None:
            raise
        found = str(error).rpartition(";")[0]
        raise NonUniformTimeError(
            f"{found}; leave --dt out to take the time as it is recorded, correct it, or leave "
            "--time out if only the time stamps are inexact"
        ) from error


def _stamps(table: OpenFile, time: str) -> Array:
    """The column of time as it was written."""
    channel = assemble.find_channel(table, time)
    return np.asarray(table.read([table.channels.index(channel)])[0])


def _uneven(record: Record, time: str | None) -> str:
    """Say how the steps of recorded time differ, and what else could be done."""
    steps, mean = np.diff(record.t), record.duration / (record.n_samples - 1)
    where = f"column {shown(time)}" if time else "the time of the file"
    return (
        f"steps between {steps.min():.6g} and {steps.max():.6g} s in {where} of {record.name}; "
        f"time is taken as it is recorded (if only the time stamps are inexact, --dt {mean:.6g} "
        "without --time states the mean step)"
    )


def _with_steps(table: OpenFile, wanted: Sequence[str], step: float) -> str | None:
    """Name the one column beside those wanted that counts such steps [s], None without one."""
    taken = [assemble.find_channel(table, name) for name in wanted]
    found = []
    for index, channel in enumerate(table.channels):
        scale = SECONDS.get(channel.unit)
        if channel in taken or not channel.header or scale is None:
            continue
        try:
            steps = scale * np.diff(table.read([index])[0])
        except DataError:
            continue
        if steps.size and steps.min() > 0 and abs(steps.mean() - step) <= clock.JITTER * step:
            found.append(channel.header)
    return found[0] if len(found) == 1 else None


def find_time(table: OpenFile, wanted: Sequence[str]) -> str | None:
    """Find the column that is called t or time, in any case, with or without a unit in brackets.

    Parameters
    ----------
    table : OpenFile
    wanted : sequence of str
        Channels that it should be the time of.

    Returns
    -------
    str or None
        None if all of them have a time of their own in the file.

    Raises
    ------
    SamplingError
        There is none, or more than one.
    """
    if all(assemble.find_channel(table, name).clock for name in wanted):
        return None
    names = [channel.header for channel in table.channels if channel.header]
    found = [channel.header for channel in clock.time_channels(table)]
    if len(found) > 1:
        asked = [assemble.find_channel(table, name).header for name in wanted]
        found = [name for name in found if name not in asked]
    if len(found) != 1:
        what = f"the columns {' and '.join(found)}" if found else "no column called t or time"
        raise SamplingError(
            f"found {what} in {shown(table.path.name)}, and neither --time nor --dt; expected to "
            f"know the sampling; give --time NAME (of {shown(', '.join(names), 200)[1:-1]}) or "
            "--dt SECONDS"
        )
    return found[0]
