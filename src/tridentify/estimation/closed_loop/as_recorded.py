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

MOST_LAGS = 6
"""Past samples that an input is foretold from."""
PER_COLUMN = 15
"""Samples for each of their columns, at least."""
RANK = 1e-12
"""Singular value over the largest up to which such columns are taken as dependent."""
ROUNDS = 15
"""Weighted fits; the weights stand still after about ten."""
LARGE = 3.0
"""Standard deviations from which a move is one of a reference."""
NORMAL = 1.4826
"""Standard deviation of a Gaussian over the median of its absolute values."""


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
        following = self.following(ends)
        found = ends[:, None] + middles[:, None] * (following - ends)[:, None]
        if self.record.behaviour == "zoh":
            n_inputs = self.record.n_inputs
            found[:, :, :n_inputs] = ends[:, None, :n_inputs]
        return np.asarray(found.reshape(-1, ends.shape[1])[:, signals])

    def following(self, ends: Array) -> Array:
        """Where the signals are at the end of every interval, just before the next sample."""
        return np.vstack([ends[1:], ends[-1:]])


@dataclass(frozen=True, eq=False)
class Foretold(AsRecorded):
    """A record whose input is on its way to what its past foretells, and moves at the samples.

    Attributes
    ----------
    ahead : (n_samples, n_inputs) array
        What the past of input and output foretells of the input at every sample; or what it was
        just before.
    """

    ahead: Array

    @classmethod
    def of(cls, record: Record) -> Foretold:
        """By a forecast that large moves do not bend."""
        return cls(record, foretold(record))

    def following(self, ends: Array) -> Array:
        """Inputs where they were foretold."""
        found = super().following(ends)
        found[:-1, : self.record.n_inputs] = self.ahead[1:]
        return found


def jumps(record: Record) -> Array:
    """(n_samples, n_inputs) by how much held references move the inputs at the samples themselves.

    Least squares of the inputs on those moves, beside the past of all signals.
    """
    u, r = np.asarray(record.u), record.reference
    if r is None or record.reference_behaviour != "zoh":
        return np.zeros(u.shape)
    moves = np.diff(r, axis=0, prepend=r[:1])
    past, lags = _past(np.column_stack([u, AsRecorded(record).outputs, r]))
    columns = np.hstack([moves[lags:], past])
    known = np.linalg.lstsq(columns, u[lags:], rcond=RANK)[0]
    return np.asarray(moves @ known[: r.shape[1]])


def _past(signals: Array) -> tuple[Array, int]:
    """Signals of some samples before, a constant beside them; and of how many."""
    lags = min(MOST_LAGS, max(1, len(signals) // (PER_COLUMN * signals.shape[1])))
    past = np.hstack([signals[lags - k : len(signals) - k] for k in range(1, lags + 1)])
    return np.column_stack([past - past.mean(axis=0), np.ones(len(past))]), lags


def foretold(record: Record) -> Array:
    """(n_samples, n_inputs) forecast of the inputs from the past of inputs and outputs.

    By least squares whose weights leave little to the moves of a reference; the first samples count
    as foretold.
    """
    u, y = np.asarray(record.u), AsRecorded(record).outputs
    past, lags = _past(np.column_stack([u, y]))
    found = np.array(u)
    for j, own in enumerate(u[lags:].T):
        weights = np.ones(len(own))
        for _ in range(ROUNDS):
            known = np.linalg.lstsq(past * weights[:, None], own * weights, rcond=RANK)[0]
            left = np.abs(own - past @ known)
            size = LARGE * NORMAL * float(np.median(left)) + 1e-300
            weights = np.minimum(1.0, size / np.maximum(left, 1e-300))
        found[lags:, j] = past @ known
    return found
