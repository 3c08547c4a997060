"""Three ways to a response that share no line with the package: modes, exponential, integration.

Each knows one thing only: from rest, simple poles away from zero (`by_modes`); companion form and
one matrix exponential, held or joined input, any initial state (`by_exponential`); an integrator of
ordinary differential equations, any input over time, feedback too (`by_integration`).
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter


def by_modes(num, den, u, dt):
    """Held-input response from rest, pole by pole."""
    den, num = np.asarray(den, float), np.atleast_1d(num).astype(float)
    y = num[0] / den[0] * u if num.size == den.size else np.zeros(u.size)
    for pole in np.roots(den).astype(complex):
        residue = np.polyval(num, pole) / np.polyval(np.polyder(den), pole)
        weight = residue * np.expm1(pole * dt) / pole
        y = y + lfilter([0.0, weight], [1.0, -np.exp(pole * dt)], u.astype(complex)).real
    return y


def companion(num, den):
    """(A, b, c, d) with the derivatives of the state one below the other."""
    den = np.asarray(den, float) / den[0]
    n = den.size - 1
    num = np.pad(np.atleast_1d(num).astype(float), (n + 1 - np.size(num), 0))
    a = np.zeros((n, n))
    a[0], a[1:, : n - 1] = -den[1:], np.eye(n - 1)
    return a, np.eye(n)[0], num[1:] - num[0] * den[1:], num[0]


def by_exponential(num, den, u, dt, intersample="zoh", initial=None):
    """Exact response in companion form, time counted in samples, one matrix exponential."""
    n = len(den) - 1
    powers = dt ** np.arange(n + 1.0)
    full = np.pad(np.atleast_1d(num).astype(float), (n + 1 - np.size(num), 0))
    a, b, row, direct = companion(full * powers, np.asarray(den, float) * powers)
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n], block[n, n + 1] = a, b, 1.0
    step = expm(block)
    slope = np.append(np.diff(u), 0.0) if intersample == "foh" else np.zeros(u.size)
    y = np.empty(u.size)
    x = np.zeros(n) if initial is None else np.asarray(initial, float) / dt ** np.arange(1.0, n + 1)
    for k in range(u.size):
        y[k] = row @ x + direct * u[k]
        x = step[:n, :n] @ x + step[:n, n] * u[k] + step[:n, n + 1] * slope[k]
    return y


def by_integration(num, den, force, t):
    """Response to ``force(t)`` from rest, by a Runge-Kutta formula of order eight."""
    a, b, row, direct = companion(num, den)
    found = solve_ivp(
        lambda now, x: a @ x + b * force(now),
        (t[0], t[-1]), np.zeros(len(b)), t_eval=t, method="DOP853", rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    return row @ found.y + direct * np.array([force(now) for now in t])
