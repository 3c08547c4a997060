"""Orthonormal cascades: any stable poles, repeated or not, as one well-conditioned state equation.

A real pole ``-s`` gives the section ``x' = -s x + sqrt(2 s) v``; a conjugate pair with
``p^2 + c p + w^2`` the section ``x1' = -c x1 - w x2 + sqrt(2 c) v``, ``x2' = w x1``. Both satisfy
``A + A' + B B' = 0``, and ``v - B' x`` is the input passed through the all-pass of the section,
``a(-p) / a(p)`` up to sign. Feeding every section with the all-pass output of the one before gives,
for the whole cascade,

    A = blockdiag(A_1, ..., A_r) - strictly_lower(B B'),  B = [B_1; ...; B_r],  A + A' + B B' = 0.

Hence the controllability Gramian is the identity: the impulse responses of the states are
orthonormal in L2(0, inf). They are the Takenaka-Malmquist functions, in real arithmetic:
Laguerre for one repeated real pole, Kautz for one repeated pair, the generalised orthonormal
basis otherwise (Ninness & Gustafsson 1997; Wahlberg 1991; Van den Hof, Heuberger & Bokor 1995).
``e^{A t}`` is a contraction, whatever the order and the spread of the poles, so no polynomial
is ever expanded to compute a filter.

Three facts carry the rest of the package; ``X(p) = (p - A)^{-1} B`` is the vector of states per
unit input.

*Numerators.* A row ``v`` stands for ``v X = n(p) / c(p)`` with ``c`` the product of all
sections. ``deg n <= q - 1 - r`` exactly when ``v B = v A B = ... = v A^{r-1} B = 0``. Arnoldi
orthogonalises this Krylov sequence, so its vectors ``k_1, ..., k_q`` sort the rows by degree:
``deg n <= d`` iff ``v`` lies in span(k_{q-d}, ..., k_q), an orthonormal basis (`degree_basis`).

*Products.* A second bank ``(A_c, B_c)``, whose poles are among those of ``(A, B)``, driven by
the signal ``w X u + d u`` has states in span(X) plus nothing else when the poles suffice; their
coordinates are inner products of impulse responses, hence the cross Gramian: the solution of
``A_c P + P A' + B_c (w + d B') = 0`` (`filter_map`).

*New poles.* ``1 + v X`` has the zeros ``eig(A - B v)``: how a denominator ``a = c (1 + v X)``
gives its roots without ever being expanded (`roots_of`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.recent import recent

KEPT = 256
"""Results that are kept of each function: those of one search at a time."""

APART = 1e-4
"""Relative distance of two poles below which their eigenvectors say nothing about one of them."""


class Cascade(NamedTuple):
    """An orthonormal cascade: ``a`` (q, q) [1/s], ``b`` (q,), ``poles`` (q,) state by state."""

    a: Array
    b: Array
    poles: Complex

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.b.size)


def sort_poles(poles: Complex) -> Complex:
    """Order poles slow to fast with every conjugate pair side by side, and make the pairs exact.

    Parameters
    ----------
    poles : (q,) complex array
        Closed under conjugation up to rounding.

    Returns
    -------
    (q,) complex array
        Pairs as ``(x + jy, x - jy)``, ``y > 0``.

    Examples
    --------
    >>> sort_poles(np.array([-3, -1 - 2j, -1 + 2j])).tolist()
    [(-1+2j), (-1-2j), (-3+0j)]
    """
    poles = np.asarray(poles, dtype=np.complex128)
    listed = poles.tolist()
    if len(listed) == 2 and listed[0].imag > 0 and listed[1].imag < 0:
        return np.array([listed[0], listed[0].conjugate()], dtype=np.complex128)
    try:
        sizes = [abs(z) for z in listed]
    except OverflowError:  # beyond the largest number
        with np.errstate(over="ignore"):
            sizes = np.abs(poles).tolist()
    sized = list(zip(sizes, listed, strict=True))
    units = [(size, z) for size, z in sized if z.imag > 0]
    units += [(size, complex(z.real)) for size, z in sized if z.imag == 0]
    units.sort(key=lambda unit: (unit[0], unit[1].imag))
    ordered: list[complex] = []
    for _, z in units:
        ordered.extend((z, z.conjugate()) if z.imag > 0 else (z,))
    return np.array(ordered, dtype=np.complex128)


@recent(KEPT)
def cascade(poles: Complex) -> Cascade:
    """Orthonormal cascade of the given stable poles, in the given order.

    Parameters
    ----------
    poles : (q,) complex array
        Real parts negative; a conjugate pair stands side by side (`sort_poles`). Any multiplicity.

    Returns
    -------
    Cascade

    Raises
    ------
    ValueError
        If a pole is not in the open left half plane or a pair is torn apart.

    Examples
    --------
    >>> c = cascade(np.array([-1 + 2j, -1 - 2j, -3.0]))
    >>> bool(np.allclose(c.a + c.a.T + np.outer(c.b, c.b), 0, atol=1e-14))
    True
    """
    from tridentify.numerics.kernels.cascades import fill_cascade

    poles = np.array(poles, dtype=np.complex128)
    a, b = np.zeros((poles.size, poles.size)), np.zeros(poles.size)
    fill_cascade(poles, 1, a, b)
    return Cascade(a, b, poles)


def denominator(poles: Complex) -> Array:
    """Coefficients of ``prod (p - pole)``, descending powers, by real sections.

    Examples
    --------
    >>> denominator(np.array([-1 + 2j, -1 - 2j, -3.0])).tolist()
    [1.0, 5.0, 11.0, 15.0]
    """
    from tridentify.numerics.kernels.polynomials import expanded

    return expanded(np.ascontiguousarray(poles, dtype=np.complex128))


def numerators(poles: Complex) -> Array:
    """Numerators ``n_i(p)`` of the states over the common denominator.

    Parameters
    ----------
    poles : (q,) complex array
        As for `cascade`.

    Returns
    -------
    (q, q) array
        Row ``i``: ``n_i``, descending powers ``p^{q-1} .. p^0``, so that state ``i`` is
        ``n_i(p) / prod (p - pole)``.
    """
    from tridentify.numerics.kernels.polynomials import numerator_table

    return numerator_table(np.ascontiguousarray(poles, dtype=np.complex128))


class DegreeBasis(NamedTuple):
    """Rows sorted by the degree of their numerator.

    ``rows[d]`` (q,) is a unit vector whose numerator has degree ``d`` exactly, with leading
    coefficient ``leading[d]``; ``rows[:d + 1]`` spans all numerators of degree at most ``d``.
    """

    rows: Array
    leading: Array


@recent(KEPT)
def degree_basis(bank: Cascade) -> DegreeBasis:
    """Orthonormal basis of the numerators, sorted by degree (Arnoldi).

    Examples
    --------
    >>> bank = cascade(np.array([-1.0, -2.0, -5.0]))
    >>> basis = degree_basis(bank)
    >>> coefficients = basis.rows @ numerators(bank.poles)
    >>> bool(np.allclose(np.tril(coefficients[:, ::-1]), coefficients[:, ::-1]))
    True
    """
    from tridentify.numerics.kernels.cascades import fill_basis

    q = bank.order
    rows, leading = np.zeros((q, q)), np.zeros(q)
    fill_basis(bank.a, bank.b, rows, leading)
    return DegreeBasis(rows, leading)


@recent(KEPT)
def filter_map(inner: Cascade, bank: Cascade) -> Array:
    """How the states of ``inner`` answer to each state of ``bank``, in coordinates on ``bank``.

    Parameters
    ----------
    inner : Cascade
        The filter (q_c states), whose poles are poles of the bank in addition to those that the
        filtered signals use.
    bank : Cascade
        The bank on which everything is expanded (q states).

    Returns
    -------
    (q, q_c, q) array
        Slice ``k`` holds the coordinates of the states of ``inner`` driven by state ``k`` of
        ``bank``. A signal ``row X + direct u`` gives ``tensordot(row + direct B, map, 1)``.

    Notes
    -----
    The coordinates are inner products of impulse responses, ``P = int z(t) x(t)' dt``, and
    solve the Sylvester equation ``A_c P + P A' = - B_c (row + direct B')``; here for all unit
    rows at once, section by section of the bank (`numerics.kernels.cascades`).

    Examples
    --------
    >>> bank = cascade(np.array([-1.0, -1.0]))
    >>> inner = cascade(np.array([-1.0]))
    >>> np.tensordot(bank.b, filter_map(inner, bank), 1).round(12).tolist()
    [[1.0, 0.0]]
    """
    from tridentify.numerics.kernels.cascades import fill_map

    found = np.zeros((bank.order, inner.order, bank.order))
    fill_map(inner.a, inner.b, bank.a, np.eye(bank.order), found)
    return found


def monomials(bank: Cascade, count: int) -> Array:
    """Rows of ``p^d / c(p)``, ``d = 0 .. count-1``, with ``c`` the denominator of the bank.

    Multiplication by ``p`` is ``v -> v A`` while the degree stays below ``q``, and ``1 / c`` is
    the last Arnoldi vector over its leading coefficient.

    Parameters
    ----------
    bank : Cascade
        q states.
    count : int
        Number of powers, at most q.

    Returns
    -------
    (count, q) array

    Examples
    --------
    >>> bank = cascade(np.array([-1.0, -2.0]))
    >>> (monomials(bank, 2) @ numerators(bank.poles)).round(12).tolist()
    [[0.0, 1.0], [1.0, 0.0]]
    """
    basis = degree_basis(bank)
    rows = np.zeros((count, bank.order))
    rows[0] = basis.rows[0] / basis.leading[0]
    for d in range(1, count):
        rows[d] = rows[d - 1] @ bank.a
    return rows


def roots_of(bank: Cascade, row: Array) -> Complex:
    """Zeros of ``1 + row X(p)``: the roots of the denominator ``c(p) (1 + row X)``.

    Examples
    --------
    >>> bank = cascade(np.array([-1.0, -2.0]))
    >>> roots_of(bank, np.zeros(2)).tolist()
    [(-1+0j), (-2+0j)]
    """
    if bank.order <= 2:
        found = _eigenvalues((bank.a - bank.b[:, None] * row).tolist())
        if found is not None:
            return sort_poles(np.array(found, dtype=np.complex128))
    return sort_poles(np.linalg.eigvals(bank.a - np.outer(bank.b, row)).astype(np.complex128))


def _eigenvalues(matrix: list[list[float]]) -> list[complex] | None:
    """Of one or two rows, without the checks that take longer; None where they are not finite."""
    if len(matrix) == 1:
        return [complex(matrix[0][0])] if math.isfinite(matrix[0][0]) else None
    (a, b), (c, d) = matrix
    half, product = 0.5 * (a - d), b * c
    square = half * half + product
    if not (math.isfinite(square) and math.isfinite(a + d)):
        return None
    if square < 0.0:
        mean, turn = 0.5 * (a + d), math.sqrt(-square)
        return [complex(mean, turn), complex(mean, -turn)]
    # the larger of two roots first: the other one without a difference of near equals
    large = half + math.copysign(math.sqrt(square), half)
    return [complex(d + large), complex(d - product / large if large else d)]


def row_of(bank: Cascade, roots: Complex) -> Array | None:
    """The row that `roots_of` turns into given roots; None where poles of the bank coincide.

    ``row X(p) = prod (p - root) / prod (p - pole) - 1`` is compared with ``X(p) = sum_k R_k (l_k
    B) / (p - z_k)``, ``R`` and ``l`` the right and left eigenvectors of ``A``, in the residues at
    the poles.

    Examples
    --------
    >>> bank = cascade(np.array([-1.0, -2.0 + 1.0j, -2.0 - 1.0j]))
    >>> row = row_of(bank, np.array([-1.5, -2.0 + 2.0j, -2.0 - 2.0j]))
    >>> roots_of(bank, row).round(9).tolist()
    [(-1.5+0j), (-2+2j), (-2-2j)]
    """
    if bank.order == 2:
        return _row_of_two(bank, roots)
    z, right = np.linalg.eig(bank.a)
    apart = z[:, None] - z[None, :]
    others = ~np.eye(z.size, dtype=bool)
    if np.any((np.abs(apart) < APART * np.abs(z)[:, None]) & others):
        return None
    apart[~others] = 1.0
    residues = np.prod((z[:, None] - roots[None, :]) / apart, axis=1)
    drive = np.linalg.solve(right, bank.b.astype(np.complex128))
    return np.asarray(np.linalg.solve(right.T, residues / drive).real)


def _row_of_two(bank: Cascade, roots: Complex) -> Array | None:
    """`row_of` by sum and product of the roots, those of ``A - B row``: two linear equations."""
    (a, b), (c, d) = bank.a.tolist()
    one, other = bank.poles.tolist()
    if abs(one - other) < APART * abs(one) or abs(one - other) < APART * abs(other):
        return None
    x, y = bank.b.tolist()
    first, second = roots.tolist()
    fall = a + d - (first + second).real
    rest = a * d - b * c - (first * second).real
    # row times B is the fall of the trace, row times adj(A) B that of the determinant
    u, v = d * x - b * y, a * y - c * x
    size = x * v - y * u
    if size == 0.0:
        return None
    return np.array([(fall * v - rest * y) / size, (rest * x - fall * u) / size])
