"""The projection method: the input's projection on the reference, then the plant.

As in the two-stage method an input without noise takes the place of the recorded one, but it is
found by a *noncausal* finite impulse response,

    u_P(t_k) = sum_{m = -m_2}^{m_1} s_m r(t_{k - m}),

so that ``u - u_P`` is uncorrelated with ``r`` at all lags, past and future, also where the
controller is not linear. The second stage, output error on ``(u_P, y)``, then converges to the best
approximation of the plant in the spectrum of ``u_P`` whatever the loop is (Forssell & Ljung 2000).
Its noise is ``v + G (u - u_P)``; it is consistent and not efficient. Between the samples ``u_P`` is
taken as the record states of its input.

A loop that settles within a thousand samples would need a thousand weights. As a response is smooth
where it is that long, ``s_m`` is taken as linear between knots, ``d`` samples apart: a smaller
space, every response in it still without any assumption on order or causality. The number of past
knots and ``d`` are those of lowest AICc, the residual of ``u`` taken as white, a factor of two
apart; the future has a quarter as many.

References
----------
U. Forssell & L. Ljung, Automatica 36(9) (2000), 1351-1357 (projection method), and Automatica 35
(1999), 1215-1241.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.closed_loop.between_samples import with_input
from tridentify.estimation.methods.base import Progress
from tridentify.estimation.methods.capability import EVERYTHING, Capability
from tridentify.estimation.methods.closed_loop.second_stage import in_two_stages
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure

FEWEST_KNOTS = 4
"""Of the shortest response: a loop that settles within four samples."""
SAMPLES_A_KNOT = 10
"""Samples that a knot needs at least, as an operator of the reference route does."""
MOST_KNOTS = 256
"""Of the longest response: 320 columns on 10,000 samples take a second."""
WIDEST = 32
"""Samples between two knots at most: a loop that needs more is sampled far too fast."""
FUTURE = 4
"""Past knots for one in the future: there is little in it unless the loop is not linear."""


@dataclass(frozen=True)
class Projection:
    """The input projected on past and future of the reference, then output error with it.

    References
    ----------
    .. [1] U. Forssell, L. Ljung, Automatica 36(9) (2000), 1351-1357.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Projection, Record, Structure, TransferFunction, identify, simulate
    >>> r = np.sign(np.sin(np.arange(400) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(r, r, dt=0.02))
    >>> record = Record(r, y, dt=0.02, reference=r, intersample="zoh")
    >>> identify(record, Structure(1, 0), Projection()).theta.round(6).tolist()
    [4.0, 2.0]
    """

    name: ClassVar[str] = "Projection"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = EVERYTHING & ~Capability.NON_UNIFORM_TIME
    """All that a uniform step allows."""

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Progress | None = None
    ) -> Estimate:
        """Estimate the coefficients.

        Parameters
        ----------
        records : sequence of Record
            Each with its references.
        structure : Structure
        progress : callable, optional

        Returns
        -------
        Estimate

        Raises
        ------
        OptionError
            A record has no reference.
        DataError, StructureError
            If records and structure are not usable or not supported.
        IdentifiabilityError
            If the data cannot determine the coefficients.
        """
        return in_two_stages(self.name, self.capabilities, records, structure, progress, _driven)


def _driven(record: Record) -> tuple[Record, str]:
    """The record with its input projected, and what is told of that."""
    u, knots, spacing = projected(np.asarray(record.u), np.asarray(record.reference))
    told = f"{knots} knots {spacing} samples apart in the past, a quarter as many in the future"
    return with_input(record, u, record.behaviour), told


def projected(u: Array, reference: Array) -> tuple[Array, int, int]:
    """The projection of the inputs, the number of past knots, and the samples between two.

    Parameters
    ----------
    u : (n_samples, n_inputs) array
    reference : (n_samples, n_references) array
        Beyond its ends it counts as its first and last values.

    Returns
    -------
    projection : (n_samples, n_inputs) array
    knots : int
    spacing : int
    """
    n, n_references = reference.shape
    most = max(min(n // (SAMPLES_A_KNOT * n_references), MOST_KNOTS), FEWEST_KNOTS)
    best, lowest, chosen = np.zeros_like(u), np.inf, (FEWEST_KNOTS, 1)
    for knots, spacing in _lengths(most, n):
        columns = _responses(reference, knots, spacing)
        weights = np.linalg.lstsq(columns, u, rcond=None)[0]
        made = columns @ weights
        left = np.maximum(np.sum((u - made) ** 2, axis=0), np.finfo(float).tiny)
        own = columns.shape[1]
        criterion = float(np.sum(n * np.log(left / n) + 2.0 * own * n / max(n - own - 1, 1)))
        if criterion < lowest:
            best, lowest, chosen = made, criterion, (knots, spacing)
    return np.asarray(best), *chosen


def _lengths(most: int, n: int) -> Iterator[tuple[int, int]]:
    """Knots and spacings a factor of two apart, none longer than half the record."""
    spacing = 1
    while spacing <= WIDEST:
        knots = FEWEST_KNOTS
        while knots <= most and knots * spacing <= n // 2:
            yield knots, spacing
            knots *= 2
        spacing *= 2


def _responses(reference: Array, knots: int, spacing: int) -> Array:
    """A constant, and every reference through the hat at each knot, from the future to the past."""
    later = -(-knots // FUTURE)
    hat = np.convolve(np.ones(spacing), np.ones(spacing)) / spacing
    margin = spacing - 1
    before, after = (knots - 1) * spacing + margin, later * spacing + margin
    padded = np.pad(reference, ((before, after), (0, 0)), mode="edge")
    smooth = np.column_stack([np.convolve(one, hat, mode="valid") for one in padded.T])
    n = len(reference)
    lags = [smooth[before - margin - k * spacing :][:n] for k in range(-later, knots)]
    return np.hstack([np.ones((n, 1)), *lags])
