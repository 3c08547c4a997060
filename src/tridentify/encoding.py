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

from tridentify.errors import DataError, UnreadableFileError
from tridentify.files import published, write_atomically
from tridentify.finding import Finding
from tridentify.parameter import Nuisance
from tridentify.structure import Structure
from tridentify.trace import Pass, Start, Status, Step, Trace
from tridentify.transfer_function import TransferFunction

T = TypeVar("T")


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
        document = json.loads(published(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UnreadableFileError(
            f"found no readable {what} in {path} ({error}); expected a JSON file written by "
            f"{writer}.save; check the path"
        ) from error
    found = document.pop(key, None) if isinstance(document, dict) else None
    if found != schema:
        raise DataError(
            f"found {key.replace('_', ' ')} {found!r} in {path}; expected {schema}; identify the "
            "record again with this version and save it"
        )
    try:
        return build(document)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"found a damaged {what} in {path} ({error!r}); expected the fields that {writer}.save "
            "wrote; identify the record again and save it"
        ) from error


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
