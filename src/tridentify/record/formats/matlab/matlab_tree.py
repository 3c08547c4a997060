"""The channels in the variables of a MATLAB file, whatever version wrote it.

A variable is a tree of numbers, texts, structs (``dict``), cells and arrays of structs (``list``).
Channels are found in it as follows; a path is ``log.imu.q``, an element ``log.leg(2)``.

* Numbers of one dimension, or of one that is longer than 1, are a channel. The columns of a matrix
  are ``y(1)``, ``y(2)``, ...; samples run down a column, as everywhere in MATLAB. A scalar is none.
* A struct with ``Time`` and ``Data`` is a timeseries, with a clock of its own. Its unit is
  ``Units`` of the struct or of ``DataInfo``.
* A struct with ``time`` and ``signals`` is what Simulink calls a structure with time.
* A struct with ``u`` or ``y`` (or ``InputData``, ``OutputData``) and ``Ts`` is laid out as
  ``iddata``: ``InputName``, ``OutputName``, ``InputUnit``, ``OutputUnit``, ``TimeUnit`` and
  ``Tstart``. Its channels go by those names.
* In any other struct, a field called ``t`` or ``time`` (`time_names`) is the time of the fields
  beside it that are as long.

Objects of MATLAB's own classes (``timeseries``, ``iddata``, ``table``) are stored in a form that is
not published; they are named, and refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import prod
from pathlib import Path
from typing import TypeAlias, Union

import numpy as np

from tridentify.errors import ForeignObjectError, TextInColumnError, UnitError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.apart.isolation import check_size
from tridentify.record.formats.channels import SECONDS, Channel, SampledFile
from tridentify.record.formats.time_names import named_time, unit_of_clock

DEEPEST = 8
"""Structures within structures: an end for references that go in circles."""
MOST_ELEMENTS = 100
"""Of an array of structures or a cell: more are a table of events and no signals."""
MOST_COLUMNS = 1000
"""Of a matrix of signals: more columns than that are samples, on their side."""
MOST_CHANNELS = 100_000
"""Of a file; the largest flight-test files have some 80,000."""


@dataclass(frozen=True)
class Numbers:
    """An array of numbers that is loaded when it is asked for, in MATLAB's order of dimensions."""

    shape: tuple[int, ...]
    load: Callable[[], np.ndarray]

    @property
    def size(self) -> int:
        """Number of numbers."""
        return prod(self.shape)

    def scalar(self) -> float | None:
        """Give the number, if it is one."""
        return float(np.real(self.load()).ravel()[0]) if self.size == 1 else None


@dataclass(frozen=True)
class Opaque:
    """What cannot be read: an object of a class."""

    kind: str


Node: TypeAlias = Union[Numbers, Opaque, str, "dict[str, Node]", "list[Node]"]
Load: TypeAlias = Callable[[], Array]


@dataclass
class _Found:
    """What a walk through the variables collects."""

    path: Path
    channels: list[Channel] = field(default_factory=list)
    loads: list[Load] = field(default_factory=list)
    clocks: dict[str, Load] = field(default_factory=dict)

    def add(self, channel: Channel, load: Load) -> None:
        if len(self.channels) < MOST_CHANNELS:
            self.channels.append(channel)
            self.loads.append(load)


class MatlabFile(SampledFile):
    """The variables of a MATLAB file as an `OpenFile`.

    Parameters
    ----------
    path : Path
    variables : dict of str to Node
    """

    def __init__(self, path: Path, variables: dict[str, Node]) -> None:
        self.path = path
        self._found = _Found(path)
        for name, node in variables.items():
            _walk(self._found, name, node, 0)
        self.channels = tuple(self._found.channels)

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give channels as numbers."""
        return [self._found.loads[index]() for index in indices]

    def instants(self, clock: str) -> Array | None:
        """Give the sampling instants of a timeseries or an experiment [s]."""
        load = self._found.clocks.get(clock)
        return None if load is None else load()


def _walk(found: _Found, path: str, node: Node, depth: int) -> None:
    if depth > DEEPEST:
        return
    if isinstance(node, Numbers):
        _add_numbers(found, path, node, [path], [""], "")
    elif isinstance(node, Opaque):
        found.add(Channel(path, path, samples=None), _refuse(found, path, node.kind))
    elif isinstance(node, list):
        for k, element in enumerate(node[:MOST_ELEMENTS]):
            _walk(found, f"{path}({k + 1})", element, depth + 1)
    elif isinstance(node, dict):
        fields = {name.lower(): value for name, value in node.items()}
        known = _add_timeseries, _add_simulink, _add_experiment
        if not any(add(found, path, fields) for add in known):
            first = len(found.channels)
            for name, value in node.items():
                _walk(found, f"{path}.{name}", value, depth + 1)
            _share_time(found, path, node, first)


def _share_time(found: _Found, path: str, node: dict[str, Node], first: int) -> None:
    """Let a field that is time by its name be the clock of the fields beside it, if as long."""
    numbers = [name for name, value in node.items() if isinstance(value, Numbers)]
    names = [name for name in numbers if name != "T"]  # a temperature
    places = named_time(names)
    channels = {one.header: one for one in found.channels[first:]}
    times = [channels[f"{path}.{names[k]}"] for k in places if f"{path}.{names[k]}" in channels]
    if len(times) != 1:
        return
    name = times[0].header.rpartition(".")[2]
    instants = node[name]
    if not isinstance(instants, Numbers):
        return
    found.clocks[path] = _scaled(found, path, instants, unit_of_clock(name))
    beside = re.compile(rf"{re.escape(path)}\.\w+(\(\d+\))?")
    for k, one in enumerate(found.channels[first:], first):
        if not one.clock and one.samples == times[0].samples and beside.fullmatch(one.header):
            found.channels[k] = replace(one, clock=path)


def _refuse(found: _Found, path: str, kind: str) -> Load:
    def load() -> Array:
        raise ForeignObjectError(
            f"found an object of class {shown(kind)} as {shown(path)} in {shown(found.path.name)}; "
            "expected numbers or plain structs; in MATLAB, save its parts as arrays, or as a "
            "struct with Time and Data, or with u, y and Ts"
        )

    return load


def _add_numbers(
    found: _Found,
    path: str,
    numbers: Numbers,
    names: Sequence[str],
    units: Sequence[str],
    clock: str,
    samples: int | None = None,
) -> None:
    """Add the columns of an array; `samples` says how long they have to be, if that is known."""
    long = [extent for extent in numbers.shape if extent != 1]
    length = samples or (long[0] if long else 1)
    # a timeseries may keep its samples along the last of three dimensions
    turned = bool(samples) and bool(long) and long[0] != samples and long[-1] == samples
    if length < 2 or numbers.size % length or (long and length not in (long[0], long[-1])):
        return
    columns = numbers.size // length
    if columns > MOST_COLUMNS:
        return
    for k in range(columns):
        named = len(names) == columns
        header = path if columns == 1 else f"{path}({k + 1})"
        name = names[k] if named else header
        if named and name != header and name:
            parent = path.rpartition(".")[0]
            header = f"{parent}.{name}" if parent else name
        found.add(
            Channel(
                header, name or header, units[k] if len(units) == columns else "", clock, length
            ),
            _column(found, header, numbers, length, k, turned),
        )


def _column(
    found: _Found, header: str, numbers: Numbers, length: int, k: int, turned: bool
) -> Load:
    def load() -> Array:
        array = _loaded(found, numbers)
        if array.dtype.kind not in "fiub":
            raise TextInColumnError(
                f"found numbers of type {array.dtype} in {shown(header)} of "
                f"{shown(found.path.name)}; expected real numbers; choose another variable"
            )
        shape = (-1, length) if turned else (length, -1)
        table = array.reshape(shape, order="F")
        return np.array(table[k] if turned else table[:, k], dtype=np.float64)

    return load


def _loaded(found: _Found, numbers: Numbers) -> np.ndarray:
    """Load an array whose declared size memory can hold, all columns of it."""
    check_size(8 * numbers.size, found.path)
    return np.asarray(numbers.load())


# ------------------------------------------------------------------------------ known structures
def _add_timeseries(found: _Found, path: str, fields: dict[str, Node]) -> bool:
    time, data = fields.get("time"), fields.get("data")
    if not (isinstance(time, Numbers) and isinstance(data, Numbers) and time.size > 1):
        return False
    if time.size not in (data.shape[0], data.shape[-1]):
        return False
    info = _fields(fields.get("datainfo"))
    unit = _text(fields.get("units") or fields.get("unit") or info.get("units"))
    timing = _fields(fields.get("timeinfo"))
    scale = _text(fields.get("timeunit") or fields.get("timeunits") or timing.get("units"))
    found.clocks[path] = _scaled(found, path, time, scale)
    columns = data.size // time.size
    _add_numbers(found, path, data, [path], [unit] * columns, path, time.size)
    return True


def _add_simulink(found: _Found, path: str, fields: dict[str, Node]) -> bool:
    time, signals = fields.get("time"), fields.get("signals")
    if not isinstance(time, Numbers) or not isinstance(signals, dict | list) or time.size < 2:
        return False
    several = signals if isinstance(signals, list) else [signals]
    found.clocks[path] = _scaled(found, path, time, "")
    for k, signal in enumerate(several[:MOST_ELEMENTS]):
        parts = _fields(signal)
        values, label = parts.get("values"), _text(parts.get("label"))
        if isinstance(values, Numbers):
            name = label or f"{path}.signals({k + 1})"
            _add_numbers(
                found, f"{path}.{label}" if label else name, values, [name], [], path, time.size
            )
    return True


def _add_experiment(found: _Found, path: str, fields: dict[str, Node]) -> bool:
    sides = (
        (fields.get("u", fields.get("inputdata")), "u", "input"),
        (fields.get("y", fields.get("outputdata")), "y", "output"),
    )
    step, stamps = fields.get("ts"), fields.get("samplinginstants")
    timed = isinstance(step, Numbers) or (isinstance(stamps, Numbers) and stamps.size > 1)
    if not timed or not any(isinstance(side[0], Numbers) for side in sides):
        return False
    unit = _text(fields.get("timeunit"))
    samples = 0
    for numbers, letter, side in sides:
        if isinstance(numbers, Numbers) and numbers.size > 1:
            samples = next(extent for extent in numbers.shape if extent != 1)
            names = _texts(fields.get(f"{side}name"))
            units = _texts(fields.get(f"{side}unit"))
            _add_numbers(found, f"{path}.{letter}", numbers, names, units, path)
    if isinstance(stamps, Numbers) and stamps.size > 1:
        found.clocks[path] = _scaled(found, path, stamps, unit)
    elif isinstance(step, Numbers) and step.size == 1:
        first = fields.get("tstart")
        start = (first.scalar() if isinstance(first, Numbers) else None) or 0.0
        found.clocks[path] = _regular(found, path, step, start, samples, unit)
    return True


def _regular(
    found: _Found, path: str, step: Numbers, start: float, samples: int, unit: str
) -> Load:
    def load() -> Array:
        times = start + (step.scalar() or 0.0) * np.arange(samples, dtype=np.float64)
        return np.asarray(_scale(found, path, unit) * times, dtype=np.float64)

    return load


def _scaled(found: _Found, path: str, time: Numbers, unit: str) -> Load:
    def load() -> Array:
        instants = np.asarray(_loaded(found, time), dtype=np.float64).ravel()
        return _scale(found, path, unit) * instants

    return load


def _scale(found: _Found, path: str, unit: str) -> float:
    if unit not in SECONDS:
        raise UnitError(
            f"found the unit {shown(unit)} of the time of {shown(path)} in "
            f"{shown(found.path.name)}; expected s, ms, us, ns, min, h or d; correct it"
        )
    return SECONDS[unit]


def _fields(node: Node | None) -> dict[str, Node]:
    return {name.lower(): value for name, value in node.items()} if isinstance(node, dict) else {}


def _text(node: Node | None) -> str:
    return node.strip() if isinstance(node, str) else ""


def _texts(node: Node | None) -> list[str]:
    if isinstance(node, str):
        return [node.strip()]
    return [_text(item) for item in node] if isinstance(node, list) else []
