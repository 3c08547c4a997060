"""A record from the channels of an open file: found by name, in seconds, on one time base.

Channels of one clock become the record as they are. Channels of several clocks need one time base,
since a record has one:

* An output is never altered: its samples stand at the instants it was sampled at, and ``nan`` at
  the others.
* An input is evaluated at the instants of the record by what it does between its own samples: the
  latest value when it is held, the straight line when it is joined by lines. Instants outside those
  of any input are left out. A reference is read like an input.
* ``instants="outputs"`` takes the instants of the outputs; changes of a held input then move to the
  next of them. ``"all"`` takes those of the inputs too, so that nothing is lost, at the price of
  uneven steps where the clocks are not multiples of each other. ``"auto"`` takes all of them if
  they lie on one uniform raster, else those of the outputs.

Instants closer to each other than a thousandth of the smallest mean step are one instant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, cast

import numpy as np

from tridentify.errors import (
    ChannelNameError,
    DuplicateColumnError,
    EmptyRangeError,
    LengthMismatchError,
    MissingColumnError,
    NonUniformTimeError,
    NotFiniteError,
    OptionError,
    SamplingError,
    TooFewSamplesError,
    UnitError,
    shown,
)
from tridentify.numerics.arrays import Array
from tridentify.record.checks.names import did_you_mean, file_units
from tridentify.record.checks.references import drawn_unless_switched
from tridentify.record.checks.samples import Intersample
from tridentify.record.checks.times import TIME_TOLERANCE, sample_range, time_axis, uniform_step
from tridentify.record.formats.channels import Channel, OpenFile
from tridentify.record.formats.time.clock import (
    JITTER,
    check_finite,
    compare_with_own_time,
    seconds_in,
    time_channels,
)
from tridentify.record.record import Record

Instants = Literal["auto", "outputs", "all"]


@dataclass(frozen=True)
class Wanted:
    """What is to become a record; see `read_record`, whose arguments these are."""

    inputs: Sequence[str]
    outputs: Sequence[str]
    time: str | None = None
    dt: float | None = None
    intersample: Intersample = "auto"
    units: Mapping[str, str] | None = None
    start: float | None = None
    stop: float | None = None
    instants: Instants = "auto"
    references: Sequence[str] = ()
    reference_intersample: Intersample | None = None
    needs_outputs: ClassVar[bool] = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "inputs", _as_names("input", self.inputs))
        if self.needs_outputs:
            object.__setattr__(self, "outputs", _as_names("output", self.outputs))
        object.__setattr__(self, "references", _as_names("reference", self.references))
        if self.instants not in ("auto", "outputs", "all"):
            raise OptionError.found(
                "instants=", self.instants, "'auto', 'outputs' or 'all'", "choose one"
            )


class InputsAlone(Wanted):
    """The same where there are no outputs to read: the inputs stand in their place."""

    needs_outputs = False


def _as_names(kind: str, names: Sequence[str]) -> tuple[str, ...]:
    chosen = (names,) if isinstance(names, str) else tuple(names or ())
    if not chosen and kind != "reference":
        raise ChannelNameError(
            f"found no {kind} asked for; expected at least one column; name the {kind} columns"
        )
    return chosen


def record_from(source: OpenFile, wanted: Wanted, name: str) -> Record:
    """Make a record of some channels of an open file.

    Parameters
    ----------
    source : OpenFile
    wanted : Wanted
    name : str
        What to call the record.

    Returns
    -------
    Record

    Raises
    ------
    DataError
        See `read_record`.
    """
    wanted = _with_time(source, wanted)
    known = source.channels
    clock = None if wanted.time is None else find_channel(source, wanted.time)
    # what drives, which is known throughout, comes first
    asked = (*wanted.inputs, *wanted.references, *wanted.outputs)
    channels = [find_channel(source, name) for name in asked]
    n_inputs = len(wanted.inputs)
    n_driving = n_inputs + len(wanted.references)
    names = _channel_names(channels, slice(n_inputs, n_driving))
    if wanted.dt is not None and wanted.time is None:
        compare_with_own_time(source, wanted.dt)
    units = {c.header: c.unit for c in known if c.unit} | _given_units(known, clock, wanted.units)
    values, times = _read(source, channels, clock, wanted, units)
    if len({id(time) for time in times}) == 1:
        t, (first, last) = times[0], sample_range(times[0], wanted.start, wanted.stop)
        for channel, samples in zip(channels[:n_driving], values, strict=False):
            check_finite(source, channel, samples, first, last)
    else:
        t, values = _one_time_base(values, times, wanted)
        t = _with_step(t, wanted.dt)
        first, last = sample_range(t, wanted.start, wanted.stop)
    record = Record(
        _stack(values[:n_inputs], first, last),
        _stack(values[n_driving:] or values[:n_inputs], first, last),
        t=t[first:last],
        intersample=wanted.intersample,
        reference=_stack(values[n_inputs:n_driving], first, last) if wanted.references else None,
        reference_names=names[n_inputs:n_driving],
        reference_intersample=wanted.reference_intersample,
        input_names=names[:n_inputs],
        output_names=names[n_driving:] or [f"{name} itself" for name in names[:n_inputs]],
        units=_kept_units(dict(zip(names, channels, strict=True)), clock, units),
        name=name,
    )
    # the mean step may differ from a stated one in the last digit
    return record if wanted.dt is None else record._derive(dt=float(wanted.dt))


# ------------------------------------------------------------------------------------------ names
def find_channel(source: OpenFile, name: str) -> Channel:
    """Find a channel by its full name, or by its name without unit or prefix.

    Raises
    ------
    MissingColumnError, DuplicateColumnError
        None or several fit.
    """
    wanted = str(name).strip()
    exact = [channel for channel in source.channels if channel.header == wanted and wanted]
    fits = exact or [channel for channel in source.channels if channel.name == wanted and wanted]
    if not fits:
        listed = ", ".join(channel.header for channel in source.channels if channel.header)
        if not listed:
            raise MissingColumnError(
                f"found no channel in {shown(source.path.name)}; expected {shown(name)}; check "
                "that the file was written completely"
            )
        raise MissingColumnError(
            f"found no column {shown(name)} in {shown(source.path.name)}; expected one of "
            f"{shown(listed, 300)[1:-1]}; correct the name"
            f"{_several_or_like(wanted, source.channels)}"
        )
    if len(fits) > 1:
        headers = shown(" or ".join(channel.header for channel in fits), 200)[1:-1]
        raise DuplicateColumnError(
            f"found {len(fits)} columns {shown(name)} in {shown(source.path.name)}; expected one; "
            f"name it in full: {headers}"
        )
    return fits[0]


def _several_or_like(wanted: str, channels: Sequence[Channel]) -> str:
    """What may have been meant by a name that no column has: several columns, or one like it."""
    known = {one.header for one in channels} | {one.name for one in channels}
    parts = [part.strip() for part in wanted.split(",")]
    if len(parts) > 1 and known.issuperset(parts):
        return ": one name each, not several in one"
    return did_you_mean(wanted, [channel.header for channel in channels])


def _channel_names(channels: list[Channel], references: slice) -> tuple[str, ...]:
    """Short names where they tell the channels apart; an input may be a reference too."""
    model = [*channels[: references.start], *channels[references.stop :]]
    for channel in channels:
        if max(model.count(channel), channels[references.start :].count(channel)) > 1:
            raise ChannelNameError(
                f"found the column {shown(channel.header)} asked for more than once; expected "
                "different columns as inputs, outputs and references; drop one"
            )
    short = [channel.name for k, channel in enumerate(channels) if channels.index(channel) == k]
    return tuple(c.name if short.count(c.name) == 1 else c.header for c in channels)


# ------------------------------------------------------------------------------------------ units
def _given_units(
    channels: Sequence[Channel], clock: Channel | None, units: Mapping[str, str] | None
) -> dict[str, str]:
    given: dict[str, str] = {}
    for name, unit in (units or {}).items():
        fits = [channel.header for channel in channels if name in (channel.header, channel.name)]
        if not fits and name == "t" and clock is not None:
            fits = [clock.header]
        if not fits:
            raise UnitError(
                f"found a unit for {shown(name)}; expected the name of a column; correct the name"
                f"{did_you_mean(name, [channel.header for channel in channels])}"
            )
        given.update(dict.fromkeys(fits, unit))
    return given


def _kept_units(
    channels: Mapping[str, Channel], clock: Channel | None, units: Mapping[str, str]
) -> dict[str, str]:
    kept = file_units({n: units[c.header] for n, c in channels.items() if c.header in units})
    return kept | ({"t": "s"} if clock is not None and clock.header in units else {})


# ------------------------------------------------------------------------------------------- time


def _with_time(source: OpenFile, wanted: Wanted) -> Wanted:
    """What is wanted, with the one channel that is time by its name where time is not stated."""
    if wanted.time is not None or wanted.dt is not None:
        return wanted
    names = (*wanted.inputs, *wanted.references, *wanted.outputs)
    asked = [find_channel(source, name) for name in names]
    found = time_channels(source)
    if len(found) > 1:
        # t and T: what is asked for is no time where another column is
        found = [channel for channel in found if channel not in asked]
    if all(channel.clock for channel in asked) or not found:
        return wanted
    if len(found) > 1:
        listed = " and ".join(shown(channel.header) for channel in found)
        raise SamplingError(
            f"found the columns {listed} in {shown(source.path.name)}, and neither time nor dt; "
            "expected to know the sampling; name the column of time or give dt [s]"
        )
    return wanted if found[0] in asked else replace(wanted, time=found[0].header)


def _read(
    source: OpenFile,
    channels: list[Channel],
    clock: Channel | None,
    wanted: Wanted,
    units: Mapping[str, str],
) -> tuple[list[Array], list[Array]]:
    """Give the samples of the channels, and the sampling instants [s] of each."""
    asked = ([clock] if clock else []) + channels
    values = source.read([source.channels.index(channel) for channel in asked])
    named = None if clock is None else seconds_in(source, clock, values.pop(0), units)
    several = len({channel.clock for channel in channels}) > 1
    axes: dict[str, Array] = {}
    for channel, samples in zip(channels, values, strict=True):
        if channel.clock not in axes:
            recorded = named
            if clock is None or clock.clock != channel.clock:
                recorded = source.instants(channel.clock)
            if recorded is None and (wanted.dt is None or several):
                raise _no_time(source, channel, clock, several)
            step = None if several else wanted.dt
            axes[channel.clock] = _sampling_instants(recorded, step, len(samples))
        if len(axes[channel.clock]) != len(samples):
            raise LengthMismatchError(
                f"found {len(samples)} samples of {shown(channel.header)} and "
                f"{len(axes[channel.clock])} of time or another channel in "
                f"{shown(source.path.name)}; expected equal lengths; choose channels that were "
                "sampled together"
            )
        if len(samples) < 2:
            raise TooFewSamplesError.found(
                f"{len(samples)} row in ", source.path.name, "at least 2", "record for longer"
            )
    return values, [axes[channel.clock] for channel in channels]


def _no_time(
    source: OpenFile, channel: Channel, clock: Channel | None, several: bool
) -> SamplingError:
    if clock is None and several:
        return SamplingError(
            f"found channels of different clocks, and no time of {shown(channel.header)} in "
            f"{shown(source.path.name)}; expected to know when each was sampled; name its column "
            "of time"
        )
    if clock is None:
        return SamplingError(
            "found neither a time column (t or time) nor dt; expected at least one, since "
            f"{shown(source.path.name)} does not say when {shown(channel.header)} was sampled; "
            "name the column of time or give dt [s]"
        )
    return SamplingError(
        f"found the time column {shown(clock.header)}, which does not belong to "
        f"{shown(channel.header)}; expected channels that were sampled together; choose the time "
        "of its own group"
    )


def _sampling_instants(recorded: Array | None, dt: float | None, n_samples: int) -> Array:
    if recorded is None:
        return time_axis(dt, None, n_samples)[1]
    if len(recorded) < 2:
        return recorded
    return _with_step(time_axis(None, recorded, n_samples)[1], dt)


def _with_step(t: Array, dt: float | None) -> Array:
    """Put recorded time on a stated step, if there is one, or refuse one that does not agree."""
    if dt is None:
        return t
    step, regular = time_axis(dt, None, len(t))
    if step is None:
        return t
    steps = np.diff(t)
    apart = np.abs(steps - step) > JITTER * step
    if apart.any():
        first = int(np.argmax(apart))
        raise NonUniformTimeError(
            f"found a step of {steps[first]:.6g} s after {t[first]:.6g} s of recorded time; "
            f"expected {step:.6g} s within 5 percent, as stated by dt; leave dt out or correct it"
        )
    shifted = regular + t[0]
    shifted.flags.writeable = False
    return cast(Array, shifted)


# --------------------------------------------------------------------------------- several clocks
def _references_between(samples: Sequence[Array], wanted: Wanted) -> list[Intersample]:
    """What each of the references does between its samples: all the same, as in a record."""
    stated, own = wanted.reference_intersample, wanted.intersample
    return [stated or drawn_unless_switched(own, samples)] * len(samples)


def _one_time_base(
    values: list[Array], times: list[Array], wanted: Wanted
) -> tuple[Array, list[Array]]:
    """Bring channels of several clocks together, as the head of this module says."""
    between = [wanted.intersample] * len(wanted.inputs)
    between += _references_between(values[len(between) :][: len(wanted.references)], wanted)
    driving = len(between)
    slack = TIME_TOLERANCE * min(float(t[-1] - t[0]) / (len(t) - 1) for t in times)
    t = _merged(times, slack)
    if wanted.instants == "outputs" or (wanted.instants == "auto" and uniform_step(t) is None):
        t = _merged(times[driving:] or times, slack)
    low = max(time[0] for time in times[:driving]) - slack
    high = min(time[-1] for time in times[:driving]) + slack
    t = t[(t >= low) & (t <= high)]
    if len(t) < 2:
        what = "inputs and references" if wanted.references else "inputs"
        raise EmptyRangeError(
            f"found {len(t)} instants at which all {what} are known, {low:.6g} to {high:.6g} s; "
            "expected at least 2; choose channels that were recorded at the same time"
        )
    placed = [
        _evaluated(times[k], values[k], t, slack, between[k])
        if k < driving
        else _spread(times[k], values[k], t, slack)
        for k in range(len(values))
    ]
    for k, name in enumerate((*wanted.inputs, *wanted.references)):
        if not np.isfinite(placed[k]).all():
            at = t[int(np.argmin(np.isfinite(placed[k])))]
            kind = "input" if k < len(wanted.inputs) else "reference"
            raise NotFiniteError(
                f"found no finite sample of {kind} {shown(name)} at {at:.6g} s; expected finite "
                "numbers; repair it or cut the record with start and stop"
            )
    return t, placed


def _merged(times: list[Array], slack: float) -> Array:
    """All instants in order; of those that are closer than `slack` the first."""
    union = np.unique(np.concatenate(times))
    return union[np.r_[True, np.diff(union) > slack]]


def _evaluated(
    time: Array, values: Array, t: Array, slack: float, intersample: Intersample
) -> Array:
    if intersample == "foh":
        return np.interp(t, time, values)
    return values[np.searchsorted(time, t + slack, side="right") - 1]


def _spread(time: Array, values: Array, t: Array, slack: float) -> Array:
    """Put samples where they belong, nan elsewhere."""
    spread = np.full(len(t), np.nan)
    place = np.clip(np.searchsorted(t, time - slack), 0, len(t) - 1)
    own = np.abs(t[place] - time) <= slack
    spread[place[own]] = values[own]
    return spread


# ---------------------------------------------------------------------------------------- samples


def _stack(columns: list[Array], first: int, last: int) -> Array:
    stacked = np.empty((last - first, len(columns)))
    for index, values in enumerate(columns):
        stacked[:, index] = values[first:last]
    stacked.flags.writeable = False
    return stacked
