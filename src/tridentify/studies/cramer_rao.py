"""The Cramer-Rao bound: the smallest covariance that an unbiased estimator can have.

The model is ``a(p) y* = b(p) x``, ``a = p^n + a_{n-1} p^{n-1} + ... + a_0``, at rest at the first
sample, and ``y(t_k) = y*(t_k) + zeta_k`` with white Gaussian noise of standard deviation
``sigma``. Differentiating the model equation by its coefficients gives the output sensitivities

    d y* / d b_j = p^j / a(p)  x,        d y* / d a_j = - p^j / a(p)  y*,

which are the states ``z, p z, ..., p^n z`` of one realisation of ``1 / a``, driven by ``x`` and by
``y*``. Both in series are one state equation, which is discretised exactly. With the sensitivities
at the samples as columns of ``Psi``,

    cov >= sigma^2 (Psi' Psi)^{-1}        (Kay 1993, Fundamentals of Statistical Signal Processing:
                                           Estimation Theory, section 3.9).

"""

from __future__ import annotations

import numpy as np

from tridentify.errors import IdentifiabilityError
from tridentify.numerics.arrays import Array
from tridentify.numerics.discretize import discretize
from tridentify.numerics.least_squares import triangle
from tridentify.numerics.propagate import propagate
from tridentify.transfer_function import TransferFunction


def output_sensitivities(
    model: TransferFunction, u: Array, dt: float, intersample: str = "zoh"
) -> Array:
    """Derivatives of the output by the coefficients, from rest.

    Parameters
    ----------
    model : TransferFunction
        One input, one output.
    u : (n_samples,) array
        The input.
    dt : float
        Sampling interval [s].
    intersample : {"zoh", "foh"}
        What the input does between the samples.

    Returns
    -------
    (n_samples, n + m + 1) array
        By ``a_{n-1}, ..., a_0, b_m, ..., b_0``.

    Examples
    --------
    >>> columns = output_sensitivities(TransferFunction([2.0], [1.0, 1.0]), np.ones(3), 0.5)
    >>> t = np.array([0.0, 0.5, 1.0])
    >>> bool(np.allclose(columns[:, 1], 1 - np.exp(-t)))
    True
    """
    a, b = model.den[0][0], model.num[0][0]
    n, m = a.size - 1, b.size - 1
    companion = np.eye(n, k=1)
    companion[-1] = -a[:0:-1]
    drive = np.eye(n)[:, -1:]
    powers = np.vstack([np.eye(n), companion[-1]])  # p^j z by state; p^n z has the input besides
    output = b[::-1] @ powers[: m + 1]
    direct = b[0] if m == n else 0.0
    both = np.block([[companion, np.zeros((n, n))], [drive * output, companion]])
    step = discretize(both, np.vstack([drive, direct * drive]), dt, intersample)
    states = np.empty((2 * n, u.size))
    propagate(
        step.transition,
        step.from_current[:, 0],
        step.from_next[:, 0],
        np.ascontiguousarray(u, dtype=np.float64)[:, None],
        np.zeros((1, 2 * n)),
        states,
    )
    by_b = powers[: m + 1] @ states[:n]
    if m == n:
        by_b[-1] += u
    return np.ascontiguousarray(np.vstack([-states[n:][::-1], by_b[::-1]]).T)


def information_factor(sensitivities: Array) -> Array:
    """Triangle ``R`` with ``R' R = Psi' Psi``: the information matrix for noise of variance one.

    Parameters
    ----------
    sensitivities : (n_samples, n_parameters) array

    Returns
    -------
    (n_parameters, n_parameters) array

    Raises
    ------
    IdentifiabilityError
        The sensitivities are linearly dependent, so that there is no bound.
    """
    factor = triangle(sensitivities)
    diagonal = np.abs(np.diag(factor))
    n_parameters = sensitivities.shape[1]
    if diagonal.size < n_parameters or diagonal.min() <= 1e-12 * diagonal.max():
        raise IdentifiabilityError(
            f"found linearly dependent sensitivities of {n_parameters} coefficients; expected a "
            "record that determines all of them; record longer or excite more"
        )
    return factor
