"""Plants, inputs, noise and bounds for the benchmarks on noisy records.

Truth, data and bound share no code with the package. Data come by the modal form: with distinct
poles ``y = sum_i r_i x_i``, ``x_i' = p_i x_i + u``, whose equivalents for a held input are scalars,
computed in extended precision. The sensitivities of the bound are central differences of the same
(their error is of order 1e-10), and the Cramer-Rao bound follows from

    Psi' V^{-1} Psi,      V the covariance matrix of the noise over the record,

with the dense Cholesky factor of ``V`` if the noise is coloured. Each noise draw has a generator of
its own, spawned from the seed by the name of its cell and its number: a result depends neither on
the other cells, nor on the number of draws or processes.
"""

from __future__ import annotations

import itertools
import zlib
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.signal
from numpy.typing import NDArray

from tridentify import Record

Array = NDArray[np.float64]
Long = NDArray[np.clongdouble]
DIFFERENCE = 1e-5
BURN_IN = 500


@dataclass(frozen=True)
class Plant:
    """``b(p) / a(p)``: coefficients in descending powers, ``a`` without its leading one."""

    name: str
    a: tuple[float, ...]
    b: tuple[float, ...]

    @property
    def theta(self) -> Array:
        return np.array([*self.a, *self.b])

    @property
    def names(self) -> list[str]:
        n, m = len(self.a), len(self.b)
        return [f"a{k}" for k in reversed(range(n))] + [f"b{k}" for k in reversed(range(m))]

    @property
    def corner(self) -> float:
        """Geometric mean of the sizes of the poles [rad/s]."""
        return float(self.a[-1] ** (1 / len(self.a)))

    def faster(self, factor: float) -> Plant:
        """The same response ``factor`` times as fast."""
        n, m = len(self.a), len(self.b) - 1
        a = tuple(value * factor ** (k + 1) for k, value in enumerate(self.a))
        b = tuple(value * factor ** (n - m + k) for k, value in enumerate(self.b))
        return Plant(f"{self.name} x{factor:g}", a, b)


@dataclass(frozen=True)
class Noise:
    """``v = C(q) / D(q) e`` with white Gaussian ``e``; by default white."""

    c: tuple[float, ...] = (1.0,)
    d: tuple[float, ...] = (1.0,)

    @property
    def white(self) -> bool:
        return self.c == self.d == (1.0,)

    def covariance(self, n_samples: int) -> Array:
        """First row of the covariance matrix (Toeplitz), for a variance of one."""
        impulse = scipy.signal.lfilter(self.c, self.d, np.eye(1, 20 * BURN_IN)[0])
        row = np.zeros(n_samples)
        for lag in range(min(n_samples, BURN_IN)):
            row[lag] = impulse[: impulse.size - lag] @ impulse[lag:]
        return np.asarray(row / row[0])

    def draw(self, rng: np.random.Generator, n_samples: int) -> Array:
        """A stretch of the stationary process, standard deviation one."""
        if self.white:
            return rng.standard_normal(n_samples)
        e = rng.standard_normal(n_samples + BURN_IN)
        impulse = scipy.signal.lfilter(self.c, self.d, np.eye(1, BURN_IN)[0])
        v = scipy.signal.lfilter(self.c, self.d, e)[BURN_IN:]
        return np.asarray(v / np.sqrt(impulse @ impulse))


@dataclass(frozen=True, eq=False)
class Cell:
    """One experiment: plant, input held over ``dt`` [s], noise of standard deviation ``std``.

    ``level`` says how ``std`` follows from the noise-free output: ``("ratio", r)`` r times its root
    mean square, ``("snr", d)`` ``10^(-d/20)`` times its standard deviation.
    """

    name: str
    plant: Plant
    u: Array
    dt: float
    level: tuple[str, float]
    noise: Noise = field(default_factory=Noise)

    @cached_property
    def clean(self) -> Array:
        return outputs(self.plant, self.plant.theta[None], self.u, self.dt)[0]

    @cached_property
    def std(self) -> float:
        kind, value = self.level
        if kind == "ratio":
            return float(value * np.sqrt(np.mean(self.clean**2)))
        return float(np.std(self.clean) * 10 ** (-value / 20))

    def record(self, seed: int, draw: int) -> Record:
        """The record with noise draw number ``draw``."""
        key = (zlib.crc32(self.name.encode()), draw)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
        y = self.clean + self.std * self.noise.draw(rng, self.u.size)
        return Record(self.u, y, dt=self.dt)

    @cached_property
    def bound(self) -> Array:
        """Cramer-Rao standard deviations of the coefficients; the start is known to be at rest."""
        return np.asarray(np.sqrt(np.diag(self.bound_covariance)))

    @cached_property
    def bound_covariance(self) -> Array:
        columns = sensitivities(self.plant, self.u, self.dt)
        if not self.noise.white:
            row = self.noise.covariance(self.u.size)
            root = scipy.linalg.cholesky(scipy.linalg.toeplitz(row), lower=True)
            columns = scipy.linalg.solve_triangular(root, columns, lower=True)
        scale = np.linalg.norm(columns, axis=0)
        factor = np.linalg.qr(columns / scale, mode="r")
        inverse = scipy.linalg.solve_triangular(factor, np.eye(scale.size)) / scale[:, None]
        return np.asarray(self.std**2 * inverse @ inverse.T)


def outputs(plant: Plant, thetas: Array, u: Array, dt: float) -> Array:
    """Outputs from rest for several parameter vectors (rows); input held."""
    n = len(plant.a)
    poles = np.array([_roots(theta[:n]) for theta in thetas])
    a = np.hstack([np.ones((len(thetas), 1)), thetas[:, :n]]).astype(np.clongdouble)
    slope = a[:, :-1] * np.arange(n, 0, -1)
    residues = _horner(thetas[:, n:].astype(np.clongdouble), poles) / _horner(slope, poles)
    decay = np.exp(poles * np.longdouble(dt))
    gain = (decay - 1) / poles
    state = np.zeros_like(poles)
    y = np.zeros((len(thetas), u.size), dtype=np.longdouble)
    for k in range(u.size - 1):
        state = decay * state + gain * np.longdouble(u[k])
        y[:, k + 1] = np.sum(residues * state, axis=1).real
    return y


def sensitivities(plant: Plant, u: Array, dt: float) -> Array:
    """Derivatives of the output by the coefficients: (n_samples, n_parameters)."""
    theta = plant.theta.astype(np.longdouble)
    steps = DIFFERENCE * np.abs(theta)
    both = np.vstack([theta + np.diag(steps), theta - np.diag(steps)])
    y = outputs(plant, both, u, dt)
    up, down = np.split(y, 2)
    return np.asarray(((up - down) / (2 * steps[:, None])).T, dtype=np.float64)


def _roots(a: Array) -> Long:
    """Roots of ``p^n + a_{n-1} p^{n-1} + ...``, refined in extended precision (Newton)."""
    full = np.concatenate([[1.0], a]).astype(np.clongdouble)
    roots = np.roots(full.real.astype(np.float64)).astype(np.clongdouble)
    slope = full[:-1] * np.arange(full.size - 1, 0, -1)
    for _ in range(4):
        roots = roots - np.polyval(full, roots) / np.polyval(slope, roots)
    return np.asarray(roots)


def _horner(coefficients: Long, points: Long) -> Long:
    """Row-wise polynomials at row-wise points."""
    value = np.zeros_like(points)
    for k in range(coefficients.shape[1]):
        value = value * points + coefficients[:, k : k + 1]
    return value


def prbs(stages: int, taps: tuple[int, int], hold: int) -> Array:
    """One period of a maximum-length binary signal, levels +-1, each held ``hold`` samples."""
    register = [1] * stages
    bits = []
    for _ in range(2**stages - 1):
        bits.append(register[-1])
        new = register[taps[0] - 1] ^ register[taps[1] - 1]
        register = [new, *register[:-1]]
    return np.repeat(2.0 * np.array(bits) - 1.0, hold)


def pilot(pulses: tuple[int, ...], width: float, dt: float, n_samples: int) -> Array:
    """Pulses of alternate sign, in units of ``width`` [s], after a twentieth of the record."""
    u = np.zeros(n_samples)
    start = n_samples // 20
    edges = start + np.rint(np.cumsum((0, *pulses)) * width / dt).astype(int)
    for k, (first, last) in enumerate(itertools.pairwise(edges)):
        u[first:last] = 1.0 if k % 2 == 0 else -1.0
    return u


WHITE = Noise()
ARMA = Noise((1.0, 0.9), (1.0, -1.0, 0.2))
RAO_GARNIER = Plant("Rao-Garnier", (5.0, 408.0, 416.0, 1600.0), (-6400.0, 1600.0))
AIRCRAFT = Plant("aircraft", (1.0, 3.0), (0.5,))
SECOND = Plant("3/(s^2+4s+3)", (4.0, 3.0), (3.0,))
SECOND_ARMA = Plant("2/(s^2+4s+3)", (4.0, 3.0), (2.0,))
OVERDAMPED = Plant("overdamped with zero", (7.0, 6.0), (1.2, 3.0))
LIGHT = Plant("lightly damped (0.1)", (0.8, 16.0), (8.0,))
THIRD = Plant("third order", (4.7, 20.8, 24.0), (36.0,))
FIRST = Plant("first order", (0.8,), (2.0,))
