"""The best a user would write by hand for ``b(s) / a(s)``, from rest, held input.

Exact zero-order-hold discretisation in closed form, `scipy.signal.lfilter`,
`scipy.optimize.least_squares`, started from least squares on state-variable filters. The user is
given for nothing what has to be known: that the record starts at rest, that there is no offset,
that the input is held, and a filter bandwidth near that of the system.

For ``b0 / (s^2 + a1 s + a0)`` there is a closed form (`fit`); for any other number of poles and
zeros the held-input equivalent is one matrix exponential of the companion form (`fit_any`).

Run as a script, it compares the choices that such a user has, from which the defaults were taken.
"""

from __future__ import annotations

import argparse
import cmath
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter

Array = NDArray[np.float64]
Coefficients = tuple[list[float], list[float]]

BANDWIDTH = 3.0


class RivalFit(NamedTuple):
    """``theta`` = (a1, a0, b0), the residual mean square, and how often the model was simulated."""

    theta: Array
    cost: float
    simulations: int


def held_closed_form(a1: float, a0: float, dt: float) -> Coefficients:
    """Numerator and denominator in ``z^-1`` of the held-input equivalent of ``1/(s^2+a1 s+a0)``."""
    half = 0.5 * a1
    frequency = cmath.sqrt(a0 - half * half)
    decay = cmath.exp(-half * dt).real
    cosine = cmath.cos(frequency * dt).real
    sine = (cmath.sin(frequency * dt) / frequency).real if frequency else dt
    first = (1.0 - decay * (cosine + half * sine)) / a0
    second = (decay * decay + decay * (half * sine - cosine)) / a0
    return [0.0, first, second], [1.0, -2.0 * decay * cosine, decay * decay]


def held_exponential(a1: float, a0: float, dt: float) -> Coefficients:
    """The same by the matrix exponential of the augmented companion form."""
    m = expm(np.array([[0.0, dt, 0.0], [-a0 * dt, -a1 * dt, dt], [0.0, 0.0, 0.0]]))
    trace, determinant = m[0, 0] + m[1, 1], m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    first = m[0, 2]
    second = m[0, 1] * m[1, 2] - m[1, 1] * m[0, 2]
    return [0.0, first, second], [1.0, -trace, determinant]


def simulate(
    theta: Array, u: Array, dt: float, held: Callable[..., Coefficients] = held_closed_form
) -> Array:
    """Model output for a held input, from rest."""
    num, den = held(theta[0], theta[1], dt)
    return np.asarray(lfilter([theta[2] * c for c in num], den, u))


def svf_start(u: Array, y: Array, dt: float, bandwidth: float = BANDWIDTH) -> Array:
    """Least squares on ``p^k y / (p + w)^2`` and ``u / (p + w)^2``, both held between samples."""
    num, den = held_closed_form(2.0 * bandwidth, bandwidth**2, dt)
    decay = np.exp(-bandwidth * dt)
    rate = [0.0, dt * decay, -dt * decay]  # of p / (p + w)^2
    position, speed, drive = lfilter(num, den, y), lfilter(rate, den, y), lfilter(num, den, u)
    acceleration = y - 2.0 * bandwidth * speed - bandwidth**2 * position
    columns = np.column_stack([-speed, -position, drive])
    return np.asarray(np.linalg.lstsq(columns, acceleration, rcond=None)[0])


def fit(
    u: Array,
    y: Array,
    dt: float,
    *,
    method: str = "lm",
    jacobian: str = "2-point",
    held: Callable[..., Coefficients] = held_closed_form,
    tolerance: float = 1e-8,
) -> RivalFit:
    """Output-error fit: SVF least squares, then `least_squares` on exact simulations."""
    start = svf_start(u, y, dt)
    count = 0

    def residual(theta: Array) -> Array:
        nonlocal count
        count += 1
        return simulate(theta, u, dt, held) - y

    def gain_for_nothing(theta: Array) -> Array:
        """Forward differences in a1 and a0; the column of b0 is the output over b0."""
        base = residual(theta) + y
        columns = np.empty((u.size, 3))
        for i in range(2):
            moved = theta.copy()
            moved[i] += 1.5e-8 * abs(theta[i])
            columns[:, i] = (residual(moved) + y - base) / (moved[i] - theta[i])
        columns[:, 2] = base / theta[2]
        return columns

    found = least_squares(
        residual,
        start,
        jac=gain_for_nothing if jacobian == "gain" else jacobian,
        method=method,
        x_scale=np.abs(start),
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
    )
    return RivalFit(found.x, 2.0 * float(found.cost) / u.size, count)


class Plant(NamedTuple):
    """``b(s) / a(s)``, descending powers, ``a`` without its leading one, and what the user is told.

    ``bandwidth`` [rad/s] of the filters for the start; ``hold`` samples a level of the input.
    """

    a: tuple[float, ...]
    b: tuple[float, ...]
    bandwidth: float
    hold: int

    @property
    def theta(self) -> Array:
        """``a``, then ``b``."""
        return np.array([*self.a, *self.b])


SECOND_ORDER = Plant((1.0, 3.0), (0.5,), BANDWIDTH, 7)
RAO_GARNIER = Plant((5.0, 408.0, 416.0, 1600.0), (-6400.0, 1600.0), 8.0, 2)


def held_any(a: Array, b: Array, dt: float) -> tuple[Array, Array]:
    """Numerators and denominator in ``z^-1`` of the held-input equivalent of ``b / a``.

    ``b`` (k, m + 1) may hold several numerators, one a row. The numerator follows from the first
    samples of the impulse response, ``num = den * (0, C B, C F B, ...)``.
    """
    n, rows = a.size, np.atleast_2d(b)
    augmented = np.zeros((n + 1, n + 1))
    augmented[0, :n], augmented[0, n] = -a * dt, dt
    augmented[np.arange(1, n), np.arange(n - 1)] = dt
    exponential = expm(augmented)
    transition, state = exponential[:n, :n], exponential[:n, n]
    den = np.real(np.poly(transition))
    impulse = np.zeros((rows.shape[0], n + 1))
    for k in range(1, n + 1):
        impulse[:, k] = rows @ state[n - rows.shape[1] :]
        state = transition @ state
    return np.array([np.convolve(den, one)[: n + 1] for one in impulse]), den


def simulate_any(theta: Array, n_poles: int, u: Array, dt: float) -> Array:
    """Model output for a held input, from rest."""
    num, den = held_any(theta[:n_poles], theta[n_poles:], dt)
    return np.asarray(lfilter(num[0], den, u))


def svf_start_any(
    u: Array, y: Array, dt: float, n_poles: int, n_zeros: int, bandwidth: float
) -> Array:
    """Least squares on ``p^k y / (p + w)^n`` and ``p^k u / (p + w)^n``, held between samples."""
    filter_ = np.poly(np.full(n_poles, -bandwidth))
    num, den = held_any(filter_[1:], np.eye(n_poles), dt)
    outputs = [lfilter(row, den, y) for row in num]
    inputs = [lfilter(row, den, u) for row in num[n_poles - 1 - n_zeros :]]
    highest = y - filter_[1:] @ np.array(outputs)
    columns = np.column_stack([*(-one for one in outputs), *inputs])
    return np.asarray(np.linalg.lstsq(columns, highest, rcond=None)[0])


def fit_any(
    u: Array,
    y: Array,
    dt: float,
    plant: Plant,
    *,
    method: str = "lm",
    tolerance: float = 1e-8,
) -> RivalFit:
    """As `fit` with differences for the Jacobian, for any number of poles and zeros.

    Of ``plant`` only the numbers of coefficients and the bandwidth are used.
    """
    n = len(plant.a)
    start = svf_start_any(u, y, dt, n, len(plant.b) - 1, plant.bandwidth)
    count = 0

    def residual(theta: Array) -> Array:
        nonlocal count
        count += 1
        return simulate_any(theta, n, u, dt) - y

    found = least_squares(
        residual, start, method=method, x_scale=np.abs(start),
        ftol=tolerance, xtol=tolerance, gtol=tolerance,
    )  # fmt: skip
    return RivalFit(found.x, 2.0 * float(found.cost) / u.size, count)


def noisy(
    plant: Plant, n_samples: int, seed: int, dt: float, decibel: float
) -> tuple[Array, Array]:
    """Input, a held random binary, and output with white noise at a signal-to-noise ratio [dB]."""
    rng = np.random.default_rng(seed)
    levels = rng.choice([-1.0, 1.0], size=n_samples // plant.hold + 1)
    u = np.repeat(levels, plant.hold)[:n_samples]
    clean = simulate_any(plant.theta, len(plant.a), u, dt)
    scale = 10.0 ** (-decibel / 20.0) * clean.std()
    return u, clean + scale * rng.standard_normal(n_samples)


def held_binary(n_samples: int, seed: int, dt: float = 0.05, hold: int = 7) -> tuple[Array, Array]:
    """Input and noisy output of ``0.5/(s^2+s+3)``: random binary, held, 10 % noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], size=n_samples // hold + 1), hold)[:n_samples]
    clean = simulate(np.array([1.0, 3.0, 0.5]), u, dt, held_exponential)
    return u, clean + 0.1 * clean.std() * rng.standard_normal(n_samples)


VARIANTS: dict[str, dict[str, object]] = {
    "lm, 2-point, closed form": {},
    "lm, 2-point, expm": {"held": held_exponential},
    "lm, b0 column for nothing, closed form": {"jacobian": "gain"},
    "trf, 2-point, closed form": {"method": "trf"},
    "trf, b0 column for nothing, closed form": {"method": "trf", "jacobian": "gain"},
    "lm, 2-point, closed form, tolerance 1e-12": {"tolerance": 1e-12},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, nargs="+", default=[250, 10_000, 1_000_000])
    for n in parser.parse_args().samples:
        u, y = held_binary(n, 1)
        repeats = 20 if n < 5000 else 3
        print(f"{n} samples: wall min [ms], simulations, cost")
        for name, options in VARIANTS.items():
            best, found = np.inf, None
            for _ in range(repeats):
                before = time.perf_counter()
                found = fit(u, y, 0.05, **options)  # type: ignore[arg-type]
                best = min(best, time.perf_counter() - before)
            assert found is not None
            print(f"  {name:44s}{1e3 * best:9.2f}{found.simulations:5d}  {found.cost:.12g}")


if __name__ == "__main__":
    main()
