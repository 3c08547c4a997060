"""A model's output for the input of a loop, and what the input does between its samples.

Of a controller that works on samples the input is held, and known everywhere. A continuous one
moves the input between the samples too, noise and all, and what it does there is not recorded. But
the part that the reference drives is a function of continuous time (`driven`), so that

    G u  =  G u_M  +  G (u - u_M)

needs an assumption for the second part alone. It is made of noise, of what a controller that is
not linear adds, and of the start; and as the noise is independent of the reference, an error of the
assumption there is noise again, and no bias. The driven part is simulated on pieces of the
intervals, held at its mean in each: right to second order in the length of a piece, jumps included.

References: R. Gonzalez, S. Pan, C. Rojas & J. Welsh, Automatica 166 (2024), on why estimators that
take the input of a continuous controller as held are not consistent.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from tridentify.estimation.closed_loop.as_recorded import AsRecorded
from tridentify.estimation.closed_loop.driven import Driven
from tridentify.estimation.closed_loop.simulated import Simulated
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.record.checks.samples import Behaviour
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

Sampling = Literal["sampled", "continuous"]

IN_WORDS = {"sampled": "sampled, its output held", "continuous": "continuous"}
"""How a controller works, as it is told."""

FINE = 0.1
"""Fastest rate times length of a piece: its mean is then right to (0.1)^2 / 24 = 0.04 %."""
STRAIGHT = 4
"""Pieces of an interval over which a recorded input is straight: what their means miss is a
sixteenth of what the mean of the whole interval would."""
MOST_PIECES = 8
"""Of an interval; loops that need more are faster than their sampling shows."""


@dataclass(frozen=True, eq=False)
class Loop:
    """One record of a loop, with what its reference drives.

    Attributes
    ----------
    driven : Driven, Simulated or AsRecorded
        What the reference drives: fitted, or simulated with a known controller; or all of the
        input, where there is no controller.
    sampling : {"sampled", "continuous"}
        How the controller works.
    late : tuple of float
        Samples after which each input acts, where a predictor is to know it; empty for at once.
    drift : bool
        Whether a predictor's output may have a slope in time.
    """

    driven: Driven | Simulated | AsRecorded
    sampling: Sampling
    late: tuple[float, ...] = field(default=(), kw_only=True)
    drift: bool = field(default=False, kw_only=True)

    @property
    def record(self) -> Record:
        """As it was recorded."""
        return self.driven.record

    def at(self, model: TransferFunction) -> Loop:
        """The loop as a model shows it: the same, where what the reference drives was fitted."""
        return self

    @property
    def fitted(self) -> Driven | AsRecorded:
        """What is driven, where it was not simulated with a known controller."""
        assert not isinstance(self.driven, Simulated)
        return self.driven

    @cached_property
    def instrument(self) -> Record:
        """The record with the driven part of its input in place of the input.

        Held at the samples or, for a continuous controller, at its mean over every interval.
        """
        return with_input(self.record, self._held, "zoh")

    @cached_property
    def _held(self) -> Array:
        if self.sampling == "sampled":
            return self.driven.inputs
        return self.driven.inputs_between(1)

    @property
    def _between(self) -> Literal["zoh", "foh"]:
        """What the rest of the input is taken to do between the samples."""
        smooth = self.sampling == "continuous" and self.record.behaviour != "zoh"
        return "foh" if smooth else "zoh"

    def beside(self, model: TransferFunction) -> Array:
        """(n_samples, n_outputs) what a model makes of the input beyond that of `instrument`."""
        rest = with_input(
            self.record, np.asarray(self.record.u) - self.driven.inputs, self._between
        )
        found = simulate(model, rest)
        if self.sampling == "sampled":
            return found
        held = with_input(self.record, self._held - self.driven.inputs[0], "zoh")
        return found + self._driven_output(model) - simulate(model, held)

    def moved_between(self, model: TransferFunction) -> Array:
        """(n_samples, n_outputs) what a model makes of the driven input beyond its samples."""
        samples = with_input(self.record, self.driven.inputs - self.driven.inputs[0], self._between)
        return self._driven_output(model) - simulate(model, samples)

    def _driven_output(self, model: TransferFunction) -> Array:
        """From pieces and from their halves, whose errors are as four to one (Richardson 1911)."""
        pieces = self.pieces
        halves = self.driven.inputs_between(2 * pieces) - self.driven.inputs[0]
        whole = halves.reshape(-1, 2, halves.shape[1]).mean(axis=1)
        fine, finer = (
            np.asarray(simulate(model, self._refined(u, count))[::count])
            for u, count in ((whole, pieces), (halves, 2 * pieces))
        )
        return finer + (finer - fine) / 3.0

    @property
    def pieces(self) -> int:
        """Of an interval, over each of which the driven input counts with its mean."""
        if isinstance(self.driven, AsRecorded):
            return STRAIGHT
        step = float(np.median(np.diff(self.record.t)))
        return int(np.clip(np.ceil(self.driven.fastest * step / FINE), 1, MOST_PIECES))

    @cached_property
    def fine_inputs(self) -> Array:
        """(pieces * n_samples, n_inputs) driven input in these pieces, about its first sample."""
        return np.asarray(self.driven.inputs_between(self.pieces) - self.driven.inputs[0])

    def _refined(self, u: Array, pieces: int) -> Record:
        record = self.record
        y = np.zeros((len(u), record.n_outputs))
        if record.dt is not None:
            return Record(u, y, dt=record.dt / pieces)
        gaps = np.append(np.diff(record.t), record.t[-1] - record.t[-2])
        t = (record.t[:, None] + gaps[:, None] * np.arange(pieces) / pieces).ravel()
        return Record(u, y, t=t)


def with_input(record: Record, u: Array, between: Behaviour) -> Record:
    """A record with another input in place of its own, and without references."""
    clock = {"t": record.t} if record.dt is None else {"dt": record.dt}
    return Record(
        u,
        record.y,
        **clock,
        intersample=between,
        input_names=record.input_names,
        output_names=record.output_names,
        units=record._units_of_a_model,
        name=record.name,
    )
