"""One or several models, however they are given, each with the name it goes by."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tridentify.errors import ChannelNameError, OptionError, SampleTypeError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

Model = Estimate | TransferFunction
Models = Model | Sequence[Model] | Mapping[str, Model]
"""What every picture and `compare` take."""

AT_ZERO = 1e-6
"""Of a pole times the record's length: it turns a constant input into a ramp to a millionth."""


@dataclass(frozen=True, eq=False)
class Entry:
    """A model among others.

    Attributes
    ----------
    name : str
    model : TransferFunction
    estimate : Estimate or None
        None for a model without standard errors.
    """

    name: str
    model: TransferFunction
    estimate: Estimate | None = field(default=None)

    @property
    def units(self) -> Mapping[str, str]:
        """Channel to unit, as far as they are known."""
        return {} if self.estimate is None else self.estimate.units

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return self.model.input_names if self.estimate is None else self.estimate.input_names

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs."""
        return self.model.output_names if self.estimate is None else self.estimate.output_names

    @property
    def unnamed(self) -> bool:
        """Whether its channels were given no names."""
        return made_up(self.input_names, self.output_names)


def made_up(input_names: Sequence[str], output_names: Sequence[str]) -> bool:
    """Whether the names of channels are those that nobody gave.

    Examples
    --------
    >>> made_up(("u1", "u2"), ("y",)), made_up(("u",), ("q",))
    (True, False)
    """
    inputs, outputs = len(input_names), len(output_names)
    usual = [
        tuple(f"{letter}{k}" for k in range(1, count + 1)) if count > 1 else (letter,)
        for letter, count in (("u", inputs), ("y", outputs))
    ]
    return (tuple(input_names), tuple(output_names)) == tuple(usual)


def entries_of(
    models: object, names: Sequence[str] | None = None, *, example: str = "plot_bode(estimate)"
) -> tuple[Entry, ...]:
    """Whatever was given, as models with names.

    Parameters
    ----------
    models : Estimate, TransferFunction, sequence of these, or mapping of names to them
    names : sequence of str, optional
        One a model; by default the keys of a mapping, the orders where they differ, else the
        methods.
    example : str
        How one writes the call, for the message of an error.

    Returns
    -------
    tuple of Entry
        At least one.

    Raises
    ------
    SampleTypeError
        Something else was given.
    OptionError
        There is none, or the names are not as many.

    Examples
    --------
    >>> pair = [TransferFunction([1.0], [1.0, 1.0]), TransferFunction([1.0], [1.0, 1.0, 2.0])]
    >>> [entry.name for entry in entries_of(pair)]
    ['1 pole, 0 zeros', '2 poles, 0 zeros']
    """
    keys: Sequence[str] | None = names
    found: list[Any]
    if isinstance(models, Mapping):
        found = list(models.values())
        keys = [str(key) for key in models] if names is None else names
    elif isinstance(models, Estimate | TransferFunction) or not isinstance(models, Iterable):
        found = [models]
    else:
        found = [] if isinstance(models, str) else list(models)
        found = [models] if isinstance(models, str) else found
    if not found:
        raise OptionError(
            f"found no model; expected an estimate or a transfer function, or several; write "
            f"{example}"
        )
    for one in found:
        if not isinstance(one, Estimate | TransferFunction):
            kind = "a Record" if isinstance(one, Record) else shown(type(one).__name__)
            raise SampleTypeError(
                f"found {kind} in place of a model; expected an Estimate or a TransferFunction, "
                f"or a list or mapping of these; write {example}"
            )
    if keys is not None and (isinstance(keys, str) or len(keys) != len(found)):
        many = 1 if isinstance(keys, str) else len(keys)
        raise OptionError(
            f"found {many} names for {len(found)} models; expected one each; give as many in a list"
        )
    called = _default_names(found) if keys is None else [str(key) for key in keys]
    return tuple(
        Entry(name, one.model, one) if isinstance(one, Estimate) else Entry(name, one)
        for name, one in zip(called, found, strict=True)
    )


def same_channels(entries: Sequence[Entry]) -> None:
    """Refuse models of different channels where one picture is to hold all of them.

    Raises
    ------
    ChannelNameError
        Names or numbers of channels differ; names that nobody gave stand for any.
    """
    named = next((entry for entry in entries if not entry.unnamed), entries[0])
    wanted = (named.input_names, named.output_names)
    for entry in entries:
        own = (entry.input_names, entry.output_names)
        found, other = (" / ".join(map(_listed, names)) for names in (own, wanted))
        fits = tuple(map(len, own)) == tuple(map(len, wanted)) and (entry.unnamed or own == wanted)
        if not fits:
            raise ChannelNameError(
                f"found models of {found} and {other}; expected the same inputs and outputs in "
                "one picture; draw them apart, or pick channel(output, input) of their models"
            )


def _listed(names: Sequence[str]) -> str:
    return shown(", ".join(names), 60)


def orders_text(model: TransferFunction) -> str:
    """Number of poles and zeros in words; the most of any channel.

    Examples
    --------
    >>> orders_text(TransferFunction([1.0, 2.0], [1.0, 1.0, 3.0]))
    '2 poles, 1 zero'
    """
    poles = max(den.size - 1 for row in model.den for den in row)
    zeros = max(num.size - 1 for row in model.num for num in row)
    return f"{poles} pole{'' if poles == 1 else 's'}, {zeros} zero{'' if zeros == 1 else 's'}"


def _default_names(models: Sequence[Model]) -> list[str]:
    """Orders where they tell the models apart, else methods, numbered where they repeat."""
    if len(models) == 1:
        return [_method(models[0])]
    kinds: tuple[Callable[[Model], str], ...] = (_orders, _method, _both)
    tellings = [[kind(one) for one in models] for kind in kinds]
    counts = [len(set(found)) for found in tellings]
    # the shortest of those that tell most models apart
    found = tellings[counts.index(max(counts))]
    if max(counts) == 1:
        found = tellings[1]
    return [
        f"{name} {found[: k + 1].count(name)}" if found.count(name) > 1 else name
        for k, name in enumerate(found)
    ]


def _both(one: Model) -> str:
    return f"{_orders(one)}, {_method(one)}"


def _orders(one: Model) -> str:
    return orders_text(one.model if isinstance(one, Estimate) else one)


def _method(one: Model) -> str:
    return one.method if isinstance(one, Estimate) else "model"


def integrates(model: TransferFunction, duration: float) -> bool:
    """Whether a pole lies at zero, or so near that a record cannot tell.

    Parameters
    ----------
    model : TransferFunction
    duration : float
        Of the record [s].

    Examples
    --------
    >>> integrates(TransferFunction([1.0], [1.0, 2.0, 0.0]), 10.0)
    True
    """
    poles = np.concatenate([np.roots(den) for row in model.den for den in row])
    return bool(np.any(np.abs(poles) * duration < AT_ZERO))
