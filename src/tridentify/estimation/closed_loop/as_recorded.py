"""A record without a controller, as Steps 2 and 4 see it for a plant that is not stable.

What drives the plant is the recorded input itself, so that the derivatives of all errors take the
place of the driven ones, and the root is the least-squares minimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

RATE = 10.0
"""Rate of the first filters times length of the record: with the shares of Step 2 between one and
thirty time constants lie within the record."""


@dataclass(frozen=True, eq=False)
class AsRecorded:
    """A record, where nothing but its input drives it.

    Attributes
    ----------
    record : Record
        On uniform time.
    """

    record: Record

    @property
    def rate(self) -> float:
        """Of the filters that Step 2 begins with [rad/s]."""
        return RATE / self.record.duration

    @property
    def inputs(self) -> Array:
        """(n_samples, n_inputs) as recorded."""
        return np.asarray(self.record.u)

    @property
    def outputs(self) -> Array:
        """(n_samples, n_outputs) as recorded, missing ones between their neighbours."""
        y = np.array(self.record.y)
        places = np.arange(len(y))
        for column in y.T:
            gone = np.isnan(column)
            column[gone] = np.interp(places[gone], places[~gone], column[~gone])
        return y

    @property
    def words(self) -> str:
        """How it is told."""
        return "input and output as recorded"

    def inputs_between(self, pieces: int) -> Array:
        """(pieces * n_samples, n_inputs) means of the inputs over pieces of every interval."""
        return self.means(pieces, slice(0, self.record.n_inputs))

    def means(self, pieces: int, signals: slice) -> Array:
        """(pieces * n_samples, k) means of signals over equal pieces of every interval.

        Parameters
        ----------
        pieces : int
        signals : slice
            Of inputs and outputs. Held inputs are held, all else is taken as linear.
        """
        ends = np.column_stack([self.inputs, self.outputs])
        middles = (np.arange(pieces) + 0.5) / pieces
        following = np.vstack([ends[1:], ends[-1:]])
        found = ends[:, None] + middles[:, None] * (following - ends)[:, None]
        if self.record.behaviour == "zoh":
            n_inputs = self.record.n_inputs
            found[:, :, :n_inputs] = ends[:, None, :n_inputs]
        return np.asarray(found.reshape(-1, ends.shape[1])[:, signals])
