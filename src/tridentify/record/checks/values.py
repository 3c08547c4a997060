"""Values from a file that anybody may have written: their kind, their range, their keys."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from tridentify.errors import StructureError, shown

T = TypeVar("T")

COUNTED = 1 << 53
"""Beyond this a float does not count any more."""


def checked(value: object, kind: type[T]) -> T:
    """A value of this very kind: True is no number, and a text no list.

    Raises
    ------
    TypeError

    Examples
    --------
    >>> checked([1], list)
    [1]
    """
    if type(value) is not kind:
        raise TypeError(f"a {type(value).__name__} in place of a {kind.__name__}")
    return value


def check_keys(document: object, keys: Iterable[str]) -> None:
    """Refuse a mapping that has other keys.

    Raises
    ------
    TypeError
        It is no mapping.
    ValueError
        A key is missing, or is one too many.
    """
    wanted = set(keys)
    for key in sorted(set(checked(document, dict)) ^ wanted, key=str)[:1]:
        raise ValueError(f"{'no' if key in wanted else 'an unknown'} part {shown(key)}")


def made_from(kind: type[T], content: Mapping[str, Any], *needed: str) -> T:
    """What ``to_dict`` gave, made again; ``needed`` are the keys that it has at least.

    Raises
    ------
    StructureError
        Keys are missing or unknown, or the values make none.
    """
    try:
        return kind(**{**{key: content[key] for key in needed}, **content})
    except (KeyError, TypeError) as error:
        if isinstance(error, StructureError):
            raise
        raise StructureError(
            f"found the keys {shown(sorted(content), 80)}; expected those of to_dict(), "
            f"{' and '.join(needed)} at least; restore the file"
        ) from error


def whole_number(value: object, most: int = COUNTED) -> int:
    """A whole number from zero to ``most``.

    Raises
    ------
    TypeError, ValueError

    Examples
    --------
    >>> whole_number(3)
    3
    """
    if not 0 <= checked(value, int) <= most:
        raise ValueError(f"{shown(value)} in place of a whole number up to {most}")
    return checked(value, int)


def finite_number(value: object, least: float = -math.inf) -> float:
    """A finite number of at least ``least``.

    Raises
    ------
    TypeError, ValueError, OverflowError

    Examples
    --------
    >>> finite_number(3, 0.0)
    3.0
    """
    found = float(checked(value, int if type(value) is int else float))
    if not (math.isfinite(found) and found >= least):
        raise ValueError(f"{found!r} in place of a finite number of at least {least:g}")
    return found


def texts(value: object) -> tuple[str, ...]:
    """A list of texts.

    Raises
    ------
    TypeError
    """
    return tuple(checked(one, str) for one in checked(value, list))


def text_by_text(value: object) -> dict[str, Any]:
    """A mapping of texts to texts.

    Raises
    ------
    TypeError
    """
    return {checked(k, str): checked(v, str) for k, v in checked(value, dict).items()}
