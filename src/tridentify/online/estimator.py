"""The seam of the on-line estimators: ``init``, a pure ``step``, ``estimate``.

An `Estimator` holds options only. What it knows is in the `State` that it is given and gives back.
The samples go through a compiled loop; between them, on a slow clock, come the *events*: a chunk of
samples to be kept, a tick at which filter and basis are adapted, an alarm. Events depend on the
samples alone, so a record that is run through at once and one that is fed sample by sample end in
the same state, bit for bit.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tridentify.errors import (
    ChannelCountError,
    DelayError,
    OptionError,
    SamplingError,
    ScaleError,
    TridentifyError,
    UnsupportedError,
    shown,
)
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.capability import Capability, refuse_unsupported
from tridentify.numerics.arrays import Array, Indices
from tridentify.online import asked
from tridentify.online.kernels import slots
from tridentify.online.kernels.workspace import LONGEST, Workspace
from tridentify.online.layout import Blueprint, Setting, constants_for, smallest_channel
from tridentify.online.saved.state import MAKERS, State
from tridentify.record.checks.scales import check_span
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

BATCH = 256
"""Intervals for which constants are made at once where time is uneven."""
MOST_DELAY = 1_000_000
"""Samples for which an input may be late: 8 MB of each input, which are copied with every state."""


LONG_RECORD = 4000
"""Samples from which the loop over blocks is loaded: its kernel takes longer to load than fewer
samples take one by one."""


class CompiledKernels(NamedTuple):
    """The compiled functions of an estimator: one sample, and whether it takes blocks.

    A block takes a sample in a third of the time, but some ten seconds more to compile on a
    machine where that has not been done; so it is left for long records.
    """

    step: Callable[[Indices, Array, Array, float], float]
    in_blocks: bool = False

    @staticmethod
    def block() -> Callable[..., int]:
        """What takes many samples; compiled, or read from disk, at the first call."""
        from tridentify.online.kernels.blocks import take_block

        return take_block

    def run(
        self, ints: Indices, c: Array, x: Array, u: Array, y: Array, start: int, stop: int,
        innovations: Array, flags: Indices,
    ) -> int:  # fmt: skip
        """Samples ``start .. stop - 1``, up to the first with an event; gives the next."""
        from tridentify.online.kernels.run import no_block, run_samples

        many = self.in_blocks and stop - start >= LONG_RECORD
        block = self.block() if many else no_block
        room = Workspace.of(ints, x, LONGEST if many else 1)
        return run_samples(
            ints, c, x, u, y, start, stop, innovations, flags, self.step, block, *room
        )


class Estimator(ABC):
    """What all on-line estimators have in common."""

    name: ClassVar[str]
    one_triangle: ClassVar[bool] = False
    """Whether all outputs share one triangle, whose columns end with the coefficients."""

    def __init_subclass__(cls) -> None:
        if "name" in cls.__dict__:
            MAKERS[cls.name] = cls

    @staticmethod
    @abstractmethod
    def kernels() -> CompiledKernels:
        """The compiled sample loop; compiled, or read from disk, at the first call."""

    # ------------------------------------------------------------------ what each of them says
    @abstractmethod
    def begin(self, setting: Setting) -> State:
        """The state before the first sample."""

    @abstractmethod
    def tick(self, state: State) -> State:
        """What is done on the slow clock."""

    @abstractmethod
    def alarmed(self, state: State) -> State:
        """What is done when the coefficients have moved."""

    def full(self, state: State) -> State:
        """What is done when more samples have been kept."""
        return state

    @abstractmethod
    def estimate(self, state: State) -> Estimate:
        """The coefficients with their standard errors.

        Raises
        ------
        NotReadyError
            The samples so far do not determine them.
        """

    @abstractmethod
    def is_ready(self, state: State) -> bool:
        """Whether the samples so far determine the coefficients."""

    def constants_for(self, blueprint: Blueprint, setting: Setting, intervals: Array) -> Array:
        """(k, ...) ``c`` of the kernels for samples that come after other intervals [s]."""
        return constants_for(blueprint, setting, intervals)

    @abstractmethod
    def rebuilt(self, setting: Setting, blueprint: Blueprint) -> Blueprint:
        """The plan of a blueprint from a file, made again from the settings and its poles alone.

        What an estimator has learnt, and keeps among the constants, is not in it.

        Raises
        ------
        ValueError
            The poles are none of this estimator's.
        """

    # ---------------------------------------------------------------------------- the seam
    def init(
        self,
        structure: Structure,
        dt: float,
        *,
        input_names: Sequence[str] = ("u",),
        output_names: Sequence[str] = ("y",),
        units: Mapping[str, str] | None = None,
        intersample: str = "zoh",
    ) -> State:
        """The state before the first sample.

        Parameters
        ----------
        structure : Structure
            One denominator for all channels; delays are known, one for each input.
        dt : float
            Sampling interval [s].
        input_names, output_names : sequence of str
            Names of the channels, and so their number.
        units : mapping of str to str, optional
            Unit of each channel.
        intersample : {"zoh", "foh"}
            What the input does between the samples.

        Returns
        -------
        State

        Raises
        ------
        OptionError, SamplingError, ScaleError
            An argument is out of range.
        ChannelCountError, DelayError, UnsupportedError
            About the structure.
        """
        return self.begin(
            self.setting(structure, dt, input_names, output_names, units, intersample)
        )

    def setting(
        self,
        structure: Structure,
        dt: float,
        input_names: Sequence[str],
        output_names: Sequence[str],
        units: Mapping[str, str] | None,
        intersample: str,
    ) -> Setting:
        """What `init` was told, checked; parameters and errors are those of `init`."""
        if not isinstance(structure, Structure):
            raise OptionError(
                f"found structure={type(structure).__name__}; expected a Structure; write for "
                "example Structure(poles=2, zeros=1)"
            )
        if not asked.is_number(dt) or not 0.0 < float(dt) < math.inf:
            raise SamplingError.found("dt=", dt, "a sampling interval above zero, in seconds")
        check_span(float(dt), float(dt))
        inputs, outputs = (
            asked.names_given("input_names", input_names),
            asked.names_given("output_names", output_names),
        )
        if intersample not in ("zoh", "foh"):
            raise UnsupportedError(
                f"found intersample={shown(intersample)}; {self.name} on-line expects 'zoh' (held) "
                "or 'foh' (straight lines), as the samples to come are not known; state one of "
                "these"
            )
        # the record checks names and units as everywhere else; it is taller than wide
        rows = 1 + max(len(inputs), len(outputs))
        probe = Record(
            np.zeros((rows, len(inputs))), np.zeros((rows, len(outputs))), dt=float(dt),
            intersample="foh" if intersample == "foh" else "zoh", input_names=inputs,
            output_names=outputs, units=units,
        )  # fmt: skip
        refuse_unsupported([probe], structure, f"{self.name} on-line", Capability.DELAY)
        if structure.drift_degree > 1:
            raise UnsupportedError(
                f"found drift={structure.drift}; {self.name} on-line expects a slope at most, as a "
                "polynomial needs the length of the record; state drift=True, or identify off-line"
            )
        try:
            structure.poles_matrix(len(outputs), len(inputs))
            structure.zeros_matrix(len(outputs), len(inputs))
        except ChannelCountError as wrong:
            raise ChannelCountError(
                f"{wrong}, or name as many channels: input_names=, output_names="
            ) from None
        delays = structure.delay_matrix(len(outputs), len(inputs))
        if len(set(delays)) > 1:
            raise UnsupportedError(
                f"found delay={shown(structure.delay)}; {self.name} on-line expects the delay of "
                "an input to be the same for all outputs; estimate the outputs one by one"
            )
        if max(delays[0]) > MOST_DELAY * float(dt):
            raise DelayError(
                f"found a delay of {max(delays[0]):g} s and samples every {float(dt):g} s; "
                f"expected at most {MOST_DELAY:,} samples, which are kept; correct the delay or "
                "its unit, or take every tenth sample"
            )
        at_rest = structure.initial_state in ("rest", "equilibrium")
        if intersample == "foh" and np.any(delays) and at_rest:
            raise UnsupportedError(
                f"found initial_state={structure.initial_state!r} with a delay and "
                "intersample='foh'; expected initial_state='free' or 'auto', since the line on "
                "which the input began is not known; leave it out"
            )
        return Setting(
            structure, float(dt), tuple(probe.input_names), tuple(probe.output_names),
            tuple(probe.units.items()), intersample,
        )  # fmt: skip

    def step(
        self, state: State, u: ArrayLike, y: ArrayLike, *, interval: float | None = None
    ) -> tuple[State, float | Array]:
        """Take in one sample.

        Parameters
        ----------
        state : State
            It is left as it is.
        u, y : float or array, (n_inputs,) and (n_outputs,)
            The sample; ``nan`` where it is missing.
        interval : float, optional
            Time since the sample before [s], where it is not ``dt``.

        Returns
        -------
        state : State
        innovation : float or (n_outputs,) array
            What of the output was not expected; ``nan`` where nothing was, or nothing came.

        Raises
        ------
        ChannelCountError, SampleTypeError
            The sample has other channels, or is no number.
        SamplingError
            The interval is not above zero.
        """
        if type(state) is not State:
            asked.check_state(state)
        values, stage = state
        if stage.method is not self:
            check_owner(self, stage.method)
        blueprint = stage.blueprint
        ints = blueprint.ints
        x = values.copy()
        setting = stage.setting
        m = len(setting.input_names)
        p = len(setting.output_names)
        if type(u) is float and type(y) is float and m == 1 and p == 1:
            x[slots.INBOX] = u
            x[slots.INBOX + 1] = y
        else:
            asked.put_sample(x, setting, u, y)
        if interval is None:
            constants, seconds = blueprint.constants, setting.dt
        else:
            constants, seconds = asked.constants_after(state, interval)
        innovation = self.kernels().step(ints, constants, x, seconds)
        found = State(x, stage)
        if x[slots.EVENT]:
            if p > 1:
                found_innovations = found.innovations
                return self._settle(found), found_innovations
            return self._settle(found), innovation
        return found, innovation if p == 1 else found.innovations

    def feed(
        self, state: State, u: Array, y: Array, intervals: Array | None = None
    ) -> tuple[State, Array, Indices]:
        """Take in many samples: the same as `step` on one after the other, bit for bit.

        Parameters
        ----------
        state : State
        u, y : (n_samples, n_inputs) and (n_samples, n_outputs) arrays
        intervals : (n_samples,) array, optional
            Time since the sample before, where it is not ``dt`` [s].

        Returns
        -------
        state : State
        innovations : (n_samples, n_outputs) array
        flags : (n_samples,) int array
            As numbers (`online.Flag`).
        """
        u, y = (np.ascontiguousarray(asked.as_table(one), dtype=np.float64) for one in (u, y))
        asked.check_state(state)
        setting = state.stage.setting
        check_owner(self, state.stage.method)
        if u.shape[1] != setting.n_inputs or y.shape[1] != setting.n_outputs or len(u) != len(y):
            raise ChannelCountError(
                f"found samples of shape {u.shape} and {y.shape}; expected "
                f"(n_samples, {setting.n_inputs}) and (n_samples, {setting.n_outputs}); give one "
                "row a sample"
            )
        innovations = np.full(y.shape, np.nan)
        flags = np.zeros(len(y), dtype=np.int64)
        if intervals is not None:
            return self._feed_unevenly(state, u, y, intervals, innovations, flags)
        run = self.kernels().run
        k = 0
        x = state.values.copy()
        while k < len(y):
            stage = state.stage
            k = run(
                stage.blueprint.ints, stage.blueprint.constants, x, u, y, k, len(y), innovations,
                flags,
            )  # fmt: skip
            state = State(x, stage)
            if x[slots.EVENT]:
                state = self._settle(state)
                x = state.values.copy() if k < len(y) else state.values
        return state, innovations, flags

    def _feed_unevenly(
        self, state: State, u: Array, y: Array, intervals: Array, innovations: Array, flags: Indices
    ) -> tuple[State, Array, Indices]:
        """Sample by sample; the matrices of many intervals are made together."""
        m = u.shape[1]
        at, end = slots.INBOX, slots.INBOX + m + y.shape[1]
        made: tuple[Blueprint, int, Array] | None = None
        for k, interval in enumerate(intervals.tolist()):
            stage = state.stage
            regular, seconds = asked.checked_interval(state, interval)
            constants = stage.blueprint.constants
            if not regular:
                if made is None or made[0] is not stage.blueprint or k >= made[1] + len(made[2]):
                    ahead = asked.bounded_intervals(intervals[k : k + BATCH], stage.setting.dt)
                    found = self.constants_for(stage.blueprint, stage.setting, ahead)
                    made = stage.blueprint, k, found
                constants = made[2][k - made[1]]
            x = state.values.copy()
            x[at : at + m], x[at + m : end] = u[k], y[k]
            self.kernels().step(stage.blueprint.ints, constants, x, seconds)
            state = State(x, stage)
            innovations[k] = state.innovations
            flags[k] = int(x[slots.FLAGS])
            if x[slots.EVENT]:
                state = self._settle(state)
        return state, innovations, flags

    def _settle(self, state: State) -> State:
        """What an event asks for; the values of ``state`` are its own."""
        x, stage = state
        event = int(x[slots.EVENT])
        x[slots.EVENT] = 0.0
        if event & slots.CHUNK_FULL:
            ints = stage.blueprint.ints
            width = stage.setting.n_inputs + stage.setting.n_outputs + 1
            at = int(ints[slots.AT_CHUNK])
            chunk = x[at : at + int(x[slots.FILLED]) * width].reshape(-1, width).copy()
            x[slots.FILLED] = 0.0
            state = self.full(State(x, stage.but(past=(*stage.past, chunk))))
        try:
            if event & slots.ALARMED:
                state = self.alarmed(state)
            due = state.values[slots.TICK] == state.values[slots.COUNT]
            return self.tick(state) if event & slots.TICKED and due else state
        except TridentifyError:
            raise
        except (ArithmeticError, ValueError) as error:
            raise ScaleError(
                f"found numbers out of the range of a float after {state.n_samples} samples "
                f"({shown(str(error), 80)}); expected products of samples within it; begin anew, "
                "with channels in other units if it comes again"
            ) from error

    # ------------------------------------------------------------------------------- as a value
    def to_dict(self) -> dict[str, Any]:
        """Name and options, ready for JSON."""
        options: dict[str, Any] = {}
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if isinstance(value, TransferFunction):
                value = {"transfer_function": value.to_dict()}
            elif isinstance(value, Mapping):
                value = {"mapping": dict(value)}
            elif isinstance(value, tuple):
                value = list(value)
            options[field.name] = value
        return {"name": self.name, "options": options}


def check_asked(method: Estimator, state: object) -> None:
    """Refuse to estimate from what is no state of this estimator, or has no room in a float.

    Raises
    ------
    OptionError
    NotReadyError
        The samples so far are too small to be squared.
    """
    asked.check_state(state)
    assert isinstance(state, State)
    check_owner(method, state.method)
    least = smallest_channel(state.stage.blueprint, state.values)
    if least < slots.SMALLEST:
        raise asked.NotReadyError(
            f"found a channel of at most {least:.0e} so far; expected samples of "
            f"{slots.SMALLEST:.0e} to {slots.LARGEST:.0e}; choose another unit"
        )


def check_owner(method: Estimator, owner: object) -> None:
    """Refuse a state that another estimator made.

    Raises
    ------
    OptionError
    """
    if not isinstance(owner, Estimator) or method.to_dict() != owner.to_dict():
        raise OptionError(
            f"found a state of {shown(owner)} in {shown(method)}; expected one that this "
            "estimator made; go on with state.method"
        )


def kept_samples(state: State) -> Array:
    """(n, n_inputs + n_outputs + 1) the samples that are kept: interval, inputs, outputs."""
    x, stage = state
    ints = stage.blueprint.ints
    width = stage.setting.n_inputs + stage.setting.n_outputs + 1
    if not ints[slots.CHUNK]:
        return np.vstack([*stage.past, np.zeros((0, width))])
    at = int(ints[slots.AT_CHUNK])
    newest = x[at : at + int(x[slots.FILLED]) * width].reshape(-1, width)
    return np.vstack([*stage.past, newest])
