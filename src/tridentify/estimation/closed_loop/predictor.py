"""The stable predictor of a plant that is not stable, and what it leaves of a record.

A plant with poles in the right half plane, or at zero, cannot be simulated on a recorded input: any
error grows with time. Its predictor can. With the plant in observer form and the recorded
output fed back,

    x_{k+1} = A x_k + B u_k + K (y_k - C x_k - D u_k),        e_k = y_k - C x_k - D u_k,      (1)

``e = (y - G u) a(z) / c(z)``, where ``c`` has the eigenvalues of ``A - K C``. With those of ``A``
that lie outside the unit circle mirrored into it, ``a / c`` is all-pass: ``e`` is white where the
noise of the output is. It is the stationary Kalman filter for an output without process noise, and
least squares of ``e`` the maximum of the likelihood. Poles at zero are put where they decay within
the record. Nothing else is changed, so that for a stable plant ``e = y - G u``.

``e`` is linear in the signals, so that what the reference drives in it is ``e`` of the driven
signals (`driven`), and its derivatives by the coefficients are instruments as in the stable case
(`methods.reference`). They are taken by central differences of (1), which is exact at the samples:
of a held input, and of a driven one of continuous time, by pieces of the intervals
(`between_samples`).

References: U. Forssell & L. Ljung, IEEE Transactions on Automatic Control 45 (2000) 137-141. L.
Ljung, *System Identification*, 2nd ed., problem 4G.6 (1999), on the mirrored predictor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.interpolation import drive

STEP = 1e-5
"""Of the central differences, relative to the coefficients' natural sizes: the root of the
rounding of ``e`` over the cube of what is left of it."""


@dataclass(frozen=True, eq=False)
class Plant:
    """Several inputs, one output, one denominator.

    Attributes
    ----------
    a : (n,) array
        ``a_{n-1} .. a_0``.
    b : tuple of arrays
        Numerators of every input, descending powers.
    """

    a: Array
    b: tuple[Array, ...]

    @cached_property
    def poles(self) -> Complex:
        """(n,) complex array [rad/s]."""
        return np.roots(np.concatenate([[1.0], self.a])).astype(np.complex128)

    @property
    def theta(self) -> Array:
        """Coefficients in the order of `Structure.names`."""
        return np.concatenate([self.a, *self.b])

    def with_theta(self, theta: Array) -> Plant:
        """The same orders with other coefficients."""
        ends = np.cumsum([self.a.size, *(one.size for one in self.b)])
        parts = np.split(theta, ends[:-1])
        return Plant(parts[0], tuple(parts[1:]))

    @property
    def scale(self) -> Array:
        """Natural sizes of the coefficients, from the typical rate of the poles."""
        n = self.a.size
        rate = max(float(np.exp(np.mean(np.log(np.abs(self.poles) + 1e-300)))), 1e-150)
        sizes = [rate ** np.arange(1.0, n + 1)]
        for one in self.b:
            powers = rate ** -np.arange(one.size - 1.0, -1.0, -1.0)
            sizes.append(float(np.max(np.abs(one) / powers) or 1.0) * powers)
        return np.concatenate(sizes)


@dataclass(frozen=True, eq=False)
class Signals:
    """What a predictor is driven by: recorded, or what the references drive of it.

    Attributes
    ----------
    u : (n_samples, n_inputs) array
        Held over the intervals.
    fine : (pieces * n_samples, n_inputs) array
        Held over equal pieces of them; added to ``u``.
    y : (n_samples,) array
    dt : float
    """

    u: Array
    fine: Array
    y: Array
    dt: float

    @property
    def pieces(self) -> int:
        """Of an interval."""
        return len(self.fine) // len(self.u) if len(self.fine) else 0

    def is_same(self, other: Signals) -> bool:
        """Whether both drive a predictor alike, to the last bit."""
        pairs = ((self.u, other.u), (self.fine, other.fine), (self.y, other.y))
        return self.dt == other.dt and all(np.array_equal(one, two) for one, two in pairs)


def recorded(loop: Loop) -> Signals:
    """All of a record, about its first sample; missing outputs are those that are driven."""
    record, part = loop.record, loop.fitted
    y = np.where(np.isnan(record.y[:, 0]), part.outputs[:, 0], record.y[:, 0])
    u = record.u - record.u[0]
    held, fine = _split(loop, u)
    return Signals(held, fine, y - y[0], float(record.dt or 0.0))


def driven_signals(loop: Loop) -> Signals:
    """What the references drive of a record."""
    part = loop.fitted
    held, fine = _split(loop, part.inputs - part.inputs[0])
    y = part.outputs[:, 0]
    return Signals(held, fine, y - y[0], float(loop.record.dt or 0.0))


def _split(loop: Loop, u: Array) -> tuple[Array, Array]:
    if loop.sampling == "sampled":
        return u, np.zeros((0, u.shape[1]))
    fine = loop.fine_inputs
    return u - (loop.fitted.inputs - loop.fitted.inputs[0]), fine


@dataclass(frozen=True, eq=False)
class Predictor:
    """Equation (1) for one plant and one sampling interval.

    Attributes
    ----------
    plant : Plant
    dt : float
        [s].
    slowest : float
        Slowest decay of the predictor [rad/s].
    fed_back : bool
        Without it ``K`` is zero and ``e`` the output's error itself, which grows where the plant
        does: of use in open loop alone, where the record grows alike.
    held : (n,) complex array, optional
        Poles of the predictor, whatever the plant [rad/s].
    """

    plant: Plant
    dt: float
    slowest: float
    fed_back: bool = True
    held: Complex | None = None

    @cached_property
    def _continuous(self) -> tuple[Array, Array, Array, Array]:
        n = self.plant.a.size
        rate = max(float(np.max(np.abs(self.plant.poles))), self.slowest)
        # time in units of 1 / rate: the states are of one size
        powers = rate ** np.arange(1.0, n + 1)
        a = np.zeros((n, n))
        a[:-1, 1:] = np.eye(n - 1)
        a[:, 0] = -self.plant.a / powers
        direct = np.array([one[0] if one.size > n else 0.0 for one in self.plant.b])
        b = np.zeros((n, len(self.plant.b)))
        for j, one in enumerate(self.plant.b):
            proper = np.pad(one[-n:], (max(n - one.size, 0), 0)) - direct[j] * self.plant.a
            b[:, j] = proper / powers
        return rate * a, rate * b, direct, powers

    def _discrete(self, step: float) -> tuple[Array, Array]:
        a, b, _, _ = self._continuous
        n, m = b.shape
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = a * step, b * step
        whole = scipy.linalg.expm(block)
        return whole[:n, :n], whole[:n, n:]

    @cached_property
    def _sampled(self) -> tuple[Array, Array]:
        return self._discrete(self.dt)

    @property
    def mirrored(self) -> Complex:
        """(n,) complex poles of the predictor [rad/s]."""
        if self.held is not None:
            return self.held
        poles = self.plant.poles
        return np.asarray(-np.maximum(np.abs(poles.real), self.slowest) + 1j * poles.imag)

    @cached_property
    def gain(self) -> Array:
        """(n,) ``K``, by Ackermann's formula on the observer form.

        In powers of ``z - 1``: slow poles and fast samples crowd around one, and in powers of ``z``
        nothing of them would be left but rounding.
        """
        n = self.plant.a.size
        decays = self.held is None and np.all(self.plant.poles.real <= -self.slowest)
        if not self.fed_back or decays:
            return np.zeros(n)
        wanted = np.real(np.poly(np.expm1(self.mirrored * self.dt)))
        step = self._less_one
        value, power, rows = np.zeros((n, n)), np.eye(n), []
        for k in range(n + 1):
            value += wanted[n - k] * power
            if k < n:
                rows.append(power[0])
            power = power @ step
        return np.asarray(value @ np.linalg.solve(np.array(rows), np.eye(n)[:, -1]))

    @property
    def _less_one(self) -> Array:
        """``exp(A dt) - 1``, as the integral of ``A exp(A t)``."""
        a, n = self._continuous[0] * self.dt, self.plant.a.size
        block = np.zeros((2 * n, 2 * n))
        block[:n, :n], block[:n, n:] = a, np.eye(n)
        return np.asarray(a @ scipy.linalg.expm(block)[:n, n:])

    def errors(self, signals: Signals, start: Array | None = None) -> Array:
        """(n_samples,) ``e``, from rest or from a start: the initial state, then the offset."""
        a, b = self._sampled
        direct, n = self._continuous[2], self.plant.a.size
        inputs = b @ signals.u.T
        through = signals.u @ direct
        if signals.pieces:
            af, bf = self._discrete(self.dt / signals.pieces)
            blocks = signals.fine.reshape(len(signals.u), signals.pieces, -1)
            step = bf
            for k in range(signals.pieces - 1, -1, -1):
                inputs = inputs + step @ blocks[:, k].T
                step = af @ step
            through = through + blocks[:, 0] @ direct
        left = signals.y - through if start is None else signals.y - start[-1] - through
        inputs = inputs + np.outer(self.gain, left)
        closed = a.copy()
        closed[:, 0] -= self.gain
        states = np.empty((n, len(left)))
        first = np.zeros(n) if start is None else np.array(start[:-1], dtype=np.float64)
        drive(np.ascontiguousarray(closed), n - 1, inputs, first, states)
        return np.asarray(left - states[0])

    def starts(self, count: int) -> Array:
        """(count, n + 1) minus the derivatives of ``e`` by the initial state and the offset."""
        a, n = self._sampled[0], self.plant.a.size
        closed = a.copy()
        closed[:, 0] -= self.gain
        found = np.empty((count, n + 1))
        states = np.empty((n, count))
        fed = np.outer(self.gain, np.ones(count))
        drive(np.ascontiguousarray(closed), n - 1, fed, np.zeros(n), states)
        found[:, n] = 1.0 - states[0]
        for k in range(n):
            states = np.empty((n, count))
            drive(np.ascontiguousarray(closed), n - 1, np.zeros((n, count)), np.eye(n)[k], states)
            found[:, k] = states[0]
        return found

    @property
    def start_numerators(self) -> Array:
        """(n,) numerators of the free response over those states."""
        return self._continuous[3] / float(self._continuous[3][0]) * 1.0

    @property
    def amplification(self) -> float:
        """Of the standard deviation of white noise of the output, by the mirrored poles."""
        if not self.fed_back:
            return 1.0
        real = self.plant.poles.real
        return float(np.exp(self.dt * np.sum(np.where(real > self.slowest, real, 0.0))))


def slopes(predictor: Predictor, signals: Signals, start: Array) -> Array:
    """(n_samples, n_coefficients) minus the derivatives of ``e`` by the coefficients.

    Parameters
    ----------
    predictor : Predictor
    signals : Signals
    start : (n + 1,) array
        Initial state, in units of the plant's own, and offset, which are held.
    """
    plant = predictor.plant
    physical = np.append(start[:-1] * predictor.start_numerators, 0.0)
    theta, scale = plant.theta, plant.scale
    # of poles that are slower than the record no more is seen than of those that are as slow
    sizes = np.maximum(np.abs(plant.poles), predictor.slowest)
    scale[: sizes.size] = np.poly(-sizes)[1:]
    found = np.empty((len(signals.u), theta.size))
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = STEP * scale[k]
        both = []
        for moved in (theta + step, theta - step):
            one = replace(predictor, plant=plant.with_theta(moved))
            own = physical / np.append(one.start_numerators, 1.0)
            own[-1] = start[-1]
            both.append(one.errors(signals, own))
        found[:, k] = (both[1] - both[0]) / (2.0 * step[k])
    return found
