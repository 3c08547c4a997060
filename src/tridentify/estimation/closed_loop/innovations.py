"""Innovations of a loop whose controller is known: what its noise is, sample by sample.

The noise ``v`` of the output goes round the loop. What a plant ``G`` leaves of the output for the
recorded input is the noise itself, if the input is known between the samples too. The two kinds of
controllers differ in that.

*Sampled.* The input is held, so that ``v = y - G u``, whatever the controller (`SampledLoop`). As
``p(y_k, u_k | past) = p(y_k | past) p(u_k | past, y_k)``, and the second factor is free of
``theta``, nothing that is known of the controller adds to the likelihood: its bound is that of
input and output as they are, with the controller or without.

*Continuous.* What the input does between its samples follows from the loop, for which the
controller must be known (`ContinuousLoop`). With ``y_r, u_r`` what the references make of output
and input in the loop of ``G`` and ``C``, and ``y_v, u_v`` what the noise makes of them,

    y  =  y_r + y_v + G held(u - u_r - u_v):                                                  (1)

the loop between the samples, the recorded input at them. The noise counts as held over each
interval, as a sensor's is that the controller reads as often as the record does. With plant and
controller in one system ``X' = A X + B v`` that the noise drives, and a second plant ``P`` that
``- held(u_v)`` drives, (1) is exact at the samples,

    s_{k+1} = F s_k + K v_k,    v_k = w_k - c s_k,    w = y - y_r - G held(u - u_r),          (2)

and gives ``v`` by a recursion. Start and offset are columns: the free response of the plant, and a
constant. Simulating the whole loop from ``r`` alone would need the start of the controller too, and
lose what the recorded input says of slow disturbances: its bound is two to three times as large.
Using the recorded input with an error of its own would have none: given (2), the same noise makes
``u``, so that ``theta`` would be determined without an error. No record is that exact.

References: L. Ljung, *System Identification*, 2nd ed., sections 13.4 and 13.5 (1999). U. Forssell &
L. Ljung, Automatica 35 (1999) 1215-1241.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from tridentify.estimation.closed_loop.simulated import Simulated, closed, closed_output
from tridentify.models.simulate import free_responses, simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.discretize import discretize
from tridentify.numerics.interpolation import drive
from tridentify.record.checks.samples import Behaviour
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction


class Innovations(Protocol):
    """One record of a loop, as it depends on the plant."""

    @property
    def record(self) -> Record:
        """As it was recorded."""
        ...

    def errors(self, plant: TransferFunction, rest: Array) -> Array:
        """(n_samples,) noise that a plant leaves, given weights of `columns`."""
        ...

    def columns(self, plant: TransferFunction) -> Array:
        """(n_samples, k) minus the derivatives of the errors by start and offset."""
        ...


class Start(NamedTuple):
    """How a record of a plant began, and whether its output has an offset.

    Attributes
    ----------
    free : bool
    settled : bool
        Whether in equilibrium with the first value of the input; without either, from rest.
    offset : bool
    """

    free: bool
    settled: bool
    offset: bool

    def columns(self, record: Record, plant: TransferFunction) -> Array:
        """(n_samples, k) what start and offset may add to the output."""
        empty = np.zeros((record.n_samples, 0))
        free = free_responses(plant.den[0][0], record) if self.free else empty
        return np.hstack([free, np.ones((record.n_samples, int(self.offset)))])


class _System(NamedTuple):
    """``F``, ``K`` and ``c`` of (2), and ``u_v = input_ s - through v``."""

    f: Array
    gain: Array
    c: Array
    input_: Array
    through: float


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """A record whose input is held.

    Attributes
    ----------
    record : Record
    start : Start
    """

    record: Record
    start: Start

    def errors(self, plant: TransferFunction, rest: Array) -> Array:
        """``y - G u``."""
        left = _held_output(self.record, np.asarray(self.record.u), plant, self.start)
        return left - self.start.columns(self.record, plant) @ rest

    def columns(self, plant: TransferFunction) -> Array:
        """Free responses of the plant, and a constant."""
        return self.start.columns(self.record, plant)


@dataclass(frozen=True, eq=False)
class ContinuousLoop:
    """A record of a continuous controller, equation (2).

    Attributes
    ----------
    driven : Simulated
        Where the references enter, and what they were before the record.
    controller : TransferFunction
    start : Start
    """

    driven: Simulated
    controller: TransferFunction
    start: Start

    @property
    def record(self) -> Record:
        """As it was recorded."""
        return self.driven.record

    @cached_property
    def _references(self) -> Record:
        record = self.driven.record
        moved = np.asarray(record.reference) - self.driven.before
        between: Behaviour = record.reference_behaviour or "zoh"
        return Record(moved, np.zeros_like(moved), dt=record.dt, intersample=between)

    def errors(self, plant: TransferFunction, rest: Array) -> Array:
        """``v`` of (2)."""
        entries, references = self.driven.entries, self._references
        made = simulate(closed_output(plant, self.controller, entries), references)
        known = simulate(closed(plant, self.controller, entries), references)
        left = (
            _held_output(self.record, np.asarray(self.record.u) - known, plant, self.start)
            - made[:, 0]
        )
        return self._predicted(plant, left - self.start.columns(self.record, plant) @ rest)

    def undriven(self, plant: TransferFunction) -> Array:
        """(n_samples,) recorded input less what the references drive."""
        known = simulate(closed(plant, self.controller, self.driven.entries), self._references)
        return np.asarray(self.record.u - known)[:, 0]

    def input_left(self, plant: TransferFunction, rest: Array) -> Array:
        """(n_samples,) recorded input less what references and noise make of it."""
        noise = self.errors(plant, rest)
        system = self._system(plant)
        inputs = np.outer(system.gain, noise)
        states = np.empty_like(inputs)
        drive(
            np.ascontiguousarray(system.f), len(inputs) - 1, inputs, np.zeros(len(inputs)), states
        )
        return self.undriven(plant) - system.input_ @ states + system.through * noise

    def columns(self, plant: TransferFunction) -> Array:
        """Free responses of the plant and a constant, through the recursion."""
        table = self.start.columns(self.record, plant)
        return np.array([self._predicted(plant, one) for one in table.T]).reshape(table.T.shape).T

    def _predicted(self, plant: TransferFunction, left: Array) -> Array:
        system = self._system(plant)
        inputs = np.outer(system.gain, left)
        states = np.empty_like(inputs)
        around = np.ascontiguousarray(system.f - np.outer(system.gain, system.c))
        drive(around, len(inputs) - 1, inputs, np.zeros(len(inputs)), states)
        return np.asarray(left - system.c @ states)

    def _system(self, plant: TransferFunction) -> _System:
        num, den = plant.num[0][0], plant.den[0][0]
        n, d = self.controller.num[0][0], self.controller.den[0][0]
        rate = _typical(np.polyadd(np.polymul(den, d), np.polymul(num, n)))
        a, b, direct = _observer(num, den, rate)
        own, into, through = _observer(n, d, rate)
        # in X: y = share (x - direct z + v), u = - z - through y, with x and z the first states
        share, x, z = 1.0 / (1.0 + direct * through), len(a), len(own)
        output, input_ = np.zeros(x + z), np.zeros(x + z)
        output[:1] = share if x else 0.0
        output[x : x + 1] = -share * direct
        input_ -= through * output
        input_[x : x + 1] -= 1.0
        whole = np.block([[a, np.zeros((x, z))], [np.zeros((z, x)), own]])
        whole[:x] += np.outer(b, input_)
        whole[x:] += np.outer(into, output)
        entry = share * np.concatenate([-through * b, into])
        dt = float(self.record.dt or 0.0)
        loop = discretize(whole, entry[:, None], dt)
        second = discretize(a, b[:, None], dt)
        f = np.block(
            [
                [loop.transition, np.zeros((x + z, x))],
                [-np.outer(second.from_current[:, 0], input_), second.transition],
            ]
        )
        through *= share
        gain = np.concatenate([loop.from_current[:, 0], through * second.from_current[:, 0]])
        c = np.concatenate([output - direct * input_, np.eye(1, x)[0]])
        return _System(f, gain, c, np.concatenate([input_, np.zeros(x)]), through)


def _held_output(record: Record, u: Array, plant: TransferFunction, start: Start) -> Array:
    """(n_samples,) output less what a plant makes of a held input."""
    moved = u - u[0] if start.settled else u
    held = Record(moved, record.y, dt=record.dt, intersample="zoh")
    return np.asarray(record.y - simulate(plant, held))[:, 0]


def _typical(polynomial: Array) -> float:
    """Geometric mean of the rates of the roots [rad/s]."""
    sizes = np.abs(np.roots(polynomial))
    sizes = sizes[sizes > 0.0]
    return float(np.exp(np.mean(np.log(sizes)))) if sizes.size else 1.0


def _observer(num: Array, den: Array, rate: float) -> tuple[Array, Array, float]:
    """Observer form in time units of ``1 / rate``; what is seen is the first state."""
    n = den.size - 1
    padded = np.pad(num, (n + 1 - num.size, 0)) / den[0]
    monic = den / den[0]
    powers = rate ** np.arange(1.0, n + 1)
    a = np.eye(n, k=1)
    if n:
        a[:, 0] = -monic[1:] / powers
    b = (padded[1:] - padded[0] * monic[1:]) / powers
    return rate * a, rate * b, float(padded[0])
