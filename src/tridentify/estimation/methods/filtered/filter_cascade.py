"""The filter ``1 / c`` of the equation error: what may be given for it, and what is kept of it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from tridentify.errors import OptionError, ScaleError, shown
from tridentify.models.regression import Experiment
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import (
    Cascade,
    DegreeBasis,
    cascade,
    degree_basis,
    denominator,
    numerators,
    sort_poles,
)
from tridentify.record.checks.scales import LARGEST_COEFFICIENT, check_filter


def checked_filter(filter: Sequence[float] | None) -> tuple[float, ...] | None:
    """Coefficients of a stable ``c(p)``, made monic; None stays None.

    Raises
    ------
    OptionError
        Not a list of finite numbers, or roots that are not in the open left half plane.
    """
    if filter is None:
        return None
    try:
        c = np.asarray(filter, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        c = np.zeros(0)
    if not (c.ndim == 1 and c.size > 1 and np.all(np.isfinite(c)) and c[0]):
        raise OptionError(
            f"found filter={filter!r}; expected the coefficients of c(p), descending powers; "
            "correct them, or leave filter out"
        )
    monic = monic_filter(c)
    if np.any(np.roots(monic).real >= 0):
        raise OptionError(
            f"found an unstable filter {tuple(filter)!r}; expected roots with negative real parts; "
            "correct the coefficients, or leave filter out"
        )
    return tuple(monic.tolist())


def monic_filter(c: Array) -> Array:
    """Coefficients of a filter, divided by the first.

    Raises
    ------
    ScaleError
        If the squares of the others then are no numbers.
    """
    with np.errstate(over="ignore", under="ignore"):
        monic = np.asarray(c / c[0])
    sizes = np.abs(monic[monic != 0])
    if not (sizes.max() <= LARGEST_COEFFICIENT and sizes.min() >= 1.0 / LARGEST_COEFFICIENT):
        raise ScaleError(
            f"found filter={shown(c.tolist())}; expected coefficients within a factor of "
            f"{LARGEST_COEFFICIENT:.0e} of the first, whose squares are numbers; choose rates that "
            "a record can show, or leave filter out"
        )
    return monic


def check_rates(poles: Complex, what: str, experiments: Sequence[Experiment]) -> None:
    """Refuse a filter whose rates have nothing to do with the records.

    Raises
    ------
    ScaleError
    """
    shortest, longest = min(e.dt for e in experiments), max(e.duration for e in experiments)
    check_filter(poles, what, shortest, longest)


class Filter(Cascade):
    """The cascade of ``1 / c`` that keeps what is asked of it again and again."""

    @classmethod
    def of(cls, c: Cascade) -> Filter:
        """The filter of a cascade; itself if it is one."""
        return c if isinstance(c, cls) else cls(*c)

    @cached_property
    def basis(self) -> DegreeBasis:
        """Its functions sorted by degree."""
        return degree_basis(self)

    @cached_property
    def proper(self) -> Array:
        """(q, q) coefficients of the numerators of ``basis``, descending powers."""
        return np.asarray(self.basis.rows @ numerators(self.poles))

    @cached_property
    def monic(self) -> Array:
        """(q + 1,) coefficients of ``c``."""
        return denominator(self.poles)


def filter_cascade(filter: Sequence[float], n_poles: int) -> Filter:
    """The filter with given coefficients.

    Raises
    ------
    OptionError
        If the degree of ``c`` is below the number of poles.
    """
    if len(filter) - 1 < n_poles:
        raise OptionError(
            f"found a filter of degree {len(filter) - 1} for {n_poles} poles; expected at least "
            "that many roots; add roots to c(p), or leave filter out"
        )
    roots = np.roots(np.asarray(filter)).astype(np.complex128)
    return Filter.of(cascade(sort_poles(roots)))
