"""What the workbench refuses, and how it says so."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tridentify.app.workers import TaskError
from tridentify.errors import DataError, OptionError, shown

Card = dict[str, Any]


class MissingError(DataError):
    """There is no record, model or job of that name."""


def refusal(error: Exception, code: str = "") -> dict[str, str]:
    """One line of an exception, as a sentence and what to do.

    Examples
    --------
    >>> refusal(DataError("found a; expected b; do c"))
    {'code': 'DataError', 'message': 'Found a; expected b', 'remedy': 'Do c'}
    """
    parts = [part.strip() for part in str(error).split("; ")]
    remedy = parts.pop() if len(parts) > 2 else ""
    code = code or (error.code if isinstance(error, TaskError) else type(error).__name__)
    return {"code": code, "message": _capital("; ".join(parts)), "remedy": _capital(remedy)}


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def found(cards: Sequence[Card], name: str, kind: str) -> Card:
    """The card of a name.

    Raises
    ------
    MissingError
    """
    for one in cards:
        if one["id"] == name:
            return one
    raise MissingError(
        f"found no {kind} {shown(name)}; expected one of this session; it was removed, perhaps in "
        "another tab: reload the page"
    )


def known(record: Card, names: Sequence[str]) -> None:
    """Refuse a channel that a record does not have.

    Raises
    ------
    OptionError
    """
    there = [one["name"] for one in record["channels"]]
    for name in names:
        if name not in there:
            raise OptionError.found("no channel ", name, f"one of {', '.join(there)}", "choose one")


def check(record: Card) -> None:
    """Refuse roles and ranges that make no record.

    Raises
    ------
    OptionError
        A channel does not exist, or has two roles; a range ends before it begins.
    """
    roles = [*record["inputs"], *record["outputs"], *record["references"]]
    known(record, roles)
    for name in roles:
        if roles.count(name) > 1:
            raise OptionError(
                f"found {shown(name)} in two roles; expected each channel in one; free the other"
            )
    for one in (*record["ranges"], *record["bad"]):
        if not one["start"] < one["end"]:
            raise OptionError(
                f"found a range from {one['start']:g} to {one['end']:g} s; expected its end after "
                "its start; give a later end"
            )
