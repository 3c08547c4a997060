"""Whether inputs to come explain what is left of an output: feedback, told from its rivals.

A controller acts on what it measures, noise and all, so that the input from a sample on carries
the noise of that sample, and a fit on past inputs leaves what later ones explain (Sims 1972). An
input that was not held as stated leaves something of that kind too: what lies between two samples
is drawn with the next one. So the test is made twice, on what is left of the present explanation
and on what is left of the best rival, beside the past inputs each time.

References: C. Sims, American Economic Review 62 (1972) 540-552.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tridentify.estimation.likelihood.problem import Problem
from tridentify.judgement.causes.attempt import Attempt
from tridentify.judgement.causes.intersample import is_staircase
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import Whitener
from tridentify.numerics.lagrange import added, span
from tridentify.record.record import Record

PAST = 12
"""Past samples of each input that the coming ones are judged beside: an input that is smooth is
known from them."""

COMING = 4
"""Samples to come that a controller may act at first."""

GUARD = 2
"""Samples to come that an input which is not held may act through: between two samples it is drawn
with the next ones."""

CHANCE = 1e-4
"""p-value from which a held input reacts to the output."""

CHANCE_MEASURED = 1e-8
"""The same of an input that is not held: it is smooth, and hardly anything quite linear."""

LEAST_SHARE = 0.02
"""Of the residual that inputs to come must explain."""

AS_MUCH = 0.8
"""Share of the gain of any other cause that inputs to come must have to be named before it."""


class Coming(NamedTuple):
    """What inputs to come explain of one output.

    Attributes
    ----------
    gain : float
        Fall of ``-2 log L``, less twice the number of columns.
    share : float
        Of the whitened residual's sum of squares.
    p_value : float
    lag : int
        Samples until the one that explains most [samples].
    input : int
    """

    gain: float
    share: float
    p_value: float
    lag: int
    input: int

    def is_clear(self, records: Sequence[Record]) -> bool:
        """Whether noise alone does not explain it."""
        held = all(record.behaviour == "zoh" for record in records)
        chance = CHANCE if held else CHANCE_MEASURED
        return self.p_value < chance and self.share > LEAST_SHARE


def reacts(end: Attempt, records: Sequence[Record], best: float) -> list[Coming | None]:
    """Whether the input reacts to the outputs, and no other cause explains it as well.

    Parameters
    ----------
    end : Attempt
        The present explanation.
    records : sequence of Record
    best : float
        Largest fall of the criterion that any other cause brings; 0 for none.

    Returns
    -------
    list of Coming or None
        One per output; None where the input does not react, as one that is commanded and repeats
        its values cannot.
    """
    problem = end.point.problem
    if is_staircase(records):
        return [None] * problem.n_outputs
    ahead, found = guard_of(problem, records), []
    for i in range(problem.n_outputs):
        seen = coming(end, records, i, ahead)
        found.append(seen if seen.is_clear(records) and seen.gain > AS_MUCH * best else None)
    return found


def guard_of(problem: Problem, records: Sequence[Record]) -> int:
    """Samples ahead that may act on the output without feedback."""
    if any(record.behaviour != "zoh" for record in records):
        return GUARD
    orders = [(one.order, i, j) for one in problem.groups for i, j in one.channels]
    return int(any(problem.n_zeros[i][j] == order for order, i, j in orders))


def coming(end: Attempt, records: Sequence[Record], output: int, guard: int) -> Coming:
    """Test inputs to come in what an explanation leaves of one output.

    Parameters
    ----------
    end : Attempt
    records : sequence of Record
        Their inputs.
    output : int
    guard : int
        Samples ahead that may act on the output without feedback: 0 where the input is held and
        the model strictly proper.
    """
    point = end.point
    noise = point.problem.noise[output] if point.problem.noise else np.zeros(0)
    own = point.sensitivities(np.eye(point.jacobian()[1].shape[1]), output)
    residual = [np.ascontiguousarray(one[:, output]) for one in point.residuals()]
    return coming_in(residual, own, noise, records, guard)


def coming_in(
    residual: Sequence[Array],
    own: Sequence[Array],
    noise: Array,
    records: Sequence[Record],
    guard: int,
) -> Coming:
    """Test inputs to come in a residual.

    Parameters
    ----------
    residual : sequence of (n_samples,) arrays
        Per experiment, not whitened; ``nan`` where a sample is missing.
    own : sequence of (n_samples, k) arrays
        Derivatives by all that was fitted.
    noise : (p,) array
        What whitens them.
    records : sequence of Record
    guard : int
        As in `coming`.
    """
    past = [_moved(record.u, range(1 - guard, PAST + 1)) for record in records]
    later = [_moved(record.u, range(-guard - COMING + 1, 1 - guard)) for record in records]
    known = [np.hstack([np.nan_to_num(a), b]) for a, b in zip(own, past, strict=True)]
    e = _white([one[:, None] for one in residual], residual, noise)[:, 0]
    basis = span(_white(known, residual, noise))
    extra = _white(later, residual, noise)
    count = sum(int(np.isfinite(one).sum()) for one in residual)
    test = added(e, basis, span(extra, basis), count)
    ratio = test.statistic * test.dimension / max(test.freedom, 1)
    gain = count * float(np.log1p(ratio)) - 2.0 * test.dimension
    each = [added(e, basis, span(column[:, None], basis), count).share for column in extra.T]
    best, n_inputs = int(np.argmax(each)), records[0].n_inputs
    lag = guard + COMING - 1 - best // n_inputs
    return Coming(gain, test.share, test.p_value, lag, best % n_inputs)


def _moved(u: Array, lags: range) -> Array:
    """Inputs so many samples ago (ahead, where negative), the ends held."""
    rows, last = np.arange(u.shape[0]), u.shape[0] - 1
    since = u - u[0]
    return np.hstack([since[np.clip(rows - lag, 0, last)] for lag in lags])


def _white(columns: Sequence[Array], residual: Sequence[Array], noise: Array) -> Array:
    found = []
    for one, left in zip(columns, residual, strict=True):
        seen = np.isfinite(left)
        rows = np.ascontiguousarray(np.where(seen, np.nan_to_num(one).T, 0.0))
        found.append(Whitener(noise, rows.shape[0]).apply(rows, seen).T)
    return np.vstack(found)
