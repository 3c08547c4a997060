"""Checks of the options of a structure, each with its own exception."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from numbers import Integral
from types import MappingProxyType
from typing import Any, TypeVar, cast

import numpy as np

from tridentify.errors import (
    BoundsError,
    ChannelCountError,
    EqualityError,
    OptionError,
    OrderError,
    PriorError,
    StaticGainError,
    StructureError,
    shown,
)
from tridentify.record.checks.scales import LARGEST_KNOWN, check_known

Bounds = tuple[float | None, float | None]
Equality = tuple[Mapping[str, float], float]
Gain = float | tuple[tuple[float | None, ...], ...]
Number = TypeVar("Number", int, float)
Matrix = tuple[tuple[Number, ...], ...]

HIGHEST_ORDER = 200
"""Most poles of a channel: far below, no digit of a coefficient is left in double precision, and
the roots of a polynomial of this degree still take milliseconds."""
HIGHEST_DRIFT = 10
"""Degree of a drift: a polynomial of a higher one follows a response of the record's length."""


def channel_matrix(
    label: str, value: Number | Matrix[Number], n_outputs: int, n_inputs: int
) -> Matrix[Number]:
    """Spread a number over all channels, or check that nested ones fit them."""
    if not isinstance(value, tuple):
        return ((value,) * n_inputs,) * n_outputs
    if (len(value), len(value[0])) != (n_outputs, n_inputs):
        raise ChannelCountError(
            f"found {label} for {len(value)} outputs x {len(value[0])} inputs; expected "
            f"{n_outputs} x {n_inputs}; nest them as {label}[output][input]"
        )
    return value


def _nested(label: str, value: object) -> list[list[object]]:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)) and value:
        rows = [list(row) if isinstance(row, (list, tuple)) else [] for row in value]
        if rows[0] and all(len(row) == len(rows[0]) for row in rows):
            return rows
    raise ChannelCountError(
        f"found {label}={shown(value)}; expected a number or equally long rows "
        f"{label}[output][input]; nest it twice, as [[1, 0]] for one output and two inputs"
    )


def checked_orders(label: str, value: object, lowest: int) -> int | Matrix[int]:
    """Give a whole number from `lowest` to `HIGHEST_ORDER`, or nested ones ``[output][input]``."""

    def order(item: object) -> int:
        try:
            whole = operator.index(item)  # type: ignore[arg-type]
        except TypeError:
            whole = lowest - 1
        if not lowest <= whole <= HIGHEST_ORDER or isinstance(item, (bool, np.bool_)):
            raise OrderError(
                f"found {label}={shown(item)}; expected a whole number of at least {lowest} and at "
                f"most {HIGHEST_ORDER}; correct {label}"
            )
        return whole

    if not isinstance(value, (list, tuple)) and np.ndim(cast(Any, value)) == 0:
        return order(value)
    return tuple(tuple(order(item) for item in row) for row in _nested(label, value))


def is_pair(given: object) -> bool:
    """Whether this is poles and zeros as a tuple or list of two, a number for one at least.

    Examples
    --------
    >>> is_pair((2, 1)), is_pair([2, 1]), is_pair([(1, 0), (2, 1)]), is_pair((2, 1, 0))
    (True, True, False, False)
    """
    if not isinstance(given, list | tuple) or len(given) != 2:
        return False
    return any(isinstance(item, Integral) for item in given)


def checked_delays(value: object) -> float | str | Matrix[float]:
    """Give seconds, nested seconds ``[output][input]``, or "free"."""

    def delay(item: object) -> float:
        number = _number(item)
        if not 0.0 <= number < math.inf:
            raise OptionError.found(
                "delay=", item, "seconds, zero or more, or 'free' to estimate it", "correct delay"
            )
        return number

    if isinstance(value, str) and value == "free":
        return value
    if not isinstance(value, (list, tuple)) and np.ndim(cast(Any, value)) == 0:
        return delay(value)
    return tuple(tuple(delay(item) for item in row) for row in _nested("delay", value))


def checked_choice(label: str, value: object) -> bool | str:
    """Give True, False or "auto"."""
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, str) and value == "auto":
        return value
    raise OptionError(f"found {label}={shown(value)}; expected True, False or 'auto'; choose one")


def checked_drift(value: object) -> bool | int | str:
    """Give True, False, "auto" or the degree of a polynomial in time, from two on."""
    if isinstance(value, (int, np.integer)) and 0 <= value <= HIGHEST_DRIFT:
        return int(value) if value > 1 else bool(value)
    if isinstance(value, str) and value == "auto":
        return value
    raise OptionError(
        f"found drift={shown(value)}; expected True, False, 'auto' or the degree of a polynomial "
        f"in time, up to {HIGHEST_DRIFT}; choose one"
    )


def _number(value: object) -> float:
    if isinstance(value, (str, bytes, bool, np.bool_)):
        return math.nan
    try:
        return float(cast(Any, value))
    except (TypeError, ValueError, OverflowError):
        return math.nan


def _check_mapping(label: str, given: object, wanted: str, example: str) -> None:
    if given is not None and not isinstance(given, Mapping):
        raise BoundsError(
            f"found {label}={shown(given)}; expected a mapping of coefficient to {wanted}; write "
            f"for example {label}={example}"
        )


def checked_fixed(fixed: Mapping[str, float] | None) -> dict[str, float]:
    """Give finite numbers by name."""
    _check_mapping("fixed", fixed, "value", '{"a0": 3.0}')
    values = {str(name): _number(value) for name, value in (fixed or {}).items()}
    for name, value in values.items():
        if not math.isfinite(value):
            raise BoundsError.found(
                f"the fixed value {shown((fixed or {}).get(name))} for ", name, "a finite number"
            )
        _check_size(BoundsError, "the fixed value", name, value, "correct it")
    return values


def _check_size(
    kind: type[StructureError], what: str, name: object, value: float, remedy: str
) -> None:
    wrong = check_known(f"{what} of {shown(name)}" if name else what, value)
    if wrong:
        raise kind(f"found {wrong}; {remedy}, or choose other units")


def checked_bounds(bounds: Mapping[str, Bounds] | None) -> dict[str, Bounds]:
    """Give (low, high) by name, None where there is no limit."""
    _check_mapping("bounds", bounds, "(low, high)", '{"a0": (0.0, None)}')
    pairs: dict[str, Bounds] = {}
    given: Mapping[str, object] = bounds or {}
    for name, pair in given.items():
        limits = tuple(pair) if isinstance(pair, (tuple, list, np.ndarray)) else ()
        low, high = (
            (
                (-math.inf if limits[0] is None else _number(limits[0])),
                (math.inf if limits[1] is None else _number(limits[1])),
            )
            if len(limits) == 2
            else (math.nan, math.nan)
        )
        if not low < high:
            raise BoundsError(
                f"found the bounds {shown(pair)} for {shown(name)}; expected (low, high) with "
                "low < high, None for no limit; correct them"
            )
        for limit in (low, high):
            if math.isfinite(limit):
                _check_size(BoundsError, "a bound", name, limit, "write None for no limit")
        pairs[str(name)] = (None if low == -math.inf else low, None if high == math.inf else high)
    return pairs


def checked_equalities(equalities: Sequence[Equality] | None) -> tuple[Equality, ...]:
    """Give (weights by name, value) pairs of finite numbers; no weight is zero."""
    given: object = equalities if equalities is not None else ()
    if not isinstance(given, (list, tuple)):
        raise _no_equality(given)
    return tuple(_equality(item) for item in given)


def _equality(item: object) -> Equality:
    if not isinstance(item, (list, tuple)) or len(item) != 2 or not isinstance(item[0], Mapping):
        raise _no_equality(item)
    value = _number(item[1])
    weights = {str(name): _number(weight) for name, weight in item[0].items()}
    if not math.isfinite(value) or not all(math.isfinite(w) for w in weights.values()):
        raise _no_equality(item)
    weights = {name: weight for name, weight in weights.items() if weight}
    if not weights:
        raise _no_equality(item)
    sizes = [abs(w) for w in weights.values()]
    largest = max(sizes)
    known = [*sizes, abs(value)] if value else sizes
    if min(known) < largest / LARGEST_KNOWN or abs(value) / LARGEST_KNOWN > largest:
        raise EqualityError(
            f"found the equality {shown(item)} with numbers of {min(known):.3g} to "
            f"{max(known):.3g}; expected numbers within a factor of "
            f"{LARGEST_KNOWN:.0e} of the largest weight; leave out what does not count"
        )
    return MappingProxyType(weights), value


def _no_equality(item: object) -> EqualityError:
    return EqualityError(
        f"found the equality {shown(item)}; expected a pair (weights by coefficient, value), "
        'such as ({"b0": 1.0, "a0": -2.0}, 0.0), finite, with a weight that is not zero; correct it'
    )


def checked_priors(
    priors: Mapping[str, tuple[float, float]] | None,
) -> dict[str, tuple[float, float]]:
    """Give (mean, standard deviation) by name."""
    if priors is not None and not isinstance(priors, Mapping):
        raise PriorError(
            f"found priors={shown(priors)}; expected a mapping of coefficient to (mean, standard "
            'deviation); write for example priors={"a0": (3.0, 0.1)}'
        )
    pairs: dict[str, tuple[float, float]] = {}
    for name, pair in (priors or {}).items():
        limits = tuple(pair) if isinstance(pair, (tuple, list, np.ndarray)) else ()
        mean, spread = map(_number, limits) if len(limits) == 2 else (math.nan, math.nan)
        if not (math.isfinite(mean) and 0.0 < spread < math.inf):
            raise PriorError(
                f"found the prior {shown(pair)} for {shown(name)}; expected (mean, standard "
                "deviation), finite, the latter above zero; correct it, or fix the coefficient"
            )
        _check_size(PriorError, "a prior mean", name, mean, "correct it")
        _check_size(PriorError, "a prior standard deviation", name, spread, "correct it")
        pairs[str(name)] = (mean, spread)
    return pairs


def checked_gain(gain: object) -> Gain | None:
    """Give a finite number, nested ones ``[output][input]`` (None where unknown), or None."""
    if gain is None:
        return None
    if isinstance(gain, np.ndarray):
        gain = gain.tolist()
    if not isinstance(gain, (list, tuple)):
        return _gain(gain)
    rows = [tuple(row) if isinstance(row, (list, tuple)) else () for row in gain]
    if not rows or not rows[0] or any(len(row) != len(rows[0]) for row in rows):
        raise StaticGainError(
            f"found static_gain={shown(gain)}; expected a number or equally long rows "
            "static_gain[output][input], None where it is unknown; nest it twice"
        )
    return tuple(tuple(None if item is None else _gain(item) for item in row) for row in rows)


def _gain(item: object) -> float:
    number = _number(item)
    if not math.isfinite(number):
        raise StaticGainError(
            f"found static_gain={shown(item)}; expected a finite number; correct it, or fix a0 to "
            "zero for an integrator"
        )
    _check_size(StaticGainError, "a static gain", None, number, "correct it")
    return number
