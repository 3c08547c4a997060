"""JSON documents that name their schema: written whole or not at all, read with bounded effort."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from tridentify.encoding.values import encode
from tridentify.errors import DataError, FileTooLargeError, UnreadableFileError, shown
from tridentify.files import published, write_atomically

T = TypeVar("T")

LARGEST = 64 * 1024 * 1024
"""Largest document that is read [bytes]: a million outliers or three million numbers, a hundred
times what estimates of long records take; as Python objects it fills a gigabyte or two."""

DEEPEST = 30
"""Deepest nesting of lists and mappings that is read; an estimate has ten levels."""

LARGEST_WHOLE = 2**63
"""Whole numbers are smaller in size than this."""

_EXPLAINED = 300
"""Longest reason in a message [characters]."""


def save_document(path: str | os.PathLike[str], key: str, schema: int, value: object) -> Path:
    """Write a dataclass as JSON that names its schema: to a temporary name first, then renamed.

    Raises
    ------
    OutputPathError
        The file cannot be written.
    """
    return write_atomically(path, document_text(key, schema, value))


def document_text(key: str, schema: int, value: object) -> str:
    """The JSON text that `save_document` writes."""
    return json.dumps({key: schema, **encode(value)}, indent=1, allow_nan=False) + "\n"


def load_document(
    path: str | os.PathLike[str],
    key: str,
    schema: int,
    build: Callable[[dict[str, Any]], T],
    what: str,
    writer: str,
) -> T:
    """Read what `save_document` wrote.

    Parameters
    ----------
    path : str or path
    key : str
        Under which the schema stands.
    schema : int
        The one that can be read.
    build : callable
        Makes the object of the document without its schema; says with `DataError`, `ValueError`,
        `TypeError`, `KeyError` or `IndexError` that it cannot.
    what, writer : str
        In words, for the messages.

    Raises
    ------
    UnreadableFileError
        There is no such file, or it is not JSON.
    FileTooLargeError
        It is larger than `LARGEST`.
    DataError
        It is of another schema version, or damaged.
    """
    document = read_json_document(path, what, writer)
    found = document.pop(key, None) if isinstance(document, dict) else None
    if type(found) is not int or found != schema:
        raise DataError(
            f"found {key.replace('_', ' ')} {shown(found)} in {path}; expected {schema}; identify "
            "the record again with this version and save it"
        )
    try:
        return build(document)
    except (AttributeError, IndexError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise DataError(
            f"found a damaged {what} in {path} ({_reason(error)}); expected the fields that "
            f"{writer}.save wrote; identify the record again and save it"
        ) from error


def read_json_document(path: str | os.PathLike[str], what: str, writer: str) -> Any:
    """Parse a file: bounded in size and depth, its numbers finite, no key twice.

    Parameters
    ----------
    path : str or path
    what, writer : str
        In words, for the messages.

    Returns
    -------
    object
        Of Python's plain types.

    Raises
    ------
    UnreadableFileError
        There is no such file, or it is not JSON.
    FileTooLargeError
        It is larger than `LARGEST`.
    """
    try:
        with open(published(path), "rb") as stream:
            content = stream.read(LARGEST + 1)
        if len(content) > LARGEST:
            raise FileTooLargeError(
                f"found more than {LARGEST >> 20} MiB in {path}; expected {what} written by "
                f"{writer}.save; check the path"
            )
        document = json.loads(
            content.decode("utf-8"), object_pairs_hook=_no_key_twice, parse_constant=_no_number
        )
        _check(document)
    except FileTooLargeError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        raise UnreadableFileError(
            f"found no readable {what} in {path} ({_reason(error)}); expected a JSON file written "
            f"by {writer}.save; check the path"
        ) from error
    return document


def _reason(error: BaseException) -> str:
    """What an error says, on one line and not for ever."""
    text = repr(error) if isinstance(error, (KeyError, AttributeError)) else str(error)
    plain = "".join(one if one.isprintable() else " " for one in text)
    return plain if len(plain) <= _EXPLAINED else shown(plain, _EXPLAINED)[1:-1]


def _no_key_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key stands in it twice")
    return found


def _no_number(text: str) -> float:
    raise ValueError(f"{text} in it is no number of JSON")


def _check(document: object) -> None:
    """Level by level, so that no depth can exhaust the stack."""
    level, depth = [document], 0
    while level:
        depth += 1
        if depth > DEEPEST:
            raise ValueError(f"it is nested more than {DEEPEST} deep")
        below: list[object] = []
        for item in level:
            for value in item.values() if isinstance(item, dict) else _items(item):
                if isinstance(value, (list, dict)):
                    below.append(value)
                elif isinstance(value, float) and not math.isfinite(value):
                    raise ValueError("a number in it leaves the range of a float")
                elif isinstance(value, int) and abs(value) >= LARGEST_WHOLE:
                    raise ValueError("a whole number in it is larger than any that is written")
        level = below


def _items(item: object) -> list[object]:
    return item if isinstance(item, list) else []
