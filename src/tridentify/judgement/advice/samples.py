"""What is wrong with single samples of a record, as its neighbours tell.

A *bad sample* stands out of what is left by the parallel model against a cubic through its
neighbours, alone: noise has a scale, taken from the middle of all such differences, and a response
that the model misses is smooth or lasts. *Lost rows* are a jump of a measured input and of an
output between the same two samples, each many times what it ever moves otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.validation.interpolated import interpolated_in
from tridentify.numerics.arrays import Array
from tridentify.numerics.converter import quantum, runs
from tridentify.numerics.robust import median_scale
from tridentify.record.checks.samples import looks_measured
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record
from tridentify.writing.layout import first_of

CHANCE = 1e-4
"""Of a Gaussian record in which a sample is taken for bad."""

LEAST = 8.0
"""Standard deviations from which a sample is bad, at least: what the operators miss of an edge may
stand out by seven."""

WIDE = 0.95
"""Quantile that the scale is also taken from, so that heavy tails are not bad samples."""

STEP = 0.5
"""Scale, at least, in steps of a converter."""

MOST_BAD = 0.02
"""Share of bad samples above which the noise has heavy tails instead."""

ROUNDING = 1e-9
"""Of an output without noise, in its standard deviation."""

MISSED = 2e-4
"""What the operators miss about an edge, in standard deviations of the output, at least: with noise
far below that, samples of a response stood out by thousands of standard deviations of the noise."""

FEW_BAD = 3
"""Bad samples that any record may have, however short."""

AT_END = 0.7
"""Weight of the difference at the first and the last sample."""

GROSS = 16.0
"""Standard deviations from which least squares is spoilt."""

ROUNDS = 6
"""Passes, each without the bad samples of those before."""

JUMPED = 12.0
"""Jump in usual ones from which rows are lost."""

LONG_STEP = 1.5
"""Interval in typical ones from which samples are missing."""

FEW = 0.05
"""Share of long intervals up to which they are gaps, not an uneven clock."""

FEWEST_HUNG = 8
"""Equal samples in a row, of a signal that has noise everywhere else, from which it hangs."""

TONE = 0.99
"""Share of the power within five lines of a spectrum that makes a single tone."""

PERIODS = 4
"""Of a tone in the record, at least: below, a step or a pulse has its power there too."""

SLOW_LINES, SLOW = 4, 0.5
"""Periods in the record up to which a disturbance is slow, and its share of what is left."""

FEWEST_LOOKED_AT = 30
"""Samples below which a median of neighbours says nothing of one of them."""
MOST_NAMED = 5
"""Samples that are named by their times; more are counted."""


def bad_samples(record: Record, output: int, left: Array, experiment: int | None) -> list[Finding]:
    """Samples of an output that stand alone.

    Parameters
    ----------
    record : Record
    output : int
    left : (n_samples,) array
        Output less a fitted response; ``nan`` where it is missing.
    experiment : int or None
        Its position; None for the only one.
    """
    y = record.y[:, output]
    rows, far = _standing_alone(left, STEP * quantum(y), float(np.nanstd(y)))
    if not rows.size or rows.size > MOST_BAD * np.isfinite(left).sum() + FEW_BAD:
        return []
    name = record.output_names[output]
    where = "" if experiment is None else f" in experiment {experiment + 1}"
    times = tuple(float(t) for t in record.t[rows])
    several = rows.size > 1
    many = f"{rows.size} samples" if several else "A sample"
    many += f" of {name}{where} {'stand' if several else 'stands'}"
    return [
        Finding(
            "bad-samples",
            "error" if far > GROSS else "warning",
            f"{many} alone, up to {far:.0f} standard deviations away from the "
            f"neighbours ({_named(times)}).",
            "Mark them as missing (nan, record.mask; --missing), or fit with a robust loss "
            "(--loss huber).",
            (name,),
            experiment,
            times,
        )
    ]


def _standing_alone(left: Array, least: float, size_of_y: float) -> tuple[NDArray[np.intp], float]:
    """Bad samples in order, and how far the farthest is off [standard deviations].

    The farthest are taken away first, so that one next to another is seen by what remains.
    """
    rows = np.flatnonzero(np.isfinite(left))
    found: list[int] = []
    farthest = 0.0
    for _ in range(ROUNDS):
        if rows.size < FEWEST_LOOKED_AT:
            break
        off = _beside_neighbours(left[rows])
        size = np.abs(off - np.median(off))
        wide = float(np.quantile(size, WIDE)) / float(ndtri(0.5 + WIDE / 2.0))
        scale = max(median_scale(size), wide, least)
        limit = max(LEAST, -float(ndtri(CHANCE / off.size / 2.0)))
        if not scale > ROUNDING * size_of_y:
            break
        size = size / max(scale, MISSED * size_of_y)
        at = np.flatnonzero((size > limit) & (size >= _largest_nearby(size)))
        if not at.size:
            break
        farthest = max(farthest, float(size[at].max()))
        found += rows[at].tolist()
        rows = np.delete(rows, at)
    return np.array(sorted(found), dtype=np.intp), farthest


def _beside_neighbours(e: Array) -> Array:
    """Differences from a cubic through two neighbours on either side, of straight lines at ends.

    A response that is missed swings between few samples of a coarse record, which a straight line
    follows far less well than a cubic: the differences at the ends are therefore in the scale that
    straight lines have over the whole record.
    """
    off = np.empty_like(e)
    off[2:-2] = e[2:-2] - (4.0 * (e[1:-3] + e[3:-1]) - e[:-4] - e[4:]) / 6.0
    scale = median_scale(off[2:-2])
    between = e[1:-1] - 0.5 * (e[:-2] + e[2:])
    off[[1, -2]] = between[[0, -1]] * _weight(scale, between, 1.0)
    # the one at the very end has a single neighbour, and is not to be blamed for it
    off[[0, -1]] = (e[[0, -1]] - e[[1, -2]]) * _weight(scale, np.diff(e), AT_END)
    return off


def _weight(scale: float, differences: Array, most: float) -> float:
    """What brings differences of another kind to the scale of the cubic's, at most `most`."""
    own = median_scale(differences)
    return min(most, scale / own) if own > 0.0 else most


def _largest_nearby(size: Array) -> Array:
    padded = np.concatenate([np.zeros(2), size, np.zeros(2)])
    return np.asarray(np.max([padded[k : k + size.size] for k in range(5)], axis=0))


def hung(record: Record, output: int, experiment: int | None) -> list[Finding]:
    """Runs of one value inside of a signal that never repeats itself elsewhere.

    Parameters
    ----------
    record : Record
    output : int
    experiment : int or None
        Its position; None for the only one.
    """
    y = record.y[:, output]
    if quantum(y) > 0:
        return []
    repeated = runs(y)
    long = repeated.length >= FEWEST_HUNG
    limits = (np.nanmax(y), np.nanmin(y))
    inside = long & (repeated.first > 0) & ~np.isin(repeated.value, limits)
    # a noise-free signal at rest repeats itself too, and does so before it first moves
    others = int((repeated.length[~long] > 1).sum())
    if not inside.any() or np.any(long & (repeated.first == 0)) or others > MOST_BAD * y.size:
        return []
    first, length = repeated.first[inside], repeated.length[inside]
    name = record.output_names[output]
    where = "" if experiment is None else f" in experiment {experiment + 1}"
    parts = [record.t[k : k + n] for k, n in zip(first, length, strict=True)]
    times = tuple(float(t) for part in parts for t in part)
    return [
        Finding(
            "stuck-sensor",
            "error",
            f"Output {name}{where} stays at exactly one value for {int(length.sum())} samples "
            f"({times[0]:.4g} to {times[-1]:.4g} s) and never repeats itself elsewhere: the sensor "
            "or the recording hung.",
            "Mark these samples as missing (nan, record.mask; --missing).",
            (name,),
            experiment,
            tuple(
                float(t) for k, n in zip(first, length, strict=True) for t in record.t[k : k + n]
            ),
        )
    ]


def single_tone(record: Record, input_: int) -> float:
    """Frequency of an input that is a single tone [rad/s]; 0 where it is not.

    Parameters
    ----------
    record : Record
    input_ : int

    Examples
    --------
    >>> u = np.sin(2.3 * 0.05 * np.arange(1000))
    >>> round(single_tone(Record(u, u, dt=0.05), 0), 1)
    2.3
    """
    even = np.linspace(record.t[0], record.t[-1], record.n_samples)
    u = np.interp(even, record.t, record.u[:, input_])
    power = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(u.size))) ** 2
    peak = int(np.argmax(power))
    near = float(power[max(peak - 2, 0) : peak + 3].sum())
    if peak < PERIODS or near < TONE * float(power.sum()):
        return 0.0
    return 2.0 * np.pi * peak / record.duration


def is_slow(record: Record, left: Array) -> bool:
    """Whether most of what is left of an output is slower than a few periods in the record.

    Parameters
    ----------
    record : Record
    left : (n_samples,) array
        Output less a response; ``nan`` where it is missing.
    """
    seen = np.isfinite(left)
    if seen.sum() < FEWEST_LOOKED_AT:
        return False
    even = np.linspace(record.t[0], record.t[-1], record.n_samples)
    e = np.interp(even, record.t[seen], left[seen])
    power = np.abs(np.fft.rfft(e - e.mean())[1:]) ** 2
    return bool(power[:SLOW_LINES].sum() > SLOW * power.sum() > 0)


def lost_rows(record: Record, fitted: Sequence[Array], experiment: int | None) -> list[Finding]:
    """Jumps of a measured input and of an output at the same place.

    Parameters
    ----------
    record : Record
    fitted : sequence of (n_samples,) arrays
        Responses of the outputs, for their number alone.
    experiment : int or None
        Its position; None for the only one.
    """
    if record.n_samples < FEWEST_LOOKED_AT or not looks_measured(record.u):
        return []
    inputs = np.any([_jumps(column) for column in record.u.T], axis=0)
    outputs = np.any([_jumps(record.y[:, i]) for i in range(len(fitted))], axis=0)
    at = np.flatnonzero(inputs & outputs)
    if not at.size or at.size > MOST_BAD * record.n_samples:
        return []
    times = tuple(float(t) for t in record.t[at + 1])
    where = "" if experiment is None else f" of experiment {experiment + 1}"
    return [
        Finding(
            "lost-rows",
            "error",
            f"Inputs and outputs{where} jump together, and nowhere else so far "
            f"({_named(times)}): rows were lost there.",
            "Cut the record there (record.split, or a --range for each part) and identify the "
            "parts together.",
            (),
            experiment,
            times,
        )
    ]


def _jumps(x: Array) -> NDArray[np.bool_]:
    """Steps between samples that their neighbours do not lead to, and that last."""
    found = np.zeros(x.size - 1, dtype=bool)
    step = np.diff(x)
    expected = 0.5 * (step[:-2] + step[2:])
    off = np.abs(step[1:-1] - expected)
    usual = median_scale(off[np.isfinite(off)])
    beside = np.maximum(np.abs(step[:-2]), np.abs(step[2:]))
    if usual > 0:
        with np.errstate(invalid="ignore"):
            lasts = np.abs(step[1:-1]) > 3.0 * beside
            found[1:-1] = (off > JUMPED * usual) & lasts
    return found


def gaps(record: Record, experiment: int | None) -> list[Finding]:
    """Missing samples: those that are nan or were made up, and intervals that are too long.

    Parameters
    ----------
    record : Record
    experiment : int or None
        Its position; None for the only one.
    """
    found = interpolated_in(record, experiment)
    where = "" if experiment is None else f" in experiment {experiment + 1}"
    lost = np.isnan(record.y)
    if lost.any():
        at = record.t[lost.any(axis=1)]
        found.append(
            Finding(
                "missing-samples",
                "note",
                f"{int(lost.sum())} output samples are missing{where}; estimates do not count "
                "them.",
                experiment=experiment,
                times=(at[0], at[-1]),
            )
        )
    steps = np.diff(record.t)
    long = (
        np.flatnonzero(steps > LONG_STEP * typical_step(record.t))
        if record.dt is None
        else steps[:0]
    )
    if long.size and long.size <= FEW * steps.size:
        times = tuple(float(t) for t in record.t[np.asarray(long, dtype=int)])
        found.append(
            Finding(
                "missing-samples",
                "note",
                f"The time stamps{where} have {long.size} gaps, the longest of "
                f"{float(steps.max()):.3g} s ({_named(times)}). A held input is taken to stay as "
                "it was there.",
                "Cut the record where the input moved in a gap (record.split), and identify the "
                "parts together.",
                experiment=experiment,
                times=times,
            )
        )
    return found


def _named(times: Sequence[float]) -> str:
    return f"at {first_of([f'{t:.4g} s' for t in times], MOST_NAMED)}"
