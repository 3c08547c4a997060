"""Sampled inputs as functions of time, and the states that they drive, at the samples.

A `Sampled` is the data: inputs, instants, what the input does between its samples, and a delay for
each channel. `States` runs one state equation over it, exactly, in blocks; there are three ways.

*Uniform time, no delay.* ``x_{k+1} = F x_k + G0 u_k + G1 u_{k+1}`` (`numerics.discretize`).

*Uniform time, a delay of* ``(d + f) h``, *d whole and* ``0 <= f < 1``. In the interval from sample
``k`` the delayed input is made of the interval before its own sample ``k - d`` for a time ``f h``,
then of the one after it (Astrom & Wittenmark, Computer-Controlled Systems, section 2.3):

    x_{k+1} = F x_k + Ga w_k + Gb w_{k+1} + Gc w_{k+2},     w_k = u_{k-d-1},

with ``Gc = 0`` for a held input. ``z_k = x_k - Gc w_{k+1}`` turns three inputs into two, ``z_{k+1}
= F z_k + Ga w_k + (Gb + F Gc) w_{k+1}``, so a delay costs nothing. Whatever the delay, nothing is
rounded to samples.

*Any other instants.* Interval by interval (`numerics.intervals`).

*Band-limited.* Between the samples the input is a sum of windowed sincs, in every interval a
polynomial (`numerics.interpolation`); a delay moves the polynomials.

In all cases the input is zero before its first sample arrives, and the state is zero there: what
the past left behind is for the initial state to say.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from tridentify.numerics import interpolation
from tridentify.numerics.arrays import Array
from tridentify.numerics.discretize import Discrete, discretize
from tridentify.numerics.intervals import Crossing, Plan, free_plan, plan, snapped
from tridentify.numerics.kept import cached_property
from tridentify.numerics.propagate import propagate

MOST_LATE = 2.0**52
"""Samples of a delay, beyond which it is later than the end of any record."""
WHOLE = 1e-9
"""Relative error of a delay over a step that passes for a whole number: rounding of the
quotient."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """Inputs as functions of time.

    Attributes
    ----------
    u : (n_samples, n_channels) array
        C-contiguous.
    dt : float
        Uniform interval [s]; a typical one where ``t`` is given.
    intersample : str
        ``"zoh"``, ``"foh"`` or, on uniform time, ``"band-limited"``.
    t : (n_samples,) array, optional
        Instants from zero [s], where they are not uniform.
    delays : tuple of float
        One for each channel [s]; empty where none is delayed.

    Examples
    --------
    >>> Sampled(np.arange(4.0)[:, None], 1.0, "zoh", delays=(1.5,)).direct.ravel().tolist()
    [0.0, 0.0, 0.0, 1.0]
    """

    u: Array
    dt: float
    intersample: str
    t: Array | None = None
    delays: tuple[float, ...] = ()

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.u.shape[0])

    @cached_property
    def groups(self) -> tuple[tuple[float, tuple[int, ...]], ...]:
        """Delays, and the channels that have each: one group, or one for every channel."""
        channels = range(self.u.shape[1])
        delays = self.delays or (0.0,) * len(channels)
        if len(set(delays)) <= 1:
            return ((delays[0] if delays else 0.0, tuple(channels)),)
        return tuple((delays[j], (j,)) for j in channels)

    @cached_property
    def shifted(self) -> tuple[tuple[int, float, Array], ...]:
        """For each group the first sample that its input reaches, ``f``, and ``w``."""
        found = []
        for delay, channels in self.groups:
            whole, part = split_delay(delay, self.dt)
            w = np.zeros((self.n_samples + 1, len(channels)))
            first = whole + 1
            if first < w.shape[0]:
                w[first:] = self.u[: w.shape[0] - first, list(channels)]
            found.append((first, part, w))
        return tuple(found)

    @cached_property
    def pieces(self) -> tuple[tuple[int, float, Array, Array], ...]:
        """Of a band-limited input, for each channel, its polynomials.

        The first sample that the input reaches, how long before it began to arrive (in samples),
        the coefficients of that first piece, and those of the intervals from that sample on.
        """
        found = []
        delays = self.delays or (0.0,) * self.u.shape[1]
        for j, delay in enumerate(delays):
            whole, part = split_delay(delay, self.dt)
            first, begun = (whole + 1, 1.0 - part) if part else (whole, 0.0)
            places = interpolation.nodes()
            u = self.u[:, j]
            head = interpolation.between(u[: 2 * interpolation.HALF + 4], begun * places)[:1]
            body = interpolation.between(u, begun + places - (begun > 0))
            # the interval from sample k lies `begun` behind input sample k - first
            rows = body[1:] if begun else body
            found.append(
                (
                    first,
                    begun,
                    interpolation.coefficients(head)[0],
                    interpolation.coefficients(rows).T,
                )
            )
        return tuple(found)

    @cached_property
    def plans(self) -> tuple[Plan, ...]:
        """For each group the events between the samples."""
        assert self.t is not None
        return tuple(
            plan(self.t, self.u[:, list(channels)], delay, self.intersample)
            for delay, channels in self.groups
        )

    def in_units(self, unit: float) -> Sampled:
        """The same with time counted in ``unit`` [s], made once."""
        if unit not in self._scaled:
            self._scaled[unit] = replace(
                self,
                dt=self.dt / unit,
                t=None if self.t is None else self.t / unit,
                delays=tuple(delay / unit for delay in self.delays),
            )
        return self._scaled[unit]

    @cached_property
    def _scaled(self) -> dict[float, Sampled]:
        return {}

    def free_plan(self, begin: int) -> Plan:
        """The intervals between the samples from sample ``begin`` on."""
        assert self.t is not None
        if begin not in self._free_plans:
            self._free_plans[begin] = free_plan(self.t, begin)
        return self._free_plans[begin]

    @cached_property
    def _free_plans(self) -> dict[int, Plan]:
        return {}

    @cached_property
    def direct(self) -> Array:
        """(n_samples, n_channels) the delayed inputs themselves at the samples."""
        if not any(self.delays):
            return self.u
        found = np.empty_like(self.u)
        for delay, channels in self.groups:
            found[:, list(channels)] = self._late(delay, self.u[:, list(channels)])
        return found

    def _late(self, delay: float, u: Array) -> Array:
        if self.t is not None:
            return _late_between(self.t, u, delay, self.intersample)
        whole, part = split_delay(delay, self.dt)
        late = np.zeros((self.n_samples, u.shape[1]))
        n = self.n_samples
        if self.intersample == "band-limited" and part:
            for j in range(u.shape[1]):
                moved = interpolation.between(u[:, j], np.array([1.0 - part]))[:, 0]
                late[whole + 1 :, j] = moved[: max(n - whole - 1, 0)]
            return late
        if self.intersample == "zoh":
            first = whole + (part > 0)
            late[first:] = u[: max(n - first, 0)]
            return late
        late[whole + 1 :] = (1.0 - part) * u[1 : max(n - whole, 1)]
        late[whole + 1 :] += part * u[: max(n - whole - 1, 0)]
        if part == 0 and whole < n:
            late[whole] = u[0]
        return late


def split_delay(delay: float, dt: float) -> tuple[int, float]:
    """A delay as whole samples and a part of one, whole up to rounding.

    Examples
    --------
    >>> split_delay(0.75, 0.5), split_delay(0.3, 0.1)
    ((1, 0.5), (3, 0.0))
    """
    ratio = min(delay / dt, MOST_LATE)
    nearest = round(ratio)
    if abs(ratio - nearest) <= WHOLE * max(1.0, abs(ratio)):
        return nearest, 0.0
    whole = math.floor(ratio)
    return whole, ratio - whole


def _late_between(t: Array, u: Array, delay: float, intersample: str) -> Array:
    """The delayed input at the samples; zero before it arrives."""
    knots = snapped(t + delay, t)
    at = np.searchsorted(knots, t, side="right") - 1
    held = np.where(at[:, None] >= 0, u[np.maximum(at, 0)], 0.0)
    if intersample == "zoh":
        return held
    here = np.maximum(at, 0)
    after = np.minimum(here + 1, t.size - 1)
    span = np.where(after > here, knots[after] - knots[here], 1.0)
    share = np.where(at >= 0, (t - knots[here]) / span, 0.0)
    return np.asarray(held + share[:, None] * (u[after] - u[here]) * (at >= 0)[:, None])


class _Runner(Protocol):
    state: Array

    def advance(self, start: int, stop: int, out: Array) -> None:
        """Write the states at samples ``start .. stop - 1``."""


class States:
    """States of ``x' = A x + B u_j`` for every channel, from zero, at the samples.

    Parameters
    ----------
    signal : Sampled
    a : (q, q) array
    b : (q,) array
    upper : int
        Non-zero diagonals of ``a`` above the main one.

    Examples
    --------
    >>> signal = Sampled(np.ones((4, 1)), 0.5, "zoh", delays=(0.75,))
    >>> out = np.empty((1, 4))
    >>> States(signal, -np.eye(1), np.ones(1), upper=1).advance(0, 4, out)
    >>> bool(np.allclose(out, 1 - np.exp(-np.array([0, 0, 0.25, 0.75]))))
    True
    """

    def __init__(
        self,
        signal: Sampled,
        a: Array,
        b: Array,
        *,
        upper: int,
    ) -> None:
        self._groups: list[tuple[slice, _Runner]] = []
        self._free: _Impulse | None = None
        self._signal, self._a, self._b = signal, a, b
        self._upper = upper
        q = b.size
        if signal.intersample == "band-limited":
            transition, weights = interpolation.moments(a, b, signal.dt)
            self._whole = Discrete(transition, weights, weights)
            for j in range(signal.u.shape[1]):
                one = _BandLimited(signal, j, transition, weights, a, b, upper)
                self._groups.append((slice(j * q, (j + 1) * q), one))
            return
        if signal.t is None:
            self._whole = discretize(a, b[:, None], signal.dt, signal.intersample)
        for g, (delay, channels) in enumerate(signal.groups):
            if not channels:
                continue
            rows = slice(channels[0] * q, (channels[-1] + 1) * q)
            runner: _Runner
            if signal.t is not None:
                runner = Crossing(signal.plans[g], a, b, upper=upper)
            else:
                runner = _Uniform(signal, g, delay, self._whole, a, b, upper)
            self._groups.append((rows, runner))

    def advance(self, start: int, stop: int, out: Array) -> None:
        """Write the states at samples ``start .. stop - 1``; to be called in their order."""
        for rows, runner in self._groups:
            runner.advance(start, stop, out[rows])

    def go_on(self, u: Array, origin: int, before: int, count: int) -> None:
        """Take the inputs of a part of a record that is not held as a whole.

        Only on uniform time, and not for a band-limited input.

        Parameters
        ----------
        u : (n, n_channels) array
            From ``before`` samples before the part (zeros before the record) to one after it, or to
            the end of the record.
        origin : int
            First sample of the part; the one before it was the last that was advanced over.
        before : int
            As many samples as the longest delay has, and one.
        count : int
            Samples of the part.

        Examples
        --------
        >>> whole = Sampled(np.arange(6.0)[:, None], 0.5, "zoh", delays=(0.75,))
        >>> two = [States(whole, -np.eye(1), np.ones(1), upper=1) for _ in range(2)]
        >>> out, parts = np.empty((1, 6)), np.empty((1, 6))
        >>> two[0].advance(0, 6, out)
        >>> for k in (0, 3):
        ...     u = np.vstack([np.zeros((2, 1)), whole.u])[k:k + 6]
        ...     two[1].go_on(u, k, 2, 3)
        ...     part = np.empty((1, 3))
        ...     two[1].advance(k, k + 3, part)
        ...     parts[:, k:k + 3] = part
        >>> bool(np.array_equal(out, parts))
        True
        """
        for (_, runner), (_, channels) in zip(self._groups, self._signal.groups, strict=True):
            assert isinstance(runner, _Uniform)
            runner.go_on(u[:, list(channels)], origin, before, count)
        if self._free is not None:
            self._free.go_on(origin, count)

    def impulse(self, begin: int) -> _Runner:
        """The response to an impulse at sample ``begin``: ``e^{A (t - t_begin)} B``, zero before.

        Examples
        --------
        >>> states = States(Sampled(np.ones((3, 1)), 0.5, "zoh"), -np.eye(1), np.ones(1), upper=1)
        >>> out = np.empty((1, 3))
        >>> states.impulse(1).advance(0, 3, out)
        >>> bool(np.allclose(out, [0, 1, np.exp(-0.5)]))
        True
        """
        signal = self._signal
        if signal.t is None:
            self._free = _Impulse(
                self._whole.transition, self._b, begin, signal.n_samples, self._upper,
            )  # fmt: skip
            return self._free
        chart = signal.free_plan(begin)
        other = next((one for _, one in self._groups if isinstance(one, Crossing)), None)
        return Crossing(chart, self._a, self._b, self._b[None, :], self._upper, other)


class _BandLimited:
    """One channel of a band-limited input."""

    def __init__(
        self,
        signal: Sampled,
        channel: int,
        transition: Array,
        weights: Array,
        a: Array,
        b: Array,
        upper: int,
    ) -> None:
        self._first, begun, head, self._body = signal.pieces[channel]
        self._transition, self._weights, self._upper = transition, weights, upper
        self.state = np.zeros((1, b.size))
        if begun:
            self.state[0] = interpolation.moments(a, b, begun * signal.dt)[1] @ head

    def advance(self, start: int, stop: int, out: Array) -> None:
        begin = min(max(start, self._first), stop)
        out[: self.state.size, : begin - start] = 0.0
        if begin < stop:
            inputs = np.zeros((self.state.size, stop - begin))
            pieces = self._body[:, begin - self._first : stop - self._first]
            inputs[:, : pieces.shape[1]] = self._weights @ pieces
            interpolation.drive(
                self._transition, self._upper, inputs, self.state[0],
                out[: self.state.size, begin - start : stop - start],
            )  # fmt: skip


class _Uniform:
    """One group of channels on uniform time."""

    def __init__(
        self,
        signal: Sampled,
        group: int,
        delay: float,
        whole: Discrete,
        a: Array,
        b: Array,
        upper: int,
    ) -> None:
        self._upper = upper
        self._after = np.zeros(b.size)
        self._first, self._origin = 0, 0
        one = b[:, None]
        if not delay:
            self._step = (whole.transition, whole.from_current[:, 0], whole.from_next[:, 0])
            own = list(signal.groups[group][1])
            self._w = (
                signal.u
                if len(own) == signal.u.shape[1]
                else np.ascontiguousarray(signal.u[:, own])
            )
            self.state = np.zeros((self._w.shape[1], b.size))
            return
        self._first, part, self._w = signal.shifted[group]
        self._step, self._after = _taps(whole, a, one, signal.dt, part, signal.intersample)
        rest = discretize(a, one, (1.0 - part) * signal.dt, signal.intersample)
        u_0, u_1 = signal.u[0], signal.u[1]
        last = u_1 if signal.intersample == "zoh" else part * u_0 + (1.0 - part) * u_1
        begun = np.outer(u_0, rest.from_current[:, 0]) + np.outer(last, rest.from_next[:, 0])
        begun -= np.outer(u_1, self._after)
        self.state = np.ascontiguousarray(begun[list(signal.groups[group][1])])

    def advance(self, start: int, stop: int, out: Array) -> None:
        begin = min(max(start, self._first), stop)
        q = self._after.size
        out[: self.state.size, : begin - start] = 0.0
        if begin == stop:
            return
        here, there = begin - self._origin, stop - self._origin
        propagate(
            *self._step, self._w, self.state, out, start=here, stop=there, column=begin - start,
            upper=self._upper,
        )  # fmt: skip
        if self._first and np.any(self._after):
            for j in range(self.state.shape[0]):
                out[j * q : (j + 1) * q, begin - start : stop - start] += np.outer(
                    self._after, self._w[here + 1 : there + 1, j]
                )

    def go_on(self, u: Array, origin: int, before: int, count: int) -> None:
        """The inputs of the samples from ``origin`` on, as `States.go_on` is given them."""
        first = before - self._first
        self._w = np.ascontiguousarray(u[first : first + count + 1])
        self._origin = origin


def _taps(
    whole: Discrete, a: Array, b: Array, dt: float, part: float, intersample: str
) -> tuple[tuple[Array, Array, Array], Array]:
    """``F, Ga, Gb + F Gc`` and ``Gc`` for a delay of ``part`` of an interval."""
    one = discretize(a, b, part * dt, intersample)
    two = discretize(a, b, (1.0 - part) * dt, intersample)
    if intersample == "zoh":
        old, new = two.transition @ one.from_current, two.from_current
        return (whole.transition, old[:, 0], new[:, 0]), np.zeros(b.shape[0])
    # in the first part from u(k - d - part) to u(k - d), in the second to u(k - d + 1 - part)
    old = part * (two.transition @ one.from_current)
    new = two.transition @ ((1.0 - part) * one.from_current + one.from_next)
    new = new + two.from_current + part * two.from_next
    last = (1.0 - part) * two.from_next
    moved = new + whole.transition @ last
    return (whole.transition, old[:, 0], moved[:, 0]), np.ascontiguousarray(last[:, 0])


class _Impulse:
    def __init__(
        self,
        transition: Array,
        b: Array,
        begin: int,
        n_samples: int,
        upper: int,
    ) -> None:
        self._transition, self._none = transition, np.zeros(b.size)
        self._nothing = np.zeros((n_samples, 1))
        self._origin = 0
        self.state = b[None, :].copy()
        self._begin, self._upper = begin, upper

    def advance(self, start: int, stop: int, out: Array) -> None:
        begin = min(max(start, self._begin), stop)
        out[: self.state.size, : begin - start] = 0.0
        if begin < stop:
            propagate(
                self._transition, self._none, self._none, self._nothing, self.state, out,
                start=begin - self._origin, stop=stop - self._origin, column=begin - start,
                upper=self._upper,
            )  # fmt: skip

    def go_on(self, origin: int, count: int) -> None:
        """Count samples from ``origin`` on, for a part of so many samples."""
        self._origin = origin
        if self._nothing.shape[0] < count:
            self._nothing = np.zeros((count, 1))
