"""Three ways to a response that share no line with the package: modes, exponential, integration.

Each knows one thing only: from rest, simple poles away from zero (`by_modes`); companion form and
one matrix exponential, held or joined input, any initial state (`by_exponential`); an integrator of
ordinary differential equations, any input over time, feedback too (`by_integration`). And the
inputs that drive them: `register`, `binary`, `levels`.
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
    driven = np.outer(u, step[:n, n])
    if intersample == "foh":
        driven += np.outer(np.append(np.diff(u), 0.0), step[:n, n + 1])
    states, free = np.empty((u.size, n)), step[:n, :n]
    x = np.zeros(n) if initial is None else np.asarray(initial, float) / dt ** np.arange(1.0, n + 1)
    for k in range(u.size):
        states[k] = x
        x = free @ x + driven[k]
    return states @ row + direct * u


def by_integration(num, den, force, t):
    """Response to ``force(t)`` from rest, by a Runge-Kutta formula of order eight."""
    a, b, row, direct = companion(num, den)
    found = solve_ivp(
        lambda now, x: a @ x + b * force(now),
        (t[0], t[-1]), np.zeros(len(b)), t_eval=t, method="DOP853", rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    return row @ found.y + direct * np.array([force(now) for now in t])


def stacked(channels):
    """(A, B, C) of ``channels[output][input] = (num, den)``, each strictly proper, side by side."""
    blocks = [
        (i, j, companion(*channels[i][j])[:3])
        for i in range(len(channels))
        for j in range(len(channels[0]))
    ]
    order = sum(len(b) for _, _, (_, b, _) in blocks)
    a, inputs = np.zeros((order, order)), np.zeros((order, len(channels[0])))
    outputs, at = np.zeros((len(channels), order)), 0
    for i, j, (block, b, row) in blocks:
        span = slice(at, at + b.size)
        a[span, span], inputs[span, j], outputs[i, span] = block, b, row
        at += b.size
    return a, inputs, outputs


def sampled_loop(channels, control, noise, dt, *, initial=None):
    """(u, y) of a plant whose input a computer sets: ``control(k, y[k])`` is held for a sample."""
    a, inputs, outputs = stacked(channels)
    n, m = inputs.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a, inputs
    step = expm(block * dt)[:n]
    x = np.zeros(n) if initial is None else np.asarray(initial, float)
    u, y = np.empty((len(noise), m)), np.empty((len(noise), len(outputs)))
    for k, disturbance in enumerate(noise):
        y[k] = outputs @ x + disturbance
        u[k] = control(k, y[k])
        x = step @ np.concatenate([x, u[k]])
    return u, y


def continuous_loop(channel, controller, r, noise, dt, *, dither=None, intersample="zoh"):
    """(u, y) of one plant and one continuous controller, ``u = C (r - y - noise) + dither``.

    ``controller`` is ``(A, b, c, d)``; the noise is held, as a converter would hold it.
    """
    a, inputs, outputs = stacked([[channel]])
    a_c, b_c, c_c, d_c = controller
    n, m = len(a), len(a_c)
    loop = np.zeros((n + m, n + m))
    loop[:n, :n], loop[:n, n:] = a - d_c * inputs @ outputs, inputs @ c_c[None, :]
    loop[n:, :n], loop[n:, n:] = -b_c[:, None] @ outputs, a_c
    drive = np.zeros((n + m, 3))
    drive[:n] = inputs @ np.array([[d_c, 1.0, -d_c]])
    drive[n:] = b_c[:, None] @ np.array([[1.0, 0.0, -1.0]])
    size = n + m
    block = np.zeros((size + 6, size + 6))
    block[:size, :size], block[:size, size : size + 3] = loop, drive
    block[size : size + 3, size + 3 :] = np.eye(3)
    step = expm(block * dt)[:size]
    forces = np.column_stack([r, np.zeros(len(r)) if dither is None else dither, noise])
    slopes = np.zeros_like(forces)
    if intersample == "foh":
        slopes[:-1, :2] = np.diff(forces[:, :2], axis=0) / dt
    x, u, y = np.zeros(size), np.empty(len(r)), np.empty(len(r))
    for k, (force, slope) in enumerate(zip(forces, slopes, strict=True)):
        y[k] = (outputs @ x[:n]).item() + force[2]
        u[k] = c_c @ x[n:] + d_c * (force[0] - y[k]) + force[1]
        x = step @ np.concatenate([x, force, slope])
    return u, y


def moving_noise_loop(pole, gains, r, noise, dt):
    """Samples of ``1 / (s - pole)`` under ``kp + ki / s`` in continuous time, from rest.

    Everything is held over each of the columns of ``noise`` (n_samples, pieces) alone.
    """
    kp, ki = gains
    pieces = noise.shape[1]
    loop = np.array([[pole - kp, ki], [-1.0, 0.0]])
    into = np.array([[kp, -kp], [1.0, -1.0]])
    whole = expm(np.block([[loop, into], [np.zeros((2, 4))]]) * dt / pieces)[:2]
    state, u, y = np.zeros(2), np.empty(len(r)), np.empty(len(r))
    for k, (wanted, row) in enumerate(zip(r, noise, strict=True)):
        y[k] = state[0] + row[0]
        u[k] = kp * (wanted - y[k]) + ki * state[1]
        for v in row:
            state = whole @ np.array([*state, wanted, v])
    return u, y


def register(stages, taps, length, hold):
    """Levels +-1 of a shift register with feedback from two of its stages."""
    bits, out = [1] * stages, []
    for _ in range(-(-length // hold)):
        out.append(2.0 * bits[-1] - 1.0)
        bits = [bits[taps[0] - 1] ^ bits[taps[1] - 1], *bits[:-1]]
    return np.repeat(out, hold)[:length]


def binary(n_samples=400, hold=6, seed=1):
    """Random levels +-1, each held for ``hold`` samples."""
    return np.sign(levels(n_samples, hold, seed))


def levels(n_samples, hold=4, seed=1):
    """Random Gaussian levels, each held for ``hold`` samples."""
    values = np.random.default_rng(seed).standard_normal(-(-n_samples // hold))
    return np.repeat(values, hold)[:n_samples]


def cramer_rao(sensitivities, noise_variance):
    """Bound on the covariance: variance times ``(S' S)^-1``, by the triangle of ``S``."""
    inverse = np.linalg.inv(np.linalg.qr(sensitivities, mode="r"))
    return noise_variance * inverse @ inverse.T
