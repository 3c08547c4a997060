"""Estimates as JSON-ready values and back, led by the annotations of the fields.

What is read is checked type by type: a number is never read from text, a truth value or a list of
other lengths, text is printable. So whatever stands in a file, what comes of it has the types that
the annotations promise, or a `ValueError` says which field has not.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from tridentify.errors import TridentifyError, shown
from tridentify.estimation.answer.decision import recalled
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.answer.parameter import Nuisance, Parameter
from tridentify.estimation.answer.trace import Awaited, Pass, Start, Status, Step, Trace
from tridentify.numerics.arrays import Array
from tridentify.record.checks.orders import HIGHEST_ORDER
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

Decoder = Callable[[Any], Any]

LONGEST_TEXT = 20_000
"""Longest text that is read [characters]: a caution takes some hundred, a call with all its options
a thousand."""

LEFT_OUT: Mapping[str, Any] = MappingProxyType({"left out at its default": True})
"""Metadata of a field that is not written where it has its default: files that know nothing of it
say the same."""

_DIMENSIONS = 3
"""Most dimensions of an array in a file: no field has more."""
_WORDS = {None: math.nan, "inf": math.inf, "-inf": -math.inf}


def encode(value: Any) -> Any:
    """JSON-ready copy: arrays as lists, nan as null, infinities as text."""
    if isinstance(value, Status):
        return value.name
    if isinstance(value, (Structure, TransferFunction)):
        return value.to_dict()
    if dataclasses.is_dataclass(value):
        return {
            f.name: encode(getattr(value, f.name))
            for f in dataclasses.fields(value)
            if f.metadata != LEFT_OUT or getattr(value, f.name) != f.default
        }
    if isinstance(value, Mapping):
        return {key: encode(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, Awaited)):
        return [encode(item) for item in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return encode(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def decode(cls: type[Any], document: Any, more: Mapping[str, Decoder] | None = None) -> Any:
    """Build a dataclass from what `encode` made of it, led by the annotations of its fields.

    Parameters
    ----------
    cls : type
        The dataclass.
    document : object
        What was read; anything at all.
    more : mapping of str to callable, optional
        Decoders of annotations that this module does not know.

    Returns
    -------
    object
        Of type `cls`.

    Raises
    ------
    ValueError
        It is no mapping, or a field is missing, unknown, or not of its type.

    Examples
    --------
    >>> from tridentify.estimation.answer.trace import Start
    >>> decode(Start, {"name": "rest", "theta": [1.0, None], "cost": "inf"})
    Start(name='rest', theta=array([ 1., nan]), cost=inf)
    """
    if not isinstance(document, dict):
        raise ValueError(f"{shown(document)} in place of the fields of {cls.__name__}")
    fields = {field.name: field for field in dataclasses.fields(cls)}
    needed = {n for n, f in fields.items() if f.default is f.default_factory is dataclasses.MISSING}
    if document.keys() - fields.keys():
        raise ValueError(f"{shown(sorted(document.keys() - fields.keys()), 80)} is no field of it")
    if needed - document.keys():
        raise ValueError(f"{shown(sorted(needed - document.keys()), 80)} is missing")
    decoders = {**_DECODERS, **(more or {})}
    made = {}
    for name, value in document.items():
        try:
            made[name] = decoders[str(fields[name].type)](value)
        except (TridentifyError, ValueError) as error:
            raise ValueError(f"{name}: {error}") from error
    return cls(**made)


def plain_model(content: Any) -> TransferFunction:
    """A transfer function from what its `to_dict` gave, after JSON.

    Raises
    ------
    ValueError, StructureError
        It is no mapping of that kind.

    Examples
    --------
    >>> plain_model(TransferFunction([1.0], [1.0, 2.0]).to_dict())
    TransferFunction([1.0], [1.0, 2.0])
    """
    parts = ("num", "den", "delay", "input_names", "output_names")
    if not isinstance(content, dict) or content.keys() != set(parts):
        found = sorted(content) if isinstance(content, dict) else content
        raise ValueError(f"{shown(found, 80)} in place of {', '.join(parts)}")
    polynomials = {
        key: [[_array(item) for item in _list(row)] for row in _list(content[key])]
        for key in ("num", "den")
    }
    for item in (one for rows in polynomials.values() for row in rows for one in row):
        if item.ndim != 1 or not 1 <= item.size <= HIGHEST_ORDER + 1:
            raise ValueError(
                f"coefficients of shape {item.shape}; expected 1 to {HIGHEST_ORDER + 1} numbers"
            )
    if {len(rows) for rows in polynomials.values()} != {len(_list(content["output_names"]))}:
        raise ValueError("as many rows of polynomials as names of outputs are expected")
    return TransferFunction(
        **polynomials,
        delay=_array(content["delay"]),
        input_names=_texts(content["input_names"]),
        output_names=_texts(content["output_names"]),
    )


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError(f"{shown(value)} in place of a list")
    return value


def _array(value: Any) -> Array:
    """Numbers in rows of one length; of an empty list no shape is known."""
    shape: list[int] = []
    level = [_list(value)]
    while True:
        lengths = {len(item) for item in level}
        if len(lengths) != 1 or len(shape) == _DIMENSIONS:
            raise ValueError("rows of different length, or nested too deep, in place of numbers")
        shape.append(lengths.pop())
        items = [one for item in level for one in item]
        if not (items and isinstance(items[0], list)):
            return np.array([_real(one) for one in items], dtype=np.float64).reshape(shape)
        level = [_list(one) for one in items]


def _real(value: Any) -> float:
    """A number; null and text stand for those that JSON has not."""
    if type(value) is float or type(value) is int:
        return float(value)
    if value is None or (type(value) is str and value in _WORDS):
        return _WORDS[value]
    raise ValueError(f"{shown(value)} in place of a number")


def _whole(value: Any) -> int:
    if type(value) is not int:
        raise ValueError(f"{shown(value)} in place of a whole number")
    return value


def _truth(value: Any) -> bool:
    if type(value) is not bool:
        raise ValueError(f"{shown(value)} in place of true or false")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str) or len(value) > LONGEST_TEXT or not value.isprintable():
        raise ValueError(
            f"{shown(value)} in place of printable text of at most {LONGEST_TEXT} characters"
        )
    return value


def _texts(value: Any) -> tuple[str, ...]:
    return tuple(_text(one) for one in _list(value))


def _mapping(decoder: Decoder) -> Decoder:
    def made(value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise ValueError(f"{shown(value)} in place of a mapping")
        return {_text(key): decoder(item) for key, item in value.items()}

    return made


def _pair(value: Any) -> tuple[float, float]:
    if len(_list(value)) != 2:
        raise ValueError(f"{shown(value)} in place of two numbers")
    return _real(value[0]), _real(value[1])


def _tuple_of(cls: type[Any]) -> Decoder:
    return lambda items: tuple(decode(cls, item) for item in _list(items))


def _status(value: Any) -> Status:
    if not isinstance(value, str) or value not in Status.__members__:
        raise ValueError(f"{shown(value)} in place of one of {', '.join(Status.__members__)}")
    return Status[value]


def _structure(value: Any) -> Structure:
    if not isinstance(value, dict):
        raise ValueError(f"{shown(value)} in place of a structure")
    return Structure.from_dict(value)


_DECODERS: Mapping[str, Decoder] = {
    "Array": _array,
    "tuple[Array, ...]": lambda items: tuple(_array(item) for item in _list(items)),
    "float": _real,
    "float | None": lambda value: None if value is None else _real(value),
    "int": _whole,
    "bool": _truth,
    "int | None": lambda value: None if value is None else _whole(value),
    "str": _text,
    "Severity": _text,
    "tuple[str, ...]": _texts,
    "Decisions": lambda items: tuple(map(recalled, _texts(items))),
    "Mapping[str, str]": _mapping(_text),
    "Mapping[str, tuple[float, float]]": _mapping(_pair),
    "tuple[Step, ...]": _tuple_of(Step),
    "Sequence[Pass]": _tuple_of(Pass),
    "tuple[Start, ...]": _tuple_of(Start),
    "tuple[Nuisance, ...]": _tuple_of(Nuisance),
    "tuple[Parameter, ...]": _tuple_of(Parameter),
    "tuple[Finding, ...]": _tuple_of(Finding),
    "tuple[float, ...]": lambda items: tuple(_real(item) for item in _list(items)),
    "Trace": lambda value: decode(Trace, value),
    "Status": _status,
    "Structure": _structure,
    "TransferFunction": plain_model,
    "TransferFunction | None": lambda value: None if value is None else plain_model(value),
    "LoopTaken | None": lambda value: None if value is None else decode(LoopTaken, value),
}
