"""Many denominators at once, by sections: coordinates, polynomials, orthonormal cascades.

A stable denominator of degree ``n`` is a product of ``n // 2`` sections ``p^2 + 2 zeta w p + w^2``
and, for odd ``n``, one factor ``p + s``. Its coordinates are ``(log w, log zeta)`` of each section
and ``log s``. Real pairs are sections with ``zeta > 1``, so a pair that splits from complex
to real moves on a smooth path, and ``|d(c, d) / d(log w, log zeta)| = 2 c w^2`` for ``c = 2
zeta w, d = w^2`` is nowhere singular. The product of factors ``f_i`` gives ``delta a = sum_i
delta f_i prod_{j != i} f_j``, a linear map whose determinant is the product of the resultants:

    |da / dphi| = prod_i (2 c_i w_i^2) * s * prod_{i < j} prod_{p in f_i, q in f_j} |p - q|.

One denominator has several coordinates (sections in any order, real poles paired in any way);
`multiplicity` counts them.

The cascade is that of `numerics.realization` with a section for every pair, complex or
real: ``x1' = -c x1 - w x2 + sqrt(2 c) v``, ``x2' = w x1`` is orthonormal for any ``zeta > 0``
(Kautz 1954), as ``A + A' + B B' = 0`` shows. All arrays run over the denominators first; rates
are in units of one over the sampling interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tridentify.numerics.arrays import Array, Complex

CLOSEST = 1e-300
"""Keeps the logarithm of the distance of two equal poles a number: near the smallest double."""
DIFFERENCE = 1e-6
"""Step of central differences of a logarithm: near the cube root of rounding."""


@dataclass(frozen=True, eq=False)
class Sections:
    """Denominators by their sections.

    Attributes
    ----------
    damping, frequency : (s, n // 2) arrays
        ``c = 2 zeta w`` and ``w`` of ``p^2 + c p + w^2``.
    rate : (s, n % 2) array
        ``s`` of the factor ``p + s``.
    """

    damping: Array
    frequency: Array
    rate: Array

    @classmethod
    def of(cls, phi: Array, n: int) -> Sections:
        """From coordinates (s, n)."""
        pairs = phi[:, : 2 * (n // 2)].reshape(phi.shape[0], -1, 2)
        frequency = np.exp(pairs[:, :, 0])
        return cls(2.0 * frequency * np.exp(pairs[:, :, 1]), frequency, np.exp(phi[:, n - n % 2 :]))

    @property
    def degree(self) -> int:
        """``n``."""
        return int(2 * self.frequency.shape[1] + self.rate.shape[1])

    def roots(self) -> Complex:
        """(s, n) roots, section by section."""
        half = 0.5 * self.damping
        apart = np.sqrt((half**2 - self.frequency**2).astype(np.complex128))
        larger = half + apart
        smaller = np.where(apart.imag == 0, self.frequency**2 / larger, half - apart)
        pairs = np.stack([-larger, -smaller], axis=2).reshape(half.shape[0], -1)
        return np.asarray(np.concatenate([pairs, -self.rate.astype(np.complex128)], axis=1))

    def polynomials(self) -> Array:
        """(s, n + 1) coefficients, descending powers."""
        found: Array = np.ones((self.damping.shape[0], 1))
        for i in range(self.damping.shape[1]):
            grown = np.zeros((len(found), found.shape[1] + 2))
            grown[:, :-2] = found
            grown[:, 1:-1] += self.damping[:, i : i + 1] * found
            grown[:, 2:] += self.frequency[:, i : i + 1] ** 2 * found
            found = grown
        for i in range(self.rate.shape[1]):
            grown = np.zeros((len(found), found.shape[1] + 1))
            grown[:, :-1] = found
            grown[:, 1:] += self.rate[:, i : i + 1] * found
            found = grown
        return np.asarray(found)

    def log_jacobian(self) -> Array:
        """(s,) ``log |da / dphi|``."""
        total = np.log(2.0 * self.damping * self.frequency**2).sum(axis=1)
        total += np.log(self.rate).sum(axis=1)
        roots = self.roots()
        owner = np.repeat(np.arange(roots.shape[1] // 2 + 1), 2)[: roots.shape[1]]
        for j in range(1, roots.shape[1]):
            others = np.flatnonzero(owner[:j] < owner[j])
            gaps = np.abs(roots[:, others] - roots[:, j : j + 1])
            total += np.log(np.maximum(gaps, CLOSEST)).sum(axis=1)
        return np.asarray(total)

    def log_multiplicity(self) -> Array:
        """(s,) logarithm of the number of coordinates that give the same denominator."""
        sections, odd = self.frequency.shape[1], self.rate.shape[1]
        real = 2 * (self.damping >= 2.0 * self.frequency).sum(axis=1) + odd
        table = np.zeros(self.degree + 1)
        for count in range(odd, self.degree + 1, 2):
            pairs = count // 2
            ways = math.factorial(count) // (2**pairs * math.factorial(pairs))
            table[count] = math.log(math.factorial(sections) * ways)
        return np.asarray(table[real])

    def geometric_mean(self) -> Array:
        """(s,) geometric mean of the pole magnitudes."""
        logs = 2.0 * np.log(self.frequency).sum(axis=1) + np.log(self.rate).sum(axis=1)
        return np.asarray(np.exp(logs / self.degree))

    def cascade(self, repeats: int) -> tuple[Array, Array]:
        """Orthonormal cascades of all sections, repeated: ``A`` (s, q, q), ``B`` (s, q)."""
        n, count = self.degree, self.damping.shape[0]
        a = np.zeros((count, n, n))
        b = np.zeros((count, n))
        for i in range(self.frequency.shape[1]):
            at = 2 * i
            a[:, at, at] = -self.damping[:, i]
            a[:, at, at + 1] = -self.frequency[:, i]
            a[:, at + 1, at] = self.frequency[:, i]
            b[:, at] = np.sqrt(2.0 * self.damping[:, i])
        if self.rate.shape[1]:
            a[:, -1, -1] = -self.rate[:, 0]
            b[:, -1] = np.sqrt(2.0 * self.rate[:, 0])
        whole = np.zeros((count, n * repeats, n * repeats))
        for k in range(repeats):
            whole[:, k * n : (k + 1) * n, k * n : (k + 1) * n] = a
        b = np.tile(b, (1, repeats))
        section = np.tile(np.arange(n) // 2, repeats) + np.repeat(np.arange(repeats), n) * n
        lower = section[:, None] > section[None, :]
        return whole - lower * b[:, :, None] * b[:, None, :], b


def coordinates(poles: Complex) -> Array:
    """(n,) or (s, n) coordinates of stable denominators, all with as many real poles.

    Complex pairs are sections; real poles are paired neighbour with neighbour, the fastest left
    over for odd ``n``.

    Parameters
    ----------
    poles : (n,) or (s, n) complex array
        Of each closed under conjugation.

    Examples
    --------
    >>> phi = coordinates(np.array([-1 + 2j, -1 - 2j, -3.0]))
    >>> Sections.of(phi[None], 3).polynomials().round(12).tolist()
    [[1.0, 5.0, 11.0, 15.0]]
    """
    count = poles.size // poles.shape[-1]
    upper = poles[poles.imag > 0].reshape(count, -1)
    real = np.sort(-poles[poles.imag == 0].real.reshape(count, -1), axis=1)
    paired = real.shape[1] // 2 * 2
    slow, fast = real[:, 0:paired:2], real[:, 1:paired:2]
    frequency = np.concatenate([np.abs(upper), np.sqrt(slow) * np.sqrt(fast)], axis=1)
    half = np.concatenate([-upper.real, 0.5 * (slow + fast)], axis=1)
    pairs = np.log(np.stack([frequency, half / frequency], axis=2)).reshape(count, -1)
    return np.concatenate([pairs, np.log(real[:, paired:])], axis=1).reshape(poles.shape)


def phi_of_a(phi: Array) -> Array:
    """(n, n) ``dphi / da`` by central differences of the polynomial."""
    n = phi.size
    steps = DIFFERENCE * np.eye(n)
    up = Sections.of(phi + steps, n).polynomials()[:, 1:]
    down = Sections.of(phi - steps, n).polynomials()[:, 1:]
    jacobian = (up - down).T / (2.0 * DIFFERENCE)
    scale = np.abs(jacobian).max(axis=1, keepdims=True)
    return np.asarray(np.linalg.pinv(jacobian / scale) / scale.T)


def numerator_tables(a: Array, b: Array, polynomials: Array) -> Array:
    """(s, n, n) numerators of the states: row ``i`` descending powers ``p^{n-1} .. p^0``.

    ``adj(p - A) B = sum_k p^{n-1-k} (A^k + a_1 A^{k-1} + ... + a_k) B`` (Faddeev-Leverrier).
    """
    n = b.shape[1]
    table = np.empty((b.shape[0], n, n))
    column = b
    for k in range(n):
        table[:, :, k] = column
        column = np.einsum("sij,sj->si", a, column) + polynomials[:, k + 1 : k + 2] * b
    return table


def degree_bases(a: Array, b: Array) -> Array:
    """(s, n, n) orthonormal columns; the last ``m + 1`` span the numerators of degree ``<= m``."""
    from tridentify.estimation.posterior.compiled_triangles import fill_bases

    found = np.empty(a.shape)
    fill_bases(a, b, found)
    return found


def filtered_rows(a: Array, b: Array, bank_a: Array, rows: Array) -> Array:
    """``rows @ realization.filter_map``, (s, k, n, q), for rows (s, k, q) of many banks' states."""
    from tridentify.estimation.posterior.compiled_triangles import fill_maps

    found = np.zeros((*rows.shape[:2], b.shape[1], rows.shape[2]))
    fill_maps(a, b, bank_a, rows, found)
    return found
