"""First-order propagation of a covariance through polynomials and their roots.

With coefficients ``theta`` of covariance ``C`` and a smooth function ``g``, the delta method takes
``var g = J C J'`` with ``J = dg/dtheta``. All derivatives here are analytic:

- a simple root of ``a(s) = sum_k a_k s^k``: differentiating ``a(lambda) = 0`` gives
  ``d lambda / d a_k = -lambda^k / a'(lambda)``;
- natural frequency ``w = |lambda|`` and damping ``z = -Re(lambda) / w``:
  ``dw = Re(conj(lambda) d lambda) / w`` and ``dz = -(Re(d lambda) + z dw) / w``;
- static gain ``g = b_0 / a_0``: ``dg/db_0 = 1/a_0``, ``dg/da_0 = -g/a_0``;
- frequency response: ``d ln G / d b_k = s^k / b(s)``, ``d ln G / d a_k = -s^k / a(s)`` at
  ``s = j omega``; the real part is the relative change of the magnitude, the imaginary part the
  change of the phase;
- step response: ``dy / db_k = p^k / a`` and ``dy / da_k = -p^k / a`` of the response itself, both
  simulated exactly (`step_response`).

A delay ``tau`` turns the phase by ``-omega tau``: ``d ln G / d tau = -j omega``. Polynomials have
descending powers and denominators are monic. The covariance of one channel is that of
``(a_{n-1}, ..., a_0, b_m, ..., b_0, tau)``.

References: S. M. Kay, *Fundamentals of Statistical Signal Processing*, vol. 1, sec. 3.6 (1993);
L. Ljung, *System Identification*, 2nd ed., sec. 9.4 (1999).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.exponential import step_states

LEAST_VARIANCE = 1e-15
"""Relative to the squared terms it is made of: four units of rounding, from which nothing is
told."""


def standard_deviation(jacobian: Array, cov: Array) -> Array:
    """Standard deviations of linear combinations of correlated coefficients.

    Parameters
    ----------
    jacobian : ndarray, shape (..., n_parameters)
    cov : ndarray, shape (n_parameters, n_parameters)

    Returns
    -------
    ndarray, shape (...)
        A variance that is no more than the rounding of its terms counts as zero: that of a
        combination which is known exactly, though its coefficients are not.

    Examples
    --------
    >>> standard_deviation(np.array([[3.0, 4.0]]), np.eye(2))
    array([5.])
    """
    if jacobian.shape[-1] == 0:
        return np.zeros(jacobian.shape[:-1])
    with np.errstate(invalid="ignore", over="ignore"):
        variance = np.einsum("...i,ij,...j->...", jacobian, cov, jacobian, optimize=True)
        size = np.abs(jacobian) @ np.sqrt(np.maximum(np.diag(cov), 0.0))
        std: Array = np.sqrt(np.where(variance <= LEAST_VARIANCE * size**2, 0.0, variance))
    return std


def root_sensitivity(polynomial: npt.ArrayLike, *, monic: bool = True) -> tuple[Complex, Complex]:
    """Roots of a polynomial and their derivatives by its coefficients.

    Parameters
    ----------
    polynomial : array_like, shape (n + 1,)
        Descending powers; the leading coefficient is not zero.
    monic : bool
        The leading coefficient is a known 1 and has no column in the derivatives.

    Returns
    -------
    roots : ndarray, shape (n,)
        Sorted by magnitude; conjugate pairs stay together, positive imaginary part first.
    sensitivity : ndarray, shape (n, n) if monic else (n, n + 1)
        ``d roots[i] / d coefficient[k]``, coefficients in descending powers. Not finite at a
        repeated root, which has no derivative.

    Examples
    --------
    >>> roots, sensitivity = root_sensitivity([1.0, 3.0, 2.0])
    >>> roots.real
    array([-1., -2.])
    >>> sensitivity.real
    array([[ 1., -1.],
           [-2.,  1.]])
    """
    coefficients = np.atleast_1d(np.asarray(polynomial, dtype=np.float64))
    roots = np.atleast_1d(np.roots(coefficients)).astype(np.complex128)
    roots = roots[np.lexsort((-roots.imag, roots.real, np.abs(roots)))]
    degree = coefficients.size - 1
    powers = np.arange(degree - 1 if monic else degree, -1, -1)
    slope = np.polyval(np.polyder(coefficients), roots) if degree else np.empty(0)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        sensitivity = -(roots[:, None] ** powers) / slope[:, None]
    return roots, sensitivity.astype(np.complex128)


def pole_quantities(den: npt.ArrayLike, cov: Array) -> tuple[tuple[str, float, float, str], ...]:
    """Natural frequency and damping of each pole pair; place and time constant of a real pole.

    Parameters
    ----------
    den : array_like, shape (n + 1,)
        Monic denominator, descending powers.
    cov : ndarray, shape (n, n)
        Covariance of ``(a_{n-1}, ..., a_0)``.

    Returns
    -------
    tuple of (kind, value, std, unit)
        ``kind`` is one of "natural frequency" [rad/s], "damping" [-], "real pole" [1/s],
        "time constant" [s] (left out for a pole at zero), numbered where there are several.

    Examples
    --------
    >>> for row in pole_quantities([1.0, 1.0, 3.0], np.diag([0.01, 0.04])):
    ...     print("{} {:.4f} {:.4f} {}".format(*row))
    natural frequency 1.7321 0.0577 rad/s
    damping 0.2887 0.0304 -
    """
    poles, sensitivity = root_sensitivity(den)
    rows: list[tuple[str, float, float, str]] = []
    for pole, derivative in zip(poles, sensitivity, strict=True):
        if pole.imag < 0:
            continue
        if pole.imag == 0:
            value = float(pole.real)
            std = float(standard_deviation(derivative.real, cov))
            rows.append(("real pole", value, std, "1/s"))
            if value != 0:
                rows.append(("time constant", -1 / value, std / value / value, "s"))
            continue
        frequency = abs(pole)
        damping = -pole.real / frequency
        d_frequency = (np.conj(pole) * derivative).real / frequency
        d_damping = -(derivative.real + damping * d_frequency) / frequency
        frequency_std = float(standard_deviation(d_frequency, cov))
        damping_std = float(standard_deviation(d_damping, cov))
        rows.append(("natural frequency", float(frequency), frequency_std, "rad/s"))
        rows.append(("damping", float(damping), damping_std, "-"))
    kinds = [row[0] for row in rows]
    for k, (kind, *_) in enumerate(rows):
        if kinds.count(kind) > 1:
            rows[k] = (f"{kind} {kinds[: k + 1].count(kind)}", *rows[k][1:])
    return tuple(rows)


def dc_gain(num: npt.ArrayLike, den: npt.ArrayLike, cov: Array) -> tuple[float, float]:
    """Static gain ``b_0 / a_0`` and its standard deviation.

    Parameters
    ----------
    num, den : array_like
        Descending powers, ``den`` monic.
    cov : ndarray, shape (n + m + 2, n + m + 2)
        Covariance of ``(a_{n-1}, ..., a_0, b_m, ..., b_0, tau)``.

    Returns
    -------
    gain, std : float
        Infinite gain and ``nan`` for an integrator.

    Examples
    --------
    >>> gain, std = dc_gain([2.0], [1.0, 4.0], np.diag([0.16, 0.04, 0.0]))
    >>> gain, round(std, 4)
    (0.5, 0.0707)
    """
    b, a = np.atleast_1d(np.asarray(num, float)), np.atleast_1d(np.asarray(den, float))
    degree = a.size - 1
    if a[-1] == 0:
        return math.copysign(math.inf, b[-1]), math.nan
    gain = float(b[-1] / a[-1])
    jacobian = np.zeros(degree + b.size + 1)
    jacobian[-2] = 1 / a[-1]
    if degree:
        jacobian[degree - 1] = -gain / a[-1]
    return gain, float(standard_deviation(jacobian, cov))


def frequency_response_std(
    num: npt.ArrayLike, den: npt.ArrayLike, cov: Array, omega: npt.ArrayLike
) -> tuple[Array, Array]:
    """Standard deviations of magnitude (relative) and phase of ``b(j omega) / a(j omega)``.

    Parameters
    ----------
    num, den : array_like
        Descending powers, ``den`` monic.
    cov : ndarray, shape (n + m + 2, n + m + 2)
        Covariance of ``(a_{n-1}, ..., a_0, b_m, ..., b_0, tau)``.
    omega : array_like, shape (n_omega,)
        Angular frequencies [rad/s].

    Returns
    -------
    magnitude_std : ndarray, shape (n_omega,)
        Relative: ``std |G| / |G|``.
    phase_std : ndarray, shape (n_omega,)
        [rad].

    Examples
    --------
    >>> cov = np.diag([0.0, 0.01, 0.0])
    >>> frequency_response_std([1.0], [1.0, 1.0], cov, [0.0])
    (array([0.1]), array([0.]))
    """
    jacobian = frequency_response_slopes(num, den, omega)
    return standard_deviation(jacobian.real, cov), standard_deviation(jacobian.imag, cov)


def frequency_response_slopes(
    num: npt.ArrayLike, den: npt.ArrayLike, omega: npt.ArrayLike
) -> Complex:
    """Derivatives of ``ln(b(j omega) / a(j omega))`` by the coefficients.

    Parameters
    ----------
    num, den : array_like
        Descending powers, ``den`` monic of degree n.
    omega : array_like, shape (n_omega,)
        Angular frequencies [rad/s].

    Returns
    -------
    ndarray of complex, shape (n_omega, n + m + 2)
        By ``(a_{n-1}, ..., a_0, b_m, ..., b_0, tau)``; not finite at a pole or zero on the axis.

    Examples
    --------
    >>> frequency_response_slopes([2.0], [1.0, 1.0], [0.0]).real  # 1 / a_0 and 1 / b_0
    array([[-1. ,  0.5, -0. ]])
    """
    b, a = np.atleast_1d(np.asarray(num, float)), np.atleast_1d(np.asarray(den, float))
    s = 1j * np.atleast_1d(np.asarray(omega, dtype=np.float64))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        by_a = -(s[:, None] ** np.arange(a.size - 2, -1, -1)) / np.polyval(a, s)[:, None]
        by_b = s[:, None] ** np.arange(b.size - 1, -1, -1) / np.polyval(b, s)[:, None]
    slopes: Complex = np.hstack((by_a, by_b, -s[:, None]))
    return slopes


def confidence_ellipse(cov: Array, level: float = 0.95, n_points: int = 73) -> Array:
    """Contour of a two-dimensional Gaussian that holds the probability ``level``.

    Parameters
    ----------
    cov : ndarray, shape (2, 2)
    level : float
        Between 0 and 1.
    n_points : int

    Returns
    -------
    ndarray, shape (n_points, 2)
        Closed curve around the origin. With two degrees of freedom the radius is
        ``sqrt(-2 ln(1 - level))`` standard deviations.

    Examples
    --------
    >>> curve = confidence_ellipse(np.diag([1.0, 4.0]), 0.95)
    >>> curve.max(axis=0).round(2)
    array([2.45, 4.9 ])
    """
    values, vectors = np.linalg.eigh(cov)
    axes = vectors * np.sqrt(np.clip(values, 0.0, None) * (-2 * math.log1p(-level)))
    angle = np.linspace(0, 2 * math.pi, n_points)
    curve: Array = np.column_stack((np.cos(angle), np.sin(angle))) @ axes.T
    return curve


@dataclass(frozen=True, eq=False)
class _Bank:
    """``1 / a`` driven by the input, and once more by the output ``b / a u``."""

    n: int
    first: int
    a: Array
    matrix: Array
    drive: Array
    powers: Array
    direct: float
    output: Array

    @classmethod
    def of(
        cls, num: npt.ArrayLike, den: npt.ArrayLike, realization: tuple[Array, Array, Array]
    ) -> _Bank:
        b, a = np.atleast_1d(np.asarray(num, float)), np.atleast_1d(np.asarray(den, float))
        first = a.size - b.size
        padded = np.pad(b, (first, 0))
        output = (padded[1:] - padded[0] * a[1:]) @ realization[2]
        return cls(a.size - 1, first, a[1:], *realization, padded[0], output)

    @property
    def both(self) -> Array:
        below = [np.outer(self.drive, self.output), self.matrix]
        return np.block([[self.matrix, np.zeros((self.n, self.n))], below])

    @property
    def inputs(self) -> Array:
        return np.concatenate([self.drive, self.direct * self.drive])

    def after_step(self, t: Array) -> Array:
        """(n_times, 2 n) states after a unit step at time zero."""
        return step_states(self.both[None], self.inputs[None], np.maximum(t, 0.0))[:, 0, :]


def step_response(
    num: npt.ArrayLike,
    den: npt.ArrayLike,
    realization: tuple[Array, Array, Array],
    times: npt.ArrayLike,
) -> tuple[Array, Array]:
    """Step response of ``b / a`` and its derivatives by the coefficients, both exact.

    Parameters
    ----------
    num, den : array_like
        Descending powers, ``den`` monic of degree n.
    realization : (a, b, c)
        State equation ``a`` (n, n), ``b`` (n,) with the poles of ``den``; row ``k`` of ``c`` (n, n)
        gives ``p^{n-1-k} / den`` per unit input.
    times : array_like, shape (n_times,)
        Rising [s]; before zero nothing has happened.

    Returns
    -------
    response : ndarray, shape (n_times,)
    jacobian : ndarray, shape (n_times, n + m + 2)
        By ``(a_{n-1}, ..., a_0, b_m, ..., b_0, tau)``.

    Notes
    -----
    From ``a y = b u``: ``dy / db_k = p^k / a u`` and ``dy / da_k = -p^k / a y``, so that one bank
    driven by ``u``, and the same bank driven by ``y``, hold everything.

    Examples
    --------
    >>> first_order = (np.array([[-1.0]]), np.ones(1), np.ones((1, 1)))
    >>> response, jacobian = step_response([2.0], [1.0, 1.0], first_order, [0.0, 1.0])
    >>> response.round(4), jacobian[1, :2].round(4)  # 2 (1 - e^-t), -2 (1 - e^-t (1 + t)), 1 - e^-t
    (array([0.    , 1.2642]), array([-0.5285,  0.6321]))
    """
    bank = _Bank.of(num, den, realization)
    t = np.atleast_1d(np.asarray(times, dtype=np.float64))
    n, matrix, drive, output, powers = bank.n, bank.matrix, bank.drive, bank.output, bank.powers
    started = (t >= 0).astype(np.float64)
    states = bank.after_step(t)
    response = states[:, :n] @ output + bank.direct * started
    by_a = -states[:, n:] @ powers.T
    by_b = states[:, :n] @ powers.T
    highest = started[:, None] - by_b @ bank.a[:, None]  # p^n / a = 1 - sum a_k p^k / a
    by_b = np.hstack([highest, by_b])[:, bank.first :]
    slope = (states[:, :n] @ matrix.T + drive) @ output * started
    return response, np.hstack([by_a, by_b, -slope[:, None]])


def impulse_response(
    num: npt.ArrayLike,
    den: npt.ArrayLike,
    realization: tuple[Array, Array, Array],
    times: npt.ArrayLike,
) -> tuple[Array, Array]:
    """Impulse response of ``b / a`` and its derivatives by the coefficients, both exact.

    Parameters
    ----------
    num, den, realization, times
        As of `step_response`.

    Returns
    -------
    response : ndarray, shape (n_times,)
        Without the impulse of weight ``b_n`` at time zero where there are as many zeros as poles.
    jacobian : ndarray, shape (n_times, n + m + 2)
        By ``(a_{n-1}, ..., a_0, b_m, ..., b_0, tau)``.

    Notes
    -----
    The states of the bank after an impulse are the time derivatives of those under a step.

    Examples
    --------
    >>> first_order = (np.array([[-1.0]]), np.ones(1), np.ones((1, 1)))
    >>> response, jacobian = impulse_response([2.0], [1.0, 1.0], first_order, [0.0, 1.0])
    >>> response.round(4), jacobian[1, :2].round(4)  # 2 e^-t, -2 t e^-t, e^-t
    (array([2.    , 0.7358]), array([-0.7358,  0.3679]))
    """
    bank = _Bank.of(num, den, realization)
    t = np.atleast_1d(np.asarray(times, dtype=np.float64))
    n, matrix, output, powers = bank.n, bank.matrix, bank.output, bank.powers
    started = (t >= 0).astype(np.float64)[:, None]
    kicked = (bank.after_step(t) @ bank.both.T + bank.inputs) * started
    response = kicked[:, :n] @ output
    by_a = -kicked[:, n:] @ powers.T
    by_b = kicked[:, :n] @ powers.T
    highest = -by_b @ bank.a[:, None]  # p^n / a = 1 - sum a_k p^k / a
    by_b = np.hstack([highest, by_b])[:, bank.first :]
    slope = kicked[:, :n] @ matrix.T @ output
    return response, np.hstack([by_a, by_b, -slope[:, None]])
