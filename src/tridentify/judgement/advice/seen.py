"""What the parallel model shows of a record: delays, feedback, the input between samples.

Each is a comparison of two linear fits on the same whitened samples. A *delay* is where Schwarz's
criterion is lowest over delayed inputs, the operators' pole and number free again at each: many
operators stand for a delay, too. Its range is where that criterion, or AICc, which takes more of
them, is less than 4 above its lowest (95 % where the number is known). An output that comes a
little before an input that repeats itself looks late by nearly the time after which it does, so
that no delay is looked for there. *Feedback* is a share of the innovations that only later inputs
explain: where the input does not react to the output there is none (Sims 1972). The input between
its samples is compared by `-2 log L`.

Reference: C. Sims, American Economic Review 62 (1972) 540-552.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.search.repeated_input import longest_told
from tridentify.judgement.causes.attempts.intersample import BEHAVIOURS, is_staircase
from tridentify.judgement.causes.attempts.parallel import Parallel, WhitenedFit, p_value
from tridentify.judgement.causes.signals.surprises import moved, small_surprises
from tridentify.numerics.arrays import Array
from tridentify.record.checks.samples import Behaviour, looks_measured
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record

PART = 0.25
"""Longest delay that is looked for, in durations."""

RANGE = 4.0
"""Rise of ``-2 log L`` that a delay is within with 95 %."""

FEW = (1, 2, 3, 4, 6, 8)
"""Operators that are tried at every delay: many of them make up for a delay that is missing."""

AHEAD = (1, 2, 3, 4, 6, 8, 12, 16)
"""Later inputs that are tried [samples]."""

GUARD = 2
"""Later samples that a measured input may act through: between its samples it is drawn with what
comes next."""

MISSED = 0.1
"""Share of the innovations that past inputs explain beside the operators, from which these miss too
much for later inputs to mean feedback."""

FEWEST_AT_REST = 10
"""Samples of rest before the first move by which the noise is known."""

AWAY, LEAST_AWAY = 8.0, 0.1
"""From where an output has left its rest: in standard deviations of what it does there, and of the
whole record."""

BEHIND = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
"""Inputs that go along with the operators [samples]: what these miss of the very first response."""


@dataclass(frozen=True)
class DelaySeen:
    """A delay, as the record shows it.

    Attributes
    ----------
    input, output : str
    value, low, high : float
        Best, and the range that the record allows [s].
    fall : float
        By how much ``-2 log L`` is lower than without.
    """

    input: str
    output: str
    value: float
    low: float
    high: float
    fall: float

    @property
    def text(self) -> str:
        """In words.

        Examples
        --------
        >>> DelaySeen("u", "y", 0.2, 0.1, 0.3, 40.0).text
        '0.2 s (0.1 to 0.3 s)'
        """
        return f"{self.value:.3g} s ({self.low:.3g} to {self.high:.3g} s)"


def delay_seen(parallel: Parallel, fit: WhitenedFit, input_: int) -> DelaySeen:
    """Find how late an input acts.

    Parameters
    ----------
    parallel : Parallel
        With its noise model.
    fit : WhitenedFit
        Its best one.
    input_ : int
    """
    first = parallel.records[0]
    step = typical_step(first.t) if first.dt is None else first.dt
    longest = PART * min(record.duration for record in parallel.records)
    longest = min([longest, *(answered(r, input_, parallel.output) for r in parallel.records)])
    longest = min(longest, longest_told(parallel.records, input_))
    grid = _grid(step, longest)
    poles = list(dict.fromkeys([fit.pole, *parallel.poles()[::2]]))
    orders = sorted({*(order for order in FEW if order < fit.order), fit.order})

    def profile(delay: float) -> tuple[float, float]:
        """By Schwarz's criterion, and by AICc."""
        delays = tuple(delay if j == input_ else d for j, d in enumerate(parallel.delays))
        moved = parallel.changed(delays=delays, left=float(grid[-1]))
        found = [one for pole in poles for one in moved.fits(pole, orders)]
        return min(map(schwarz, found)), min(one.criterion for one in found)

    values = np.array([profile(float(delay)) for delay in grid])
    around = [_around(grid, int(best), step) for best in np.argmin(values, axis=0)]
    finer = np.unique(np.round(np.concatenate(around) / step, 9)) * step
    extra = np.array([delay for delay in finer if np.abs(grid - delay).min() > 0.1 * step])
    more = np.array([profile(float(delay)) for delay in extra]).reshape(-1, 2)
    delays, values = np.concatenate([grid, extra]), np.concatenate([values, more])
    order = np.argsort(delays)
    delays, values = delays[order], values[order]
    best = int(np.argmin(values[:, 0]))
    ranges = [_range(delays, one) for one in values.T]
    return DelaySeen(
        first.input_names[input_],
        first.output_names[parallel.output],
        float(delays[best]),
        min(low for low, _ in ranges),
        max(step, *(high for _, high in ranges)),
        float(values[delays == 0.0][0, 0] - values[best, 0]),
    )


def _around(grid: Array, best: int, step: float) -> Array:
    """Delays between the neighbours of one, half a sample apart or more [s]."""
    low, high = grid[max(best - 1, 0)], grid[min(best + 1, grid.size - 1)]
    return np.arange(low, high + step / 2, max(step / 2, (high - low) / 12))


def schwarz(fit: WhitenedFit) -> float:
    """Schwarz's criterion of a fit (Annals of Statistics 6, 1978, 461-464).

    Parameters
    ----------
    fit : WhitenedFit
    """
    return fit.deviance + fit.rank * float(np.log(fit.count))


def _range(delays: Array, values: Array) -> tuple[float, float]:
    """Delays within `RANGE` of the best one; its neighbours where it is alone."""
    best = int(np.argmin(values))
    within = np.flatnonzero(values <= values[best] + RANGE)
    first, last = int(within[0]), int(within[-1])
    low = delays[max(first - 1, 0)] if first == best else delays[first]
    high = delays[min(last + 1, delays.size - 1)] if last == best else delays[last]
    return float(low), float(high)


def answered(record: Record, input_: int, output: int) -> float:
    """Time after which the output has left its rest, once the inputs leave theirs [s].

    No delay is longer, however alike the periods of a swing are. Infinite where a record does not
    begin at rest, or the output is not clearly away within the time that it was seen to rest.

    Parameters
    ----------
    record : Record
    input_, output : int
        Their places.

    Examples
    --------
    >>> t = np.arange(100.0)
    >>> rng = np.random.default_rng(0)
    >>> y = np.where(t > 43.0, 1.0, 0.0) + 0.02 * rng.standard_normal(100)
    >>> answered(Record(t >= 40.0, y, dt=1.0), 0, 0)
    4.0
    """
    moved = np.flatnonzero((record.u != record.u[0]).any(axis=1))
    rest = int(moved[0]) if moved.size else 0
    if rest < FEWEST_AT_REST or record.u[rest, input_] == record.u[0, input_]:
        return np.inf
    y = record.y[: 2 * rest, output]
    middle, size = np.nanmean(y[:rest]), np.nanstd(y[:rest])
    away = np.abs(y[rest:] - middle) > max(AWAY * size, LEAST_AWAY * np.nanstd(record.y[:, output]))
    lasting = away[:-2] & away[1:-1] & away[2:]
    first = np.flatnonzero(lasting)
    return float(record.t[rest + first[0]] - record.t[rest]) if first.size else np.inf


def _grid(step: float, longest: float) -> Array:
    """Every sample at first, then a fifth more each time [s]."""
    found = [0.0]
    while (following := found[-1] + step * max(1.0, round(0.2 * found[-1] / step))) <= longest:
        found.append(following)
    return np.array(found)


def feedback_seen(parallel: Parallel, fit: WhitenedFit) -> float:
    """Chance that noise alone lets later inputs explain so much; 1 where that cannot be told.

    Parameters
    ----------
    parallel : Parallel
        With its noise model.
    fit : WhitenedFit
        Its best one.

    Notes
    -----
    Where past inputs explain more beside the operators, what is left is no noise but a response
    that the operators miss, and later inputs, which resemble past ones, may stand in for it. Only
    what their past does not tell of them counts, and of that the small moves (`signals.surprises`):
    an input that has none was commanded.
    """
    surprises = small_surprises(parallel.records)
    if not any(np.any(one) for one in surprises):
        return 1.0
    if any(looks_measured(record.u) for record in parallel.records):
        known, later = (*range(-GUARD, 0), *BEHIND), [k for k in AHEAD if k > GUARD]
    else:
        # a held input acts after its sample: what goes along with it made the input
        known, later = BEHIND[1:], [0, *AHEAD]
    beside = [moved(r.u - r.u[0], known) for r in parallel.records]
    ahead = [moved(one, [-k for k in later]) for one in surprises]
    both = [np.hstack(pair) for pair in zip(beside, ahead, strict=True)]
    small = parallel.fits(fit.pole, (fit.order,), beside)[0]
    if 1.0 - small.rss / max(fit.rss, 1e-300) > MISSED:
        return 1.0
    return p_value(small, parallel.fits(fit.pole, (fit.order,), both)[0])


def behaviours_seen(parallel: Parallel, fit: WhitenedFit) -> dict[Behaviour, float]:
    """``-2 log L`` of every behaviour of the inputs that the records allow."""
    present = parallel.records[0].behaviour
    repeats = is_staircase(parallel.records)
    found: dict[Behaviour, float] = {}
    for behaviour in BEHAVIOURS:
        if repeats and behaviour == "band-limited" != present:
            continue  # as `identify`: no measured signal repeats its values
        try:
            records = tuple(record.between(behaviour) for record in parallel.records)
        except TridentifyError:
            continue
        changed = parallel.changed(records=records)
        found[behaviour] = min(f.deviance for f in changed.fits(fit.pole, (fit.order,)))
    return found
