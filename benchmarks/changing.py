"""Plants that change while they are recorded, for the benchmarks of on-line estimation.

The equations are ``y^(n) + a_{n-1} y^(n-1) + ... + a_0 y = b_m u^(m) + ... + b_0 u`` in observer
form, ``x_1 = y``, with an input that is held between the samples. At a step of the coefficients the
states of that form are kept; with a numerator of degree zero they are the output and its
derivatives.

`drifting` is the time-varying plant of the field,

    y'' + a1(t) y' + a2(t) y = 200 u,  a1 = 5 + 40 t / 1000,  a2 = 160 - 90 cos(2 pi t / 1000),

every 0.01 s for 1000 s. Coefficients are taken at the middle of each sample interval (the
exponential midpoint rule, whose error is of third order in the interval); `check_drifting` compares
with an integrator of Dormand and Prince's at a tolerance of 1e-12.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.integrate
import scipy.linalg
import scipy.signal
from numpy.typing import NDArray
from plants import Plant, prbs

Array = NDArray[np.float64]
TIME_STEP, DURATION, VARIANCE = 0.01, 1000.0, 0.1
HOLD = 10
TERMS = 24
TRUTH: dict[str, Callable[[Array], Array]] = {
    "a1": lambda t: 5.0 + 40.0 * t / DURATION,
    "a0": lambda t: 160.0 - 90.0 * np.cos(2 * np.pi * t / DURATION),
    "b0": lambda t: np.full_like(t, 200.0),
}


def drifting_input() -> Array:
    """Binary signal of ten stages, held 0.1 s, repeated over 1000 s."""
    one = prbs(10, (10, 7), HOLD)
    return np.resize(one, round(DURATION / TIME_STEP))


def drifting(u: Array) -> Array:
    """Noise-free output of the time-varying plant from rest, (n_samples,)."""
    middle = (np.arange(u.size) + 0.5) * TIME_STEP
    rates = np.zeros((u.size, 3, 3))
    rates[:, 0, 1] = 1.0
    rates[:, 1, 0], rates[:, 1, 1] = -TRUTH["a0"](middle), -TRUTH["a1"](middle)
    rates[:, 1, 2] = TRUTH["b0"](middle)
    steps, term = np.tile(np.eye(3), (u.size, 1, 1)), np.tile(np.eye(3), (u.size, 1, 1))
    for k in range(1, TERMS):
        term = term @ rates * (TIME_STEP / k)
        steps += term
    x, slope, y = 0.0, 0.0, []
    for (f, g, h), value in zip(steps[:, :2].transpose(0, 2, 1).tolist(), u.tolist(), strict=True):
        y.append(x)
        x, slope = (f[i] * x + g[i] * slope + h[i] * value for i in (0, 1))
    return np.array(y)


def check_drifting(u: Array, y: Array, start: float = 400.0, seconds: float = 2.0) -> float:
    """Largest difference to an integrator over some seconds, relative to the output's size."""
    first, count = round(start / TIME_STEP), round(seconds / TIME_STEP)
    long = drifting(u[: first + count + 1])
    slope = (long[first + 1] - long[first - 1]) / (2 * TIME_STEP)

    # start both from the same state: shoot for the sample after the first
    def fly(slope_0: float, n_steps: int) -> Array:
        state, found = np.array([long[first], slope_0]), [long[first]]
        for k in range(first, first + n_steps):
            solution = scipy.integrate.solve_ivp(
                _rates, (k * TIME_STEP, (k + 1) * TIME_STEP), state, "DOP853",
                rtol=1e-12, atol=1e-14, args=(u[k],),
            )  # fmt: skip
            state = solution.y[:, -1]
            found.append(state[0])
        return np.array(found)

    low, high = (fly(slope + d, 1)[1] for d in (-1.0, 1.0))
    slope += 2.0 * (long[first + 1] - low) / (high - low) - 1.0
    return float(np.max(np.abs(fly(slope, count) - y[first : first + count + 1])) / np.std(y))


def _rates(t: float, state: Array, u: float) -> list[float]:
    now = {name: float(value(np.array(t))) for name, value in TRUTH.items()}
    return [state[1], -now["a1"] * state[1] - now["a0"] * state[0] + now["b0"] * u]


def held(a: Array, b: Array, dt: float) -> tuple[Array, Array, float]:
    """Observer form over one sample interval: transition, input column, direct term."""
    n = a.size
    b = np.pad(b, (n + 1 - b.size, 0))
    rates = np.zeros((n + 1, n + 1))
    rates[:n, 0] = -a
    rates[: n - 1, 1:n] = np.eye(n - 1)
    rates[:n, n] = b[1:] - b[0] * a
    step = scipy.linalg.expm(rates * dt)
    return step[:n, :n], step[:n, n], float(b[0])


def stepped(before: Plant, after: Plant, u: Array, dt: float, change: int) -> Array:
    """Noise-free output from rest of a plant that becomes another one at sample ``change``."""
    state, parts = np.zeros(len(before.a)), []
    for plant, piece in ((before, u[:change]), (after, u[change:])):
        if not piece.size:
            continue
        transition, column, direct = held(np.array(plant.a), np.array(plant.b), dt)
        system = (transition, column[:, None], np.eye(1, state.size), np.array([[direct]]), dt)
        _, y, states = scipy.signal.dlsim(system, piece, x0=state)
        parts.append(y[:, 0])
        state = transition @ states[-1] + column * piece[-1]
    return np.concatenate(parts)


def scaled(plant: Plant, name: str, factor: float) -> Plant:
    """The plant with one coefficient multiplied."""
    values = dict(zip(plant.names, plant.theta.tolist(), strict=True))
    values[name] *= factor
    theta = tuple(values.values())
    n = len(plant.a)
    return Plant(f"{plant.name}, {name} x {factor:g}", theta[:n], theta[n:])
