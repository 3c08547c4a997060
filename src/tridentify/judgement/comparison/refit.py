"""A model held, and everything that belongs to a record alone fitted to that record.

The response of a model to the input of a record is ``y = G u + N x``: the columns ``N`` are the
free responses of its denominators (the unknown initial state), a constant (the unknown trim) and,
where it is asked for, a straight line. They enter linearly and each output has its own, so ``x``
is one small least-squares problem an output, on the triangle of the columns.

With delays, what came before the first sample reaches the output until the last of the inputs has
arrived; these samples are neither explained nor counted, as in an estimation. Modes that grow are
taken backward in time (`both_ways`).
"""

from __future__ import annotations

import numpy as np

from tridentify.errors import ScaleError
from tridentify.judgement.comparison.both_ways import grows, responses
from tridentify.models.columns import drift_columns
from tridentify.models.simulate import free_responses, simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.least_squares import solve, triangle
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

ROUNDING = 1e-13
"""Of the largest number that is added up: what is left of a difference has an error of so much."""
LOST = 0.01
"""Share of an output's movement that rounding may make up: a hundredth moves a fit by as much."""


def refitted(model: TransferFunction, record: Record, *, drift: int) -> Array:
    """Response of a model with offset, initial state and perhaps drift fitted to a record.

    Parameters
    ----------
    model : TransferFunction
        Held.
    record : Record
        Of the model's inputs and outputs, in their order.
    drift : int
        Degree of the polynomial in time that is fitted too.

    Returns
    -------
    (n_samples, n_outputs) array
        In units of the outputs; ``nan`` before the last delayed input has arrived, and everywhere
        for an output whose response leaves the range of numbers or drowns in rounding, as that of
        an unstable model with a delay does over a long record.

    Examples
    --------
    >>> model = TransferFunction([2.0], [1.0, 1.0])
    >>> u, t = np.zeros(4), np.arange(4.0)
    >>> record = Record(u, 3.0 + 0.5 * np.exp(-t), t=t)
    >>> (refitted(model, record, drift=0)[:, 0] - record.y[:, 0]).round(12).tolist()
    [0.0, 0.0, 0.0, 0.0]
    """
    nothing = np.full((record.n_samples, model.n_outputs), np.nan)
    since = record.t - record.t[0]
    late = float(np.max(model.delay, initial=0.0))
    begin = int(np.searchsorted(since, (1.0 - 1e-9) * late))
    if begin >= record.n_samples:
        return nothing
    try:
        if grows(model, record.duration):
            driven, free = responses(model, record)
        else:
            driven, free = simulate(model, record), _free(model, record, float(since[begin]))
    except ScaleError:
        return nothing
    found = nothing
    constants = [np.ones((record.n_samples, 1)), drift_columns(since / since[-1], drift).T]
    for i in range(model.n_outputs):
        columns = np.hstack([*free[i], *constants])
        seen = np.isfinite(record.y[:, i])
        seen[:begin] = False
        if not np.any(seen):
            continue
        left = record.y[seen, i] - driven[seen, i]
        size = float(np.max(np.abs(driven[seen, i])))
        moved = record.y[seen, i] - record.y[seen, i].mean()
        if ROUNDING * size > LOST * float(np.sqrt(np.mean(moved**2))) > 0:
            continue
        columns = columns / _lengths(columns[seen])
        small = triangle(np.column_stack([columns[seen], left]))
        x = solve(small[:, :-1], small[:, -1]).x
        found[begin:, i] = driven[begin:, i] + columns[begin:] @ x
    return found


def _free(model: TransferFunction, record: Record, after: float) -> list[list[Array]]:
    """Free responses of the different denominators behind every output."""
    known: dict[bytes, Array] = {}
    found = []
    for row in model.den:
        own = {den.tobytes(): den for den in row if den.size > 1}
        for key, den in own.items():
            if key not in known:
                known[key] = free_responses(den, record, after)
        found.append([known[key] for key in own])
    return found


def _lengths(columns: Array) -> Array:
    """Lengths of the columns, without overflow; one for a column of zeros."""
    largest = np.max(np.abs(columns), axis=0)
    largest = np.where(largest > 0, largest, 1.0)
    lengths = largest * np.sqrt(np.sum((columns / largest) ** 2, axis=0))
    return np.where(lengths > 0, lengths, 1.0)
