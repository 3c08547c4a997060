"""A loop whose controller is known: what the reference drives follows the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import DataError, UnsupportedError
from tridentify.estimation.closed_loop.between_samples import Loop, Sampling
from tridentify.estimation.closed_loop.driven import Driven
from tridentify.estimation.closed_loop.simulated import Simulated, closed, simulated
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction


@dataclass(frozen=True, eq=False)
class KnownLoop(Loop):
    """One record of a loop with a known controller.

    Attributes
    ----------
    controller : TransferFunction
    """

    controller: TransferFunction

    def at(self, model: TransferFunction) -> Loop:
        """The loop of a model; where that is unstable, the one that was there."""
        part = self.driven
        assert isinstance(part, Simulated)
        transfer = closed(model, self.controller, part.entries)
        if not transfer.is_stable:
            return self
        return Loop(replace(part, transfer=transfer), self.sampling)


def known_loop(
    part: Driven, model: TransferFunction, controller: TransferFunction, sampling: Sampling
) -> KnownLoop:
    """The loop of a first model and a known controller.

    Parameters
    ----------
    part : Driven
        What the reference drives, as it was fitted.
    model : TransferFunction
    controller : TransferFunction
    sampling : {"sampled", "continuous"}

    Raises
    ------
    DataError
        The model that the record shows and the controller make no stable loop.
    """
    found = simulated(part.record, model, controller)
    if found is None:
        raise DataError(
            "found a controller that makes no stable loop with the model that the record shows; "
            "expected that of u = r - C y or u = C (r - y); look at its sign, or leave it out"
        )
    return KnownLoop(found, sampling, controller)


def refuse_unknown_loop(
    records: Sequence[Record], structure: Structure, controller: TransferFunction
) -> None:
    """Refuse loops that cannot be simulated yet.

    Raises
    ------
    UnsupportedError
    """
    first = records[0]
    counts = (first.n_inputs, first.n_outputs, controller.n_inputs, controller.n_outputs)
    if counts != (1, 1, 1, 1):
        raise UnsupportedError(
            f"found {counts[0]} inputs and {counts[1]} outputs with a controller that is given; "
            "expected one of each, and of the controller; write controller='continuous' or "
            "'sampled'"
        )
    late = structure.delay == "free" or bool(np.any(structure.delay_matrix(1, 1)))
    if late or controller.delay.any():
        raise UnsupportedError(
            "found a delay in a loop whose controller is given; expected none; write "
            "controller='continuous' or 'sampled'"
        )
