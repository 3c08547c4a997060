"""Poles and gains of models of different orders, mode beside mode.

The coefficient ``a1`` of a model with two poles and that of one with three have nothing to do with
each other. What can be compared is where the modes lie (natural frequency and damping of a pair,
place of a real pole) and the static gain. Modes of one kind are paired by their distance in the
logarithm of frequency, nearest first; a mode that lies further than `APART` from any other stands
by itself.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.answer.parameter import Parameter
from tridentify.judgement.comparison.entries import Entry
from tridentify.numerics.delta_method import dc_gain, pole_quantities
from tridentify.transfer_function import TransferFunction

APART = 2.0
"""Ratio of two natural frequencies beyond which they are different modes: one octave."""


@dataclass(frozen=True)
class Quantity:
    """A pole's or a gain's number for every model.

    Attributes
    ----------
    name, unit : str
    values : tuple of Parameter or None
        In the order of the models; None where a model has no such mode.
    """

    name: str
    unit: str
    values: tuple[Parameter | None, ...]


@dataclass(frozen=True)
class _Mode:
    """A pair of poles or a real pole, with the numbers that say where it is."""

    kind: str
    place: str
    size: float
    rows: tuple[Parameter, ...]


def quantities(entries: Sequence[Entry]) -> tuple[Quantity, ...]:
    """Natural frequency and damping, real poles, and static gains of several models.

    Parameters
    ----------
    entries : sequence of Entry

    Returns
    -------
    tuple of Quantity
        Modes by rising frequency, then the gains.

    Examples
    --------
    >>> slow = TransferFunction([2.0], [1.0, 2.0])
    >>> both = TransferFunction([60.0], np.polymul([1.0, 2.1], [1.0, 30.0]))
    >>> for row in quantities([Entry("slow", slow), Entry("both", both)]):
    ...     print(row.name, [None if v is None else round(v.value, 3) for v in row.values])
    real pole 1 [-2.0, -2.1]
    real pole 2 [None, -30.0]
    dc gain [1.0, 0.952]
    """
    modes, gains = [], []
    for entry in entries:
        own_modes, own_gains = _split(_derived(entry))
        modes.append(own_modes)
        gains.append(own_gains)
    found = [row for group in _paired(modes) for row in _rows(group)]
    names = dict.fromkeys(gain.name for own in gains for gain in own)
    for name in names:
        own_values = tuple(next((g for g in own if g.name == name), None) for own in gains)
        unit = next((g.unit for g in own_values if g is not None and g.unit), "")
        found.append(Quantity(name, unit, own_values))
    return tuple(_numbered(found))


def _derived(entry: Entry) -> tuple[Parameter, ...]:
    if entry.estimate is not None:
        return tuple(p for p in entry.estimate.derived() if not p.name.startswith("time constant"))
    return tuple(row for row in _of_model(entry.model) if not row.name.startswith("time constant"))


def _of_model(model: TransferFunction) -> list[Parameter]:
    """As `Estimate.derived`, without standard errors."""
    shared = model.common_denominator is not None
    rows, gains = [], []
    for i, output in enumerate(model.output_names):
        for j, source in enumerate(model.input_names):
            num, den = model.num[i][j], model.den[i][j]
            n, label = den.size - 1, "" if model.is_siso else f"[{output},{source}]"
            if not shared or (i, j) == (0, 0):
                where = "" if shared else label
                for name, value, _, unit in pole_quantities(den, np.zeros((n, n))):
                    rows.append(Parameter(name + where, value, 0.0, unit))
            size = n + num.size + 1
            gain = dc_gain(num, den, np.zeros((size, size)))[0]
            gains.append(Parameter("dc gain" + label, gain, 0.0, ""))
    return rows + gains


def _split(rows: Sequence[Parameter]) -> tuple[list[_Mode], list[Parameter]]:
    """Modes, and what is no mode."""
    modes, rest = [], []
    pending: Parameter | None = None
    for row in rows:
        kind, place = _kind(row.name)
        if kind == "natural frequency":
            pending = row
        elif kind == "damping" and pending is not None:
            modes.append(_Mode("pair", place, pending.value, (pending, row)))
            pending = None
        elif kind == "real pole":
            modes.append(_Mode("real", place, abs(row.value), (row,)))
        else:
            rest.append(row)
    return modes, rest


def _kind(name: str) -> tuple[str, str]:
    """Name of a quantity without its number, and its channel."""
    found = re.fullmatch(r"(.*?)(?: \d+)?(\[.*\])?", name)
    assert found is not None
    return found[1], found[2] or ""


def _paired(modes: Sequence[Sequence[_Mode]]) -> list[list[_Mode | None]]:
    """Groups of one mode a model at most, those that lie nearest to each other together."""
    groups: list[list[_Mode | None]] = []
    for k, own in enumerate(modes):
        near = sorted(
            (abs(_apart(mode, group)), m, g)
            for (m, mode), (g, group) in itertools.product(enumerate(own), enumerate(groups))
            if abs(_apart(mode, group)) <= math.log(APART)
        )
        taken: dict[int, int] = {}
        for _, m, g in near:
            if m not in taken and g not in taken.values():
                taken[m] = g
        for m, mode in enumerate(own):
            if m in taken:
                groups[taken[m]][k] = mode
            else:
                alone: list[_Mode | None] = [None] * len(modes)
                alone[k] = mode
                groups.append(alone)
    return sorted(groups, key=lambda group: next(m.size for m in group if m is not None))


def _apart(mode: _Mode, group: Sequence[_Mode | None]) -> float:
    """Logarithm of the ratio of frequencies; infinite for another kind or channel."""
    first = next(one for one in group if one is not None)
    if (first.kind, first.place) != (mode.kind, mode.place):
        return math.inf
    if not first.size or not mode.size:
        return 0.0 if first.size == mode.size else math.inf
    return math.log(mode.size / first.size)


def _rows(group: Sequence[_Mode | None]) -> list[Quantity]:
    first = next(one for one in group if one is not None)
    found = []
    for k, row in enumerate(first.rows):
        values = tuple(None if one is None else one.rows[k] for one in group)
        found.append(Quantity("".join(_kind(row.name)), row.unit, values))
    return found


def _numbered(found: Sequence[Quantity]) -> list[Quantity]:
    """Modes of one kind numbered by rising frequency."""
    names = [row.name for row in found]
    numbered = []
    for k, row in enumerate(found):
        name = row.name
        if names.count(name) > 1:
            kind, place = _kind(name)
            name = f"{kind} {names[: k + 1].count(name)}{place}"
        numbered.append(Quantity(name, row.unit, row.values))
    return numbered
