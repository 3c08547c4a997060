"""The projection method: the input's projection on the reference, then the plant.

As in the two-stage method an input without noise takes the place of the recorded one, but it is
found by a *noncausal* finite impulse response,

    u_P(t_k) = sum_{m = -m_2}^{m_1} s_m r(t_{k - m}),

so that ``u - u_P`` is uncorrelated with ``r`` at all lags, past and future, also where the
controller is not linear. The second stage, output error on ``(u_P, y)``, then converges to the best
approximation of the plant in the spectrum of ``u_P`` whatever the loop is (Forssell & Ljung 2000).
Its noise is ``v + G (u - u_P)``; it is consistent and not efficient. Between the samples ``u_P`` is
taken as the record states of its input.

The past taps are as many as AICc says, the residual of ``u`` taken as white, of lengths a factor of
two apart; the future ones a quarter of these.

References
----------
U. Forssell & L. Ljung, Automatica 36(9) (2000), 1351-1357 (projection method), and Automatica 35
(1999), 1215-1241.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.closed_loop.between_samples import with_input
from tridentify.estimation.likelihood.question import silently
from tridentify.estimation.methods.base import Progress, check
from tridentify.estimation.methods.capability import EVERYTHING, Capability
from tridentify.estimation.methods.closed_loop.second_stage import second_stage
from tridentify.estimation.methods.route import refuse_unreferenced
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure

FEWEST_TAPS = 4
"""Of the shortest response: a loop that settles within four samples."""
SAMPLES_A_TAP = 10
"""Samples that a tap needs at least, as an operator of the reference route does."""
MOST_TAPS = 512
"""Of the longest response: 600 columns on 10,000 samples take some seconds."""
FUTURE = 4
"""Past taps for one in the future: there is little in it unless the loop is not linear."""


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

    @property
    def name(self) -> str:
        """``"Projection"``."""
        return "Projection"

    @property
    def capabilities(self) -> Capability:
        """All that a uniform step allows."""
        return EVERYTHING & ~Capability.NON_UNIFORM_TIME

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
        say = progress or silently
        check(records, structure, self.name, self.capabilities)
        refuse_unreferenced("Projection()", records, "use ThreeModel(route='direct')")
        say("the projection of the input on the reference")
        found = [projected(np.asarray(one.u), np.asarray(one.reference)) for one in records]
        made = [
            with_input(one, u, one.behaviour) for one, (u, _) in zip(records, found, strict=True)
        ]
        taps = ", ".join(str(count) for _, count in found)
        told = f"first stage: {taps} past taps on each reference, a quarter as many in the future"
        return second_stage(Request.of(records, structure, self.name), made, told, say)


def projected(u: Array, reference: Array) -> tuple[Array, int]:
    """The projection of the inputs, and the number of past taps.

    Parameters
    ----------
    u : (n_samples, n_inputs) array
    reference : (n_samples, n_references) array
        Beyond its ends it counts as its first and last values.

    Returns
    -------
    projection : (n_samples, n_inputs) array
    taps : int
    """
    n, n_references = reference.shape
    most = min(n // (SAMPLES_A_TAP * n_references), MOST_TAPS)
    best, lowest, taps, chosen = np.zeros_like(u), np.inf, FEWEST_TAPS, FEWEST_TAPS
    while taps <= max(most, FEWEST_TAPS):
        columns = _shifted(reference, taps)
        weights = np.linalg.lstsq(columns, u, rcond=None)[0]
        made = columns @ weights
        left = np.maximum(np.sum((u - made) ** 2, axis=0), np.finfo(float).tiny)
        own = columns.shape[1]
        criterion = float(np.sum(n * np.log(left / n) + 2.0 * own * n / max(n - own - 1, 1)))
        if criterion < lowest:
            best, lowest, chosen = made, criterion, taps
        taps *= 2
    return np.asarray(best), chosen


def _shifted(reference: Array, taps: int) -> Array:
    """A constant, and every reference at lags from the future to the past."""
    later = -(-taps // FUTURE)
    padded = np.pad(reference, ((taps - 1, later), (0, 0)), mode="edge")
    n = len(reference)
    lags = [padded[taps - 1 - lag :][:n] for lag in range(-later, taps)]
    return np.hstack([np.ones((n, 1)), *lags])
