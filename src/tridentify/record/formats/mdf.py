"""MDF4 (and MDF3) measurement files, by asammdf.

A channel keeps its name; where several groups have a channel of that name it is ``group0.speed``,
``group1.speed``. Every group has a clock of its own, the master channel, if that is one of time.
Samples that the file marks as invalid are missing.

A conversion from raw to physical values may be a formula in the file. asammdf has numexpr evaluate
it; only formulas of numbers, arithmetic and the functions of mathematics are let through to it.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tridentify.errors import ForeignObjectError, TextInColumnError, shown
from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import Channel, SampledFile

FUNCTIONS = frozenset({"x", "x1", "abs", "sqrt", "exp", "log", "log10", "pow", "floor", "ceil"}) | {
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "arcsin", "arccos", "arctan"),
    *("sinh", "cosh", "tanh", "where"),
}
TIME_SYNC = (0, 1)
DEEPEST = 8
"""Conversions within conversions: an end for some that go in circles."""

_TOKEN = re.compile(
    r"\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?|[A-Za-z_]\w*|[-+*/^(),%<>\s]"
)


class MdfFile(SampledFile):
    """An MDF file as an `OpenFile`."""

    def __init__(self, path: Path) -> None:
        from asammdf import MDF

        self.path = path
        self._mdf: Any = MDF(str(path))
        listed: list[Channel] = []
        self._sources: list[tuple[int, int]] = []
        groups: list[Any] = self._mdf.groups
        counts = Counter(channel.name for group in groups for channel in group.channels)
        for g, group in enumerate(groups):
            samples = int(group.channel_group.cycles_nr)
            for k, channel in enumerate(group.channels):
                name = str(channel.name)
                header = name if counts[channel.name] == 1 else f"group{g}.{name}"
                unit = str(self._mdf.get_channel_unit(group=g, index=k) or "").strip()
                listed.append(Channel(header, name, unit, f"group{g}", samples))
                self._sources.append((g, k))
        self.channels = tuple(listed)

    def read(self, indices: Sequence[int]) -> list[Array]:
        """Give channels as numbers, nan where the file marks them as invalid."""
        return [self._values(*self._sources[index]) for index in indices]

    def instants(self, clock: str) -> Array | None:
        """Give the master channel of a group [s], if it has one of time."""
        g = int(clock.removeprefix("group"))
        position = self._mdf.masters_db.get(g)
        if position is None:
            return None
        master = self._mdf.groups[g].channels[position]
        if getattr(master, "sync_type", 1) not in TIME_SYNC:
            return None
        self._check_conversion(master)
        return np.asarray(self._mdf.get_master(g), dtype=np.float64)

    def _values(self, g: int, k: int) -> Array:
        channel = self._mdf.groups[g].channels[k]
        self._check_conversion(channel)
        signal = self._mdf.get(group=g, index=k, ignore_invalidation_bits=True)
        samples = np.asarray(signal.samples)
        if samples.dtype.kind not in "fiub" or samples.ndim != 1:
            raise TextInColumnError(
                f"found samples of {samples.dtype} in channel {shown(channel.name)} of "
                f"{shown(self.path.name)}; expected one number a sample; choose another channel"
            )
        values = samples.astype(np.float64)
        invalid = signal.invalidation_bits
        if invalid is not None:
            values[np.asarray(invalid, dtype=bool)] = np.nan
        return values

    def _check_conversion(self, channel: Any) -> None:
        for formula in _formulas(channel.conversion, DEEPEST):
            if not plain_formula(formula):
                raise ForeignObjectError(
                    f"found the conversion {shown(formula)} of channel {shown(channel.name)} in "
                    f"{shown(self.path.name)}; expected arithmetic in X, since nothing else of a "
                    "file is evaluated; export the physical values"
                )


def _formulas(conversion: Any, depth: int) -> Iterator[str]:
    """Give the formulas of a conversion and of those that it refers to."""
    formula = getattr(conversion, "formula", "")
    if isinstance(formula, bytes):
        formula = formula.decode("latin-1")
    if formula:
        yield str(formula).rstrip("\0")
    referenced = getattr(conversion, "referenced_blocks", None) or {}
    for block in referenced.values():
        if depth and hasattr(block, "conversion_type"):
            yield from _formulas(block, depth - 1)


def plain_formula(formula: str) -> bool:
    """Tell whether a formula is arithmetic with known functions, and short.

    Examples
    --------
    >>> plain_formula("2.5e-3*X + sin(X1)^2"), plain_formula("X.__class__"), plain_formula("f(X)")
    (True, False, False)
    """
    if len(formula) > 1000:
        return False
    position = 0
    while position < len(formula):
        token = _TOKEN.match(formula, position)
        if token is None:
            return False
        if token[0][0].isalpha() or token[0][0] == "_":
            if token[0].lower() not in FUNCTIONS:
                return False
            if formula[max(position - 1, 0) : position] == ".":
                return False
        position = token.end()
        if formula[position : position + 1] == "." and not token[0].isspace():
            return False
    return True


open_file = MdfFile
