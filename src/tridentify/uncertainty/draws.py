"""What many coefficient vectors at once say about poles, gains, step and frequency response.

Every function takes rows of ``theta`` and gives one row each, with array operations over all rows.

*Roots*, and which root of a draw belongs to which root of the estimate: `numerics.root_draws`.

*Step responses* use the coordinates of the estimate: with ``X(p) = (p - A)^{-1} B`` the orthonormal
states on its denominator ``c(p)``, and ``p^k / c = m_k X``, another denominator is ``c (1 + alpha
X)`` with ``alpha = sum_k (a_k - c_k) m_k``, so that its response is that of the state matrix ``A -
B alpha``. No draw's polynomial is factored, and nothing is ill-conditioned that is not so for the
estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tridentify.errors import UnsupportedError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.exponential import step_states
from tridentify.numerics.root_draws import matched, stacked_roots
from tridentify.uncertainty.step import powers_of


def denominators(estimate: Estimate) -> Iterator[tuple[int, int]]:
    """Channels (output, input) with a denominator of their own; the first where it is shared."""
    for i in range(len(estimate.output_names)):
        for j in range(len(estimate.input_names)):
            if not estimate.structure.shared or (i, j) == (0, 0):
                yield i, j


def unstable(estimate: Estimate, theta: Array) -> npt.NDArray[np.bool_]:
    """Whether a draw has a pole that is not in the open left half plane, shape (n_draws,)."""
    found = np.zeros(len(theta), dtype=np.bool_)
    for i, j in denominators(estimate):
        found |= np.any(stacked_roots(estimate.channel_draws(theta, i, j)[1]).real >= 0, axis=1)
    return found


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


def frequency_values(estimate: Estimate, theta: Array, omega: Array) -> Complex:
    """``G(j omega)`` of every draw, shape (n_draws, n_omega, n_outputs, n_inputs)."""
    s = (1j * omega).astype(np.complex128)
    shape = (len(theta), omega.size, len(estimate.output_names), len(estimate.input_names))
    found = np.empty(shape, dtype=np.complex128)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for i in range(shape[2]):
            for j in range(shape[3]):
                num, den, delay = estimate.channel_draws(theta, i, j)
                found[:, :, i, j] = _horner(num, s) / _horner(den, s)
                if np.any(delay):
                    found[:, :, i, j] *= np.exp(-np.outer(delay, s))
    return found


def _horner(polynomials: Array, s: Complex) -> Complex:
    value = np.zeros((len(polynomials), s.size), dtype=np.complex128)
    for column in polynomials.T:
        value = value * s + column[:, None]
    return value


def step_values(estimate: Estimate, theta: Array, times: Array) -> Array:
    """Unit step responses of every draw, shape (n_draws, n_times, n_outputs, n_inputs).

    Raises
    ------
    UnsupportedError
        A delay was estimated, so that every draw would need times of its own.
    """
    return _time_values(estimate, theta, times, _step)


def impulse_values(estimate: Estimate, theta: Array, times: Array) -> Array:
    """Impulse responses of every draw, without the impulse of a direct term; as `step_values`."""
    return _time_values(estimate, theta, times, _impulse)


def _time_values(
    estimate: Estimate,
    theta: Array,
    times: Array,
    respond: Callable[[Array, Array, Array, Array], Array],
) -> Array:
    if any(name.startswith("delay") for name in estimate.names):
        raise UnsupportedError(
            "found an estimated delay; expected a known one to draw responses over time; use "
            "step_band or impulse_band"
        )
    shape = (len(theta), times.size, len(estimate.output_names), len(estimate.input_names))
    found = np.empty(shape)
    for i in range(shape[2]):
        for j in range(shape[3]):
            late = times - estimate.model.delay[i, j]
            num, den, _ = estimate.channel_draws(theta, i, j)
            found[:, :, i, j] = respond(num, den, estimate.model.den[i][j], late)
    return found


class _Driven(NamedTuple):
    """Systems in the coordinates of a reference denominator, and their states under a step."""

    closed: Array
    drive: Array
    output: Array
    direct: Array
    states: Array


def _driven(num: Array, den: Array, reference: Array, times: Array) -> _Driven:
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
    return _Driven(closed, drive, output, direct, states)


def _step(num: Array, den: Array, reference: Array, times: Array) -> Array:
    """Step responses (n_draws, n_times) by the coordinates of the reference denominator."""
    found = _driven(num, den, reference, times)
    with np.errstate(over="ignore", invalid="ignore"):
        response = np.einsum("tdn,dn->dt", found.states, found.output)
    return np.asarray(response + np.outer(found.direct, times >= 0))


def _impulse(num: Array, den: Array, reference: Array, times: Array) -> Array:
    """Impulse responses (n_draws, n_times): the states move as those under a step change."""
    found = _driven(num, den, reference, times)
    with np.errstate(over="ignore", invalid="ignore"):
        kicked = np.einsum("dnm,tdm->tdn", found.closed, found.states) + found.drive
        response = np.einsum("tdn,dn->dt", kicked, found.output)
    return np.asarray(response * (times >= 0))
