"""Coordinates in which a stable system cannot be left, for drawing coefficients.

Coefficients of a stable denominator are positive, and their standard errors grow with them: a
normal distribution around a low estimate is too narrow, and reaches below zero. Both mend when the
normal distribution is laid on a logarithm. For every degree the right positive numbers are those of
Routh's table: a monic polynomial is Hurwitz if and only if it comes out of

    D_0 = 1,  D_1 = s + g_1,  D_k = s D_{k-1} + g_k D_{k-2}

with all ``g_k > 0`` (Schwarz 1956; Barnett & Storey 1970, ch. 3). For ``s^2 + a_1 s + a_0`` they
are ``a_1`` and ``a_0``. The map is smooth and one to one, also through repeated poles. So the
coordinates are ``ln g``, and for the numerators ``b / a_0``, whose sign is free:

    phi ~ N(phi_hat, J^{-1} cov J^{-T}),   J = d theta / d phi,

to first order the same distribution as ``theta ~ N(theta_hat, cov)``. ``J`` is taken by complex
steps (Squire & Trapp 1998), which are exact to rounding.

References: H. R. Schwarz, Z. angew. Math. Phys. 7, 473-500 (1956); S. Barnett & C. Storey, *Matrix
Methods in Stability Theory* (1970); W. Squire & G. Trapp, SIAM Review 40, 110-112 (1998).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tridentify.errors import UnsupportedError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array

Table = list[tuple[list[int], list[list[int]]]]

STEP = 1e-30
"""Imaginary: a complex step subtracts nothing, so that it may be far below rounding."""
FARTHEST = 60.0
"""Draws stay within ``e^60`` of the estimate, so that no product of them overflows."""


def routh(den: Array) -> Array:
    """Numbers ``g_1 .. g_n`` of a monic polynomial; all positive if and only if it is Hurwitz.

    Parameters
    ----------
    den : ndarray, shape (n + 1,)
        Descending powers.

    Returns
    -------
    ndarray, shape (n,)
        ``nan`` from where the table breaks off, as it does for some that are not Hurwitz.

    Examples
    --------
    >>> routh(np.array([1.0, 6.0, 11.0, 6.0]))
    array([ 6., 10.,  1.])
    """
    n = den.size - 1
    g = np.full(n, np.nan)
    even, odd = den[0::2].astype(np.float64), den[1::2].astype(np.float64)
    # Euclid's algorithm on the two halves, each made monic: even = s odd + g_k rest
    for k in range(n):
        rest = odd if k == 0 else even[1:] - np.pad(odd[1:], (0, even.size - odd.size))
        if not rest[0] > 0:
            return g
        g[k] = rest[0]
        even, odd = (even if k == 0 else odd), rest / rest[0]
    return g


def unrouth(g: Any) -> Any:
    """Monic polynomials, shape (n_draws, n + 1), of rows ``g_1 .. g_n``, real or complex.

    Examples
    --------
    >>> unrouth(np.array([[6.0, 10.0, 1.0]]))
    array([[ 1.,  6., 11.,  6.]])
    """
    before, now = None, np.ones((len(g), 1), dtype=g.dtype)
    for k in range(g.shape[1]):
        grown = np.pad(now, ((0, 0), (0, 1)))
        if before is None:
            grown[:, 1:] += g[:, :1]
        else:
            grown[:, 2:] += g[:, k : k + 1] * before
        before, now = now, grown
    return now


def stable_draws(estimate: Estimate, normal: Array) -> Array:
    """Coefficients, shape (n_draws, n_parameters), from standard normal numbers of that shape.

    Raises
    ------
    UnsupportedError
        The estimate is not stable, or it holds coefficients that were not estimated, or a delay.
    """
    structure = estimate.structure
    if structure.equalities or structure.static_gain is not None or not np.all(estimate.std):
        raise UnsupportedError(
            "found an estimate with fixed coefficients or equalities; expected all coefficients "
            "estimated freely for scale='stable', whose draws keep no constraints; use "
            "scale='coefficients'"
        )
    table, size = _table(estimate)
    centre = _coordinates(estimate, table)
    if not np.all(np.isfinite(centre)):
        raise UnsupportedError(
            "found an estimate that is not stable; expected a stable one for scale='stable'; use "
            "scale='coefficients'"
        )
    turned = np.tile(centre.astype(np.complex128), (size, 1)) + 1j * STEP * np.eye(size)
    jacobian = (_coefficients(turned, table).imag / STEP).T
    std = np.where(estimate.std > 0, estimate.std, 1.0)
    values, vectors = np.linalg.eigh(estimate.cov / np.outer(std, std))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    moved = normal @ np.linalg.solve(jacobian / std[:, None], root).T
    far = np.zeros(size, dtype=np.bool_)
    for rows, _ in table:
        far[rows] = True
    moved = np.where(far, np.clip(moved, -FARTHEST, FARTHEST), moved)
    return np.asarray(_coefficients(centre + moved, table), dtype=np.float64)


def _table(estimate: Estimate) -> tuple[Table, int]:
    """Places of each denominator in ``theta``, with those of the numerators over it."""
    position = {name: k for k, name in enumerate(estimate.names)}
    found: dict[tuple[int, ...], list[list[int]]] = {}
    for i, output in enumerate(estimate.output_names):
        for j, source in enumerate(estimate.input_names):
            label = f"[{output},{source}]"
            rows = []
            for letter, size in (
                ("a", len(estimate.model.den[i][j]) - 1),
                ("b", len(estimate.model.num[i][j])),
            ):
                names = [f"{letter}{k}" for k in range(size - 1, -1, -1)]
                rows.append([position.get(n + label, position.get(n, -1)) for n in names])
            found.setdefault(tuple(rows[0]), []).append(rows[1])
    places = [k for a, rows in found.items() for k in (*a, *(k for row in rows for k in row))]
    if sorted(places) != list(range(len(estimate.names))):
        raise UnsupportedError(
            "found a delay or a fixed coefficient; expected all coefficients estimated, and no "
            "delay, for scale='stable'; use scale='coefficients'"
        )
    return [(list(a), rows) for a, rows in found.items()], len(estimate.names)


def _coordinates(estimate: Estimate, table: Table) -> Array:
    theta = np.asarray(estimate.theta)
    phi = theta.copy()
    for rows, numerators in table:
        with np.errstate(divide="ignore", invalid="ignore"):
            for row in numerators:
                phi[row] = theta[row] / theta[rows[-1]]
            phi[rows] = np.log(routh(np.append(1.0, theta[rows])))
    return phi


def _coefficients(phi: Any, table: Table) -> Any:
    theta = np.empty_like(phi)
    for rows, numerators in table:
        theta[:, rows] = unrouth(np.exp(phi[:, rows]))[:, 1:]
        for row in numerators:
            theta[:, row] = phi[:, row] * theta[:, rows[-1:]]
    return theta
