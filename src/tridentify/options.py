"""What can be asked of an estimate, as a list for forms, and what the answers become.

`list_options` names every choice with its type, default, help and switch of the command line;
`from_options` makes of answers in words the structure and the method that `identify` takes. The
workbench is built on both.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

from tridentify.errors import OptionError, shown
from tridentify.estimation.methods.base import Method
from tridentify.judgement.choice import METHODS
from tridentify.physical import MODELS
from tridentify.structure import AutoStructure, Structure

Kind = Literal["choice", "text"]
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"

FLAGS: Mapping[str, str] = MappingProxyType({"auto": "auto", "yes": "yes", "no": "no"})


@dataclass(frozen=True)
class Option:
    """One choice.

    Attributes
    ----------
    name, label, help, group : str
    type : {"choice", "text"}
    switch : str
        Of the command ``tridentify identify``, or of ``tridentify physical`` for a physical map.
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
    switch: str
    choices: tuple[str, ...] = field(default=())

    def to_dict(self) -> dict[str, Any]:
        """The same in plain types, as JSON has them."""
        return {**self.__dict__, "choices": list(self.choices)}


def _switch(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _chosen(
    name: str, label: str, choices: Sequence[str], words: str, group: str, switch: str = ""
) -> Option:
    own = switch or _switch(name)
    return Option(name, label, "choice", choices[0], words, group, own, tuple(choices))


def _typed(name: str, label: str, default: str, words: str, group: str, switch: str = "") -> Option:
    return Option(name, label, "text", default, words, group, switch or _switch(name))


MODEL, RECORD, NOISE, KNOWN = "Model", "Record", "Noise and method", "What is known"

OPTIONS: tuple[Option, ...] = (
    Option(
        "poles", "Poles", "choice", "2",
        "Degree of the denominator; auto: chosen for you among several orders.",
        MODEL, "--poles", ("auto", "1", "2", "3", "4", "5", "6", "8"),
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
        "drift", "Drift", ("as it comes", *FLAGS),
        "A straight line under each output; as it comes: only behind an integrator.", RECORD,
    ),
    _chosen(
        "initial_state", "Initial state", ("auto", "rest", "equilibrium", "free"),
        "What the plant was doing when the record begins.", RECORD,
    ),
    _chosen(
        "intersample", "Between samples", ("as the record", "auto", "zoh", "foh", "band-limited"),
        "What the input does between its samples: held, linear, or without steps.", RECORD,
        "--intersample",
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
    _chosen(
        "controller", "How it works", ("unknown", "sampled", "continuous"),
        "How that controller works between the samples, where its reference is recorded.", NOISE,
    ),
    _typed("fixed", "Fixed", "", "Coefficients that are known: a0=12, b1=0.", KNOWN, "--fix"),
    _typed("bounds", "Bounds", "", "Limits of coefficients: a1=0:3, b0=0:.", KNOWN, "--bound"),
    _typed(
        "priors", "Known roughly", "", "Value and standard deviation: a0=12+-0.5.", KNOWN,
        "--prior",
    ),
    _chosen(
        "physical", "Physical map", ("none", *MODELS),
        "Physical parameters behind the coefficients.", KNOWN, "--model",
    ),
    _typed("known", "Known parameters", "", "Of the physical map: mass=1.2, R=4+-0.1.", KNOWN),
)  # fmt: skip

GIVEN_TO_METHOD = ("noise", "loss", "route", "controller")
DEFAULTS: Mapping[str, str] = MappingProxyType({one.name: one.default for one in OPTIONS})


def list_options() -> tuple[Option, ...]:
    """All that can be asked of an estimate, in the order of a form.

    Returns
    -------
    tuple of Option

    Examples
    --------
    >>> [option.name for option in list_options()][:3]
    ['poles', 'zeros', 'delay']
    >>> next(option.choices for option in list_options() if option.name == "noise")
    ('auto', 'white', 'ar')
    """
    return OPTIONS


def from_options(options: Mapping[str, Any]) -> tuple[Structure | AutoStructure, Method]:
    """The structure and the method that answers in words stand for.

    Parameters
    ----------
    options : mapping of str to str
        Name of an `Option` to what is chosen; the others keep their default. What concerns the
        record (``intersample``) or a physical map is checked, and no part of the result.

    Returns
    -------
    structure : Structure or AutoStructure
        The latter for ``{"poles": "auto"}``: `identify` then chooses the orders.
    method : Method

    Raises
    ------
    OptionError
        There is no such option or choice, or a text is not a number or knowledge of coefficients.
    StructureError
        The orders do not go together.

    Examples
    --------
    >>> structure, method = from_options({"poles": 2, "fixed": "a0=4", "noise": "white"})
    >>> structure.zeros, dict(structure.fixed), method.noise
    (1, {'a0': 4.0}, 'white')
    """
    chosen = checked(options)
    known_parameters(chosen)
    return structure_of(chosen), method_of(chosen)


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
    if not isinstance(given, Mapping):
        raise OptionError.found("the options ", given, "names and choices", 'write {"poles": 2}')
    for name, value in given.items():
        if name not in known:
            raise OptionError(
                f"found the option {shown(name)}; expected one of {', '.join(known)}; leave it out"
            )
        choices = known[name].choices
        if choices and str(value) not in choices:
            raise OptionError.found(
                f"{name} = ", str(value), f"one of {', '.join(choices)}", "choose one"
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
        _check_open(chosen)
        return Structure.auto(**terms)
    poles, zeros = _orders(chosen)
    return Structure(poles=poles, zeros=zeros, **terms, **_knowledge(chosen))


def _check_open(chosen: Mapping[str, str]) -> None:
    """Refuse what is said of coefficients whose number is not known yet."""
    for name in ("zeros", "fixed", "bounds", "priors"):
        if chosen[name] != DEFAULTS[name]:
            raise OptionError(
                f"found {name} = {shown(chosen[name])} with poles = auto; expected a number of "
                f"poles with it; choose their number, or leave {name} as it comes"
            )


def _orders(chosen: Mapping[str, str]) -> tuple[int, int]:
    poles = int(chosen["poles"])
    return poles, poles - 1 if chosen["zeros"] == "auto" else int(chosen["zeros"])


def _terms(chosen: Mapping[str, str]) -> dict[str, Any]:
    terms: dict[str, Any] = {}
    if chosen["delay"] not in ("", "0"):
        terms["delay"] = chosen["delay"] if chosen["delay"] == "free" else _seconds(chosen["delay"])
    for name, by_itself in (("offset", "auto"), ("drift", "as it comes")):
        if chosen[name] != by_itself:
            terms[name] = {"yes": True, "no": False}.get(chosen[name], "auto")
    if chosen["initial_state"] != "auto":
        terms["initial_state"] = chosen["initial_state"]
    return terms


def _seconds(text: str) -> float:
    if not re.fullmatch(NUMBER, text):
        raise OptionError.found("the delay ", text, "seconds such as 0.12, or free")
    return float(text)


def _knowledge(chosen: Mapping[str, str]) -> dict[str, Any]:
    examples = {"bounds": "a1=0:3", "priors": "a0=12+-0.5", "fixed": "a0=12"}
    found = read_knowledge(lambda kind, value: _named(kind, chosen[kind], value, examples[kind]))
    return {name: values for name, values in found.items() if values}


def read_knowledge(parts: Callable[[str, str], Mapping[str, tuple[str, ...]]]) -> dict[str, Any]:
    """What is known of coefficients, as `Structure` takes it.

    Parameters
    ----------
    parts : callable
        Takes ``fixed``, ``bounds`` or ``priors`` and what a value of this kind looks like, a
        regular expression; gives the groups of each value by the name of the coefficient.

    Examples
    --------
    >>> texts = {"fixed": {"a0": ("3",)}, "bounds": {"b0": ("0", None)}, "priors": {}}
    >>> read_knowledge(lambda kind, value: texts[kind])
    {'fixed': {'a0': 3.0}, 'bounds': {'b0': (0.0, None)}, 'priors': {}}
    """
    pairs = parts("bounds", rf"({NUMBER})?\s*:\s*({NUMBER})?")
    spreads = parts("priors", rf"({NUMBER})\s*\+-\s*({NUMBER})")
    fixed = parts("fixed", rf"({NUMBER})")
    return {
        "fixed": {name: float(value) for name, (value,) in fixed.items()},
        "bounds": {
            name: (float(low) if low else None, float(high) if high else None)
            for name, (low, high) in pairs.items()
        },
        "priors": {name: (float(mean), float(std)) for name, (mean, std) in spreads.items()},
    }


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
    asked = {key: chosen[key] for key in GIVEN_TO_METHOD if chosen[key] != DEFAULTS[key]}
    make: Any = METHODS[chosen["method"]]
    try:
        method: Method = make(**asked)
    except OptionError:
        raise
    except TypeError:
        given = ", ".join(f"{name}={value}" for name, value in asked.items())
        raise OptionError(
            f"found {given} with the method {chosen['method']}, which has no such choice; expected "
            "it with three-model; leave it as it comes or choose that method"
        ) from None
    return method


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
