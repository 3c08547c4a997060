"""Checks of the options of a structure, each with its own exception."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from typing import Any, TypeVar, cast

import numpy as np

from tridentify.errors import BoundsError, ChannelCountError, OptionError, OrderError, shown

Bounds = tuple[float | None, float | None]
Number = TypeVar("Number", int, float)
Matrix = tuple[tuple[Number, ...], ...]


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
    """Give a whole number, or nested ones ``[output][input]``, of at least `lowest`."""

    def order(item: object) -> int:
        try:
            whole = operator.index(item)  # type: ignore[arg-type]
        except TypeError:
            whole = lowest - 1
        if whole < lowest or isinstance(item, (bool, np.bool_)):
            raise OrderError(
                f"found {label}={shown(item)}; expected a whole number of at least {lowest}; "
                f"correct {label}"
            )
        return whole

    if not isinstance(value, (list, tuple)) and np.ndim(cast(Any, value)) == 0:
        return order(value)
    return tuple(tuple(order(item) for item in row) for row in _nested(label, value))


def checked_delays(value: object) -> float | str | Matrix[float]:
    """Give seconds, nested seconds ``[output][input]``, or "free"."""

    def delay(item: object) -> float:
        number = _number(item)
        if not 0.0 <= number < math.inf:
            raise OptionError(
                f"found delay={shown(item)}; expected seconds, zero or more, or 'free' to estimate "
                "it; correct delay"
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


def _number(value: object) -> float:
    if isinstance(value, (str, bytes, bool, np.bool_)):
        return math.nan
    try:
        return float(cast(Any, value))
    except (TypeError, ValueError, OverflowError):
        return math.nan


def checked_fixed(fixed: Mapping[str, float] | None) -> dict[str, float]:
    """Give finite numbers by name."""
    values = {str(name): _number(value) for name, value in (fixed or {}).items()}
    for name, value in values.items():
        if not math.isfinite(value):
            raise BoundsError(
                f"found the fixed value {shown((fixed or {}).get(name))} for {shown(name)}; "
                "expected a finite number; correct it"
            )
    return values


def checked_bounds(bounds: Mapping[str, Bounds] | None) -> dict[str, Bounds]:
    """Give (low, high) by name, None where there is no limit."""
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
        pairs[str(name)] = (None if low == -math.inf else low, None if high == math.inf else high)
    return pairs
