"""What the sensor and its converter did to the samples: coarse steps and limits.

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

Reference: B. Widrow & I. Kollar, *Quantization Noise*, Cambridge University Press (2008).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.attempts.first_samples import Predictions, beginning
from tridentify.judgement.cautions.stuck import (
    DITHER,
    EXACT,
    JUMP,
    Seen,
    coded,
    fast,
    hanging,
    repeating,
    without_spikes,
)
from tridentify.judgement.cautions.wraps import wrapped
from tridentify.numerics.arrays import Array
from tridentify.numerics.converter import Runs, quantum, runs
from tridentify.numerics.quantiles import root_mean_square
from tridentify.record.record import Record

Ints = NDArray[np.intp]

LONGEST = 100_000
"""Samples of a record that are looked at."""
ROUNDING = 1e-9
"""Noise over output below which it is rounding, and says nothing of a sensor."""
NEAR = 1e-4
"""Share of the range below a limit from which the advice takes samples out: far below what a
converter resolves."""
FEWEST_AT_LIMIT = 4
"""Samples at the largest or smallest value below which it is a peak."""
BEYOND_NOISE = 4.0
"""Standard errors by which the model must lie beyond the limit on the average: one in 30,000 by
chance."""
FEWEST_PLATEAUS = 2
"""Runs at a limit below which it is one peak."""
LEAST_PLATEAU = 3
"""Samples of the longest of them."""
PILED = 2.0
"""Samples at the limit over those one step inside it: noise that is rounded leaves no more at its
end than beside it."""
LOOSE = 0.2
"""Share of runs that may not fit the rule of the others."""
TURNING = 0.5
"""Share of samples at which the input turns from which an end of its own is no plateau."""


def sensor_findings(
    estimate: Estimate,
    record: Record,
    experiment: int,
    known: Predictions | None = None,
    recorded: Record | None = None,
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
    recorded : Record, optional
        What the sensors gave, where the estimate is a fit to something else.
    """
    record, fitted = _given(estimate, record, experiment, known, recorded)
    several = len(estimate.nuisance) > 1
    return seen_in(record, fitted, estimate.noise_variance, experiment if several else None)


def _given(
    estimate: Estimate,
    record: Record,
    experiment: int,
    known: Predictions | None,
    recorded: Record | None,
) -> tuple[Record, Array]:
    """What sensors gave, and what the estimate makes of it.

    What a reference drives is no value of a sensor: nothing of it repeats, and no step is seen.
    """
    record = beginning(record, LONGEST)
    fitted = (known or Predictions(estimate)).fitted(record, experiment)
    if recorded is None or recorded is record:
        return record, fitted
    given = beginning(recorded, LONGEST)
    return given, given.y - record.y + fitted


def recorded_findings(estimate: Estimate, records: Sequence[Record]) -> list[Finding]:
    """The same of a plant whose response no record shows: beside the sample before, each.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
    """
    found = []
    for number, whole in enumerate(records):
        record = beginning(whole, LONGEST)
        before = np.vstack([record.y[:1], record.y[:-1]])
        place = number if len(records) > 1 else None
        found += seen_in(record, before, estimate.noise_variance, place)
    return found


def stuck_samples(
    estimate: Estimate,
    record: Record,
    experiment: int,
    known: Predictions | None = None,
    recorded: Record | None = None,
) -> NDArray[np.bool_]:
    """Samples that the remedy of a sensor that hung, or repeats its values, leaves out.

    Parameters
    ----------
    estimate : Estimate
    record : Record
    experiment : int
    known : Predictions, optional
    recorded : Record, optional
        As in `sensor_findings`.

    Returns
    -------
    (n_samples, n_outputs) bool array
    """
    short, fitted = _given(estimate, record, experiment, known, recorded)
    stuck = np.zeros(record.y.shape, dtype=bool)
    for seen, name in _seen(short, fitted, estimate.noise_variance, ""):
        for first, length in seen.lost:
            stuck[first : first + length, record.output_names.index(name)] = True
    return stuck


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
    where = "" if experiment is None else f" in experiment {experiment + 1}"
    place = _Place(record.t, experiment)
    found = [place.put(seen, name) for seen, name in _seen(record, fitted, noise_variance, where)]
    for j, name in enumerate(record.input_names):
        clipped = _clipped_input(record.u[:, j], name + where)
        found += [] if clipped is None else [place.put(clipped)]
    return found


def _seen(
    record: Record, fitted: Array, noise_variance: Array, where: str
) -> Iterator[tuple[Seen, str]]:
    """What is seen of every output, with its name."""
    u = record.u
    for i, name in enumerate(record.output_names):
        y, f = without_spikes(record.y[:, i]), fitted[:, i]
        noise = math.sqrt(float(noise_variance[i]))
        if not noise > ROUNDING * float(root_mean_square(y)):
            continue
        if (wraps := wrapped(record.y[:, i], name + where)) is not None:
            yield wraps, name
            continue
        if (code := coded(y, name + where)) is not None:
            yield code, name
            y = np.where(np.isin(np.arange(y.size), code.samples), np.nan, y)
        repeated, least = runs(y), EXACT * min(noise, fast(y - f))
        q = quantum(y, 0.0 if repeated.first.size else least)
        own = [repeats := repeating(y, u, q, f, repeated, name + where)]
        if q < least:
            q = 0.0
        own.append(_coarse(y, q, noise, name + where))
        own.append(_saturated(y, f, u, q, noise, repeated, name + where))
        if repeats is None:
            own.append(hanging(y, f, u, q, noise, repeated, name + where))
        yield from ((seen, name) for seen in own if seen is not None)


class _Place(NamedTuple):
    """Of which record the samples are."""

    t: Array
    experiment: int | None

    def put(self, seen: Seen, *outputs: str) -> Finding:
        """The finding with its times [s]."""
        times = tuple(float(self.t[k]) for k in seen.samples)
        return Finding(
            seen.code,
            seen.severity,
            seen.message,
            seen.remedy,
            outputs,
            self.experiment,
            times,
            kind=seen.kind,
        )


def _coarse(y: Array, q: float, noise: float, name: str) -> Seen | None:
    """The step of the converter against the noise."""
    if not (q > 0 and EXACT * q < noise < math.sqrt(DITHER**2 + 1.0 / 12.0) * q):
        return None
    levels = round(float(np.fmax.reduce(y) - np.fmin.reduce(y)) / q) + 1
    share = min(q * q / 12.0 / noise**2, 1.0)
    return Seen(
        "quantisation",
        "warning",
        f"Output {name} is quantised in steps of {q:.4g} ({levels} levels in use), which make "
        f"{100 * share:.0f} % of the residual's variance. The noise is too small to spread such an "
        "error evenly, so it follows the signal and the standard errors are only approximate.",
        "Use a finer range of the converter, or a larger excitation.",
    )


class _Limit(NamedTuple):
    """A plateau at an end of the values."""

    side: float
    """1 at the largest value, -1 at the smallest."""
    value: float
    at: NDArray[np.bool_]
    beyond: bool
    """Whether the model goes on where the samples stay; else they are cut off in motion."""


def _saturated(
    y: Array, f: Array, u: Array, q: float, noise: float, repeated: Runs, name: str
) -> Seen | None:
    """Plateaus at the largest and the smallest value, inside of what the model says."""
    ends = ((1.0, float(np.fmax.reduce(y))), (-1.0, float(np.fmin.reduce(y))))
    tried = (_at_end(y, f, u, q, noise, repeated, side, value) for side, value in ends)
    found = [one for one in tried if one is not None]
    if not found:
        return None
    span = ends[0][1] - ends[1][1]
    at = np.any([one.at for one in found], axis=0)
    words = {1.0: ("largest", ">="), -1.0: ("smallest", "<=")}
    values = " or ".join(f"its {words[one.side][0]} value {one.value:.6g}" for one in found)
    bad = " or ".join(
        f"{words[one.side][1]} {one.value - one.side * NEAR * span:.6g}" for one in found
    )
    beyond = all(one.beyond for one in found)
    where = "where the model goes beyond" if beyond else "cut off in motion"
    places = np.flatnonzero(at)
    return Seen(
        "saturation",
        "error",
        f"{places.size} samples of {name} stay at {values}, {where}: the sensor or its converter "
        "is saturated there.",
        f"Mark as missing (nan, record.mask) where it is {bad}, or record again with a wider "
        "range.",
        (int(places[0]), int(places[-1])),
    )


def _at_end(
    y: Array,
    f: Array,
    u: Array,
    q: float,
    noise: float,
    repeated: Runs,
    side: float,
    limit: float,
) -> _Limit | None:
    """The limit that one end of the values is; None where it is a peak, or the system's rest."""
    span = float(np.fmax.reduce(y) - np.fmin.reduce(y))
    at = y == limit
    plateaus = repeated.value == limit
    if at.sum() < FEWEST_AT_LIMIT or not plateaus.any():
        return None
    as_long = _inner(repeated, y) & (repeated.length >= repeated.length[plateaus].max())
    beside = zip(repeated.first[as_long], repeated.length[as_long], strict=True)
    # where the model rests too it is the system that stands
    if any(np.ptp(f[k : k + n]) > max(q, noise) for k, n in beside):
        return None
    first = repeated.first[plateaus]
    entered = np.abs(y[first[first > 0]] - y[first[first > 0] - 1])
    entered = entered[np.isfinite(entered)]
    if not entered.size or not float(np.median(entered)) > max(JUMP * span, 1.5 * q):
        return None
    inside = side * (f[at] - limit)
    beyond = float(inside.mean()) > max(BEYOND_NOISE * noise / math.sqrt(inside.size), 0.5 * q)
    if not (beyond or _piled(y, u, q, repeated, plateaus, side)):
        return None
    return _Limit(side, limit, at, beyond)


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
    return ~_one_of(repeated.value, (np.fmax.reduce(y), np.fmin.reduce(y)))


def _one_of(values: Array, few: Sequence[float]) -> NDArray[np.bool_]:
    """As `numpy.isin`, which sorts."""
    found = np.zeros(values.size, dtype=bool)
    for one in few:
        found |= values == one
    return found


def _clipped_input(u: Array, name: str) -> Seen | None:
    """Plateaus at the ends of an input that is noisy everywhere else.

    Nothing is no limit: rain, sunlight and heaters rest there.
    """
    repeated = runs(u)
    ends = [end for end in (float(u.max()), float(u.min())) if end != 0.0]
    at_end = _one_of(repeated.value, ends)
    if int(at_end.sum()) < 2 or np.any(~at_end) or repeated.length.max() < 3:
        return None
    free = ~_one_of(u, ends)
    inner = free[1:-1] & free[2:] & free[:-2]
    if inner.sum() < 20:
        return None
    slope = np.diff(u)
    turning = (slope[1:] * slope[:-1] < 0)[inner].mean()
    if not turning > TURNING:
        return None
    count = int(repeated.length[at_end].sum())
    places = np.flatnonzero(~free)
    at = " and ".join(f"{end:.6g}" for end in reversed(ends))
    return Seen(
        "saturation",
        "warning",
        f"{count} samples of input {name} stay at its ends, {at}, while it is noisy elsewhere: a "
        "measured input that is saturated is not what acted on the system.",
        "Check the range of its sensor, or use the command if that is known.",
        (int(places[0]), int(places[-1])),
    )
