"""The two-stage method: the input that the reference makes first, then the plant.

In ``u = S r - C S v`` the reference is independent of the noise, so that a fit of ``u`` to ``r``
gives ``S``, and ``u_M = S r`` is an input without noise. With it

    y = G u_M + S v

is an open-loop problem, whatever the controller, and the second stage is output error on ``(u_M,
y)`` (Van den Hof & Schrama 1993). What is paid: the noise of the second stage is ``S v``, and that
part of ``u`` which the first stage does not explain is noise too, so the estimate is consistent
and not efficient. ``S v`` is coloured even where ``v`` is not, so that the second stage has a model
of its noise. The error of ``u_M`` between the samples stays: it is taken as the record states of
its input, and of a continuous controller in a loop that is fast for its samples that is a bias
without limits; the reference route has none there.

The first stage is that of the reference route (`closed_loop.driven`), but with as many Laguerre
functions as the samples determine, of the rate that leaves least of ``u``; the authors take an FIR
or an ARX model of high order. A number that suits ``u``, by AICc, would not do: what the first
stage misses is driven by the reference, and the second takes it for noise.

So many functions take some of the noise of ``u`` as well, which is that of ``y`` behind a filter:
a bias of the plant. By least squares it is that of the noise where the functions lie, and what a
controller makes of noise is largest at the loop's own frequencies, where they lie. Weighed by the
noise, an autoregression of what is left of ``u``, as the past inputs of the ARX model weigh it,
they take the least.

References
----------
P. Van den Hof & R. Schrama, Automatica 29(6) (1993), 1523-1527.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.closed_loop.between_samples import with_input
from tridentify.estimation.closed_loop.driven import (
    MOST_FUNCTIONS,
    colours_of,
    driven,
    fitted,
    near,
)
from tridentify.estimation.methods.base import Progress
from tridentify.estimation.methods.capability import EVERYTHING, Capability
from tridentify.estimation.methods.closed_loop.second_stage import IN_NOISE, in_two_stages
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten_columns
from tridentify.record.record import Record
from tridentify.structure import Structure


@dataclass(frozen=True)
class TwoStage:
    """Two stages: the input from the reference, then output error with that input.

    References
    ----------
    .. [1] P. Van den Hof, R. Schrama, Automatica 29(6) (1993), 1523-1527.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, TwoStage, identify, simulate
    >>> r = np.sign(np.sin(np.arange(400) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(r, r, dt=0.02))
    >>> record = Record(r, y, dt=0.02, reference=r, intersample="zoh")
    >>> identify(record, Structure(1, 0), TwoStage()).theta.round(6).tolist()
    [4.0, 2.0]
    """

    name: ClassVar[str] = "TwoStage"
    """What tables and files call it."""
    capabilities: ClassVar[Capability] = EVERYTHING
    """All of them."""

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
        return in_two_stages(
            self.name, self.capabilities, records, structure, progress, _driven, IN_NOISE
        )


def _driven(record: Record) -> tuple[Record, str]:
    """The record with the input that its reference makes, and what is told of that."""
    u = np.asarray(record.u)
    parts = near(driven(record), MOST_FUNCTIONS)
    part = min(parts, key=lambda one: float(np.prod(np.std(u - one.inputs, axis=0))))
    noises = colours_of(part)[: record.n_inputs]
    made = [_weighed(part.columns, one, a) for one, a in zip(u.T, noises, strict=True)]
    return with_input(record, np.column_stack(made), record.behaviour), part.words


def _weighed(columns: Array, signal: Array, noise: Array) -> Array:
    """(n_samples,) what columns make of a signal, by least squares in a coloured noise."""
    table = whiten_columns(
        [np.column_stack([columns, signal])], [np.ones(len(signal), dtype=bool)], noise
    )
    return np.asarray(columns @ fitted(table[:, :-1], table[:, -1:])[:, 0])
