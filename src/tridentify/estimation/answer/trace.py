"""How an estimate was reached: the passes, their steps, the starts tried, and how it ended.

One pass goes through the steps of the strategy (parallel, series-parallel, series model) or one
step on the output error. The records here are values for people, plots and reports to read.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from tridentify.estimation.answer.decision import DecisionKind, Decisions, KnownDecision
from tridentify.numerics.arrays import Array
from tridentify.numerics.kept import cached_property


def freeze_arrays(noun: object) -> None:
    """Replace each field annotated ``Array`` of a frozen dataclass by a read-only float64 copy."""
    for name in _array_fields(type(noun)):  # type: ignore[arg-type]
        array = np.array(getattr(noun, name), dtype=np.float64)
        array.setflags(write=False)
        object.__setattr__(noun, name, array)


@cache
def _array_fields(kind: type) -> tuple[str, ...]:
    return tuple(one.name for one in dataclasses.fields(kind) if one.type == "Array")


def pairs(poles: npt.ArrayLike) -> Array:
    """Poles as rows of real and imaginary part; rows are kept.

    Examples
    --------
    >>> pairs([-1 + 2j]).tolist(), pairs([[-1.0, 2.0]]).tolist(), pairs([]).shape
    ([[-1.0, 2.0]], [[-1.0, 2.0]], (0, 2))
    """
    given = np.asarray(poles)
    if np.iscomplexobj(given):
        given = np.column_stack([given.real, given.imag])
    return np.asarray(given, dtype=np.float64).reshape(-1, 2)


class Status(enum.Enum):
    """How an estimation ended; each member carries a message, a remedy and whether it is usable.

    Examples
    --------
    >>> Status.MAX_PASSES.ok, Status.CONVERGED.ok
    (False, True)
    >>> Status.MAX_PASSES.remedy
    'allow more passes, or try fewer poles or zeros'
    """

    CONVERGED = "converged"
    MAX_PASSES = "max passes"
    AT_STABILITY_LIMIT = "at stability limit"
    AT_SAMPLING_LIMIT = "at sampling limit"
    SETTLED = "settled"
    WEAKLY_IDENTIFIABLE = "weakly identifiable"
    STALLED = "stalled"
    POSTERIOR_MEAN = "posterior mean"

    @property
    def message(self) -> str:
        """What happened, in one line."""
        return _STATUS[self][0]

    @property
    def remedy(self) -> str:
        """What to do about it; empty when nothing needs doing."""
        return _STATUS[self][1]

    @property
    def ok(self) -> bool:
        """Whether the coefficients are usable (with the caution that `message` states)."""
        return self not in (Status.MAX_PASSES, Status.STALLED, Status.AT_SAMPLING_LIMIT)


_STATUS = {
    Status.CONVERGED: ("converged to a stationary point of the output-error cost", ""),
    Status.MAX_PASSES: (
        "the passes ran out before the coefficients stopped moving",
        "allow more passes, or try fewer poles or zeros",
    ),
    Status.AT_STABILITY_LIMIT: (
        "converged, but a pole lies at the limit of stability",
        "look for a drift or an integration in the record; allow a drift, or use fewer poles",
    ),
    Status.SETTLED: (
        "the method's own equations are solved, but not those of the least output error",
        "use ThreeModel(), or OutputError() from this model, which end on a checked minimum",
    ),
    Status.AT_SAMPLING_LIMIT: (
        "converged, but a pole is faster than the sampling can show",
        "use fewer poles, or sample faster",
    ),
    Status.WEAKLY_IDENTIFIABLE: (
        "converged, but the record hardly determines some of the coefficients",
        "record longer, excite nearer to the natural frequency, or use fewer poles or zeros",
    ),
    Status.POSTERIOR_MEAN: (
        "the mean of all models that explain the record, not the one that explains it best",
        "record longer, excite nearer to the natural frequency, or use fewer poles or zeros, to "
        "narrow the intervals",
    ),
    Status.STALLED: (
        "no step lowers the output-error cost any further, yet its gradient is not zero",
        "rescale the record, try another starting model, or use fewer poles or zeros",
    ),
}


@dataclasses.dataclass(frozen=True, eq=False)
class Step:
    """One step: "parallel", "series-parallel", "series", "output error" or "posterior".

    ``coefficients`` are the weights ``beta`` of a parallel model (output by output, input by
    input), those of a series model (output by output, ``W_0 = 1`` first), else the coefficients of
    the model found, or of its denominators alone. ``kind`` names the operators ("allpass",
    "laguerre" or "orthonormal"), and row k of ``poles`` holds real and imaginary part [rad/s] of
    the pole that operator k adds, or of a pole of the filter ``c(p)`` of a series-parallel model;
    empty where the step has none, or did not say.
    """

    name: str
    coefficients: Array
    cost: float
    condition: float
    note: str = ""
    kind: str = ""
    poles: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "poles", pairs(self.poles))
        freeze_arrays(self)


@dataclasses.dataclass(frozen=True, eq=False)
class Pass:
    """One pass over the steps: ``theta`` after it, and how far it is from settled.

    ``cost`` is the weighted mean-square output error, ``beta_distance`` the largest
    ``|beta - (1, 0, ..., 0)|`` of the series model, ``gradient`` the share of the residual that
    lies along the score directions; the latter two are ``nan`` where not computed.
    """

    number: int
    steps: tuple[Step, ...]
    theta: Array
    cost: float
    beta_distance: float = math.nan
    gradient: float = math.nan
    note: str = ""

    def __post_init__(self) -> None:
        freeze_arrays(self)


@dataclasses.dataclass(frozen=True, eq=False)
class Start:
    """A starting point that was tried, with its output-error cost."""

    name: str
    theta: Array
    cost: float

    def __post_init__(self) -> None:
        freeze_arrays(self)


class Awaited(Sequence[Pass]):
    """Passes that are worked out when they are asked for, as few are ever told.

    Parameters
    ----------
    make : callable
        Gives them.

    Examples
    --------
    >>> awaited = Awaited(lambda: (Pass(1, (), np.array([1.0, 3.0]), cost=0.2),))
    >>> len(awaited), awaited[-1].number
    (1, 1)
    """

    def __init__(self, make: Callable[[], tuple[Pass, ...]]) -> None:
        self._make = make

    @cached_property
    def made(self) -> tuple[Pass, ...]:
        """As they are."""
        found = self._make()
        # what they were made of is let go
        self._make = lambda: found
        return found

    def __len__(self) -> int:
        return len(self.made)

    def __getitem__(self, place: Any) -> Any:
        return self.made[place]

    def __reduce__(self) -> tuple[Any, ...]:
        return tuple, (self.made,)


@dataclasses.dataclass(frozen=True, eq=False)
class Trace:
    """The way to an estimate: passes, starts tried, decisions taken, and why it stopped.

    Examples
    --------
    >>> trace = Trace((Pass(1, (), np.array([1.0, 3.0]), cost=0.2),), stopped="one pass")
    >>> trace.passes[-1].cost, trace.stopped
    (0.2, 'one pass')
    """

    passes: Sequence[Pass]
    starts: tuple[Start, ...] = ()
    decisions: Decisions = ()
    stopped: str = ""

    def told(self, *words: str) -> Trace:
        """The same way with further decisions.

        Parameters
        ----------
        *words : str
            One a decision.

        Examples
        --------
        >>> Trace((), decisions=("offset",)).told("no drift").decisions
        ('offset', 'no drift')
        """
        if not words:
            return self
        return dataclasses.replace(self, decisions=(*self.decisions, *words))

    def about(self, *kinds: DecisionKind) -> tuple[KnownDecision, ...]:
        """The decisions of some kinds.

        Parameters
        ----------
        *kinds : DecisionKind

        Examples
        --------
        >>> Trace((), decisions=(DecisionKind.NOISE_WHITE.told(),)).about(DecisionKind.NOISE_WHITE)
        ('noise white',)
        """
        known = (one for one in self.decisions if isinstance(one, KnownDecision))
        return tuple(one for one in known if one.kind in kinds)
