"""What many coefficient vectors at once say about poles, gains, step and frequency response.

Every function takes rows of ``theta`` and gives one row each, with array operations over all rows.

*Roots* are eigenvalues of companion matrices. Which root of a draw belongs to which root of the
estimate is the assignment with the smallest sum of distances, relative to the size of the root. A
pair of conjugate roots that became two real ones keeps its meaning through its quadratic factor
``s^2 + 2 z w s + w^2 = (s - p1)(s - p2)``: the natural frequency is ``sqrt(p1 p2)`` and the damping
exceeds one. Two real roots that became a pair count with their real part. Of a saddle (one pole on
either side) the frequency counts as zero and the damping as infinite: beyond every other draw.

*Step responses* use the coordinates of the estimate: with ``X(p) = (p - A)^{-1} B`` the orthonormal
states on its denominator ``c(p)``, and ``p^k / c = m_k X``, another denominator is ``c (1 + alpha
X)`` with ``alpha = sum_k (a_k - c_k) m_k``, so that its response is that of the state matrix ``A -
B alpha``. No draw's polynomial is factored, and nothing is ill-conditioned that is not so for the
estimate.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from tridentify.errors import UnsupportedError
from tridentify.estimate import Estimate
from tridentify.numerics import delta_method
from tridentify.numerics.exponential import step_states
from tridentify.uncertainty.step import powers_of

Real = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

FEW = 4
"""Up to so many roots every assignment is tried for all draws at once (24 of them)."""


def channel_draws(
    estimate: Estimate, theta: Real, output: int, input_: int
) -> tuple[Real, Real, Real]:
    """Polynomials of one channel for every draw.

    Returns
    -------
    num : ndarray, shape (n_draws, m + 1)
    den : ndarray, shape (n_draws, n + 1)
    delay : ndarray, shape (n_draws,)
        [s].
    """
    num, den = estimate.model.num[output][input_], estimate.model.den[output][input_]
    source = estimate.input_names[input_]
    label = f"[{estimate.output_names[output]},{source}]"
    position = {name: k for k, name in enumerate(estimate.names)}

    def column(names: tuple[str, ...], known: float) -> Real:
        for name in names:
            if name in position:
                return theta[:, position[name]]
        return np.full(len(theta), known)

    def polynomial(letter: str, values: Real) -> Real:
        powers = range(len(values) - 1, -1, -1)
        columns = [
            column((f"{letter}{k}{label}", f"{letter}{k}"), v)
            for k, v in zip(powers, values.tolist(), strict=True)
        ]
        return np.stack(columns, axis=1)

    delay = column((f"delay[{source}]", "delay"), float(estimate.model.delay[output, input_]))
    return polynomial("b", num), polynomial("a", den), delay


def denominators(estimate: Estimate) -> Iterator[tuple[int, int]]:
    """Channels (output, input) with a denominator of their own; the first where it is shared."""
    for i in range(len(estimate.output_names)):
        for j in range(len(estimate.input_names)):
            if not estimate.structure.shared or (i, j) == (0, 0):
                yield i, j


def unstable(estimate: Estimate, theta: Real) -> npt.NDArray[np.bool_]:
    """Whether a draw has a pole that is not in the open left half plane, shape (n_draws,)."""
    found = np.zeros(len(theta), dtype=np.bool_)
    for i, j in denominators(estimate):
        found |= np.any(stacked_roots(channel_draws(estimate, theta, i, j)[1]).real >= 0, axis=1)
    return found


def stacked_roots(polynomials: Real) -> Complex:
    """Roots of a stack of polynomials of one degree.

    Parameters
    ----------
    polynomials : ndarray, shape (n_draws, n + 1)
        Descending powers.

    Returns
    -------
    ndarray, shape (n_draws, n)
        In no particular order; ``nan`` where a coefficient is not finite or the leading one is 0.

    Examples
    --------
    >>> np.sort(stacked_roots(np.array([[1.0, 3.0, 2.0], [2.0, 4.0, 0.0]])), axis=1).real
    array([[-2., -1.],
           [-2.,  0.]])
    """
    count, n = polynomials.shape[0], polynomials.shape[1] - 1
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        monic = polynomials[:, 1:] / polynomials[:, :1]
    sound = np.all(np.isfinite(monic), axis=1)
    companion = np.zeros((count, n, n))
    companion[:, 1:, :-1] = np.eye(max(n - 1, 0))
    if n:
        companion[:, 0, :] = -np.where(sound[:, None], monic, 0.0)
    roots = np.linalg.eigvals(companion).astype(np.complex128)
    roots[~sound] = np.nan
    return roots


def matched(roots: Complex, reference: Complex) -> Complex:
    """Reorder the roots of every draw: root ``i`` is the one that belongs to ``reference[i]``.

    Parameters
    ----------
    roots : ndarray, shape (n_draws, n)
    reference : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n_draws, n)

    Examples
    --------
    >>> matched(np.array([[-5.2 + 0j, -0.9]]), np.array([-1.0 + 0j, -5.0])).real
    array([[-0.9, -5.2]])
    """
    n = reference.size
    if n < 2:
        return roots.copy()
    scale = np.where(np.abs(reference) > 0, np.abs(reference), 1.0)
    cost = np.abs(roots[:, None, :] - reference[:, None]) / scale[:, None]
    cost = np.nan_to_num(cost, nan=0.0, posinf=1e300)
    if n <= FEW:
        orders = np.array(list(itertools.permutations(range(n))), dtype=np.intp)
        total = sum((cost[:, i, orders[:, i]] for i in range(n)), np.zeros((len(roots), 1)))
        chosen = orders[np.argmin(total, axis=1)]
    else:
        chosen = np.array([linear_sum_assignment(one)[1] for one in cost], dtype=np.intp)
    return np.take_along_axis(roots, chosen, axis=1)


def root_parts(roots: Complex, reference: Complex) -> Complex:
    """Matched roots; a reference pair keeps one real part and one non-negative imaginary part.

    Parameters
    ----------
    roots : ndarray, shape (n_draws, n)
    reference : ndarray, shape (n,)
        Conjugate pairs side by side, the upper one first.

    Returns
    -------
    ndarray, shape (n_draws, n)
        Where a pair of the reference is two real roots in a draw, both count as their mean.
    """
    found = matched(roots, reference)
    for k in np.flatnonzero(reference.imag > 0):
        first, second = found[:, k], found[:, k + 1]
        real = 0.5 * (first + second).real
        imag = np.where(first.imag == 0, 0.0, np.abs(first.imag))
        found[:, k], found[:, k + 1] = real + 1j * imag, real - 1j * imag
    return found


def pole_values(den: Real, reference: Real) -> Real:
    """Natural frequencies, dampings, real poles and time constants of every draw.

    Parameters
    ----------
    den : ndarray, shape (n_draws, n + 1)
    reference : ndarray, shape (n + 1,)
        The estimate's denominator, which says which quantities there are.

    Returns
    -------
    ndarray, shape (n_draws, n_quantities)
        In the order of `tridentify.numerics.delta_method.pole_quantities`.

    Examples
    --------
    >>> pole_values(np.array([[1.0, 1.0, 4.0], [1.0, 5.0, 4.0]]), np.array([1.0, 1.0, 4.0]))
    array([[2.  , 0.25],
           [2.  , 1.25]])
    """
    centre = delta_method.root_sensitivity(reference)[0]
    roots = matched(stacked_roots(den), centre)
    columns: list[Real] = []
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for k, pole in enumerate(centre):
            if pole.imag > 0:
                product = (roots[:, k] * roots[:, k + 1]).real
                frequency = np.sqrt(np.where(product < 0, 0.0, product))
                total = (roots[:, k] + roots[:, k + 1]).real
                columns += [frequency, -total / (2.0 * frequency)]
            elif pole.imag == 0:
                columns.append(roots[:, k].real)
                if pole.real != 0:
                    columns.append(-1.0 / roots[:, k].real)
    return np.stack(columns, axis=1)


def derived_values(estimate: Estimate, theta: Real) -> Real:
    """``estimate.derived_rows()`` of every draw, shape (n_draws, n_quantities)."""
    blocks = []
    for i, j in denominators(estimate):
        den = channel_draws(estimate, theta, i, j)[1]
        blocks.append(pole_values(den, estimate.model.den[i][j]))
    gains = []
    for i in range(len(estimate.output_names)):
        for j in range(len(estimate.input_names)):
            num, den, _ = channel_draws(estimate, theta, i, j)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                gains.append(num[:, -1] / den[:, -1])
    return np.hstack([*blocks, np.stack(gains, axis=1)])


def frequency_values(estimate: Estimate, theta: Real, omega: Real) -> Complex:
    """``G(j omega)`` of every draw, shape (n_draws, n_omega, n_outputs, n_inputs)."""
    s = (1j * omega).astype(np.complex128)
    shape = (len(theta), omega.size, len(estimate.output_names), len(estimate.input_names))
    found = np.empty(shape, dtype=np.complex128)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for i in range(shape[2]):
            for j in range(shape[3]):
                num, den, delay = channel_draws(estimate, theta, i, j)
                found[:, :, i, j] = _horner(num, s) / _horner(den, s)
                if np.any(delay):
                    found[:, :, i, j] *= np.exp(-np.outer(delay, s))
    return found


def _horner(polynomials: Real, s: Complex) -> Complex:
    value = np.zeros((len(polynomials), s.size), dtype=np.complex128)
    for column in polynomials.T:
        value = value * s + column[:, None]
    return value


def step_values(estimate: Estimate, theta: Real, times: Real) -> Real:
    """Unit step responses of every draw, shape (n_draws, n_times, n_outputs, n_inputs).

    Raises
    ------
    UnsupportedError
        A delay was estimated, so that every draw would need times of its own.
    """
    if any(name.startswith("delay") for name in estimate.names):
        raise UnsupportedError(
            "found an estimated delay; expected a known one to draw step responses; use step_band"
        )
    shape = (len(theta), times.size, len(estimate.output_names), len(estimate.input_names))
    found = np.empty(shape)
    for i in range(shape[2]):
        for j in range(shape[3]):
            late = times - estimate.model.delay[i, j]
            num, den, _ = channel_draws(estimate, theta, i, j)
            found[:, :, i, j] = _step(num, den, estimate.model.den[i][j], late)
    return found


def _step(num: Real, den: Real, reference: Real, times: Real) -> Real:
    """Step responses (n_draws, n_times) by the coordinates of the reference denominator."""
    n, m = reference.size - 1, num.shape[1] - 1
    a, b, powers = powers_of(reference)
    alpha = (den[:, 1:] - reference[1:]) @ powers
    padded = np.pad(num, ((0, 0), (n - m, 0)))
    direct = padded[:, 0]
    # b / den = beta X w + d w with w = u - alpha X w, and b / c = beta X + d
    beta = (padded[:, 1:] - direct[:, None] * reference[1:]) @ powers
    output = beta - direct[:, None] * alpha
    closed = a - b[:, None] * alpha[:, None, :]
    drive = np.broadcast_to(b, (len(num), n))
    states = step_states(closed, drive, np.maximum(times, 0.0))
    with np.errstate(over="ignore", invalid="ignore"):
        response = np.einsum("tdn,dn->dt", states, output)
    return np.asarray(response + np.outer(direct, times >= 0))
