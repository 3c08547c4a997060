"""The ready-made physical models on the command line: names, channels, units, what is known."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from tridentify.cli import tables
from tridentify.cli.terminal import show, show_json
from tridentify.errors import ChannelCountError, OptionError, UnitMismatchError, shown
from tridentify.options import NUMBER
from tridentify.physical import MODELS, PhysicalModel
from tridentify.physical.channels import match_channels
from tridentify.record.record import Record
from tridentify.writing.layout import unit_factors, unit_product

Known = dict[str, float | tuple[float, float]]

SI = {"force": "N", "position": "m", "voltage": "V", "speed": "rad/s", "current": "A"}
"""Units of channels of the models; the other channels of a model need only be alike."""
ANY = ("input", "output")
"""Channels that may have any unit: that of the gain follows from them."""
RATES = ("q", "r")
"""Channels of which the unit is that of the others per second."""


def chosen_model(name: str | None, files: Sequence[Path] | None) -> PhysicalModel:
    """Make the model of that name.

    Raises
    ------
    OptionError
        There is none of that name, or no file is given.
    """
    if name is None or name not in MODELS:
        found = "no --model" if name is None else f"--model {shown(name)}"
        raise OptionError(
            f"found {found}; expected one of {', '.join(MODELS)}; choose one, --list shows their "
            "parameters"
        )
    if not files:
        raise OptionError("found no file; expected the record of an experiment; give its path")
    return MODELS[name]()


def channels_of(
    model: PhysicalModel, inputs: Sequence[str], outputs: Sequence[str]
) -> dict[str, str]:
    """Say which column is which channel of the model.

    Parameters
    ----------
    model : PhysicalModel
    inputs, outputs : sequence of str
        Columns: ``elevator=de`` says which channel one is, those that have a channel's name in
        their own are these (`match_channels`), the others follow in the order of the model.

    Returns
    -------
    dict
        Channel of the model -> column.

    Raises
    ------
    ChannelCountError
        Not as many columns as the model has channels.
    OptionError
        Two columns for one channel.

    Examples
    --------
    >>> from tridentify.physical import short_period
    >>> channels_of(short_period(), ["de"], ["q", "AoA"])
    {'elevator': 'de', 'alpha': 'AoA', 'q': 'q'}
    >>> channels_of(short_period(), ["de"], ["y_q", "y_alpha"])
    {'elevator': 'de', 'alpha': 'y_alpha', 'q': 'y_q'}
    >>> channels_of(short_period(), ["elevator=de"], ["q=y2", "alpha=y1"])
    {'elevator': 'de', 'alpha': 'y1', 'q': 'y2'}
    """
    found: dict[str, str] = {}
    for kind, ours, given in (
        ("input", model.input_names, inputs),
        ("output", model.output_names, outputs),
    ):
        if len(given) != len(ours):
            raise ChannelCountError(
                f"found {len(given)} --{kind} for {model.name}; expected {len(ours)}, for "
                f"{', '.join(ours)}; name a column for each"
            )
        stated: dict[str, str] = {}
        rest: list[str] = []
        for text in given:
            channel, sign, column = (part.strip() for part in text.partition("="))
            named = (channel, column) if sign and channel in ours and column else (text, text)
            if named[0] in stated:
                raise OptionError(
                    f"found --{kind} {shown(text)} and another column for {named[0]}; expected one "
                    "for each channel; drop one"
                )
            if named[0] in ours:
                stated[named[0]] = named[1]
            else:
                rest.append(text)
        others = match_channels([name for name in ours if name not in stated], rest)
        found |= {name: stated[name] if name in stated else others[name] for name in ours}
    return found


def known_parameters(given: Sequence[str]) -> Known:
    """Read what ``--known`` says.

    Parameters
    ----------
    given : sequence of str
        ``R1=1e4`` or ``R1=1e4+-100``.

    Returns
    -------
    dict
        Name -> value, or value and standard deviation.

    Raises
    ------
    OptionError
        A text is neither, or a name occurs twice.

    Examples
    --------
    >>> known_parameters(["R1=1e4", "C1=1e-7+-1e-9"])
    {'R1': 10000.0, 'C1': (1e-07, 1e-09)}
    """
    found: Known = {}
    for text in given:
        match = re.fullmatch(rf"\s*([^\s=]+)\s*=\s*({NUMBER})\s*(?:\+-\s*({NUMBER})\s*)?", text)
        if match is None or match[1] in found:
            raise OptionError(
                f"found --known {shown(text)}; expected a parameter and its value such as R1=1e4 "
                "or R1=1e4+-100, once for each; correct it"
            )
        found[match[1]] = (
            float(match[2]) if match[3] is None else (float(match[2]), float(match[3]))
        )
    return found


def check_units(records: Sequence[Record], named: Mapping[str, str]) -> None:
    """Refuse columns whose units are known and do not go with those of the parameters.

    Parameters
    ----------
    records : sequence of Record
    named : mapping of str to str
        Channel of the model -> channel of the records.

    Raises
    ------
    UnitMismatchError

    Examples
    --------
    >>> record = Record([0, 1], [0, 1], dt=1.0, units={"u": "kN", "y": "m"})
    >>> check_units([record], {"force": "u", "position": "y"})
    Traceback (most recent call last):
    ...
    tridentify.errors.UnitMismatchError: found 'u' in kN; expected N, ...
    """
    for record in records:
        alike: dict[str, str] = {}
        for ours, theirs in named.items():
            unit = record.units.get(theirs, "")
            if unit and ours in SI and _plain_unit(unit) != _plain_unit(SI[ours]):
                raise UnitMismatchError(
                    f"found {shown(theirs)} in {unit}; expected {SI[ours]}, as the units of the "
                    "parameters want it; convert the column, or correct its unit with --unit"
                )
            if unit and ours not in (*SI, *ANY):
                alike[theirs] = _plain_unit(unit, 1 if ours in RATES else 0)
        if len(set(alike.values())) > 1:
            found = ", ".join(f"{name} in {record.units[name]}" for name in alike)
            raise UnitMismatchError(
                f"found {found}; expected one unit, and a rate in that unit per second; convert a "
                "column, or correct its unit with --unit"
            )


def _plain_unit(unit: str, seconds: int = 0) -> str:
    """A unit times seconds to a power; radians are numbers."""
    factors = unit_factors(unit)
    factors["s"] = factors.get("s", 0) + seconds
    factors.pop("rad", None)
    return unit_product(dict(sorted(factors.items())))


def show_models(as_json: bool) -> None:
    """Print the models with their channels and parameters."""
    document: dict[str, Any] = {}
    blocks: list[str | Table] = []
    for name, make in MODELS.items():
        model = make()
        rows = [(p.name, p.unit, p.description) for p in model.parameters]
        told = [dict(zip(("name", "unit", "description"), row, strict=True)) for row in rows]
        sides = {"inputs": model.input_names, "outputs": model.output_names}
        document[name] = {**sides, "parameters": told}
        inputs, outputs = (", ".join(names) for names in sides.values())
        blocks.append(f"{name}: {outputs} from {inputs}")
        blocks.append(tables.make_table(("parameter", "unit", "description"), [rows]))
    if as_json:
        show_json(document)
    else:
        show(*blocks)
