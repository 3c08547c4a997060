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
(`reference`). They are taken by central differences of (1), which is exact at the samples:
of a held input, and of a driven one of continuous time, by pieces of the intervals
(`between_samples`).

References: U. Forssell & L. Ljung, IEEE Transactions on Automatic Control 45 (2000) 137-141. L.
Ljung, *System Identification*, 2nd ed., problem 4G.6 (1999), on the mirrored predictor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tridentify.estimation.closed_loop.between_samples import MOST_PIECES, Loop
from tridentify.numerics.arrays import Array, Complex, Flags
from tridentify.numerics.exponential import exponentials
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
    along : (n_coefficients, n_free) array, optional
        Directions in which the coefficients may move, where something is known of them.
    """

    a: Array
    b: tuple[Array, ...]
    along: Array | None = None

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
        return Plant(parts[0], tuple(parts[1:]), self.along)

    @property
    def free(self) -> Array:
        """(n_coefficients, n_free) directions in which the coefficients may move."""
        return np.eye(self.theta.size) if self.along is None else self.along

    @property
    def scale(self) -> Array:
        """Natural sizes of the coefficients, from the typical rate of the poles.

        Those at zero have none; one rad/s where there is no other.
        """
        n, moving = self.a.size, np.abs(self.poles[self.poles != 0.0])
        rate = max(float(np.exp(np.mean(np.log(moving)))), 1e-150) if moving.size else 1.0
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
    return later(loop, Signals(held, fine, y - y[0], float(record.dt or 0.0)))


def observed(loop: Loop) -> Flags:
    """(n_samples,) where an output is there, and the inputs that it answers to were recorded."""
    seen = np.isfinite(loop.record.y[:, 0])
    seen[: int(np.ceil(max(loop.late, default=0.0)))] = False
    return np.asarray(seen)


def later(loop: Loop, signals: Signals) -> Signals:
    """The same with inputs that act as late as those of a loop; they were at rest before.

    A delay that is no whole number of pieces mixes the means of two of them, which is right to
    second order in their length.
    """
    if not any(loop.late):
        return signals
    samples = np.array(loop.late)
    if np.all(samples == np.round(samples)):
        fine = shifted(signals.fine, samples * signals.pieces)
        return replace(signals, u=shifted(signals.u, samples), fine=fine)
    pieces = signals.pieces or MOST_PIECES
    whole = np.repeat(signals.u, pieces, axis=0)
    whole = whole + signals.fine if signals.pieces else whole
    return replace(signals, u=np.zeros_like(signals.u), fine=shifted(whole, samples * pieces))


def shifted(table: Array, steps: Array) -> Array:
    """Columns later by so many rows each, filled up with their first row.

    Examples
    --------
    >>> shifted(np.array([[0.0], [1.0], [3.0]]), np.array([1.5])).ravel().tolist()
    [0.0, 0.0, 0.5]
    """
    if not len(table):
        return table
    found = np.empty_like(table)
    rows = np.arange(len(table))
    for j, step in enumerate(steps):
        whole = int(np.floor(step))
        near, far = (table[np.maximum(rows - k, 0), j] for k in (whole, whole + 1))
        found[:, j] = near + (step - whole) * (far - near)
    return found


def driven_signals(loop: Loop) -> Signals:
    """What the references drive of a record."""
    part = loop.fitted
    held, fine = _split(loop, part.inputs - part.inputs[0])
    y = part.outputs[:, 0]
    return later(loop, Signals(held, fine, y - y[0], float(loop.record.dt or 0.0)))


def _split(loop: Loop, u: Array) -> tuple[Array, Array]:
    if loop.sampling == "sampled":
        return u, np.zeros((0, u.shape[1]))
    fine = loop.fine_inputs
    return u - (loop.fitted.inputs - loop.fitted.inputs[0]), fine


@dataclass(frozen=True, eq=False)
class Predictors:
    """Equation (1) for several plants of the same orders and one sampling interval.

    Attributes
    ----------
    plants : tuple of Plant
    dt : float
        [s].
    slowest : float
        Slowest decay of the predictors [rad/s].
    fed_back : bool
        Without it ``K`` is zero and ``e`` the output's error itself, which grows where the plant
        does: of use in open loop alone, where the record grows alike.
    held : (n,) complex array, optional
        Poles of the predictors, whatever the plant [rad/s].
    """

    plants: tuple[Plant, ...]
    dt: float
    slowest: float
    fed_back: bool = True
    held: Complex | None = None

    @cached_property
    def poles(self) -> Complex:
        """(n_plants, n) complex array [rad/s]."""
        if len(self.plants) == 1:
            return self.plants[0].poles[None, :]
        count, n = len(self.plants), self.plants[0].a.size
        companion = np.zeros((count, n, n))
        companion[:, 0] = [-one.a for one in self.plants]
        companion[:, 1:, :-1] = np.eye(n - 1)
        return np.linalg.eigvals(companion).astype(np.complex128)

    @cached_property
    def _observer(self) -> tuple[Array, Array, Array, Array]:
        """State matrices (s, n, n), (s, n, m), direct parts (s, m), and units of the states."""
        a = np.stack([one.a for one in self.plants])
        count, n = a.shape
        rates = np.maximum(np.max(np.abs(self.poles), axis=1), self.slowest)[:, None]
        # time in units of 1 / rate: the states are of one size
        powers = rates ** np.arange(1.0, n + 1)
        matrix = np.zeros((count, n, n))
        matrix[:, :-1, 1:] = np.eye(n - 1)
        matrix[:, :, 0] = -a / powers
        numerators = [np.stack(own) for own in zip(*(one.b for one in self.plants), strict=True)]
        direct = np.zeros((count, len(numerators)))
        b = np.zeros((count, n, len(numerators)))
        for j, one in enumerate(numerators):
            if one.shape[1] > n:
                direct[:, j] = one[:, 0]
            proper = one[:, -n:]
            b[:, n - proper.shape[1] :, j] = proper
            b[:, :, j] -= direct[:, j, None] * a
        scaled = rates[:, :, None] * b / powers[:, :, None]
        return rates[:, :, None] * matrix, scaled, direct, powers

    def _discrete(self, step: float) -> tuple[Array, Array, Array]:
        """``exp(A step)``, what a held input makes of the states, and ``exp(A step) - 1``."""
        a, b, _, _ = self._observer
        count, n, _ = a.shape
        block = np.zeros((count, 2 * n, 2 * n))
        block[:, :n, :n], block[:, :n, n:] = a * step, np.eye(n)
        whole = exponentials(block)
        integral = whole[:, :n, n:]
        return whole[:, :n, :n], integral @ (b * step), (a * step) @ integral

    @cached_property
    def _sampled(self) -> tuple[Array, Array, Array]:
        return self._discrete(self.dt)

    @property
    def mirrored(self) -> Complex:
        """(n_plants, n) complex poles of the predictors [rad/s]."""
        if self.held is not None:
            return np.broadcast_to(self.held, self.poles.shape)
        real = -np.maximum(np.abs(self.poles.real), self.slowest)
        return np.asarray(real + 1j * self.poles.imag)

    @cached_property
    def gains(self) -> Array:
        """(n_plants, n) ``K``, by Ackermann's formula on the observer form.

        In powers of ``z - 1``: slow poles and fast samples crowd around one, and in powers of ``z``
        nothing of them would be left but rounding.
        """
        count, n = self.poles.shape
        found = np.zeros((count, n))
        decays = np.all(self.poles.real <= -self.slowest, axis=1) & (self.held is None)
        fed = np.flatnonzero(~decays) if self.fed_back else np.zeros(0, dtype=np.intp)
        if not fed.size:
            return found
        wanted = np.zeros((fed.size, n + 1), dtype=np.complex128)
        wanted[:, 0] = 1.0
        for k, root in enumerate(np.expm1(self.mirrored[fed] * self.dt).T):
            wanted[:, 1 : k + 2] -= wanted[:, : k + 1] * root[:, None]
        step = self._sampled[2][fed]
        value, power, rows = np.zeros_like(step), np.broadcast_to(np.eye(n), step.shape), []
        for k in range(n + 1):
            value = value + wanted.real[:, n - k, None, None] * power
            if k < n:
                rows.append(power[:, 0])
            power = power @ step
        last = np.broadcast_to(np.eye(n)[:, -1:], (fed.size, n, 1))
        found[fed] = (value @ np.linalg.solve(np.stack(rows, axis=1), last))[:, :, 0]
        return found

    @cached_property
    def closed(self) -> Array:
        """(n_plants, n, n) ``A - K C``."""
        found = self._sampled[0].copy()
        found[:, :, 0] -= self.gains
        return found

    @property
    def units(self) -> Array:
        """(n_plants, n) of the states."""
        return self._observer[3]

    def errors(self, signals: Signals, starts: Array | None = None) -> Array:
        """(n_plants, n_samples) ``e``, from rest or from starts: initial state, then the offset."""
        _, b, _ = self._sampled
        direct = self._observer[2]
        inputs, through = b @ signals.u.T, direct @ signals.u.T
        if signals.pieces:
            af, step, _ = self._discrete(self.dt / signals.pieces)
            blocks = signals.fine.reshape(len(signals.u), signals.pieces, -1)
            for k in range(signals.pieces - 1, -1, -1):
                inputs = inputs + step @ blocks[:, k].T
                step = af @ step
            through = through + direct @ blocks[:, 0].T
        offsets = 0.0 if starts is None else starts[:, -1:]
        left = signals.y - offsets - through
        if self.gains.any():
            inputs = inputs + self.gains[:, :, None] * left[:, None, :]
        count, n, samples = inputs.shape
        first = np.zeros((count, n)) if starts is None else np.array(starts[:, :-1], dtype=float)
        states = np.empty((n, samples))
        found = np.empty_like(left)
        for k in range(count):
            drive(self.closed[k], n - 1, inputs[k], first[k], states)
            found[k] = left[k] - states[0]
        return found


@dataclass(frozen=True, eq=False)
class Predictor:
    """Equation (1) for one plant and one sampling interval; attributes as of `Predictors`."""

    plant: Plant
    dt: float
    slowest: float
    fed_back: bool = True
    held: Complex | None = None

    def of(self, plants: Sequence[Plant]) -> Predictors:
        """The same of other plants."""
        return Predictors(tuple(plants), self.dt, self.slowest, self.fed_back, self.held)

    @cached_property
    def _alone(self) -> Predictors:
        return self.of([self.plant])

    @property
    def mirrored(self) -> Complex:
        """(n,) complex poles of the predictor [rad/s]."""
        found: Complex = self._alone.mirrored[0]
        return found

    def errors(self, signals: Signals, start: Array | None = None) -> Array:
        """(n_samples,) ``e``, from rest or from a start: the initial state, then the offset."""
        found: Array = self._alone.errors(signals, None if start is None else start[None, :])[0]
        return found

    def starts(self, count: int) -> Array:
        """(count, n + 1) minus the derivatives of ``e`` by the initial state and the offset."""
        closed, gain, n = self._alone.closed[0], self._alone.gains[0], self.plant.a.size
        found, states = np.empty((count, n + 1)), np.empty((n, count))
        fed = np.outer(gain, np.ones(count))
        drive(closed, n - 1, fed, np.zeros(n), states)
        found[:, n] = 1.0 - states[0]
        for k in range(n):
            drive(closed, n - 1, np.zeros((n, count)), np.eye(n)[k], states)
            found[:, k] = states[0]
        return found

    def levels(self, count: int) -> Array:
        """(count, n_inputs) minus the derivatives of ``e`` by levels of the inputs."""
        alone, n = self._alone, self.plant.a.size
        direct = alone._observer[2][0]
        fed = alone._sampled[1][0] - np.outer(alone.gains[0], direct)
        found, states = np.empty((count, direct.size)), np.empty((n, count))
        for j, own in enumerate(fed.T):
            drive(alone.closed[0], n - 1, np.outer(own, np.ones(count)), np.zeros(n), states)
            found[:, j] = direct[j] + states[0]
        return found

    @property
    def start_numerators(self) -> Array:
        """(n,) numerators of the free response over those states."""
        units = self._alone.units[0]
        return np.asarray(units / float(units[0]))

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
    physical = start[:-1] * predictor.start_numerators
    theta, scale = plant.theta, plant.scale
    # of poles that are slower than the record no more is seen than of those that are as slow
    sizes = np.maximum(np.abs(plant.poles), predictor.slowest)
    scale[: sizes.size] = np.poly(-sizes)[1:]
    steps = STEP * np.diag(scale)
    moved = predictor.of([plant.with_theta(theta + one) for one in (*steps, *-steps)])
    own = physical * moved.units[:, :1] / moved.units
    up, down = np.split(
        moved.errors(signals, np.column_stack([own, np.full(len(own), start[-1])])), 2
    )
    return np.asarray((down - up).T / (2.0 * STEP * scale))
