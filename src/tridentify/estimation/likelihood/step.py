"""Scores taken apart, and the step that follows from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tridentify.numerics.arrays import Array, Complex


class Proposal(NamedTuple):
    """A step: where it leads, and what it promises.

    Attributes
    ----------
    poles : (n,) complex array
        Not necessarily admissible.
    decrease : float
        Predicted fall of `Point.objective`.
    delays : (n_inputs,) array or None
        Where they are estimated along [s].
    change : (n_scores,) array
        The step itself: of ``alpha`` and the delays.
    """

    poles: Complex
    decrease: float
    delays: Array | None
    change: Array


class Bend(NamedTuple):
    """A direction, and how much more than Gauss-Newton the cost bends along it (`bend`).

    Attributes
    ----------
    direction : (n_scores,) array
        The last step, in the coordinates of the new point.
    excess : float
        In the unit of the Gauss-Newton curvature.
    """

    direction: Array
    excess: float


class Decomposition(NamedTuple):
    """SVD of the scores along the directions that count, scaled; the residual on them, its norm.

    ``basis`` are these directions; None where all count.
    """

    basis: Array | None
    s: Array
    vt: Array
    scale: Array
    projection: Array
    total: float
    held: str

    def gain(self, damping: float) -> Array:
        """Of every singular value."""
        # what is so small that its square is none moves nothing
        s = self.s.tolist()
        least = 1e-13 * s[0]
        return np.array([v / (v * v + damping) if v > least and v * v > 0.0 else 0.0 for v in s])

    def step(self, damping: float) -> Array:
        """(n_scores,) change of ``alpha`` and the delays."""
        moved = self.vt.T @ (self.gain(damping) * self.projection)
        moved = moved / self.scale
        return -moved if self.basis is None else np.asarray(-self.basis @ moved)


def decomposition_of(scores: Array, residual: Array, basis: Array, held: str = "") -> Decomposition:
    """Of scores along some directions.

    Parameters
    ----------
    scores : (rows, n) array
    residual : (rows,) array
    basis : (n, k) array
        Orthonormal directions.
    held : str
        What is to be said of those that are left out.
    """
    from tridentify.estimation.likelihood.compiled.cost import decomposed

    own = np.ascontiguousarray(scores @ basis)
    return Decomposition(basis, *decomposed(own, residual), held)
