"""JSON documents that name their schema: written whole or not at all, read with bounded effort."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from tridentify.errors import DataError, UnreadableFileError, shown
from tridentify.estimation.answer.encoding.values import encode
from tridentify.writing.files import published, write_atomically

T = TypeVar("T")

MOST_BYTES = 1 << 27
"""Largest document that is read [bytes]: some million samples that an on-line estimator keeps."""

MOST_VALUES = 4_000_000
"""Most values of a document that is read: a million outliers, a hundred times what estimates of
long records hold. Each takes up to a hundred bytes of memory."""

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
    DataError
        It is of another schema version, or damaged.
    """
    try:
        document = read_json(path)
    except (OSError, ValueError) as error:
        raise UnreadableFileError(
            f"found no readable {what} in {path} ({one_line(error)}); expected a JSON file written "
            f"by {writer}.save; check the path"
        ) from error
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
            f"found a damaged {what} in {path} ({one_line(error)}); expected the fields that "
            f"{writer}.save wrote; identify the record again and save it"
        ) from error


def read_json(path: str | os.PathLike[str]) -> Any:
    """What a JSON file of any origin holds: finite numbers, no key twice, an end to its depth.

    Parameters
    ----------
    path : str or path

    Returns
    -------
    object
        Of Python's plain types.

    Raises
    ------
    OSError
        It cannot be read.
    ValueError
        It is no JSON, or too large or too deep to be one that was written by this package.
    """
    with open(published(path), "rb") as stream:
        content = stream.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(f"more than {MOST_BYTES >> 20} MiB")
    values = sum(map(content.count, (b",", b"[", b"{")))
    if values > MOST_VALUES:
        raise ValueError(f"{values} values, and at most {MOST_VALUES} can be")
    try:
        document = json.loads(
            content.decode("utf-8"),
            object_pairs_hook=_no_key_twice,
            parse_constant=_no_number,
            parse_float=_finite,
        )
    except RecursionError as error:
        raise ValueError(f"nested more than {DEEPEST} deep") from error
    _check(document)
    return document


def one_line(error: BaseException) -> str:
    r"""What an error says, on one line and not for ever.

    Examples
    --------
    >>> one_line(ValueError("two\nlines")), one_line(KeyError("theta"))
    ('two lines', "KeyError('theta')")
    """
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


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]} in it leaves the range of a float")
    return value


def _check(document: object) -> None:
    """Level by level, so that no depth can exhaust the stack."""
    level, depth = [document], 0
    while level:
        depth += 1
        if depth > DEEPEST:
            raise ValueError(f"nested more than {DEEPEST} deep")
        below: list[object] = []
        for item in level:
            for value in item.values() if isinstance(item, dict) else _items(item):
                if isinstance(value, (list, dict)):
                    below.append(value)
                elif isinstance(value, int) and abs(value) >= LARGEST_WHOLE:
                    raise ValueError("a whole number in it is larger than any that is written")
        level = below


def _items(item: object) -> list[object]:
    return item if isinstance(item, list) else []
