"""What can be asked of an estimate: the list that the page shows, and what an answer becomes.

The same choices become a `Structure` and a method, lines of Python, and a command line.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Any, Literal

from tridentify.errors import OptionError, shown
from tridentify.estimation.methods.base import Method
from tridentify.judgement.choice import METHODS
from tridentify.physical import (
    PhysicalModel,
    dc_motor,
    dutch_roll,
    first_order_dead_time,
    mass_spring_damper,
    rc_circuit,
    rcrc_circuit,
    short_period,
)
from tridentify.structure import AutoStructure, Structure

Kind = Literal["choice", "text"]
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"

MAPS: Mapping[str, Callable[[], PhysicalModel]] = MappingProxyType(
    {
        "short-period": short_period,
        "dutch-roll": dutch_roll,
        "mass-spring-damper": mass_spring_damper,
        "first-order-dead-time": first_order_dead_time,
        "rc-circuit": rc_circuit,
        "rcrc-circuit": rcrc_circuit,
        "rcrc-circuit-buffered": partial(rcrc_circuit, buffered=True),
        "dc-motor": dc_motor,
        "dc-motor-current": partial(dc_motor, "current"),
        "dc-motor-speed-current": partial(dc_motor, "both"),
    }
)
"""Physical parameters behind the coefficients, by the name of their map."""

FLAGS: Mapping[str, str] = MappingProxyType({"auto": "auto", "yes": "yes", "no": "no"})


@dataclass(frozen=True)
class Option:
    """One choice.

    Attributes
    ----------
    name, label, help, group : str
    type : {"choice", "text"}
    choices : tuple of str
        Of a choice; none of a text.
    default : str
    """

    name: str
    label: str
    type: Kind
    default: str
    help: str
    group: str
    choices: tuple[str, ...] = field(default=())

    def document(self) -> dict[str, Any]:
        """As the page takes it."""
        return {**self.__dict__, "choices": list(self.choices)}


def _chosen(name: str, label: str, choices: Sequence[str], words: str, group: str) -> Option:
    return Option(name, label, "choice", choices[0], words, group, tuple(choices))


def _typed(name: str, label: str, default: str, words: str, group: str) -> Option:
    return Option(name, label, "text", default, words, group)


MODEL, RECORD, NOISE, KNOWN = "Model", "Record", "Noise and method", "What is known"

OPTIONS: tuple[Option, ...] = (
    Option(
        "poles", "Poles", "choice", "2",
        "Degree of the denominator; auto: chosen for you among several orders.",
        MODEL, ("auto", "1", "2", "3", "4", "5", "6", "8"),
    ),
    _chosen(
        "zeros", "Zeros", ("auto", "0", "1", "2", "3", "4", "5"),
        "Degree of the numerator; auto: one less than the poles.", MODEL,
    ),
    _typed("delay", "Delay [s]", "0", "Dead time in seconds, or free: estimated along.", MODEL),
    _chosen(
        "offset", "Offset", tuple(FLAGS),
        "A constant of each output; auto: where the record asks for it.", RECORD,
    ),
    _chosen(
        "drift", "Drift", ("as offset", *FLAGS),
        "A straight line under each output.", RECORD,
    ),
    _chosen(
        "initial_state", "Initial state", ("auto", "rest", "equilibrium", "free"),
        "What the plant was doing when the record begins.", RECORD,
    ),
    _chosen(
        "intersample", "Between samples", ("as the record", "auto", "zoh", "foh", "band-limited"),
        "What the input does between its samples: held, linear, or without steps.", RECORD,
    ),
    _chosen(
        "noise", "Noise", ("auto", "white", "ar"),
        "White, or with a memory that is estimated along (ar).", NOISE,
    ),
    _chosen(
        "loss", "Loss", ("squared", "huber", "student"),
        "Huber and Student give outliers less weight.", NOISE,
    ),
    _chosen(
        "method", "Method", tuple(METHODS),
        "The three models, or another method of the field to compare with.", NOISE,
    ),
    _chosen(
        "route", "Controller", ("auto", "open-loop", "reference", "direct"),
        "What is made of a controller that may have been running.", NOISE,
    ),
    _typed("fixed", "Fixed", "", "Coefficients that are known: a0=12, b1=0.", KNOWN),
    _typed("bounds", "Bounds", "", "Limits of coefficients: a1=0:3, b0=0:.", KNOWN),
    _typed("priors", "Known roughly", "", "Value and standard deviation: a0=12+-0.5.", KNOWN),
    _chosen(
        "physical", "Physical map", ("none", *MAPS),
        "Physical parameters behind the coefficients.", KNOWN,
    ),
    _typed("known", "Known parameters", "", "Of the physical map: mass=1.2, R=4+-0.1.", KNOWN),
)  # fmt: skip

DEFAULTS: Mapping[str, str] = MappingProxyType({one.name: one.default for one in OPTIONS})


def checked(given: Mapping[str, Any]) -> dict[str, str]:
    """All options, those that were not given at their default.

    Raises
    ------
    OptionError
        There is no such option, or it has no such choice.

    Examples
    --------
    >>> checked({"poles": 3})["poles"], checked({})["noise"]
    ('3', 'auto')
    """
    known = {one.name: one for one in OPTIONS}
    for name, value in given.items():
        if name not in known:
            raise OptionError(
                f"found the option {shown(name)}; expected one of {', '.join(known)}; leave it out"
            )
        choices = known[name].choices
        if choices and str(value) not in choices:
            raise OptionError(
                f"found {name} = {shown(str(value))}; expected one of {', '.join(choices)}; "
                "choose one"
            )
    return {**DEFAULTS, **{name: str(value).strip() for name, value in given.items()}}


def structure_of(chosen: Mapping[str, str]) -> Structure | AutoStructure:
    """The structure that is asked for.

    Parameters
    ----------
    chosen : mapping of str to str
        As `checked` gives it.

    Raises
    ------
    OptionError, StructureError
        A text is not a number, or not knowledge of coefficients, or the orders do not go together.

    Examples
    --------
    >>> structure_of(checked({"poles": 2, "fixed": "a0=4"})).fixed
    mappingproxy({'a0': 4.0})
    """
    terms = _terms(chosen)
    if chosen["poles"] == "auto":
        return AutoStructure(template=Structure(1, 0, **terms))
    poles, zeros = _orders(chosen)
    return Structure(poles=poles, zeros=zeros, **terms, **_knowledge(chosen))


def _orders(chosen: Mapping[str, str]) -> tuple[int, int]:
    poles = int(chosen["poles"])
    return poles, poles - 1 if chosen["zeros"] == "auto" else int(chosen["zeros"])


def _terms(chosen: Mapping[str, str]) -> dict[str, Any]:
    terms: dict[str, Any] = {}
    if chosen["delay"] not in ("", "0"):
        terms["delay"] = chosen["delay"] if chosen["delay"] == "free" else _seconds(chosen["delay"])
    for name, by_itself in (("offset", "auto"), ("drift", "as offset")):
        if chosen[name] != by_itself:
            terms[name] = {"yes": True, "no": False}.get(chosen[name], "auto")
    if chosen["initial_state"] != "auto":
        terms["initial_state"] = chosen["initial_state"]
    return terms


def _seconds(text: str) -> float:
    if not re.fullmatch(NUMBER, text):
        raise OptionError(
            f"found the delay {shown(text)}; expected seconds such as 0.12, or free; correct it"
        )
    return float(text)


def _knowledge(chosen: Mapping[str, str]) -> dict[str, Any]:
    pairs = _named("bounds", chosen["bounds"], rf"({NUMBER})?\s*:\s*({NUMBER})?", "a1=0:3")
    spreads = _named("priors", chosen["priors"], rf"({NUMBER})\s*\+-\s*({NUMBER})", "a0=12+-0.5")
    fixed = _named("fixed", chosen["fixed"], rf"({NUMBER})", "a0=12")
    found = {
        "fixed": {name: float(value) for name, (value,) in fixed.items()},
        "bounds": {
            name: (float(low) if low else None, float(high) if high else None)
            for name, (low, high) in pairs.items()
        },
        "priors": {name: (float(mean), float(std)) for name, (mean, std) in spreads.items()},
    }
    return {name: values for name, values in found.items() if values}


def known_parameters(chosen: Mapping[str, str]) -> dict[str, float | tuple[float, float]]:
    """What is known of the parameters of the physical map."""
    given = _named("known", chosen["known"], rf"({NUMBER})(?:\s*\+-\s*({NUMBER}))?", "mass=1.2")
    return {
        name: (float(value), float(std)) if std else float(value)
        for name, (value, std) in given.items()
    }


def _named(option: str, text: str, value: str, example: str) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for part in filter(None, (one.strip() for one in re.split(r"[,;]", text))):
        match = re.fullmatch(rf"([^\s=]+)\s*=\s*{value}", part)
        if match is None:
            raise OptionError(
                f"found {shown(part)} in {option}; expected a name and its value such as "
                f"{example}, several with commas between; correct it"
            )
        name, *numbers = match.groups()
        found[name] = tuple(numbers)
    return found


def method_of(chosen: Mapping[str, str]) -> Method:
    """The method with its options.

    Raises
    ------
    OptionError
        The method has no such choice.
    """
    asked = _method_options(chosen)
    make: Any = METHODS[chosen["method"]]
    try:
        method: Method = make(**asked)
    except TypeError:
        given = ", ".join(f"{name}={value}" for name, value in asked.items())
        raise OptionError(
            f"found {given} with the method {chosen['method']}, which has no such choice; expected "
            "it with three-model; leave it as it comes or choose that method"
        ) from None
    return method


def _method_options(chosen: Mapping[str, str]) -> dict[str, str]:
    return {
        name: chosen[name] for name in ("noise", "loss", "route") if chosen[name] != DEFAULTS[name]
    }


def words_of(structure: Structure) -> str:
    """Orders as a card shows them.

    Examples
    --------
    >>> words_of(Structure(2, 1)), words_of(Structure(1, 0, delay="free"))
    ('2 poles, 1 zero', '1 pole, no zero, delay')
    """
    poles, zeros = structure.poles, structure.zeros
    late = ", delay" if structure.delay == "free" or structure.delay else ""
    if not isinstance(poles, int):
        return f"poles of their own for each channel{late}"
    count = f"{poles} pole{'s' if poles > 1 else ''}"
    if not isinstance(zeros, int):
        return f"{count}{late}"
    return f"{count}, {zeros or 'no'} zero{'s' if zeros > 1 else ''}{late}"
