"""What a search comes upon: starts and where they led, ends, and what is handed on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tridentify.estimation.answer.estimate import Pass, Start
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Recorder
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.thresholds import EQUAL
from tridentify.estimation.search.one_mode_moved import Move
from tridentify.models.regression import Regression
from tridentify.numerics.arrays import Complex

ALIKE = 0.02
"""Relative difference of poles within which the window's end has been followed on the whole record
already."""


@dataclass(frozen=True, eq=False)
class SearchEnd:
    """Where a search ended: the point, the nuisance terms it was made with, and the verdict.

    ``settled`` says that a richer parallel model had nothing to add; ``reachable`` is the AICc
    to be met.
    """

    base: Problem
    point: Point
    variant: Variant
    reachable: float
    settled: bool


@dataclass(frozen=True, eq=False)
class KnownTriangles:
    """Triangles of the whole record at poles, for whoever begins there, and if it ends there too.

    ``white`` says that the residual there passed for white noise; ``point`` is the fit there, in
    place of ``whole``.
    """

    poles: Complex
    whole: tuple[Regression, ...] = ()
    white: bool = False
    point: Point | None = None


@dataclass(frozen=True, eq=False)
class End:
    """Where the poles of a window led on the whole record.

    ``alone`` says that there is one choice of nuisance terms, and that it was finished.
    """

    near: Complex
    poles: Complex
    point: Point
    whole: tuple[Regression, ...]
    alone: bool
    passes: tuple[Pass, ...]


@dataclass(frozen=True, eq=False)
class Scan:
    """The last places looked at, and for what."""

    base: Problem
    variant: Variant
    poles: Complex
    moves: list[Move]


@dataclass(frozen=True, eq=False)
class Far:
    """Where the search of an averaged record led.

    It knows nothing of the noise between its samples: whitened ones need not be searched again.

    ``settled`` says that the window had nothing left to be found, and one start was followed.
    """

    settled: bool
    point: Point
    passes: tuple[Pass, ...]
    scan: Scan | None


@dataclass(frozen=True, eq=False)
class Starts:
    """What a search found: where to finish from, and what was seen on the way.

    Attributes
    ----------
    seeds : tuple of (n,) complex arrays
        Poles to finish from.
    trails : tuple of Recorder
        The passes that led to each seed.
    tried : tuple of Start
        All starts with the cost they led to.
    count : int
        Most starts of a kind that were followed.
    known : KnownTriangles, optional
        Triangles of the whole record, where they were made.
    scan : Scan, optional
        The last places looked at.
    far : Far, optional
        What an averaged record gave.
    near : (n,) complex array, optional
        Poles that the record may well have.
    """

    seeds: tuple[Complex, ...]
    trails: tuple[Recorder, ...]
    tried: tuple[Start, ...]
    count: int
    known: KnownTriangles | None = None
    scan: Scan | None = None
    far: Far | None = None
    near: Complex | None = None

    @property
    def triangles(self) -> dict[bytes, tuple[Regression, ...]]:
        """Triangles of the whole record that exist already, by the bytes of the seed."""
        known = self.known
        if known is None:
            return {}
        whole = known.whole if known.point is None else known.point.triangles.whole
        return {known.poles.tobytes(): whole}

    @property
    def reached(self) -> Point | None:
        """Where the search ended, if that was a fit to all samples."""
        return None if self.known is None else self.known.point

    def saw_white(self, point: Point) -> bool:
        """Whether the search saw that the residual of this very point passes for white noise."""
        known = self.known
        return known is not None and known.white and np.array_equal(known.poles, point.poles)

    def beside(self, poles: Complex) -> Starts:
        """With poles from elsewhere, if there are any, as another seed."""
        return (
            self
            if not poles.size
            else replace(self, seeds=(*self.seeds, poles), trails=(*self.trails, Recorder()))
        )


class Met(NamedTuple):
    """An end of steps on the cost of one problem and choice of nuisance terms."""

    base: Problem
    variant: Variant
    point: Point

    def is_near(self, other: Point) -> bool:
        """Whether another point is on its way to the same end."""
        above = other.objective - self.point.objective
        return bool(0.0 <= above < EQUAL) and np.allclose(
            other.poles, self.point.poles, rtol=ALIKE, atol=0.0
        )


class Followed(NamedTuple):
    """A start, and where it led."""

    base: Problem
    variant: Variant
    start: Complex
    point: Point
    recorder: Recorder

    def is_of(self, base: Problem, variant: Variant, start: Complex) -> bool:
        """Whether the same start of the same problem is followed."""
        same = self.base is base and self.variant is variant
        return same and np.array_equal(self.start, start)
