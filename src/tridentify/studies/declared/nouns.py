"""What a file declares: systems, inputs, noises, methods, and which of them meet.

The cells of a study, and who takes part in each.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from tridentify.errors import OptionError, TridentifyError
from tridentify.numerics.arrays import Array
from tridentify.transfer_function import TransferFunction

Options = tuple[tuple[str, Any], ...]
"""Names and values, hashable."""


class Offered(NamedTuple):
    """Names of options that a kind takes, and of those that it cannot do without."""

    names: tuple[str, ...]
    needed: tuple[str, ...] = ()

    @classmethod
    def by(cls, made: Callable[..., Any], *, but: Collection[str] = ()) -> Offered:
        """Those of a function or a class, but for some.

        Examples
        --------
        >>> Offered.by(TransferFunction.channel, but=("self",)).needed
        ('output', 'source')
        """
        found = [p for p in inspect.signature(made).parameters.values() if p.name not in but]
        needed = tuple(p.name for p in found if p.default is p.empty)
        return cls(tuple(p.name for p in found), needed)


def refusal(where: str, error: Exception) -> OptionError:
    """What somebody else says of an option, with the place in the file, on one line."""
    told = " ".join(str(error).split())
    if not isinstance(error, TridentifyError):
        told = f"found options that are not taken ({told}); expected other values; correct them"
    return OptionError(f"{where}: {told}")


@dataclass(frozen=True)
class DeclaredSystem:
    """A system with one input and one output, whose coefficients are the truth.

    Attributes
    ----------
    name : str
    num, den : tuple of float
        Descending powers; the denominator begins with one.
    """

    name: str
    num: tuple[float, ...]
    den: tuple[float, ...]

    @property
    def theta(self) -> Array:
        """The truth: ``a_{n-1}, ..., a_0, b_m, ..., b_0``."""
        return np.array([*self.den[1:], *self.num])

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of the coefficients, in the order of `theta`."""
        n, m = len(self.den) - 1, len(self.num)
        return (*(f"a{k}" for k in reversed(range(n))), *(f"b{k}" for k in reversed(range(m))))

    @property
    def corner(self) -> float:
        """Geometric mean of the sizes of the poles [rad/s]."""
        return float(abs(self.den[-1]) ** (1 / (len(self.den) - 1)))

    @property
    def model(self) -> TransferFunction:
        """The truth as a transfer function."""
        return TransferFunction(self.num, self.den)


@dataclass(frozen=True)
class DeclaredInput:
    """An input, held between its samples.

    Attributes
    ----------
    name, kind : str
    dt : float
        Sampling interval [s].
    samples : int or None
        Length of the record: longer signals are cut, shorter ones refused.
    options : tuple of (str, object)
        What else the kind takes.
    """

    name: str
    kind: str
    dt: float
    samples: int | None = None
    options: Options = ()


@dataclass(frozen=True)
class DeclaredNoise:
    """A noise at one level.

    Attributes
    ----------
    name, kind : str
    measure : {"std", "ratio", "snr"}
        In units of the output; over the root mean square of the noise-free output; in dB, of the
        standard deviation of the noise-free output over that of the noise.
    level : float
        In that measure.
    options : tuple of (str, object)
        What else the kind takes.
    """

    name: str
    kind: str
    measure: str
    level: float
    options: Options = ()

    @property
    def none(self) -> bool:
        """Whether there is no noise at all."""
        return self.measure != "snr" and self.level == 0.0


@dataclass(frozen=True)
class DeclaredMethod:
    """A method with its options and what it is told of the record.

    Attributes
    ----------
    name, kind : str
    structure : tuple of (str, object)
        Offset, drift and initial state.
    options : tuple of (str, object)
        Of the method itself.
    """

    name: str
    kind: str
    structure: Options = ()
    options: Options = ()


@dataclass(frozen=True)
class StudyCell:
    """One system under one input with one noise."""

    system: DeclaredSystem
    input: DeclaredInput
    noise: DeclaredNoise

    @property
    def name(self) -> str:
        """By which results know it."""
        return f"{self.system.name} / {self.input.name} / {self.noise.name}"


@dataclass(frozen=True)
class DeclaredGrid:
    """Names of those that meet, every one with every other."""

    systems: tuple[str, ...]
    inputs: tuple[str, ...]
    noises: tuple[str, ...]
    methods: tuple[str, ...]


@dataclass(frozen=True)
class DeclaredStudy:
    """A Monte Carlo study as a file declares it.

    Attributes
    ----------
    name, description : str
    draws : int
        Noise draws a cell; without noise there is one.
    seed : int
        Of all draws.
    systems, inputs, noises, methods : tuple
    grids : tuple of DeclaredGrid
        Which of them meet.
    """

    name: str
    description: str
    draws: int
    seed: int
    systems: tuple[DeclaredSystem, ...]
    inputs: tuple[DeclaredInput, ...]
    noises: tuple[DeclaredNoise, ...]
    methods: tuple[DeclaredMethod, ...]
    grids: tuple[DeclaredGrid, ...]

    def settings(self) -> Mapping[str, Any]:
        """What decides about the numbers of a draw, as JSON holds it.

        How many draws there are does not: the first of a long study are those of a short one. Nor
        does what it is called.
        """
        told = asdict(self)
        for name in ("draws", "description", "name"):
            del told[name]
        return told | {"version": version("tridentify")}


Meeting = tuple[StudyCell, DeclaredMethod]


def meetings(study: DeclaredStudy) -> tuple[Meeting, ...]:
    """Every cell with every method that takes part in it, each pair once.

    Parameters
    ----------
    study : DeclaredStudy

    Returns
    -------
    tuple of (StudyCell, DeclaredMethod)
        Cells in the order in which the grids name them, the methods of a cell together.
    """
    found: dict[StudyCell, dict[DeclaredMethod, None]] = {}
    systems = {one.name: one for one in study.systems}
    inputs = {one.name: one for one in study.inputs}
    noises = {one.name: one for one in study.noises}
    methods = {one.name: one for one in study.methods}
    for grid in study.grids:
        for system in grid.systems:
            for signal in grid.inputs:
                for noise in grid.noises:
                    cell = StudyCell(systems[system], inputs[signal], noises[noise])
                    own = found.setdefault(cell, {})
                    own.update(dict.fromkeys(methods[name] for name in grid.methods))
    return tuple((cell, method) for cell, own in found.items() for method in own)


def cells(study: DeclaredStudy) -> tuple[StudyCell, ...]:
    """Every cell once.

    Parameters
    ----------
    study : DeclaredStudy
    """
    return tuple(dict.fromkeys(cell for cell, _ in meetings(study)))


def draws_of(study: DeclaredStudy, cell: StudyCell) -> int:
    """How many noise draws a cell has: one where there is no noise."""
    return 1 if cell.noise.none else study.draws
