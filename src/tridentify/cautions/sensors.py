"""What the sensor and its converter did to the samples: coarse steps, limits, hanging, repeats.

All of it is judged with the model at hand, as equal samples alone mean nothing: a step response
that has settled, a simulated record, a coarse converter at rest all repeat their values.

*Quantisation* is harmless while the noise spreads the values over several steps: with Gaussian
noise of half a step or more the error is as good as white, independent, and of variance ``q^2 /
12`` (Widrow & Kollar 2008). Below that it is a function of the signal, neither white nor
independent of the input. Quantised *inputs* are recorded as they acted, so nothing is said.

*Saturation* is a plateau of two and more samples at the largest or smallest value that is entered
with a jump and lies inside of what the model says, on average by more than chance and half a step.
With noise and a coarse converter alone the samples at the largest value are those where the noise
points outward; a response that settles enters its plateau smoothly.

*Hanging* is a run of one value, longer than any that a coarse converter makes by chance, during
which the model moves by several standard deviations of the noise.

*Repeats* are single samples equal to the one before in a signal that otherwise never repeats.

Reference: B. Widrow & I. Kollar, *Quantization Noise*, Cambridge University Press (2008).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tridentify.estimate import Estimate
from tridentify.numerics.converter import Runs, quantum, runs
from tridentify.record import Record

Array = NDArray[np.float64]

LONGEST = 100_000
ROUNDING = 1e-9
DITHER = 0.5
EXACT = 0.1
JUMP = 1e-3
NEAR = 1e-4
FEWEST_AT_LIMIT = 4
BEYOND = 4.0
FEWEST_HANGING = 5
MOVED = 6.0
FEWEST_REPEATS = 3
MOST_REPEATS = 0.1
TURNING = 0.5


def sensor_cautions(estimate: Estimate, record: Record, experiment: int, where: str) -> list[str]:
    """Coarse steps, limits, hanging and repeats in one record.

    Parameters
    ----------
    estimate : Estimate
    record : Record
        Its first 100,000 samples are looked at.
    experiment : int
        Its position among those identified.
    where : str
        What to add to the name of a channel.
    """
    fitted = estimate.predict(record, experiment=experiment)[:LONGEST]
    found: list[str] = []
    for i, name in enumerate(estimate.output_names):
        y, f = record.y[:LONGEST, i], fitted[:, i]
        noise = math.sqrt(float(estimate.noise_variance[i]))
        if not noise > ROUNDING * float(np.sqrt(np.nanmean(y**2))):
            continue
        repeated, q = runs(y), quantum(y)
        if q == 0:
            found += _repeating(y, repeated, name + where)
        if q < EXACT * noise:
            q = 0.0
        found += _coarse(y, q, noise, name + where)
        found += _saturated(y, f, q, noise, repeated, name + where)
        found += _hanging(y, f, q, noise, repeated, name + where)
    for j, name in enumerate(estimate.input_names):
        found += _clipped_input(record.u[:LONGEST, j], name + where)
    return found


def _coarse(y: Array, q: float, noise: float, name: str) -> list[str]:
    """The step of the converter against the noise."""
    if not (q > 0 and EXACT * q < noise < math.sqrt(DITHER**2 + 1.0 / 12.0) * q):
        return []
    levels = round(float(np.nanmax(y) - np.nanmin(y)) / q) + 1
    share = min(q * q / 12.0 / noise**2, 1.0)
    return [
        f"Output {name} is quantised in steps of {q:.4g} ({levels} levels in use), which make "
        f"{100 * share:.0f} % of the residual's variance. The noise is too small to spread such an "
        "error evenly, so it follows the signal and the standard errors are only approximate. Use "
        "a finer range of the converter, or a larger excitation."
    ]


def _saturated(y: Array, f: Array, q: float, noise: float, repeated: Runs, name: str) -> list[str]:
    """Plateaus at the largest and the smallest value, inside of what the model says."""
    found = []
    span = float(np.nanmax(y) - np.nanmin(y))
    for side, limit in ((1.0, float(np.nanmax(y))), (-1.0, float(np.nanmin(y)))):
        at = y == limit
        plateaus = repeated.value == limit
        if at.sum() < FEWEST_AT_LIMIT or not plateaus.any():
            continue
        if np.any(
            repeated.length[~plateaus & _inner(repeated, y)] >= repeated.length[plateaus].max()
        ):
            continue
        first = repeated.first[plateaus]
        entered = np.abs(y[first[first > 0]] - y[first[first > 0] - 1])
        if not entered.size or not float(np.nanmedian(entered)) > max(JUMP * span, 1.5 * q):
            continue
        inside = side * (f[at] - limit)
        if float(inside.mean()) > max(BEYOND * noise / math.sqrt(inside.size), 0.5 * q):
            sign, word = (">=", "largest") if side > 0 else ("<=", "smallest")
            found.append(
                f"{int(at.sum())} samples of {name} stay at its {word} value {limit:.6g}, where "
                "the model goes beyond: the sensor or its converter is saturated there. Mark as "
                f"missing (nan, record.mask) where it is {sign} {limit - side * NEAR * span:.6g}, "
                "or record again with a wider range."
            )
    return found


def _inner(repeated: Runs, y: Array) -> NDArray[np.bool_]:
    """Runs that are neither at the largest nor at the smallest value."""
    return ~np.isin(repeated.value, (np.nanmax(y), np.nanmin(y)))


def _hanging(y: Array, f: Array, q: float, noise: float, repeated: Runs, name: str) -> list[str]:
    """Runs of one value while the model moves."""
    ends = (np.nanmax(y), np.nanmin(y))
    seen = np.isfinite(y)
    pairs = max(int((seen[1:] & seen[:-1]).sum()), 1)
    count = lost = 0
    begin = 0
    for first, length, value in zip(*repeated, strict=True):
        if length < FEWEST_HANGING or value in ends or first == 0:
            continue
        others = float(repeated.length.sum() - repeated.length.size - length + 1)
        chance = min(max(others, 1.0) / pairs, 0.999)
        if (length - 1) * math.log(1.0 / chance) < math.log(pairs) + 7.0:
            continue
        part = f[first : first + length]
        if np.ptp(part) > MOVED * noise + 2.0 * q:
            begin = begin if count else int(first)
            count, lost = count + 1, lost + int(length)
    if not count:
        return []
    times = "once" if count == 1 else f"{count} times"
    return [
        f"Output {name} stays at exactly one value {times} ({lost} samples, the first from sample "
        f"{begin} on) while the model moves: the sensor or the recording hung. Mark these samples "
        "as missing (nan)."
    ]


def _repeating(y: Array, repeated: Runs, name: str) -> list[str]:
    """Single repeats in a signal that otherwise never repeats."""
    span = float(np.nanmax(y) - np.nanmin(y))
    padded = np.concatenate([[np.nan], y, [np.nan]])
    before = np.abs(y[repeated.first] - padded[repeated.first])
    last = repeated.first + repeated.length
    after = np.abs(padded[np.minimum(last + 1, padded.size - 1)] - y[repeated.first])
    moving = (before > JUMP * span) & (after > JUMP * span)
    count = int(np.sum(moving & (repeated.length == 2)))
    if count < FEWEST_REPEATS or count < MOST_REPEATS * repeated.length.sum():
        return []
    return [
        f"{count} samples of {name} repeat the one before exactly, although the signal moves: rows "
        "stored twice, or a sensor slower than the record. Mark the repeats as missing (nan), and "
        "check the times of the samples."
    ]


def _clipped_input(u: Array, name: str) -> list[str]:
    """Plateaus at the ends of an input that is noisy everywhere else."""
    repeated = runs(u)
    ends = (float(u.max()), float(u.min()))
    at_end = np.isin(repeated.value, ends)
    if int(at_end.sum()) < 2 or np.any(~at_end) or repeated.length.max() < 3:
        return []
    free = ~np.isin(u, ends)
    inner = free[1:-1] & free[2:] & free[:-2]
    if inner.sum() < 20:
        return []
    slope = np.diff(u)
    turning = (slope[1:] * slope[:-1] < 0)[inner].mean()
    if not turning > TURNING:
        return []
    count = int(repeated.length[at_end].sum())
    return [
        f"{count} samples of input {name} stay at its ends, {ends[1]:.6g} and {ends[0]:.6g}, while "
        "it is noisy elsewhere: a measured input that is saturated is not what acted on the "
        "system. Check the range of its sensor, or use the command if that is known."
    ]
