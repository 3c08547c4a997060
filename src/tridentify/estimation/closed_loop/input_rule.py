"""Whether recorded inputs follow from recorded samples alone: what kind of controller made them.

A computer that reads reference and output when the record does gives an input that is a function of
these samples,

    u_k  =  sum_i c_i y_{k-i}  +  sum_i d_i r_{k-i}  +  sum_i f_i u_{k-i}  +  constant,      (1)

to the last recorded digit for a linear controller, and for one that meets a limit wherever it does
not. One that acts in continuous time, or more often than is recorded, sees what noise does between
the samples: (1) is then left with an error that no coefficients take away. So the record tells the
two apart without any model of the plant.

A computer that is slower than the record leaves no such rule, but an input that changes at every
second or third sample alone, and is held in between for all to see (`is_held`).

Three cases are not told. A controller without memory, ``u = K (r - y)``, makes (1) either way. And
noise that is held over each interval, as in simulations, tells everything: then (1) holds for a
continuous controller too, but with the states of the plant among those of the rule, so with more
lags than the plant has poles. Fewer lags are a sampled controller's, if they are the whole rule: of
fast samples they leave a millionth of the input where more leave nothing. A plant that integrates
has one state less there: where its output stands is nothing but what the noise is counted from.

Nor does a record without noise: all signals of a linear loop then follow from the references, and
each from any other, whatever the controller. So what is left of (1) counts beside what the input
moves beyond its own past and the references, which is noise.

Where no reference is recorded, a set point that changes at times would take one lag more, and make
one with memory of a controller that has none. So (1) is looked for in what input and outputs move
by, where its changes are single samples that do not fit.

A fourth is not either: a controller that reads more than is recorded (another sensor, an inner
loop), or is not linear, leaves no rule (1) whether it was sampled or not. What a continuous one
makes of noise between the samples mostly is a small part of what it makes of the samples; where
more is left, no rule says nothing (`UNSEEN`).

Coefficients are those of least absolute errors (least squares with weights ``1 / |error|``, again
and again; Schlossmacher 1973, J. American Statistical Association 68, 857-859), which pass through
the majority of the samples where a majority is exact, whatever the others are. A set point that is
not recorded and changes at times leaves a majority too, of a rule with one lag more; but that makes
more of noise, and the least errors are those of another, with errors at the changes. Without these,
and as many samples behind each as there are lags, the rule is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tridentify.numerics.arrays import Array, Flags, Indices
from tridentify.record.record import Record

LAGS = 6
"""Of each signal, at most: a controller of sixth order, its delays included."""
EXACT = 1e-4
"""What is left of an exact rule, beside the rounding of what is recorded, over what the input moves
beyond its own past and the references: continuous controllers leave 6e-3 and more, whatever the
noise (random loops)."""
SHARPER = 3.0
"""Times what more lags leave, that is left of a rule which is not the whole: rounding is reduced by
less, and what a part of a rule leaves by a hundred and more (random loops)."""
NEARLY = 0.1
"""What a rule leaves over what the input moves beyond its own past and the references, up to which
it holds but for noise between the samples: continuous PI leave 0.006 to 0.04, lead 0.1 to 0.3;
sampled ones that read another sensor 0.1 and more (28 random loops)."""
FLOATS = 1e-11
"""Share of the moving input below which what is left is the rounding of the sums."""
PAST = 2 * LAGS
"""Lags of the past that the input moves beyond: of as many states as a rule may stand for."""
COARSE = 3e-3
"""Rounding of the rule over what the input moves beyond its own past and the references, from which
the rule may be hidden: continuous controllers leave 1e-2 of that at least (random loops)."""
FEWEST_CHANGES = 20
"""Of an input that is held over several samples."""
REGULAR = 0.95
"""Share of the pauses between its changes that are multiples of the shortest usual one."""
FINELY = 0.05
"""Rounding over the usual change, from which equal neighbours may be chance."""
MAJORITY = 0.5
"""Share of the samples in which a rule has to hold."""
WITHIN = 1.5
"""Standard deviations of the rounding, within which an exact rule stays in seven samples of eight,
and in more than half of them while its own error is below two."""
USUAL = 0.6745
"""Median of the size of a Gaussian, in standard deviations."""
HIDDEN = 2.0
"""The same of the usual sample, from which no rule has made it."""
FEWEST_EACH, MOST_EACH = 5, 40
"""Samples for each coefficient, at least and at most: more say nothing new of a rule."""
LONGEST = 4000
"""Samples of a record without a reference, one behind the other: work, and no more."""
TURNS = 15
"""Of the weights: a majority that is exact shows in ten."""
CHANGES, ROUNDS = 6.0, 4
"""Times the usual error from which a set point may have changed, and how often they are left out:
two rounds find all."""
FEWEST_VALUES = 16
"""Different values from which a signal may be rounded; one with fewer was set to them."""
MOST_DIGITS = 12
"""Digits behind the point up to which numbers count as rounded."""


class InputRule(Enum):
    """How recorded inputs follow from recorded samples."""

    SAMPLED = "the input follows from the recorded samples to the last digit"
    HELD = "the input stays as it is for several samples, at regular intervals"
    STATIC = "the input follows from the sample at the same time"
    LONGER = "the input follows from more recorded samples than the plant has poles"
    NONE = "the input does not follow from the recorded samples"
    UNSEEN = "what made the input is not linear, or not recorded whole"
    UNKNOWN = "the records do not tell whether the input follows from their samples"


def input_rule(records: Sequence[Record], poles: int) -> InputRule:
    """What the records say of the controller that made their inputs.

    Parameters
    ----------
    records : sequence of Record
        With references, or without: what moved the input beside the outputs is not known then.
    poles : int
        Of the plant.

    Returns
    -------
    InputRule
        ``UNKNOWN`` on uneven time, where too few samples are recorded with all that is behind
        them, where rounding is coarse, and where records or inputs say different things.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> r, y = np.repeat(rng.standard_normal(20), 10), rng.standard_normal(200)
    >>> u = np.cumsum(r - y)
    >>> input_rule([Record(u, y, dt=0.1, reference=r)], 2).name
    'SAMPLED'
    >>> moved = u + 0.01 * rng.standard_normal(200)
    >>> input_rule([Record(moved, y, dt=0.1, reference=r)], 2).name
    'NONE'
    >>> input_rule([Record(u + rng.standard_normal(200), y, dt=0.1, reference=r)], 2).name
    'UNSEEN'
    """
    if all(one.dt is not None and all(map(is_held, np.asarray(one.u).T)) for one in records):
        return InputRule.HELD
    found = {_rule(one, j, min(poles, LAGS)) for one in records for j in range(one.n_inputs)}
    if found == {InputRule.SAMPLED, InputRule.STATIC}:
        return InputRule.SAMPLED
    if found == {InputRule.NONE, InputRule.UNSEEN}:
        return InputRule.UNSEEN
    return found.pop() if len(found) == 1 else InputRule.UNKNOWN


def is_held(u: Array) -> bool:
    """Whether an input changes at regular intervals of several samples alone.

    Parameters
    ----------
    u : (n_samples,) array
        On uniform time.

    Examples
    --------
    >>> slow = np.repeat(np.random.default_rng(0).standard_normal(40), 3)
    >>> is_held(slow), is_held(slow[::3])
    (True, False)
    """
    steps = np.diff(u)
    changes = np.flatnonzero(steps)
    if changes.size < FEWEST_CHANGES:
        return False
    pauses = np.diff(changes)
    usual = int(np.argmax(np.bincount(pauses)))
    fine = _resolution(u[:, None])[0] < FINELY * float(np.median(np.abs(steps[changes])))
    return usual > 1 and bool(fine and np.mean(pauses % usual == 0) > REGULAR)


def _rule(record: Record, j: int, few: int) -> InputRule:
    """Of one input of one record."""
    if record.dt is None or record.n_samples <= LAGS:
        return InputRule.UNKNOWN
    u, y, known = np.asarray(record.u), np.asarray(record.y), record.reference is not None
    reference = np.asarray(record.reference) if known else np.zeros((len(u), 0))
    # a reference that stays for a while was set so
    outer = np.concatenate([_resolution(y), _resolution(reference, converted=False)])
    own = _resolution(u)
    free = _free(u[:, j], np.isfinite(np.hstack([y, reference])).all(axis=1))
    if not known:
        u, y, outer, own = _moves(u), _moves(y), np.sqrt(2.0) * outer, np.sqrt(2.0) * own
        free = free[np.isin(free - 1, free)]  # the move farthest back needs the sample before it
    signals = np.hstack([y, reference])
    width = 1 + signals.shape[1] * (1 + LAGS) + u.shape[1] * LAGS
    size = float(np.std(u[:, j]))
    if free.size < FEWEST_EACH * width or not size > 0:
        return InputRule.UNKNOWN
    # a change that is not known shows in the sample, and in those behind it
    some = free[:LONGEST]
    if known:
        some = free[np.unique(np.linspace(0, free.size - 1, MOST_EACH * width).astype(int))]

    beyond = _beyond_its_past(u, reference, some[some >= PAST], j)

    def holds(lags: int) -> tuple[bool | None, float]:
        table = np.hstack(
            [_lagged(signals, some, range(lags + 1)), _lagged(u, some, range(1, lags + 1))]
        )
        steps = np.concatenate([np.repeat(outer, lags + 1), np.repeat(own, lags)])
        seen = _holds(table, u[some, j], steps, own[j], size, beyond)
        if seen[0] is not False:
            return seen
        steady = _without_changes(table, u[some, j], some, lags)
        if steady.sum() < FEWEST_EACH * width:
            return seen
        again = _holds(table[steady], u[some, j][steady], steps, own[j], size, beyond)
        return again if again[0] else seen

    static, _ = holds(0)
    if static is not False:
        return InputRule.STATIC if static else InputRule.UNKNOWN
    shorter, left = holds(few)
    longer, least = holds(LAGS)
    if shorter and left <= SHARPER * least:
        return InputRule.SAMPLED
    if longer and not (shorter is None or left <= SHARPER * least):
        return InputRule.LONGER
    if shorter or longer is not False:
        return InputRule.UNKNOWN
    return InputRule.NONE if least < NEARLY * beyond else InputRule.UNSEEN


def _without_changes(columns: Array, target: Array, some: Indices, lags: int) -> Array:
    """(n,) whether neither a sample nor one of those before it is off by far more than usual."""
    whole = np.hstack([np.ones((len(target), 1)), columns])
    whole = whole / (np.linalg.norm(whole, axis=0) + 1e-300)
    steady = np.ones(len(target), dtype=bool)
    for _ in range(ROUNDS):
        solved = np.linalg.lstsq(whole[steady], target[steady], rcond=1e-13)[0]
        left = np.abs(target - whole @ solved)
        off = some[left > CHANGES * np.median(left)]
        near = np.unique(off[:, None] + np.arange(lags + 1))
        steady = ~np.isin(some, near)
        if not steady.any():
            break
    return steady


def _beyond_its_past(u: Array, reference: Array, some: Indices, j: int) -> float:
    """Usual size of what an input moves beyond its own past and the references."""
    past = [_lagged(reference, some, range(PAST + 1)), _lagged(u, some, range(1, PAST + 1))]
    table = np.hstack([np.ones((some.size, 1)), *past])
    table = table / (np.linalg.norm(table, axis=0) + 1e-300)
    left = u[some, j] - table @ np.linalg.lstsq(table, u[some, j], rcond=1e-13)[0]
    return float(np.median(np.abs(left))) / USUAL


def _holds(
    columns: Array, target: Array, steps: Array, step: float, size: float, beyond: float
) -> tuple[bool | None, float]:
    """Whether a combination of columns is the target in most samples; None where that is hidden.

    Beside it what it usually leaves, and no less than its rounding.

    Parameters
    ----------
    columns : (n, k) array
    target : (n,) array
    steps : (k,) array
        Between two values that a column may have.
    step : float
        Of the target.
    size : float
        By how much the target moves.
    beyond : float
        The same, beyond its own past and the references.
    """
    whole = np.hstack([np.ones((len(target), 1)), columns])
    scale = np.linalg.norm(whole, axis=0)
    scale[scale == 0] = 1.0
    weights = np.ones(len(target))
    for _ in range(TURNS):
        solved = np.linalg.lstsq(whole * weights[:, None] / scale, target * weights, rcond=1e-13)[0]
        left = np.abs(target - whole @ (solved / scale))
        # rounding is uniform over a step and independent from signal to signal
        rounding = float(np.sqrt((step**2 + (solved / scale)[1:] ** 2 @ steps**2) / 12.0))
        rounding = max(rounding, FLOATS * size)
        usual = max(float(np.median(left)), rounding)
        if np.mean(left <= EXACT * beyond + WITHIN * rounding) > MAJORITY:
            return True if rounding < COARSE * beyond else None, usual
        weights = 1.0 / np.sqrt(np.maximum(left, 1e-3 * EXACT * beyond + FLOATS * size))
    return None if float(np.median(left)) < HIDDEN * rounding else False, usual


def _moves(signals: Array) -> Array:
    """By how much signals move to every sample; the first is not known to move."""
    return np.diff(signals, axis=0, prepend=signals[:1])


def _free(u: Array, seen: Flags) -> Indices:
    """Samples that are seen with their past, the input off the values that it stays at: its limits.

    Only the extremes count, and where they stand twice in a row.
    """
    stays = np.append(False, np.diff(u) == 0.0)
    limits = [value for value in (u.min(), u.max()) if np.any(stays & (u == value))]
    away = seen & ~np.isin(u, limits)
    past = sliding_window_view(away, LAGS + 1).all(axis=1)
    return np.asarray(LAGS + np.flatnonzero(past))


def _lagged(signals: Array, some: Indices, lags: range) -> Array:
    """Columns of every signal at every lag, signal by signal."""
    columns = [one[some - k] for one in signals.T for k in lags]
    return np.column_stack(columns) if columns else np.zeros((some.size, 0))


def _resolution(signals: Array, *, converted: bool = True) -> Array:
    """Smallest step that the numbers of each signal show: of decimals, floats, or a converter."""
    found = []
    for one in (signal[np.isfinite(signal)] for signal in signals.T):
        values, step = np.unique(one), float(np.finfo(float).eps * np.abs(one).max())
        if values.size >= FEWEST_VALUES:
            digits = (d for d in range(MOST_DIGITS) if np.array_equal(one.round(d), one))
            step = max(step, next((10.0**-d for d in digits), 0.0))
            repeated = converted and values.size < 0.5 * one.size
            step = max(step, float(np.diff(values).min())) if repeated else step
        found.append(step)
    return np.array(found)
