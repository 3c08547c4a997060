"""A measured input that is smooth but for a floor of white noise: whether that noise acted.

*Where it is seen.* The spectrum of a smooth input falls until it meets the noise of its sensor, and
is flat from there on. That floor gives the noise's variance, and the frequency above which the
record of the input holds nothing else.

*Whether it acted.* A floor alone does not say: turbulence, or a controller that passes on the noise
of another sensor, are as flat, and did act. So the input is smoothed forth and back above that
frequency, and the model fitted anew. Noise that acted is missing then, and the record is explained
worse; noise that did not was driving the model, with a residual that follows it, and is gone. What
is left of an input so smoothed is an error that does not depend on the smoothed input, and biases
nothing (Carroll et al. 2006, chapter 4: regression calibration), so that the coefficients move by
the bias that the noise brought. The filter is that of the spectrum (Wiener), which bites into sines
and sweeps, or one that takes off nothing below the edge, whichever leaves less.

Reference: R. Carroll, D. Ruppert, L. Stefanski & C. Crainiceanu, *Measurement Error in Nonlinear
Models*, 2nd ed., Chapman & Hall (2006).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival, one
from tridentify.numerics.arrays import Array
from tridentify.numerics.recent import recent
from tridentify.record.record import Record

FEWEST = 200
"""Samples of a record that show a floor."""

TOP = 0.75
"""Share of the band from which on an input must be noise alone, if it is anywhere."""

SMOOTHED = 16
"""Part of the band over which a spectrum is averaged to see where it meets its floor."""

MEETS = 2.0
"""Averaged spectrum over the floor, above which it holds more than noise: of 25 lines one in ten
thousand is higher by chance."""

CLEAR_OF = 5
"""Part of the band above that meeting in which the input may still show."""

FLAT = 4.5
"""Standard errors by which both halves of a floor may differ."""

STANDS_OUT = 30.0
"""Spectrum over its floor where the input moves, at least: else it is noise that commanded."""

LEAST = 0.005
"""Noise over the spread of an input, below which it moves no coefficient that anyone would see."""

FOLLOWS = 0.05
"""Share of that noise from which outputs of the same sample and before tell it: a controller."""

BEYOND = 1.5
"""Times the edge of a floor, beyond which an input that is smooth has nothing of its own left."""

FAR_BELOW = 0.45
"""Edge of a floor up to which an input is smooth for certain."""

PAST = 3
"""Samples of outputs that may tell it."""

FINELY = 4
"""Lines to either side that a spectrum is averaged over for the filter: the input itself moves
fast from line to line."""

KEPT = 8
"""Inputs whose floor is kept: the quick look and the causes ask for the same."""


class Floor(NamedTuple):
    """White noise that an input carries.

    Attributes
    ----------
    size : float
        Standard deviation; 0 where there is none that is seen.
    edge : float
        Share of the band [0, Nyquist] from which on there is nothing else.
    gain : (n_lines,) array
        Of the filter that leaves the likeliest input without it, evenly from 0 to Nyquist (Wiener):
        what of the spectrum is not the floor.
    """

    size: float
    edge: float
    gain: Array


@recent(KEPT)
def floor_of(u: Array) -> Floor:
    """The floor of an input; of size 0 where it has none.

    Examples
    --------
    >>> t, noise = np.arange(800), np.random.default_rng(0).standard_normal(800)
    >>> found = floor_of(np.cumsum(np.sin(0.07 * t) + np.sin(0.11 * t + 1.0)) + 0.5 * noise)
    >>> 0.4 < found.size < 0.6, found.edge < 0.5
    (True, True)
    >>> floor_of(noise).size
    0.0
    """
    nothing = Floor(0.0, 1.0, np.ones(2))
    n = u.size
    if n < FEWEST:
        return nothing
    # a line between the ends takes away a jump there, which would look like high frequencies
    window = np.hanning(n)
    power = np.abs(np.fft.rfft((u - np.linspace(u[0], u[-1], n)) * window)) ** 2
    power = power[1:] / float(window @ window)
    top = power[int(TOP * power.size) :]
    level = float(top.mean())
    mean = _averaged(power, max(power.size // SMOOTHED // 2, 4))
    peak = int(np.argmax(mean))
    met = np.flatnonzero(mean[peak:] < MEETS * level)
    if not met.size or not level > 0.0 or mean[peak] < STANDS_OUT * level:
        return nothing
    first = peak + int(met[0])
    if first > TOP * power.size:
        return nothing
    # where it meets its floor half of it is still the input
    alone = power[first + (power.size - first) // CLEAR_OF :]
    level = float(alone.mean())
    lower, upper = np.array_split(alone, 2)
    # neighbouring lines of a tapered spectrum share half of what they show
    error = np.sqrt(2.0 * (1.0 / lower.size + 1.0 / upper.size))
    if abs(float(np.log(lower.mean() / upper.mean()))) > FLAT * error:
        return nothing
    size = float(np.sqrt(level))
    if not size > LEAST * float(np.std(u)):
        return nothing
    gain = np.clip(1.0 - level / _averaged(power, FINELY), 0.0, 1.0)
    gain[first:] = 0.0
    return Floor(size, first / power.size, np.concatenate([[1.0], gain]))


def _averaged(power: Array, half: int) -> Array:
    """Every line with so many to either side."""
    width = 2 * half + 1
    return np.convolve(np.pad(power, half, mode="reflect"), np.full(width, 1.0 / width), "valid")


def floors(records: Sequence[Record], j: int) -> list[Floor] | None:
    """Of an input that is not held, one a record; None where none has one."""
    if any(record.dt is None or record.behaviour == "zoh" for record in records):
        return None
    found = [floor_of(np.ascontiguousarray(record.u[:, j])) for record in records]
    return found if any(one.size for one in found) else None


def may_carry_noise(records: Sequence[Record]) -> bool:
    """Whether any input has a floor that may be noise of its sensor."""
    return any(floors(records, j) is not None for j in range(records[0].n_inputs))


def carries_noise(records: Sequence[Record], j: int) -> bool:
    """Whether an input that is smooth far below its band has a floor that follows no output.

    Outputs then know what its samples do not say.
    """
    return any(
        own.size > 0.0 and own.edge < FAR_BELOW and not _follows(record, j, BEYOND * own.edge)
        for record, own in zip(records, floors(records, j) or (), strict=False)
    )


def floor_rivals(present: Present) -> Iterator[Rival]:
    """Inputs that are smooth, without the noise of their sensors."""
    records = present.records
    for j, name in enumerate(records[0].input_names):
        found = floors(records, j)
        if found is None:
            continue
        pairs = list(zip(records, found, strict=True))
        if any(
            own.size and _follows(record, j, min(BEYOND * own.edge, TOP)) for record, own in pairs
        ):
            continue
        largest = max(found, key=lambda own: own.size)
        spread = max(float(np.std(record.u[:, j])) for record in records)
        edge = max(own.edge for own in found if own.size) * 0.5 / present.step
        for filter_, gains in (
            (f"a Wiener filter (gain 1 - floor / spectrum, none above {edge:.2g} Hz)", 1),
            (f"a low-pass filter (all below {edge:.2g} Hz, nothing above)", 0),
        ):
            pairs = [(record, own if gains else _below(own)) for record, own in pairs]
            yield replace(
                one(
                    "input-noise",
                    replace(present, records=tuple(_without(*pair, j) for pair in pairs)),
                    f"an input {name} without the noise of {largest.size:.2g} that was recorded "
                    f"with it ({100.0 * largest.size / spread:.2g} % of its spread; above "
                    f"{edge:.2g} Hz its spectrum is flat)",
                    f"Give what {name} was told to be (the command), measure it with less noise, "
                    "or smooth it forth and back, which delays nothing: what was tried is "
                    f"{filter_}.",
                ),
                kind="floor",
                calms=True,
            )


def _below(own: Floor) -> Floor:
    """With a filter that takes off what is above the edge, and nothing else.

    A spectrum of lines, or one that wanders through the record, is not that of a taper's middle.
    """
    return own._replace(gain=(np.linspace(0.0, 1.0, own.gain.size) <= own.edge).astype(float))


def _without(record: Record, own: Floor, j: int) -> Record:
    if not own.size:
        return record
    u = np.array(record.u)
    u[:, j] = filtered(u[:, j], own.gain)
    return record._derive(u=u)


def filtered(x: Array, gain: Array) -> Array:
    """A signal whose lines are taken so many times: forth and back, without a delay.

    Parameters
    ----------
    x : (n_samples,) array
        Goes on beyond its ends as it is within, turned about these.
    gain : (n_lines,) array
        Evenly from 0 to Nyquist.
    """
    n = x.size
    ends = np.concatenate([2.0 * x[0] - x[:0:-1], x, 2.0 * x[-1] - x[-2::-1]])
    lines = np.fft.rfft(ends)
    share = np.linspace(0.0, 1.0, lines.size)
    lines *= np.interp(share, np.linspace(0.0, 1.0, gain.size), gain)
    return np.asarray(np.fft.irfft(lines, ends.size)[n - 1 : 2 * n - 1])


def _follows(record: Record, j: int, edge: float) -> bool:
    """Whether outputs tell what an input does above its floor: it is a controller's, and acted."""
    fast = (np.linspace(0.0, 1.0, record.n_samples) > edge).astype(np.float64)
    noise = filtered(record.u[:, j], fast)
    columns = []
    for y in record.y.T:
        there = np.isfinite(y)
        if there.sum() < FEWEST:
            continue
        filled = np.interp(np.arange(y.size), np.flatnonzero(there), y[there])
        own = filtered(filled, fast)
        columns += [np.roll(own, lag)[PAST:] for lag in range(PAST + 1)]
    if not columns:
        return False
    known, wanted = np.column_stack(columns), noise[PAST:]
    left = wanted - known @ np.linalg.lstsq(known, wanted, rcond=1e-10)[0]
    chance = 4.0 * known.shape[1] / wanted.size
    return bool(1.0 - float(left @ left) / float(wanted @ wanted) > max(FOLLOWS, chance))
