"""The columns of a triangle: where they stand, and what combinations of them there are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander

from tridentify.numerics.arrays import Array


def drift_columns(place: Array, degree: int) -> Array:
    """What a drift of some degree is made of: the ramp, and Legendre polynomials from the second.

    Parameters
    ----------
    place : (n,) array
        From 0 at the first sample of the record to 1 at the last.
    degree : int

    Returns
    -------
    (degree, n) array

    Examples
    --------
    >>> drift_columns(np.array([0.0, 0.5, 1.0]), 2).tolist()
    [[0.0, 0.5, 1.0], [1.0, -0.5, 1.0]]
    """
    found = np.empty((int(degree), place.size))
    if degree:
        found[0] = place
    if degree > 1:
        found[1:] = legvander(2.0 * place - 1.0, degree)[:, 2:].T
    return found


@dataclass(frozen=True)
class Layout:
    """Where things stand among the columns of a triangle."""

    order: int
    n_inputs: int
    free: bool
    offset: bool
    drift: int

    @property
    def states(self) -> int:
        """Number of impulse and input states."""
        return self.order * (self.n_inputs + self.free)

    @property
    def n_signals(self) -> int:
        """Columns before the outputs."""
        return self.states + self.n_inputs + self.offset + self.drift

    def input_states(self, j: int) -> slice:
        """Columns of the states driven by input ``j``."""
        first = self.order * (j + self.free)
        return slice(first, first + self.order)

    def direct(self, j: int) -> int:
        """Column of input ``j`` itself."""
        return self.states + j

    @property
    def nuisance(self) -> slice:
        """Columns of the constant and of the drift."""
        return slice(self.states + self.n_inputs, self.n_signals)


@dataclass(frozen=True, eq=False)
class Regression:
    """The triangle of one experiment on one bank.

    Attributes
    ----------
    layout : Layout
    signals : tuple of (r, n_signals) arrays
        One per output (the same array when all outputs have the same samples).
    targets : tuple of (r,) arrays
        The outputs in the same coordinates.
    counts : tuple of int
        Output samples used.
    log_scale : tuple of float
        Per output the log determinant of the noise's covariance, for innovations of variance
        one; empty where all are white.
    leads : (n_outputs, n_inputs) array, optional
        How long before the impulse each input begins to act [s]; None where it never does.
    """

    layout: Layout
    signals: tuple[Array, ...]
    targets: tuple[Array, ...]
    counts: tuple[int, ...]
    log_scale: tuple[float, ...] = ()
    leads: Array | None = None

    def input_signal(self, output: int, channel: int, row: Array, direct: float = 0.0) -> Array:
        """``(row X + direct) u_channel`` of ``output``; ``row`` (q,) or (q, k)."""
        s = self.signals[output]
        value = s[:, self.layout.input_states(channel)] @ row
        if direct:
            value = value + direct * s[:, self.layout.direct(channel)]
        return np.asarray(value)

    def impulse_signal(self, output: int, row: Array) -> Array:
        """``row X delta`` in the coordinates of ``output``; ``row`` (q,) or (q, k)."""
        return np.asarray(self.signals[output][:, : self.layout.order] @ row)

    def nuisance_signals(self, output: int) -> Array:
        """The constant and the drift (r, k)."""
        return self.signals[output][:, self.layout.nuisance]
