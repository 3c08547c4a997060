"""What the reference drives where the controller is known: the loop of a model, simulated.

With ``G = b / a``, a controller ``C = n / d`` on what is measured and no noise, the input follows

    u = a d / (a d + b n) r                 of a reference added at the plant's input, u = r - C y,
    u = a n / (a d + b n) r                 of one at the set point, u = C (r - y),

functions of continuous time. Nothing is fitted, so that no noise of the record is in them; what
they need is the model (Gilson, Garnier, Young & Van den Hof 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np

from tridentify.estimation.closed_loop.driven import befores, refined
from tridentify.models.regression import Experiment
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

Entry = Literal["input", "set point"]

ENTRIES: tuple[Entry, ...] = ("input", "set point")
"""Where a reference may enter."""
AT = {"input": "at the plant's input, u = r - C y", "set point": "at the set point, u = C (r - y)"}
"""The same, as it is told."""


@dataclass(frozen=True, eq=False)
class Simulated:
    """What the references of one record drive in the loop of a model.

    Attributes
    ----------
    record : Record
        With one input and one output.
    transfer : TransferFunction
        From the references to the input; stable.
    entries : tuple of {"input", "set point"}
        Where each reference enters.
    before : (n_references,) array
        What the references were before the record.
    """

    record: Record
    transfer: TransferFunction
    entries: tuple[Entry, ...]
    before: Array

    @property
    def words(self) -> str:
        """How it was found, as it is told."""
        places = ", ".join(dict.fromkeys(AT[one] for one in self.entries))
        return f"loop simulated with the controller given, reference {places}"

    @property
    def rate(self) -> float:
        """Fastest pole of the loop [rad/s]."""
        return float(np.max(np.abs(np.roots(self.transfer.den[0][0]))))

    @property
    def fastest(self) -> float:
        """The same, as of operators."""
        return self.rate

    @cached_property
    def inputs(self) -> Array:
        """(n_samples, n_inputs) part of the inputs that the references drive, at the samples."""
        moving = self._moving
        return moving + np.mean(np.asarray(self.record.u) - moving)

    @property
    def misfit(self) -> float:
        """Sum of squares of the input that is left."""
        return float(np.sum((np.asarray(self.record.u) - self.inputs) ** 2))

    @cached_property
    def _moving(self) -> Array:
        return self._driven_by(refined(self.record, self.before, 1))[:-1]

    def inputs_between(self, pieces: int) -> Array:
        """Means of the driven inputs over equal pieces of every interval, as `Driven` gives them.

        Parameters
        ----------
        pieces : int
            In an interval.
        """
        fine = refined(self.record, self.before, 2 * pieces)
        node = self._driven_by(fine)
        came = fine.u[:-1] if fine.intersample == "zoh" else fine.u[1:]
        # at a jump of the reference the input jumps too, by the gain at infinite frequency
        through = np.array([_direct(num, den) for num, den in self._channels])
        left = node[1:] - ((fine.u[1:] - came) @ through)[:, None]
        right = node[:-1]
        means = (right[0::2] + 2.0 * (left[0::2] + right[1::2]) + left[1::2]) / 6.0
        return np.asarray(means + (self.inputs[0] - self._moving[0]))

    @property
    def _channels(self) -> list[tuple[Array, Array]]:
        return list(zip(self.transfer.num[0], self.transfer.den[0], strict=True))

    def _driven_by(self, fine: Experiment) -> Array:
        clock = {"dt": fine.dt} if fine.t is None else {"t": fine.t}
        record = Record(
            fine.u, fine.y, **clock, intersample=self.record.reference_behaviour or "zoh"
        )
        return np.asarray(simulate(self.transfer, record))


def _direct(num: Array, den: Array) -> float:
    return float(num[0] / den[0]) if len(num) == len(den) else 0.0


def closed(
    model: TransferFunction, controller: TransferFunction, entries: Sequence[Entry]
) -> TransferFunction:
    """From the references to the input of a loop.

    Parameters
    ----------
    model, controller : TransferFunction
        Each of one input and one output.
    entries : sequence of {"input", "set point"}
        Where each reference enters.

    Examples
    --------
    >>> lag, gain = TransferFunction([1.0], [1.0, 1.0]), TransferFunction([2.0], [1.0])
    >>> print(closed(lag, gain, ["set point"]).den[0][0])
    [1. 3.]
    """
    return _around(model.den[0][0], model, controller, entries)


def closed_output(
    model: TransferFunction, controller: TransferFunction, entries: Sequence[Entry]
) -> TransferFunction:
    """From the references to the output of a loop, as `closed` to its input."""
    return _around(model.num[0][0], model, controller, entries)


def _around(
    seen: Array, model: TransferFunction, controller: TransferFunction, entries: Sequence[Entry]
) -> TransferFunction:
    n, d = controller.num[0][0], controller.den[0][0]
    whole = np.polyadd(np.polymul(model.den[0][0], d), np.polymul(model.num[0][0], n))
    numerators = {"input": np.polymul(seen, d), "set point": np.polymul(seen, n)}
    return TransferFunction([[numerators[one] for one in entries]], [[whole for _ in entries]])


def simulated(
    record: Record, model: TransferFunction, controller: TransferFunction
) -> Simulated | None:
    """The simulation that explains the recorded input best, of those that the references allow.

    Where each reference enters, and what it was before the record, are tried.

    Returns
    -------
    Simulated or None
        None where no loop of the model and the controller is stable.
    """
    found: list[Simulated] = []
    reference = np.asarray(record.reference)
    for entries in product(ENTRIES, repeat=reference.shape[1]):
        transfer = closed(model, controller, entries)
        if transfer.is_stable:
            found += [Simulated(record, transfer, entries, one) for one in befores(reference)]
    return min(found, key=lambda one: one.misfit, default=None)
