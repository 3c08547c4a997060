"""What a Levenberg-Marquardt step is, and promises, in machine code, once scores are decomposed.

As `step.Decomposition` and `likelihood.cost` have it in Python.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.compiled import compiled

NEGLIGIBLE = 1e-13
"""Singular values over the largest, as in `step.Decomposition.gain`."""


@compiled("float64(float64, float64, float64)", inner=True, linked=True)
def fall(share: float, total: float, samples: float) -> float:
    """Of the objective, where the residual's square falls by ``share``."""
    fraction = share / (total * total) if total > 0.0 else 0.0
    lower: float = np.log1p(-min(fraction, 1.0 - 1e-15))
    return -samples * lower


@compiled("float64(float64[::1], float64[::1], float64, float64, float64)", inner=True, linked=True)
def promised(s: Array, projection: Array, total: float, damping: float, samples: float) -> float:
    """The fall of minus two log likelihood that a step promises."""
    share, least = 0.0, NEGLIGIBLE * s[0]
    for k in range(s.size):
        if s[k] > least and s[k] * s[k] > 0.0:
            part = s[k] * (s[k] / (s[k] * s[k] + damping))
            share += projection[k] * projection[k] * part * (2.0 - part)
    return fall(share, total, samples)


@compiled("float64[::1](float64[:,::1], float64[::1])", inner=True, linked=True)
def combined(matrix: Array, weights: Array) -> Array:
    """The product."""
    found = np.zeros(matrix.shape[0])
    for r in range(matrix.shape[0]):
        for c in range(weights.size):
            found[r] += matrix[r, c] * weights[c]
    return found


@compiled("float64(float64[::1], float64[::1])", inner=True, linked=True)
def dot(one: Array, other: Array) -> float:
    """Inner product."""
    total = 0.0
    for k in range(one.size):
        total += one[k] * other[k]
    return total


@compiled("float64(float64[::1], float64[::1], float64)", inner=True, linked=True)
def slope_left(s: Array, projection: Array, total: float) -> float:
    """The residual's share along the scores, as `Point.gradient`."""
    square = 0.0
    for k in range(s.size):
        if s[k] > NEGLIGIBLE * s[0]:
            square += projection[k] * projection[k]
    return np.sqrt(square) / total if total > 0.0 else 0.0


@compiled(
    "float64[::1](float64[::1], float64[:,::1], float64[::1], float64[::1], float64)",
    inner=True, linked=True,
)  # fmt: skip
def damped(s: Array, vt: Array, scale: Array, projection: Array, damping: float) -> Array:
    """The step of the least squares of a decomposition, damped."""
    change = np.zeros(scale.size)
    for k in range(s.size):
        if s[k] > NEGLIGIBLE * s[0] and s[k] * s[k] > 0.0:
            part = s[k] / (s[k] * s[k] + damping) * projection[k]
            for c in range(change.size):
                change[c] -= vt[k, c] * part / scale[c]
    return change


@compiled(
    "float64(float64[::1], float64[:,::1], float64[::1], float64[::1], float64)",
    inner=True, linked=True,
)  # fmt: skip
def bent_by(
    change: Array, scores: Array, residual: Array, direction: Array, excess: float
) -> float:
    """Take from a step what the bend takes of its part along it; gives what it promises then."""
    across = combined(scores, direction)
    length, moved = dot(across, across), combined(scores, change)
    share = dot(moved, across) / length * excess / (1.0 + excess)
    for c in range(change.size):
        change[c] -= share * direction[c]
    for r in range(moved.size):
        moved[r] -= share * across[r]
    bent = excess * dot(moved, across) ** 2 / length
    return -(2.0 * dot(residual, moved) + dot(moved, moved) + bent)


@compiled("float64(float64[::1], float64[:,::1], float64[::1], float64)", inner=True, linked=True)
def bend_of(direction: Array, scores: Array, residual: Array, before: float) -> float:
    """The bend that a step back shows, which is turned forward; ``nan`` for none."""
    for c in range(direction.size):
        direction[c] = -direction[c]
    across = combined(scores, direction)
    length = dot(across, across)
    if not length > 0.0:
        return np.nan
    return (2.0 * dot(residual, across) - before) / (2.0 * length) - 1.0
