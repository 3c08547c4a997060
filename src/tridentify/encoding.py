"""Estimates as JSON-ready values and back, led by the annotations of the fields."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tridentify.errors import DataError, UnreadableFileError, shown
from tridentify.files import published, write_atomically
from tridentify.finding import Finding
from tridentify.parameter import Nuisance
from tridentify.structure import Structure
from tridentify.trace import Pass, Start, Status, Step, Trace
from tridentify.transfer_function import TransferFunction

T = TypeVar("T")

MOST_BYTES = 1 << 27
"""Of a file: some million samples that an on-line estimator keeps."""
MOST_VALUES = 4_000_000
"""Of a file; each takes some hundred bytes of memory."""


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
        Makes the object of the document without its schema.
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
        document = read_json(published(path))
    except (OSError, ValueError) as error:
        raise UnreadableFileError(
            f"found no readable {what} in {path} ({error}); expected a JSON file written by "
            f"{writer}.save; check the path"
        ) from error
    found = document.pop(key, None) if isinstance(document, dict) else None
    if found != schema:
        raise DataError(
            f"found {key.replace('_', ' ')} {shown(found)} in {path}; expected {schema}; "
            "identify the record again with this version and save it"
        )
    try:
        return build(document)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"found a damaged {what} in {path} ({error!r}); expected the fields that {writer}.save "
            "wrote; identify the record again and save it"
        ) from error


def read_json(path: str | os.PathLike[str]) -> Any:
    """What a JSON file of any origin holds: numbers that are finite, and an end to its depth.

    Raises
    ------
    OSError
        It cannot be read.
    ValueError
        It is no JSON, or too large or too deep to be one that was written by this package.
    """
    with Path(path).open("rb") as stream:
        data = stream.read(MOST_BYTES + 1)
    if len(data) > MOST_BYTES:
        raise ValueError(f"more than {MOST_BYTES >> 20} MiB")
    values = sum(map(data.count, (b",", b"[", b"{")))
    if values > MOST_VALUES:
        raise ValueError(f"{values} values; at most {MOST_VALUES} can be")
    try:
        return json.loads(data.decode("utf-8"), parse_constant=_no_number, parse_float=_finite)
    except RecursionError as error:
        raise ValueError("values nested too deeply") from error


def _no_number(text: str) -> float:
    raise ValueError(f"{text} in place of a number")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text[:40]}, which is out of the range of a float")
    return value


def encode(value: Any) -> Any:
    """JSON-ready copy: arrays as lists, nan as null, infinities as text."""
    if isinstance(value, Status):
        return value.name
    if isinstance(value, (Structure, TransferFunction)):
        return value.to_dict()
    if dataclasses.is_dataclass(value):
        return {f.name: encode(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {key: encode(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [encode(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return encode(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def decode(cls: type[Any], document: Mapping[str, Any]) -> Any:
    """Build a dataclass from what `_encode` made of it, led by the annotations of its fields."""
    fields = {field.name: str(field.type) for field in dataclasses.fields(cls)}
    return cls(
        **{k: _DECODERS.get(fields[k], lambda kept: kept)(value) for k, value in document.items()}
    )


def _tuple_of(cls: type[Any]) -> Callable[[Any], Any]:
    return lambda items: tuple(decode(cls, item) for item in items)


_DECODERS: dict[str, Callable[[Any], Any]] = {
    "Array": lambda value: np.array(value, dtype=np.float64),
    "tuple[Array, ...]": lambda items: tuple(np.array(a, dtype=np.float64) for a in items),
    "float": lambda value: math.nan if value is None else float(value),
    "tuple[str, ...]": tuple,
    "tuple[Step, ...]": _tuple_of(Step),
    "tuple[Pass, ...]": _tuple_of(Pass),
    "tuple[Start, ...]": _tuple_of(Start),
    "tuple[Nuisance, ...]": _tuple_of(Nuisance),
    "tuple[Finding, ...]": _tuple_of(Finding),
    "tuple[float, ...]": lambda items: tuple(float(x) for x in items),
    "Trace": lambda value: decode(Trace, value),
    "Status": Status.__getitem__,
    "Structure": Structure.from_dict,
    "TransferFunction": TransferFunction.from_dict,
}
