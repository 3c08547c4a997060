"""Where things stand in the vector of an on-line estimator, and the matrices of its sample loop."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.discretize import Discrete, discretize
from tridentify.numerics.realization import Cascade, cascade
from tridentify.numerics.sampled import split_delay
from tridentify.online.kernels import slots
from tridentify.online.kernels.slots import scatter_size, triangle_size
from tridentify.online.task import Task
from tridentify.structure import Structure

CHUNK = 64
"""Samples that are kept for one fold into a triangle: blocks of QR are quicker than rotations, and
the memory stays small."""
NEARLY_ZERO = 1e-30
"""Share of the bank's input that a start in place of zero gets, where an empty column would be no
direction."""


@dataclass(frozen=True)
class Setting:
    """What an estimator was told at the beginning.

    Attributes
    ----------
    structure : Structure
    dt : float
        Sampling interval [s].
    input_names, output_names : tuple of str
    units : tuple of (str, str)
        Channel and unit.
    intersample : str
        ``"zoh"`` or ``"foh"``.
    """

    structure: Structure
    dt: float
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    units: tuple[tuple[str, str], ...]
    intersample: str

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return len(self.input_names)

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.output_names)

    @property
    def n_poles(self) -> int:
        """Degree of the denominator."""
        return self.structure.common_poles

    @cached_property
    def zeros(self) -> tuple[tuple[int, ...], ...]:
        """Degrees of the numerators, ``[output][input]``."""
        return self.structure.zeros_matrix(self.n_outputs, self.n_inputs)

    @cached_property
    def delays(self) -> tuple[float, ...]:
        """Of each input [s]."""
        return self.structure.delay_matrix(self.n_outputs, self.n_inputs)[0]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the coefficients."""
        return self.structure.names(self.input_names, self.output_names)

    @property
    def n_directions(self) -> int:
        """Ways for an output to move: its coefficients, and a constant."""
        return self.n_poles + max(sum(row) for row in self.zeros) + self.n_inputs + 1

    @property
    def late(self) -> int:
        """Samples after which every input that acts is one that was seen."""
        return max(whole + (part > 0) for whole, part in self.shifts)

    @cached_property
    def shifts(self) -> tuple[tuple[int, float], ...]:
        """Of each input the delay in whole samples and a part of one."""
        return tuple(split_delay(delay, self.dt) for delay in self.delays)


class NuisanceColumns(NamedTuple):
    """Which columns stand behind those of the inputs."""

    free: bool
    offset: bool
    drift: bool

    @classmethod
    def of(cls, structure: Structure, restarted: bool) -> NuisanceColumns:
        """All that a structure leaves open; an estimator that starts anew starts from any state."""
        state = structure.initial_state
        return cls(
            restarted or state in ("free", "auto"),
            bool(structure.offset) or state == "equilibrium",
            bool(structure.drift),
        )


@dataclass(frozen=True, eq=False)
class Blueprint:
    """The plan of the vector ``x`` of an estimator, and the constants of its kernel.

    Attributes
    ----------
    ints : (N_INTS,) int array
    constants : array
        ``c`` of the kernels at the sampling interval.
    size : int
        Length of ``x``.
    poles : (q,) complex array
        Of the bank; empty while samples are only collected.
    nuisance : NuisanceColumns
    """

    ints: Indices
    constants: Array
    size: int
    poles: Complex
    nuisance: NuisanceColumns

    @cached_property
    def bank(self) -> Cascade:
        """The bank of operators."""
        return cascade(self.poles)

    @property
    def n_columns(self) -> int:
        """Width of a row."""
        return int(self.ints[slots.COLUMNS])


DOUBTS = ("unmodelled-response", "nonlinear")  # codes


class Doubt(NamedTuple):
    """What the inputs explain of the samples that a model left, when these were last all there.

    Attributes
    ----------
    code : str
        Of the finding, one of `DOUBTS`.
    share : float
        Of what the model left.
    """

    code: str
    share: float


@dataclass(frozen=True, eq=False)
class Stage:
    """What holds between two events of an estimator.

    Attributes
    ----------
    method : Estimator
    setting : Setting
    blueprint : Blueprint
    poles : (n,) complex array
        Of the model, as last solved for; empty before the first time.
    past : tuple of (k, n_inputs + n_outputs + 1) arrays
        Samples that are kept: interval, inputs, outputs.
    changes : tuple of int
        Samples at which the coefficients were found to have moved.
    searching : bool
        Whether a model is still looked for.
    extra : tuple of arrays
        What else a method keeps.
    task : Task, optional
        Work that is under way; not saved, as the other numbers say how to do it again.
    doubt : Doubt, optional
        What speaks against the model in samples that are gone.
    """

    method: Any
    setting: Setting
    blueprint: Blueprint
    poles: Complex
    past: tuple[Array, ...] = ()
    changes: tuple[int, ...] = ()
    searching: bool = True
    extra: tuple[Array, ...] = ()
    task: Task | None = None
    doubt: Doubt | None = None

    def but(self, **changes: Any) -> Stage:
        """A copy with other values."""
        return replace(self, **changes)


class Places:
    """Hands out places one after the other."""

    def __init__(self, at: int) -> None:
        self.at = at

    def take(self, count: int) -> int:
        """Places for ``count`` numbers."""
        at = self.at
        self.at += count
        return at


def collecting(setting: Setting) -> Blueprint:
    """Only the samples are kept."""
    nothing = np.zeros(0, dtype=np.complex128)
    return parallel(setting, nothing, NuisanceColumns(False, False, False), True)


def parallel(
    setting: Setting,
    poles: Complex,
    nuisance: NuisanceColumns,
    keep: bool,
    forgetting: float = 1.0,
    kind: int = 0,
) -> Blueprint:
    """Step 1 on a bank; without poles only the samples are kept.

    Parameters
    ----------
    setting : Setting
    poles : (q,) complex array
        Of the bank.
    nuisance : NuisanceColumns
    keep : bool
        Whether the samples are still kept.
    forgetting : float
    kind : int
        Of forgetting, as in `online.kernels.parallel`.
    """
    m, p, q = setting.n_inputs, setting.n_outputs, poles.size
    columns = q * (m + nuisance.free) + m + nuisance.offset + nuisance.drift if q else 0
    directions = setting.n_directions if q else 0
    ints, plan, constants = places_of(
        setting, poles, nuisance, columns, directions, CHUNK if keep else 0, kind
    )
    ints[slots.DRIFT] = nuisance.drift
    ints[slots.DIRECTIONS_STRIDE] = directions * columns
    ints[slots.COLLECTING] = q == 0
    ints[slots.FACTOR] = triangle_size(columns)
    ints[slots.AT_FACTOR] = plan.take(p * int(ints[slots.FACTOR]))
    ints[slots.C_MAPS] = constants.take(p * directions * columns)
    c = filled(constants.at, ints, setting, poles, forgetting)
    return Blueprint(ints, c, plan.at, poles, nuisance)


def places_of(
    setting: Setting,
    poles: Complex,
    nuisance: NuisanceColumns,
    columns: int,
    directions: int,
    chunk: int,
    kind: int,
) -> tuple[Indices, Places, Places]:
    """``ints`` of what all estimators have, and where the vector and the constants go on.

    Parameters
    ----------
    setting : Setting
    poles : (q,) complex array
        Of the bank.
    nuisance : NuisanceColumns
    columns : int
        Width of a row.
    directions : int
        That the watch follows.
    chunk : int
        Samples for which there is room.
    kind : int
        Of forgetting.
    """
    m, p, q = setting.n_inputs, setting.n_outputs, poles.size
    ints = np.zeros(slots.N_INTS, dtype=np.int64)
    ints[slots.INPUTS], ints[slots.OUTPUTS] = m, p
    ints[slots.ORDER], ints[slots.COLUMNS] = q, columns
    ints[slots.FREE], ints[slots.OFFSET], ints[slots.KIND] = (*nuisance[:2], kind)
    ints[slots.BEGIN] = setting.late if nuisance.free else 0
    ints[slots.UPPER] = int(np.any(poles.imag != 0))
    ints[slots.DIRECTIONS], ints[slots.BLOCK] = directions, max(20, 4 * directions)
    ints[slots.ALERT] = slots.LEVEL_OF_DOUBT
    ints[slots.EQUILIBRIUM] = setting.structure.initial_state == "equilibrium"
    ints[slots.CHUNK] = chunk
    plan = Places(slots.INBOX + m + p)
    ints[slots.LINE] = max(whole for whole, _ in setting.shifts) + 3
    ints[slots.AT_LINE] = plan.take(m * int(ints[slots.LINE]))
    ints[slots.AT_REFERENCE] = plan.take(m)
    ints[slots.AT_FIRST_INPUT] = plan.take(m)
    ints[slots.AT_LARGEST] = plan.take(2 * (m + p))
    ints[slots.AT_CHUNK] = plan.take(chunk * (m + p + 1))
    judged = directions + directions * (directions + 1) // 2 + slots.SUMS
    ints[slots.WATCH] = slots.SCORES + 2 * directions + slots.SCALES * judged
    ints[slots.AT_WATCH] = plan.take(p * int(ints[slots.WATCH]))
    ints[slots.SCATTER] = scatter_size(directions) if directions else 0
    ints[slots.AT_SCATTER] = plan.take(p * int(ints[slots.SCATTER]))
    ints[slots.AT_ROW] = plan.take(columns)
    ints[slots.AT_WORK] = plan.take(max(columns, q))
    constants = Places(slots.CONSTANTS)
    ints[slots.C_STEP] = constants.take(q * q)
    ints[slots.C_TAPS] = constants.take(3 * m * q)
    ints[slots.C_DIRECT] = constants.take(2 * m)
    ints[slots.C_START] = constants.take(1 + q)
    ints[slots.C_EXTRA] = constants.take(m)
    return ints, plan, constants


def filled(size: int, ints: Indices, setting: Setting, poles: Complex, forgetting: float) -> Array:
    """(size,) constants with those that all estimators have."""
    c = np.zeros(size)
    c[slots.INTERVAL], c[slots.FORGETTING] = setting.dt, forgetting
    c[slots.PACE] = min(1.0, max(5.0 * (1.0 - forgetting), 1e-3))
    for j, (whole, _) in enumerate(setting.shifts):
        c[ints[slots.C_EXTRA] + j] = whole
    if poles.size:
        bank, at = cascade(poles), int(ints[slots.C_START])
        c[at] = NEARLY_ZERO * np.abs(bank.b).max()
        c[at + 1 : at + 1 + poles.size] = bank.b
        fill_inputs(c, ints, setting, bank, setting.dt)
    return c


def constants_for(blueprint: Blueprint, setting: Setting, intervals: Array) -> Array:
    """(k, ...) ``c`` for samples that come after other intervals [s]; no delays."""
    c = np.tile(blueprint.constants, (intervals.size, 1))
    if blueprint.poles.size:
        ints, bank, m = blueprint.ints, blueprint.bank, setting.n_inputs
        found = discretize_each(bank, intervals, setting.intersample)
        q, k = bank.order, intervals.size
        at = int(ints[slots.C_STEP])
        c[:, at : at + q * q] = found.transition.reshape(k, -1)
        taps = np.zeros((k, m, 3, q))
        taps[:, :, 0], taps[:, :, 1] = found.from_next[:, None], found.from_current[:, None]
        at = int(ints[slots.C_TAPS])
        c[:, at : at + 3 * m * q] = taps.reshape(k, -1)
    return c


def discretize_each(bank: Cascade, intervals: Array, intersample: str) -> Discrete:
    """(k, q, q), (k, q), (k, q): exact equivalents for many intervals [s] at once."""
    a = bank.a * intervals[:, None, None]
    b = bank.b[None, :, None] * intervals[:, None, None]
    found = discretize(a, b, 1.0, intersample)
    return Discrete(found.transition, found.from_current[..., 0], found.from_next[..., 0])


def fill_inputs(c: Array, ints: Indices, setting: Setting, bank: Cascade, interval: float) -> None:
    """Transition and taps of a bank for an interval between two samples [s]."""
    q, foh = bank.order, setting.intersample == "foh"
    b = bank.b[:, None]
    whole = discretize(bank.a, b, interval, setting.intersample)
    at = int(ints[slots.C_STEP])
    c[at : at + q * q] = whole.transition.ravel()
    for j, (_, part) in enumerate(setting.shifts):
        taps = np.zeros((3, q))
        if not part:
            taps[0], taps[1] = whole.from_next[:, 0], whole.from_current[:, 0]
        else:
            one = discretize(bank.a, b, part * interval, setting.intersample)
            two = discretize(bank.a, b, (1.0 - part) * interval, setting.intersample)
            if foh:
                # a line from w(k-2) to w(k-1), cut at its last part, then one from w(k-1) to w(k)
                taps[2] = part * (two.transition @ one.from_current)[:, 0]
                middle = two.transition @ ((1.0 - part) * one.from_current + one.from_next)
                taps[1] = (middle + two.from_current + part * two.from_next)[:, 0]
                taps[0] = (1.0 - part) * two.from_next[:, 0]
            else:
                taps[2] = (two.transition @ one.from_current)[:, 0]
                taps[1] = two.from_current[:, 0]
        at = int(ints[slots.C_TAPS]) + 3 * j * q
        c[at : at + 3 * q] = taps.ravel()
        at = int(ints[slots.C_DIRECT]) + 2 * j
        c[at : at + 2] = (1.0 - part, part) if foh else (float(not part), float(part > 0))


def fresh(blueprint: Blueprint) -> Array:
    """The vector before the first sample."""
    x = np.zeros(blueprint.size)
    ints = blueprint.ints
    for i in range(int(ints[slots.OUTPUTS])):
        w = int(ints[slots.AT_WATCH] + i * ints[slots.WATCH])
        x[w + slots.HIGHEST], x[w + slots.LOWEST] = -np.inf, np.inf
        x[w + slots.INNOVATION] = np.nan
    return x


def with_directions(blueprint: Blueprint, directions: Array) -> Blueprint:
    """The same with the sensitivities that the watch follows.

    Parameters
    ----------
    blueprint : Blueprint
    directions : (n_outputs, n_directions, n_columns) array
        Each a combination of the columns.
    """
    c = blueprint.constants.copy()
    at = int(blueprint.ints[slots.C_MAPS])
    c[at : at + directions.size] = directions.ravel()
    return replace(blueprint, constants=c)


def smallest_channel(blueprint: Blueprint, x: Array) -> float:
    """The largest sample so far of the channel where that is smallest, but for those at zero."""
    at = int(blueprint.ints[slots.AT_LARGEST])
    channels = int(blueprint.ints[slots.INPUTS] + blueprint.ints[slots.OUTPUTS])
    sizes = x[at : at + 2 * channels : 2]
    return float(np.min(sizes, where=sizes > 0.0, initial=np.inf))


def watch_of(blueprint: Blueprint, output: int) -> int:
    """Where the watch of an output begins."""
    return int(blueprint.ints[slots.AT_WATCH] + output * blueprint.ints[slots.WATCH])


def factor_of(blueprint: Blueprint, output: int) -> int:
    """Where the triangle of an output begins."""
    return int(blueprint.ints[slots.AT_FACTOR] + output * blueprint.ints[slots.FACTOR])
