"""Sensitivities of the frequency response, by line, input and output.

A sine of amplitude ``A`` at ``w`` on input ``j`` adds, in the steady state, ``A^2 / (2 sigma_i^2)
Re(g* g')`` to the information of every sample of output ``i``, with ``g`` the derivatives of ``G_ij
(i w)`` by the coefficients:

    d G / d a_k = - s^k / a(s) G,     d G / d b_k = s^k / a(s) e^(- s tau),     d G / d tau = - s G.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import OptionError, shown
from tridentify.excitation.checks import band_of, positive, vector
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.rational import rational_response
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

POINTS = 160
"""Candidates: over four decades neighbours lie six percent apart, within the width of any resonance
whose damping is above 0.03."""


def response_gradient(model: TransferFunction, structure: Structure, omega: Array) -> Complex:
    """Derivatives of the frequency response by the coefficients, times their magnitudes.

    Parameters
    ----------
    model : TransferFunction
        With the orders of the structure.
    structure : Structure
    omega : (n_omega,) array
        [rad/s], positive.

    Returns
    -------
    (n_omega, n_outputs, n_inputs, p) complex array
        In the order of `Structure.names`; a coefficient that is zero counts with magnitude one.

    Examples
    --------
    >>> model = TransferFunction([2.0], [1.0, 1.0])
    >>> response_gradient(model, Structure(1, 0), np.array([1.0])).ravel()
    array([-0.+1.j,  1.-1.j])
    """
    outputs, inputs = model.n_outputs, model.n_inputs
    poles = structure.poles_matrix(outputs, inputs)
    zeros = structure.zeros_matrix(outputs, inputs)
    s = 1j * omega.astype(np.complex128)
    p = structure.n_parameters(outputs, inputs)
    found = np.zeros((omega.size, outputs, inputs, p), dtype=np.complex128)
    at = poles[0][0] if structure.shared else 0
    for i in range(outputs):
        for j in range(inputs):
            den, late = model.den[i][j], np.exp(-s * model.delay[i, j])
            n, m = poles[i][j], zeros[i][j]
            whole = rational_response(model.num[i][j], den, s) * late
            first = 0 if structure.shared else at
            for k in range(n):
                found[:, i, j, first + k] = -_power(den[1 + k], n - 1 - k, den, s) * whole
            at = at if structure.shared else at + n
            b = np.concatenate([np.zeros(max(m + 1 - model.num[i][j].size, 0)), model.num[i][j]])
            for k, value in enumerate(b[b.size - m - 1 :]):
                found[:, i, j, at + k] = _power(value, m - k, den, s) * late
            at += m + 1
            if structure.delay == "free":
                found[:, i, j, p - inputs + j] = -s * (model.delay[i, j] or 1.0) * whole
    return found


def _power(value: float, k: int, den: Array, s: Complex) -> Complex:
    """``|value| s^k / den``, with one in place of zero."""
    term = np.zeros(k + 1)
    term[0] = abs(float(value)) or 1.0
    return np.asarray(rational_response(term, den, s))


def candidates(like: TransferFunction, band: object, lines: ArrayLike | None) -> Array:
    """Frequencies among which the power is to be distributed [rad/s].

    Parameters
    ----------
    like : TransferFunction
        Where neither is given, they reach from a tenth of its slowest corner to ten times its
        fastest.
    band : (float, float), optional
    lines : array_like, optional
        The frequencies themselves.

    Returns
    -------
    (n_omega,) array
        Rising.

    Raises
    ------
    OptionError
        They are not positive or not rising.
    """
    if band is not None and lines is not None:
        raise OptionError("found both band and lines; expected one of the two; drop one")
    if lines is not None:
        omega = vector("lines", lines)
        if np.any(omega <= 0) or np.any(np.diff(omega) <= 0):
            raise OptionError(
                f"found lines={shown(omega.tolist())}; expected positive angular frequencies "
                "[rad/s] in rising order; correct them"
            )
        return omega
    if band is None:
        parts = [p for rows in (like.num, like.den) for row in rows for p in row]
        roots = np.abs(np.concatenate([np.roots(np.trim_zeros(p, "f")) for p in parts]))
        corners = roots[roots > 1e-9 * np.max(roots, initial=0.0)]
        if not corners.size:
            raise OptionError(
                "found a model without corner frequencies; expected candidates; give band or lines"
            )
        return np.geomspace(corners.min() / 10.0, corners.max() * 10.0, POINTS)
    low, high = band_of(band)
    return np.geomspace(positive("band", low), high, POINTS)
