"""What a residual is searched for: inputs past and coming, drifts, later changes.

All are columns beside the residual, experiment by experiment, not whitened. What the input was
before the record is unknown and taken for its first value: a column need not be the truth to be
uncorrelated with noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.validation.residuals import Output, View
from tridentify.judgement.validation.statistics import bends
from tridentify.numerics.arrays import Array
from tridentify.numerics.kept import cached_property

MOST_LAGS = 40
"""Knots of a response that is looked for in the residual."""
AHEAD = 4
"""Samples to come at which feedback is looked for first, where the input is not held."""
FIRST_LAGS = 4
"""Lags that are knots of their own, as a direct term or a delay shows there."""
PER_COLUMN = 6
"""Samples for each knot at least: with fewer the F test has no power."""
WAVES = 4
"""A constant and three cosines, the quickest of one and a half periods over the record."""


def past_lags(view: View, output: Output) -> list[int]:
    """Knots [samples] of the responses that are looked for: first each lag, then wider."""
    n_inputs = view.records[0].n_inputs
    most = max(min(MOST_LAGS, output.count // (PER_COLUMN * n_inputs)), 3)
    longest = max(min(record.n_samples for record in view.records) // 4, most)
    return list(_knots(most, longest))


@lru_cache(maxsize=64)
def _knots(most: int, longest: int) -> tuple[int, ...]:
    grown = np.round(np.geomspace(1.0, longest + 1.0, most)).astype(int) - 1
    return tuple(sorted({*range(min(FIRST_LAGS, most)), *grown.tolist()}))


def moved_input(view: View, channel: int, lag: int) -> tuple[Array, ...]:
    """One input so many samples earlier (later, where ``lag`` is negative), per experiment."""
    found = []
    for record in view.records:
        u = np.asarray(record.u[:, channel] - record.u[0, channel])
        n = u.size
        k = min(abs(lag), n)
        moved = np.full(n, 0.0 if lag >= 0 else float(u[-1]))
        if lag >= 0:
            moved[k:] = u[: n - k]
        else:
            moved[: n - k] = u[k:]
        found.append(moved)
    return tuple(found)


def responses(
    view: View, channels: Sequence[int], lags: Sequence[int], *, coming: bool = False
) -> tuple[Array, ...]:
    """Responses to several inputs that together make any smooth one, (n_samples, k) per experiment.

    Parameters
    ----------
    view : View
    channels : sequence of int
        Inputs.
    lags : sequence of int
        Knots: response ``k`` rises from knot ``k - 1``, has its peak at knot ``k``, is zero from
        knot ``k + 1`` on.
    coming : bool
        Of the samples to come in place of those before.
    """
    found = []
    for record in view.records:
        columns = []
        for j in channels:
            u = np.asarray(record.u[:, j] - record.u[0, j])
            if coming:
                # the last value stays; the present one belongs to the past, and so do the next
                # ones of an input that is not held: what lies between the samples is not known
                ahead = 1 if record.behaviour == "zoh" else AHEAD
                moved = np.append(u[ahead:], np.full(ahead, u[-1]))[::-1]
                columns.append(_hats(moved - moved[0], lags)[::-1])
            else:
                columns.append(_hats(u, lags))
        found.append(np.hstack(columns))
    return tuple(found)


def _hats(u: Array, lags: Sequence[int]) -> Array:
    """An input through each of several responses."""
    from tridentify.numerics.kernels.hats import through_hats

    found = np.empty((len(lags), u.size))
    through_hats(np.ascontiguousarray(u), _between(tuple(lags)), found)
    return found.T


@lru_cache(maxsize=16)
def _between(lags: tuple[int, ...]) -> NDArray[np.int64]:
    """(k, 3) where each response rises from, its peak, and where it is zero again."""
    return np.stack([[lags[0] - 1, *lags[:-1]], lags, [*lags[1:], lags[-1] + 1]], axis=1)


def waves(view: View) -> tuple[Array, ...]:
    """A constant and slow cosines, for each experiment its own."""
    many = len(view.records)
    count = WAVES if many == 1 else 2 if many < 4 else 1
    found = []
    for e, record in enumerate(view.records):
        since = record.t - record.t[0]
        phase = np.pi * since / since[-1]
        own = np.zeros((record.n_samples, many * count))
        own[:, e * count : (e + 1) * count] = np.cos(np.outer(phase, np.arange(count)))
        found.append(own)
    return tuple(found)


def later(view: View, output: Output) -> tuple[Array, ...]:
    """The derivatives by the coefficients, in the second half of all samples only."""
    total = sum(record.n_samples for record in view.records)
    before, found = 0, []
    for one in output.coefficients:
        position = before + np.arange(one.shape[0])
        found.append(one * (position >= total // 2)[:, None])
        before += one.shape[0]
    return tuple(found)


def searched_columns(view: View, index: int, estimate: Estimate) -> SearchedColumns:
    """What one output's residual is searched for: computed once for a look and for all tests.

    Parameters
    ----------
    view : View
    index : int
        Of the output.
    estimate : Estimate
        The one that is looked at.
    """
    if index not in view.searched:
        view.searched[index] = SearchedColumns(view, index, estimate)
    found: SearchedColumns = view.searched[index]
    return found


class SearchedColumns:
    """All that a residual is searched for, not whitened; one array per experiment."""

    def __init__(self, view: View, index: int, estimate: Estimate) -> None:
        self._asked = view, index, estimate
        self._view, self._output = view, view.outputs[index]
        self._inputs = range(view.records[0].n_inputs)
        self.lags = tuple(past_lags(view, self._output))

    @cached_property
    def past(self) -> tuple[Array, ...]:
        """Responses to past inputs."""
        return responses(self._view, self._inputs, self.lags)

    @cached_property
    def coming(self) -> tuple[Array, ...]:
        """Responses to inputs to come."""
        few = self.lags[: max(len(self.lags) // 2, 2)]
        return responses(self._view, self._inputs, few, coming=True)

    @cached_property
    def wave(self) -> tuple[Array, ...]:
        """A constant and slow cosines."""
        return waves(self._view)

    @cached_property
    def later(self) -> tuple[Array, ...]:
        """The derivatives in the second half alone."""
        return later(self._view, self._output)

    @cached_property
    def late(self) -> tuple[tuple[Array, ...], ...]:
        """The fitted output some samples later."""
        return tuple(bends.late(*self._asked))

    @cached_property
    def bends(self) -> tuple[tuple[Array, ...], ...]:
        """Every kind of non-linearity."""
        return tuple(bends.bends(*self._asked))
