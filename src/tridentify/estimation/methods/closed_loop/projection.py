"""The projection method: the input's projection on the reference, then the plant.

As in the two-stage method an input without noise takes the place of the recorded one, but it is
found by a *noncausal* finite impulse response,

    u_P(t_k) = sum_{m = -m_2}^{m_1} s_m r(t_{k - m}),

so that ``u - u_P`` is uncorrelated with ``r`` at all lags, past and future, also where the
controller is not linear. The second stage, output error on ``(u_P, y)``, then converges to the best
approximation of the plant in the spectrum of ``u_P`` whatever the loop is (Forssell & Ljung 2000).
Its noise is ``v + G (u - u_P)``; it is consistent and not efficient. Between the samples ``u_P`` is
taken as the record states of its input.

A loop that settles within a thousand samples would need a thousand weights. As a response is the
smoother the later it is, ``s_m`` is taken as linear between knots whose distance grows with the
lag: a smaller space, every response in it still without any assumption on order or causality, but
that a loop does not swing for more than five periods. The past has knots up to half the record, as
many as it has samples for, the future the first quarter of these. A length that suits ``u``, by
AICc, would not do: what is cut off is driven by the reference, and the second stage takes it for
noise. What is fitted of the noise biases the plant as well, but by no more than the share of knots
in samples.

References
----------
U. Forssell & L. Ljung, Automatica 36(9) (2000), 1351-1357 (projection method), and Automatica 35
(1999), 1215-1241.
"""

from __future__ import annotations

from collections.abc import Sequence
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

FINEST = 32
"""Lag over the distance of knots there, at most: five swings with a knot for every radian."""
SAMPLES_A_KNOT = 10
"""Samples that a knot needs at least, as an operator of the reference route does."""
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
    u, reference = np.asarray(record.u), np.asarray(record.reference)
    past = lags(*reference.shape)
    future = past[: -(-len(past) // FUTURE)]
    told = f"{len(past)} knots over {past[-1]} samples of the past, {len(future)} of the future"
    return with_input(record, projected(u, reference, past, future), record.behaviour), told


def lags(n: int, n_references: int) -> list[int]:
    """Knots from one sample to half the record, as fine as the number of samples allows.

    Parameters
    ----------
    n, n_references : int
        Samples, and signals that each knot weighs.

    Examples
    --------
    >>> lags(80, 1)
    [1, 2, 4, 8, 16, 32, 40]
    """
    found: list[int] = []
    for finest in range(1, FINEST + 1):
        knots = [1]
        while knots[-1] < n // 2:
            knots.append(min(knots[-1] + max(1, knots[-1] // finest), n // 2))
        if found and len(knots) > n // (SAMPLES_A_KNOT * n_references):
            break
        found = knots
    return found


def projected(u: Array, reference: Array, knots: Sequence[int], later: Sequence[int]) -> Array:
    """The inputs projected on a constant, the references, and hats of their past and future.

    Parameters
    ----------
    u : (n_samples, n_inputs) array
    reference : (n_samples, n_references) array
        Beyond its ends it counts as its first and last values.
    knots, later : sequence of int
        Lags behind and before a sample, rising from one.
    """
    columns = [np.ones((len(reference), 1)), reference, *_hats(reference, knots)]
    columns += [one[::-1] for one in _hats(reference[::-1], later)]
    table = np.hstack(columns)
    return np.asarray(table @ np.linalg.lstsq(table, u, rcond=None)[0])


def _hats(reference: Array, knots: Sequence[int]) -> list[Array]:
    """Sums of earlier samples, by a hat about each of some lags; half of one at the first."""
    n, reach = len(reference), max(knots, default=0)
    padded = np.pad(reference, ((reach, 0), (0, 0)), mode="edge")
    length = n + 2 * reach
    spectrum = np.fft.rfft(padded, length, axis=0)
    columns = []
    for k, centre in enumerate(knots):
        first, last = knots[max(k - 1, 0)], knots[min(k + 1, len(knots) - 1)]
        span = np.arange(first, last + 1)
        weights = np.interp(
            span, [first, centre, last], [float(k == 0), 1.0, float(centre == last)]
        )
        made = np.fft.irfft(spectrum * np.fft.rfft(weights, length)[:, None], length, axis=0)
        columns.append(made[reach - first :][:n])
    return columns
