"""Whether a sensor hung or repeats its values: runs of one value that nothing else explains.

*Hanging* is a run of one value, longer than any that a coarse converter makes by chance, during
which the model moves by several standard deviations of the noise; not one that the output leaves
step by step, as where dry friction holds it.

*Repeats* are single samples equal to the one before in a signal that otherwise never repeats.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.answer.finding import Severity
from tridentify.numerics.arrays import Array
from tridentify.numerics.converter import Runs, runs
from tridentify.numerics.robust import median_scale

Ints = NDArray[np.intp]

EXACT = 0.1
"""Noise over a step of the converter below which it is no noise: samples repeat as the signal
does."""
DITHER = 0.5
"""Standard deviation of the noise [steps of the converter] below which rounding is no longer like
white noise: at half a step its error depends on the signal by less than a hundredth."""
JUMP = 1e-3
"""Share of the range by which a value must be entered to have been jumped at, and not
approached."""
STOOD = 0.5
"""Share of the way that the model went meanwhile within which what comes next goes on from where
the output stood: one that hung would be at its end."""
AT_ONCE = 2.0
"""Largest change of the steps elsewhere above which a signal that stops does so at once: what has
inertia and sticks has come to rest before."""
FEWEST_TURNS = 20
"""Changes of the steps that tell how fast a signal stops."""
FEWEST_HANGING = 5
"""Equal samples in a row below which a sensor has not hung."""
SMOOTHLY = 2.5
"""Steps of the converter by which a value is left without a jump: one of motion, one of noise."""
FAR_OFF = 10.0
"""Range of all other values by which one that is met again and again is away from them: a system
does not get there in one sample, and back."""
FEWEST_CODES = 3
"""Samples with such a value below which it is a spike."""
RARELY = 0.02
"""Runs of equal values a sample, below which values do not repeat by themselves."""
LONG_RUN = 8
"""Equal samples in a row that noise of any size cannot make where values do not repeat."""
MOVED = 6.0
"""Standard deviations of the noise by which the model moves while the sensor stands still: noise of
some ten samples does not spread so far."""
RESTLESS = 0.8
"""Share of samples with a new input from which a still output needs an explanation."""
FEWEST_REPEATS = 3
"""Repeated values below which they are chance."""
MOST_REPEATS = 0.1
"""Share of all runs that repeated values must be."""
ELSEWHERE = range(3, 19)
"""Distances [samples] at which equal samples are met by chance."""
BEYOND_CHANCE = 4.0
"""Times the scatter of their number by which neighbours have to be equal more often."""
MOSTLY = 0.8
"""Share of the samples, or of the runs, that make repeating the rule: a slow sensor."""
STATIC = 1e-6
"""Share of the range within which values are a function of the inputs at that moment: the digits of
a file."""
FEWEST_CHANGES = 8
"""Changes below which their common divisor is chance."""
FEW_BEYOND = 0.01
"""Share of the samples that may be spikes: more are a signal."""
FAR_BEYOND = 10.0
"""Usual steps from one sample to the next by which spikes are away from all others: no signal that
goes on rising gets there in one."""
LONGEST_SPIKE = 2
"""Samples in a row that one spike may have."""
CHANCE = 14.0
"""Log of one over the probability that all changes fall on multiples by chance: 1e-6."""


SLOW = "slow-sensor"
"""Kind of what is said of a sensor that is slower than the record."""


class Seen(NamedTuple):
    """A finding whose samples are not yet times.

    ``lost`` are the stretches, first sample and length, that its remedy leaves out.
    """

    code: str
    severity: Severity
    message: str
    remedy: str
    samples: tuple[int, ...] = ()
    lost: tuple[tuple[int, int], ...] = ()
    kind: str = ""


def fast(residual: Array) -> float:
    """Size of the noise from one sample to the next: what wanders spreads no converter's steps.

    Parameters
    ----------
    residual : (n_samples,) array
    """
    steps = _finite(np.diff(residual))
    if not steps.size:  # no two neighbours are there: those that are there in turn
        steps = np.diff(_finite(residual))
    return float(np.sqrt(np.mean(steps**2) / 2.0)) if steps.size else 0.0


def rough(y: Array) -> float:
    """Size of what is not smooth, by third differences: a motion that is sampled well has none.

    Parameters
    ----------
    y : (n_samples,) array
    """
    third = _finite(np.abs(np.diff(y, 3)))
    return float(np.median(third) / (0.6745 * math.sqrt(20.0))) if third.size else 0.0


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def without_spikes(y: Array) -> Array:
    """An output with what is far from all of its other values missing, where that is little.

    A record that its sensor cuts off may have spikes all the same (of the transmission). Seen from
    one of them the limit is a value like any other, and each stay there a sensor that hung.

    Examples
    --------
    >>> y = np.clip(3.0 * np.sin(0.1 * np.arange(300.0)), -2.0, 2.0)
    >>> y[150] = 9.0
    >>> float(np.nanmax(without_spikes(y))), float(np.nanmin(without_spikes(y)))
    (2.0, -2.0)
    """
    seen = _finite(y)
    if not FEW_BEYOND * seen.size >= 1.0:
        return y
    steps = np.diff(seen)
    # at a limit there is none
    step = FAR_BEYOND * median_scale(steps[steps != 0.0]) if steps.any() else 0.0
    few = int(FEW_BEYOND * seen.size)
    spiked = np.zeros(y.size, dtype=bool)
    for side in (1.0, -1.0):
        far = np.sort(np.partition(side * seen, -few - 1)[-few - 1 :])
        gaps = np.flatnonzero(np.diff(far) > step)
        if gaps.size and step > 0.0:
            spiked |= side * y > far[gaps[0]]
    if not spiked.any():
        return y
    if runs(np.where(spiked, 1.0, np.nan)).length.max(initial=0) > LONGEST_SPIKE:
        return y
    return np.where(spiked, np.nan, y)


def hanging(
    y: Array, f: Array, u: Array, q: float, noise: float, repeated: Runs, name: str
) -> Seen | None:
    """Runs of one value while the model moves.

    Parameters
    ----------
    y, f : (n_samples,) arrays
        Recorded and fitted output.
    u : (n_samples, n_inputs) array
    q : float
        Step of the converter; zero for none.
    noise : float
        Standard deviation.
    repeated : Runs
        Of the recorded output.
    name : str
        Of the output, and where it is.
    """
    if repeated.length.max(initial=0) < FEWEST_HANGING:
        return None
    ends = (np.fmax.reduce(y), np.fmin.reduce(y))
    seen = np.isfinite(y)
    pairs = max(int((seen[1:] & seen[:-1]).sum()), 1)
    stuck: list[tuple[int, int]] = []
    usual = float((repeated.length > 1).sum()) / pairs
    quick = min(noise, fast(y - f))
    noisy = noise > EXACT * q and (not q or rough(y) > DITHER * q)
    restless = np.mean(np.any(u[1:] != u[:-1], axis=1)) > RESTLESS
    for first, length, value in zip(*repeated, strict=True):
        if length < FEWEST_HANGING or value in ends or first == 0:
            continue
        others = float(repeated.length.sum() - repeated.length.size - length + 1)
        chance = min(max(others, 1.0) / pairs, 0.999)
        if (length - 1) * math.log(1.0 / chance) < math.log(pairs) + 7.0:
            continue
        if _at_rest(y, u, int(first), int(length)):
            continue
        if _goes_on(y, f, int(first), int(length), MOVED * quick, q):
            continue
        part = f[first : first + length]
        frozen = restless and not np.ptp(u[first : first + length], axis=0).any()
        # its own residual is part of the noise's size: where nothing else repeats, noise that is
        # there cannot have stood still
        alone = usual < RARELY and length >= LONG_RUN and noisy
        if frozen or alone or np.ptp(part) > MOVED * quick + 2.0 * q:
            stuck.append((int(first), int(length)))
    if not stuck:
        return None
    hung = tuple(k for first, length in stuck for k in range(first, first + length))
    times = "once" if len(stuck) == 1 else f"{len(stuck)} times"
    if all(_left_by_steps(y, first + length, q) for first, length in stuck):
        return Seen(
            "stuck-sensor",
            "warning",
            f"Output {name} stays at exactly one value {times} ({len(hung)} samples, the first "
            f"from sample {hung[0]} on) while the model moves, and goes on from "
            "where it stood: dry friction holds what moves, or the sensor hung and its signal came "
            "back.",
            "If the sensor hung, mark these samples as missing (nan, record.mask; --mask).",
            hung,
            tuple(stuck),
            "held",
        )
    return Seen(
        "stuck-sensor",
        "error",
        f"Output {name} stays at exactly one value {times} ({len(hung)} samples, the first from "
        f"sample {hung[0]} on) while the model moves: the sensor or the recording hung.",
        "Mark these samples as missing (nan, record.mask; --mask).",
        hung,
        tuple(stuck),
    )


def coded(y: Array, name: str) -> Seen | None:
    """One value far from all others that is met again: -999, 9999, 1e20.

    Examples
    --------
    >>> y = np.sin(0.1 * np.arange(100.0))
    >>> y[20:30] = -999.0
    >>> coded(y, "y").samples == tuple(range(20, 30))
    True
    """
    for value in (float(np.fmin.reduce(y)), float(np.fmax.reduce(y))):
        others = y[np.isfinite(y) & (y != value)]
        at = np.flatnonzero(y == value)
        if at.size < FEWEST_CODES or np.unique(others[: LONG_RUN**2]).size < LONG_RUN:
            continue
        if float(np.abs(others - value).min()) < FAR_OFF * float(np.ptp(others)):
            continue
        return Seen(
            "stuck-sensor",
            "error",
            f"Output {name} is exactly {value:g} in {at.size} samples (the first is sample "
            f"{at[0]}), far from all others: a code for missing values.",
            "Mark them as missing (nan, record.mask; --missing), before anything is made of them.",
            tuple(at.tolist()),
            tuple((int(k), 1) for k in at),
            "missing-code",
        )
    return None


def _goes_on(y: Array, f: Array, first: int, length: int, much: float, q: float) -> bool:
    """Whether the output goes on from where it stood although the model has gone elsewhere.

    After a sensor has hung the output jumps to where it would be. One that goes on from where it
    stood, by a step of the converter or less than half of the way that the model went, has stood
    still: it sticks, or its input is too small to move it. Not one that stood still at once, from a
    speed that it does not lose in one sample elsewhere: it hung, and is back near there by chance.
    """
    after = first + length
    if after >= y.size or not np.isfinite(y[after]) or _stops_at_once(y, first, after, q):
        return False
    far = much + SMOOTHLY * q
    went = abs(float(f[after] - f[first]))
    if went > far and _left_by_steps(y, after, q):
        return True
    came, comes = y[first - 1] - f[first - 1], y[after] - f[after]
    behind = abs(float(comes - came)) > far
    return behind and abs(float(y[after] - y[after - 1])) < STOOD * went


def _stops_at_once(y: Array, first: int, after: int, q: float) -> bool:
    """Whether a value is met at a speed that the signal loses nowhere else from sample to sample.

    Examples
    --------
    >>> y = 5.0 * np.sin(0.05 * np.arange(200.0))
    >>> y[60:80] = y[59]
    >>> _stops_at_once(y, 59, 80, 0.01), _stops_at_once(y, 31, 33, 0.01)
    (True, False)
    """
    turns = np.abs(np.diff(y, 2))
    if not 1 < first < after < y.size - 1:
        return False
    elsewhere = _finite(np.concatenate([turns[: first - 1], turns[after:]]))
    if elsewhere.size < FEWEST_TURNS:
        return False
    return bool(turns[first - 1] > AT_ONCE * elsewhere.max() + SMOOTHLY * q)


def _left_by_steps(y: Array, after: int, q: float) -> bool:
    """Whether a value is left as a motion that begins leaves it, not by a jump."""
    if not q or after >= y.size or not np.isfinite(y[after]):
        return False
    return abs(float(y[after] - y[after - 1])) <= SMOOTHLY * q


def _at_rest(y: Array, u: Array, first: int, length: int) -> bool:
    """Whether an output without noise stands still because no input has moved, or only just."""
    before = y[: first + length]
    moved = float(np.nanmax(before) - np.nanmin(before))
    still = not np.ptp(u[: first + length - FEWEST_HANGING + 1], axis=0).any()
    return still and moved <= STATIC * float(np.fmax.reduce(y) - np.fmin.reduce(y))


def repeating(y: Array, u: Array, q: float, f: Array, repeated: Runs, name: str) -> Seen | None:
    """Runs of one value that the signal enters and leaves at a jump; parameters as of `hanging`."""
    if repeated.length.size < FEWEST_REPEATS:
        return None
    span = float(np.fmax.reduce(y) - np.fmin.reduce(y))
    limits = np.isin(repeated.value, (np.fmax.reduce(y), np.fmin.reduce(y))) & (repeated.length > 2)
    own = ~limits & _jumps(y, repeated, JUMP * span)
    if q:
        own &= _regular(repeated, y, f, q)
    count, lost = int(own.sum()), int((repeated.length[own] - 1).sum())
    if count < FEWEST_REPEATS or count < MOST_REPEATS * repeated.length.size:
        return None
    if _is_static(u, repeated, own) or (repeated.length[own].max() == 2 and _meet(y, count)):
        return None
    lengths = repeated.length[own]
    first = int(repeated.first[own][0])
    usual = int(np.median(lengths))
    covered = int(lengths.sum()) / int(np.isfinite(y).sum())
    repeats = tuple((k + 1, n - 1) for k, n in _places(repeated, own))
    again = tuple(k for begin, n in repeats for k in range(begin, begin + n))
    if covered > MOSTLY:
        slow = _slow(usual, bool(np.mean(lengths == usual) > MOSTLY), lengths, name)
        return slow._replace(lost=repeats)
    if usual > 2:
        rows = all(np.ptp(u[k : k + n], axis=0).max() == 0 for k, n in _places(repeated, own))
        what = "the logger may have stopped, as the inputs repeat too" if rows else "they hung"
        return Seen(
            "stuck-sensor",
            "error",
            f"Output {name} repeats one value exactly in {count} places ({lost} samples, the first "
            f"from sample {first} on), although it moves before and after: {what}.",
            "Mark the repeats as missing (nan); where rows are stored twice, cut the "
            "record there (record.slice), as the inputs in between are lost.",
            again,
            # where rows are stored twice, samples that are left out do not put the times right
            () if rows else repeats,
        )
    return Seen(
        "stuck-sensor",
        "warning",
        f"{lost} samples of {name} repeat the one before exactly, although the signal moves: rows "
        "stored twice, or a sensor slower than the record.",
        "Mark the repeats as missing (nan), and check the times of the samples.",
        again,
        repeats,
    )


def _meet(y: Array, count: int) -> bool:
    """Whether samples farther apart are equal as often as neighbours are.

    Noise about a few levels meets a value of a fine converter again at any distance; rows that are
    stored twice, or a slow sensor, are equal to their neighbours alone.
    """
    apart = np.array([np.count_nonzero(y[m:] == y[:-m]) for m in ELSEWHERE if m < y.size])
    usual = float(apart.mean()) if apart.size else 0.0
    return count < usual + BEYOND_CHANCE * math.sqrt(usual + 1.0)


def _slow(usual: int, regular: bool, lengths: Ints, name: str) -> Seen:
    """What to do about a sensor slower than the record."""
    if regular:
        how, keep = f"{usual} times in a row", f"keep every {usual}th sample"
        rates = f", or pass the output at its own rate (Record.from_rates, factor {usual})"
    else:
        how, keep = f"{float(lengths.mean()):.2g} times in a row on average", "keep the first"
        rates = ""
    return Seen(
        "stuck-sensor",
        "error",
        f"Output {name} repeats each value {how}, although the signal moves: its sensor is slower "
        "than the record by that factor. Held values delay the response and spoil the zeros.",
        f"Mark the repeats as missing ({keep} of each value, set the others to nan){rates}.",
        kind=SLOW,
    )


def _places(repeated: Runs, own: NDArray[np.bool_]) -> list[tuple[int, int]]:
    return list(zip(repeated.first[own].tolist(), repeated.length[own].tolist(), strict=True))


def _jumps(y: Array, repeated: Runs, least: float) -> NDArray[np.bool_]:
    """Runs whose neighbours on both sides are away from them by more than ``least``."""
    padded = np.concatenate([[np.nan], y, [np.nan]])
    before = np.abs(repeated.value - padded[repeated.first])
    after = np.abs(padded[repeated.first + repeated.length + 1] - repeated.value)
    return np.asarray((before > least) & (after > least))


def _regular(repeated: Runs, y: Array, f: Array, q: float) -> NDArray[np.bool_]:
    """Runs on one grid of samples, where a coarse converter changes on that grid only.

    Changes of a converter without a clock of its own fall on any sample. All changes on one in
    ``k`` samples, while the model moves by more than two steps in between, are held values.
    """
    none = np.zeros(repeated.length.size, dtype=bool)
    changes = np.flatnonzero((y[1:] != y[:-1]) & np.isfinite(y[1:]) & np.isfinite(y[:-1])) + 1
    if changes.size < FEWEST_CHANGES:
        return none
    factor = int(np.gcd.reduce(np.diff(changes)))
    last = repeated.first + repeated.length - 1
    moved = np.abs(f[last] - f[repeated.first]) > 2.0 * q
    if factor < 2 or (changes.size - 1) * math.log(factor) < CHANCE or moved.sum() < 3:
        return none
    return np.asarray(repeated.length <= 2 * factor)


def _is_static(u: Array, repeated: Runs, own: NDArray[np.bool_]) -> bool:
    """Whether the values that repeat are those of a held input, exactly, without dynamics."""
    places = _places(repeated, own)
    if any(np.ptp(u[k : k + n - 1], axis=0).max() > 0 for k, n in places):
        return False
    last = (repeated.first + repeated.length - 2)[own]
    matrix = np.column_stack([u[last], np.ones(last.size)])
    values = repeated.value[own]
    if values.size <= matrix.shape[1]:
        return False
    left = values - matrix @ np.linalg.lstsq(matrix, values)[0]
    return bool(np.abs(left).max() <= STATIC * np.ptp(values))
