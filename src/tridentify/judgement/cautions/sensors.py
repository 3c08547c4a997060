"""What the sensor and its converter did to the samples: coarse steps, limits, hanging, repeats.

All of it is judged with the model at hand, as equal samples alone mean nothing: a step response
that has settled, a simulated record, a coarse converter at rest all repeat their values.

*Quantisation* is harmless while the noise spreads the values over several steps: with Gaussian
noise of half a step or more the error is as good as white, independent, and of variance ``q^2 /
12`` (Widrow & Kollar 2008). Below that it is a function of the signal, neither white nor
independent of the input. Quantised *inputs* are recorded as they acted, so nothing is said.

*Saturation* is a plateau of two and more samples at the largest or smallest value that is entered
with a jump and lies inside of what the model says, on average by more than chance and half a step.
A model that was fitted to much saturation may not go beyond it. So plateaus of three and more
samples count too that are cut off in motion: a flat top that a fast system makes of a held input
ends a fixed time after that input changes, and those of saturation do not.
With noise and a coarse converter alone the samples at the largest value are those where the noise
points outward; a response that settles enters its plateau smoothly.

*Hanging* is a run of one value, longer than any that a coarse converter makes by chance, during
which the model moves by several standard deviations of the noise; not one that the output leaves
step by step, as where dry friction holds it.

*Repeats* are single samples equal to the one before in a signal that otherwise never repeats.

Reference: B. Widrow & I. Kollar, *Quantization Noise*, Cambridge University Press (2008).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding, Severity
from tridentify.judgement.causes.first_samples import Predictions, beginning
from tridentify.numerics.arrays import Array
from tridentify.numerics.converter import Runs, quantum, runs
from tridentify.record.record import Record

Ints = NDArray[np.intp]

LONGEST = 100_000
"""Samples of a record that are looked at."""
ROUNDING = 1e-9
"""Noise over output below which it is rounding, and says nothing of a sensor."""
DITHER = 0.5
"""Standard deviation of the noise [steps of the converter] below which rounding is no longer like
white noise: at half a step its error depends on the signal by less than a hundredth."""
EXACT = 0.1
"""Noise over a step of the converter below which it is no noise: samples repeat as the signal
does."""
JUMP = 1e-3
"""Share of the range by which a value must be entered to have been jumped at, and not
approached."""
NEAR = 1e-4
"""Share of the range below a limit from which the advice takes samples out: far below what a
converter resolves."""
FEWEST_AT_LIMIT = 4
"""Samples at the largest or smallest value below which it is a peak."""
BEYOND_NOISE = 4.0
"""Standard errors by which the model must lie beyond the limit on the average: one in 30,000 by
chance."""
FEWEST_HANGING = 5
"""Equal samples in a row below which a sensor has not hung."""
SMOOTHLY = 2.5
"""Steps of the converter by which a value is left without a jump: one of motion, one of noise."""
RARELY = 0.02
"""Runs of equal values a sample, below which values do not repeat by themselves."""
LONG_RUN = 8
"""Equal samples in a row that noise of any size cannot make where values do not repeat."""
MOVED = 6.0
"""Standard deviations of the noise by which the model moves while the sensor stands still: noise of
some ten samples does not spread so far."""
FEWEST_REPEATS = 3
"""Repeated values below which they are chance."""
MOST_REPEATS = 0.1
"""Share of all runs that repeated values must be."""
MOSTLY = 0.8
"""Share of the samples, or of the runs, that make repeating the rule: a slow sensor."""
STATIC = 1e-6
"""Share of the range within which values are a function of the inputs at that moment: the digits of
a file."""
FEWEST_CHANGES = 8
"""Changes below which their common divisor is chance."""
CHANCE = 14.0
"""Log of one over the probability that all changes fall on multiples by chance: 1e-6."""
FEWEST_PLATEAUS = 2
"""Runs at a limit below which it is one peak."""
LEAST_PLATEAU = 3
"""Samples of the longest of them."""
PILED = 2.0
"""Samples at the limit over those one step inside it: noise that is rounded leaves no more at its
end than beside it."""
LOOSE = 0.2
"""Share of runs that may not fit the rule of the others."""
RESTLESS = 0.8
"""Share of samples with a new input from which a still output needs an explanation."""
TURNING = 0.5
"""Share of samples at which the input turns from which an end of its own is no plateau."""


def sensor_findings(
    estimate: Estimate,
    record: Record,
    experiment: int,
    known: Predictions | None = None,
) -> list[Finding]:
    """Coarse steps, limits, hanging and repeats in one record.

    Parameters
    ----------
    estimate : Estimate
    record : Record
        Its first 100,000 samples are looked at.
    experiment : int
        Its position among those identified.
    known : Predictions, optional
        What was computed before.
    """
    record = beginning(record, LONGEST)
    fitted = (known or Predictions(estimate)).fitted(record, experiment)
    several = len(estimate.nuisance) > 1
    return seen_in(record, fitted, estimate.noise_variance, experiment if several else None)


def seen_in(
    record: Record, fitted: Array, noise_variance: Array, experiment: int | None
) -> list[Finding]:
    """Coarse steps, limits, hanging and repeats, whatever the response was fitted with.

    Parameters
    ----------
    record : Record
    fitted : (n_samples, n_outputs) array
        Response of any model.
    noise_variance : (n_outputs,) array
    experiment : int or None
        Its position; None for the only one.
    """
    u = record.u
    found: list[Finding] = []
    where = "" if experiment is None else f" in experiment {experiment + 1}"
    place = _Place(record.t, experiment)
    for i, name in enumerate(record.output_names):
        y, f = record.y[:, i], fitted[:, i]
        noise = math.sqrt(float(noise_variance[i]))
        if not noise > ROUNDING * float(np.sqrt(np.nanmean(y**2))):
            continue
        repeated, q = runs(y), quantum(y)
        own = [repeats := _repeating(y, u, q, f, repeated, name + where)]
        if q < EXACT * min(noise, _fast(y - f)):
            q = 0.0
        own.append(_coarse(y, q, noise, name + where))
        own += _saturated(y, f, u, q, noise, repeated, name + where)
        if repeats is None:
            own.append(_hanging(y, f, u, q, noise, repeated, name + where))
        found += [place.put(seen, name) for seen in own if seen is not None]
    for j, name in enumerate(record.input_names):
        clipped = _clipped_input(record.u[:, j], name + where)
        found += [] if clipped is None else [place.put(clipped)]
    return found


class _Seen(NamedTuple):
    """A finding whose samples are not yet times."""

    code: str
    severity: Severity
    message: str
    remedy: str
    samples: tuple[int, ...] = ()


class _Place(NamedTuple):
    """Of which record the samples are."""

    t: Array
    experiment: int | None

    def put(self, seen: _Seen, *outputs: str) -> Finding:
        """The finding with its times [s]."""
        times = tuple(float(self.t[k]) for k in seen.samples)
        return Finding(
            seen.code, seen.severity, seen.message, seen.remedy, outputs, self.experiment, times
        )


def _fast(residual: Array) -> float:
    """Size of the noise from one sample to the next: what wanders spreads no converter's steps."""
    steps = _finite(np.diff(residual))
    if not steps.size:  # no two neighbours are there: those that are there in turn
        steps = np.diff(_finite(residual))
    return float(np.sqrt(np.mean(steps**2) / 2.0)) if steps.size else 0.0


def _rough(y: Array) -> float:
    """Size of what is not smooth, by third differences: a motion that is sampled well has none."""
    third = _finite(np.abs(np.diff(y, 3)))
    return float(np.median(third) / (0.6745 * math.sqrt(20.0))) if third.size else 0.0


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def _coarse(y: Array, q: float, noise: float, name: str) -> _Seen | None:
    """The step of the converter against the noise."""
    if not (q > 0 and EXACT * q < noise < math.sqrt(DITHER**2 + 1.0 / 12.0) * q):
        return None
    levels = round(float(np.nanmax(y) - np.nanmin(y)) / q) + 1
    share = min(q * q / 12.0 / noise**2, 1.0)
    return _Seen(
        "quantisation",
        "warning",
        f"Output {name} is quantised in steps of {q:.4g} ({levels} levels in use), which make "
        f"{100 * share:.0f} % of the residual's variance. The noise is too small to spread such an "
        "error evenly, so it follows the signal and the standard errors are only approximate.",
        "Use a finer range of the converter, or a larger excitation.",
    )


def _saturated(
    y: Array, f: Array, u: Array, q: float, noise: float, repeated: Runs, name: str
) -> list[_Seen]:
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
        entered = entered[np.isfinite(entered)]
        if not entered.size or not float(np.median(entered)) > max(JUMP * span, 1.5 * q):
            continue
        inside = side * (f[at] - limit)
        beyond = float(inside.mean()) > max(BEYOND_NOISE * noise / math.sqrt(inside.size), 0.5 * q)
        if beyond or _piled(y, u, q, repeated, plateaus, side):
            sign, word = (">=", "largest") if side > 0 else ("<=", "smallest")
            where = "where the model goes beyond" if beyond else "cut off in motion"
            ends = np.flatnonzero(at)
            found.append(
                _Seen(
                    "saturation",
                    "error",
                    f"{int(at.sum())} samples of {name} stay at its {word} value {limit:.6g}, "
                    f"{where}: the sensor or its converter is saturated there.",
                    "Mark as missing (nan, record.mask) where it is "
                    f"{sign} {limit - side * NEAR * span:.6g}, or record again with a wider range.",
                    (int(ends[0]), int(ends[-1])),
                )
            )
    return found


def _piled(
    y: Array, u: Array, q: float, repeated: Runs, plateaus: NDArray[np.bool_], side: float
) -> bool:
    """Whether plateaus at a limit are neither noise of a coarse converter nor of a held input."""
    first, length = repeated.first[plateaus], repeated.length[plateaus]
    if first.size < FEWEST_PLATEAUS or length.max() < LEAST_PLATEAU:
        return False
    limit = float(repeated.value[plateaus][0])
    if q:
        near = np.abs(y - limit + side * q) < 0.5 * q
        if (y == limit).sum() < PILED * near.sum() + FEWEST_AT_LIMIT:
            return False
        padded = np.concatenate([[np.nan], y])
        jumped = np.abs(padded[first] - limit) > 1.5 * q
        first, length = first[jumped], length[jumped]
        if first.size < FEWEST_PLATEAUS:
            return False
    changes = np.flatnonzero(np.any(u[1:] != u[:-1], axis=1)) + 1
    last = first + length
    ends = last[last < y.size]
    return not (
        _follow(ends, first[: ends.size], changes)
        or (q > 0 and _follow(first[first > 0], None, changes, slack=1))
    )


def _follow(times: Ints, begun: Ints | None, changes: Ints, slack: int = 0) -> bool:
    """Whether events come one fixed lag after changes of the input, and none came in between."""
    if not (times.size and changes.size):
        return not times.size
    position = np.searchsorted(changes, times, side="right") - 1
    if begun is not None:
        # an input that moves during a plateau, but for its last samples, does not explain it
        moved = np.searchsorted(changes, times - 2) - np.searchsorted(changes, begun + 1)
        if np.mean(moved > 0) > LOOSE:
            return False
    lags = np.where(position >= 0, times - changes[np.maximum(position, 0)], -times)
    usual = int(np.median(lags))
    return bool(np.mean(np.abs(lags - usual) <= slack) >= 1.0 - LOOSE)


def _inner(repeated: Runs, y: Array) -> NDArray[np.bool_]:
    """Runs that are neither at the largest nor at the smallest value."""
    return ~np.isin(repeated.value, (np.nanmax(y), np.nanmin(y)))


def _hanging(
    y: Array, f: Array, u: Array, q: float, noise: float, repeated: Runs, name: str
) -> _Seen | None:
    """Runs of one value while the model moves."""
    ends = (np.nanmax(y), np.nanmin(y))
    seen = np.isfinite(y)
    pairs = max(int((seen[1:] & seen[:-1]).sum()), 1)
    hung: list[int] = []
    count = 0
    usual = float((repeated.length > 1).sum()) / pairs
    quick = min(noise, _fast(y - f))
    noisy = noise > EXACT * q and (not q or _rough(y) > DITHER * q)
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
        if q and _goes_on(y, f, int(first), int(length), MOVED * quick, q):
            continue
        part = f[first : first + length]
        frozen = restless and not np.ptp(u[first : first + length], axis=0).any()
        # its own residual is part of the noise's size: where nothing else repeats, noise that is
        # there cannot have stood still
        alone = usual < RARELY and length >= LONG_RUN and noisy
        if frozen or alone or np.ptp(part) > MOVED * quick + 2.0 * q:
            hung += range(int(first), int(first + length))
            count += 1
    if not count:
        return None
    times = "once" if count == 1 else f"{count} times"
    return _Seen(
        "stuck-sensor",
        "error",
        f"Output {name} stays at exactly one value {times} ({len(hung)} samples, the first from "
        f"sample {hung[0]} on) while the model moves: the sensor or the recording hung.",
        "Mark these samples as missing (nan, record.mask; --mask).",
        tuple(hung),
    )


def _goes_on(y: Array, f: Array, first: int, length: int, much: float, q: float) -> bool:
    """Whether a value is left by a step of the converter although the model has gone elsewhere.

    After a sensor has hung the output jumps to where it would be. One that goes on from where it
    stood has stood still: it sticks, or its input is too small to move it.
    """
    after = first + length
    if after >= y.size or not np.isfinite(y[after]):
        return False
    left = abs(float(y[after] - y[after - 1]))
    return left <= SMOOTHLY * q and abs(float(f[after] - f[first])) > much + SMOOTHLY * q


def _at_rest(y: Array, u: Array, first: int, length: int) -> bool:
    """Whether an output without noise stands still because no input has moved, or only just."""
    before = y[: first + length]
    moved = float(np.nanmax(before) - np.nanmin(before))
    still = not np.ptp(u[: first + length - FEWEST_HANGING + 1], axis=0).any()
    return still and moved <= STATIC * float(np.nanmax(y) - np.nanmin(y))


def _repeating(y: Array, u: Array, q: float, f: Array, repeated: Runs, name: str) -> _Seen | None:
    """Runs of one value that the signal enters and leaves at a jump."""
    span = float(np.nanmax(y) - np.nanmin(y))
    limits = np.isin(repeated.value, (np.nanmax(y), np.nanmin(y))) & (repeated.length > 2)
    own = ~limits & _jumps(y, repeated, JUMP * span)
    if q:
        own &= _regular(repeated, y, f, q)
    count, lost = int(own.sum()), int((repeated.length[own] - 1).sum())
    if count < FEWEST_REPEATS or count < MOST_REPEATS * repeated.length.size:
        return None
    if _is_static(y, u, repeated, own):
        return None
    lengths = repeated.length[own]
    first = int(repeated.first[own][0])
    again = tuple(k for begin, n in _places(repeated, own) for k in range(begin + 1, begin + n))
    usual = int(np.median(lengths))
    covered = int(lengths.sum()) / int(np.isfinite(y).sum())
    if covered > MOSTLY:
        return _slow(usual, bool(np.mean(lengths == usual) > MOSTLY), lengths, name)
    if usual > 2:
        rows = all(np.ptp(u[k : k + n], axis=0).max() == 0 for k, n in _places(repeated, own))
        what = "the logger may have stopped, as the inputs repeat too" if rows else "they hung"
        return _Seen(
            "stuck-sensor",
            "error",
            f"Output {name} repeats one value exactly in {count} places ({lost} samples, the first "
            f"from sample {first} on), although it moves before and after: {what}.",
            "Mark the repeats as missing (nan); where rows are stored twice, cut the "
            "record there (record.slice), as the inputs in between are lost.",
            again,
        )
    return _Seen(
        "stuck-sensor",
        "warning",
        f"{lost} samples of {name} repeat the one before exactly, although the signal moves: rows "
        "stored twice, or a sensor slower than the record.",
        "Mark the repeats as missing (nan), and check the times of the samples.",
        again,
    )


def _slow(usual: int, regular: bool, lengths: Ints, name: str) -> _Seen:
    """What to do about a sensor slower than the record."""
    if regular:
        how, keep = f"{usual} times in a row", f"keep every {usual}th sample"
        rates = f", or pass the output at its own rate (Record.from_rates, factor {usual})"
    else:
        how, keep = f"{float(lengths.mean()):.2g} times in a row on average", "keep the first"
        rates = ""
    return _Seen(
        "stuck-sensor",
        "error",
        f"Output {name} repeats each value {how}, although the signal moves: its sensor is slower "
        "than the record by that factor. Held values delay the response and spoil the zeros.",
        f"Mark the repeats as missing ({keep} of each value, set the others to nan){rates}.",
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


def _is_static(y: Array, u: Array, repeated: Runs, own: NDArray[np.bool_]) -> bool:
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


def _clipped_input(u: Array, name: str) -> _Seen | None:
    """Plateaus at the ends of an input that is noisy everywhere else."""
    repeated = runs(u)
    ends = (float(u.max()), float(u.min()))
    at_end = np.isin(repeated.value, ends)
    if int(at_end.sum()) < 2 or np.any(~at_end) or repeated.length.max() < 3:
        return None
    free = ~np.isin(u, ends)
    inner = free[1:-1] & free[2:] & free[:-2]
    if inner.sum() < 20:
        return None
    slope = np.diff(u)
    turning = (slope[1:] * slope[:-1] < 0)[inner].mean()
    if not turning > TURNING:
        return None
    count = int(repeated.length[at_end].sum())
    places = np.flatnonzero(np.isin(u, ends))
    return _Seen(
        "saturation",
        "warning",
        f"{count} samples of input {name} stay at its ends, {ends[1]:.6g} and {ends[0]:.6g}, while "
        "it is noisy elsewhere: a measured input that is saturated is not what acted on the "
        "system.",
        "Check the range of its sensor, or use the command if that is known.",
        (int(places[0]), int(places[-1])),
    )
