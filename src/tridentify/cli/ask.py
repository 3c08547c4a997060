"""What is asked of the records: options as text, turned into a structure and a method.

What is known of the coefficients is one of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Literal, TypeVar

from tridentify.errors import ChannelCountError, OptionError, OrderError, shown
from tridentify.estimation.methods.base import Method
from tridentify.options import NUMBER, read_knowledge

_NAME = r"\s*([^\s=]+)\s*=\s*"


def known_from(
    fixed: Sequence[str], bounds: Sequence[str], priors: Sequence[str], gains: Sequence[str]
) -> dict[str, Any]:
    """Read ``--fix``, ``--bound``, ``--prior`` and ``--gain`` into options of `Structure`.

    Parameters
    ----------
    fixed : sequence of str
        ``a0=3``.
    bounds : sequence of str
        ``b0=0:5``, a side left empty for no limit.
    priors : sequence of str
        ``a0=3+-0.1``: mean and standard deviation.
    gains : sequence of str
        One number for all channels, or one text for each output with a number for each input and
        commas between, ``?`` where it is unknown.

    Returns
    -------
    dict
        ``fixed``, ``bounds``, ``priors`` and ``static_gain``.

    Raises
    ------
    OptionError
        A text is none of these, or a coefficient is named twice by one option.
    ChannelCountError
        The gains of several outputs are for different numbers of inputs.

    Examples
    --------
    >>> known_from(["a0=3"], ["b0=0:"], ["a1=1+-0.1"], ["2"])
    {'fixed': {'a0': 3.0}, 'bounds': {'b0': (0.0, None)}, 'priors': {'a1': (1.0, 0.1)}, \
'static_gain': 2.0}
    """
    given = {
        "bounds": ("--bound", bounds, "b0=0: or b0=0:5"),
        "priors": ("--prior", priors, "a0=3+-0.1"),
        "fixed": ("--fix", fixed, "a0=3"),
    }
    found = read_knowledge(lambda kind, value: _by_name(*given[kind], value))
    return {**found, "static_gain": _gain(gains)}


def _by_name(
    option: str, given: Sequence[str], example: str, value: str
) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for text in given:
        match = re.fullmatch(_NAME + value + r"\s*", text)
        if match is None:
            raise OptionError.found(
                f"{option} ", text, f"a coefficient and its value such as {example}"
            )
        name, *parts = match.groups()
        if name in found:
            raise OptionError.found(f"{option} twice for ", name, "it once", "drop one of the two")
        found[name] = tuple(parts)
    return found


def _gain(given: Sequence[str]) -> float | list[list[float | None]] | None:
    rows: list[list[float | None]] = []
    for text in given:
        cells = [cell.strip() for cell in text.split(",")]
        if not all(cell == "?" or re.fullmatch(NUMBER, cell) for cell in cells):
            raise OptionError(
                f"found --gain {shown(text)}; expected a number, or one for each input such as "
                "1.5,? where the second is unknown; correct it"
            )
        rows.append([None if cell == "?" else float(cell) for cell in cells])
    if not rows:
        return None
    if len({len(row) for row in rows}) > 1:
        raise ChannelCountError(
            f"found --gain {' --gain '.join(given)}; expected the same number of inputs for each "
            "output; write ? where a gain is unknown"
        )
    return rows[0][0] if len(rows) == 1 and len(rows[0]) == 1 else rows


Number = TypeVar("Number", int, float)


def nested_zeros(given: Sequence[str], n_outputs: int, n_inputs: int) -> int | list[list[int]]:
    """Read the numbers of zeros.

    Parameters
    ----------
    given : sequence of str
        One number; or for each output a number, or a number for each input with commas between.
    n_outputs, n_inputs : int

    Returns
    -------
    int or list of list of int, ``[output][input]``

    Raises
    ------
    OrderError, ChannelCountError
        Something else is given, or for other numbers of channels.

    Examples
    --------
    >>> nested_zeros(["1"], 2, 1), nested_zeros(["1", "0"], 2, 1), nested_zeros(["1,0"], 1, 2)
    (1, [[1], [0]], [[1, 0]])
    """
    return _nested("--zeros", _orders("--zeros", given), given, n_outputs, n_inputs)


def nested_poles(given: Sequence[str], n_outputs: int, n_inputs: int) -> int | list[list[int]]:
    """Read the numbers of poles: one of a shared denominator, or those of separate ones.

    Parameters
    ----------
    given : sequence of str
        As for `nested_zeros`; a single number means one denominator for all channels.
    n_outputs, n_inputs : int

    Returns
    -------
    int or list of list of int, ``[output][input]``

    Raises
    ------
    OrderError, ChannelCountError
        Something else is given, or for other numbers of channels.

    Examples
    --------
    >>> nested_poles(["2"], 1, 2), nested_poles(["2,1"], 1, 2), nested_poles(["2", "1"], 2, 1)
    (2, [[2, 1]], [[2], [1]])
    """
    return _nested("--poles", _orders("--poles", given), given, n_outputs, n_inputs)


def chooses_orders(poles: Sequence[str], zeros: Sequence[str], known: bool) -> bool:
    """Whether the record is to choose the orders: no --poles, or --poles auto.

    Raises
    ------
    OrderError
        Only one of --poles and --zeros says something, or coefficients are stated of a structure
        that is not.

    Examples
    --------
    >>> chooses_orders([], [], False), chooses_orders(["auto"], [], False)
    (True, True)
    >>> chooses_orders(["2"], ["1"], True)
    False
    """
    auto = not poles or [one.strip() for one in poles] == ["auto"]
    if auto and zeros:
        raise OrderError(
            f"found --zeros {zeros[0]} without a number of --poles; expected both, or neither for "
            "orders that the record chooses; state --poles"
        )
    if auto and known:
        raise OrderError(
            "found knowledge of coefficients without --poles; expected --poles and --zeros, as a "
            "coefficient belongs to its order; state them"
        )
    if not auto and not zeros:
        raise OrderError(
            f"found --poles {poles[0]} without --zeros; expected both, or --poles auto; state "
            "--zeros"
        )
    return auto


def nested_delays(
    given: Sequence[str], n_outputs: int, n_inputs: int
) -> float | list[list[float]] | Literal["free"]:
    """Read the dead times.

    Parameters
    ----------
    given : sequence of str
        Nothing, ``free``, or seconds as for `nested_zeros`.
    n_outputs, n_inputs : int

    Returns
    -------
    float, list of list of float ``[output][input]``, or "free"

    Raises
    ------
    OptionError, ChannelCountError
        Something else is given, or for other numbers of channels.

    Examples
    --------
    >>> nested_delays([], 1, 1), nested_delays(["free"], 1, 1), nested_delays(["0.1,0"], 1, 2)
    (0.0, 'free', [[0.1, 0.0]])
    """
    if not given:
        return 0.0
    if [text.strip() for text in given] == ["free"]:
        return "free"
    rows = []
    for text in given:
        cells = [cell.strip() for cell in text.split(",")]
        if not all(re.fullmatch(NUMBER, cell) for cell in cells):
            raise OptionError(
                f"found --delay {shown(text)}; expected seconds such as 0.1, or for each input "
                "such as 0.1,0, or free alone; correct it"
            )
        rows.append([float(cell) for cell in cells])
    return _nested("--delay", rows, given, n_outputs, n_inputs)


def _orders(option: str, given: Sequence[str]) -> list[list[int]]:
    rows = []
    for text in given:
        if not re.fullmatch(r"\s*\d{1,4}\s*(,\s*\d{1,4}\s*)*", text):
            raise OrderError.found(
                f"{option} ", text, "a whole number such as 1, or one for each input such as 1,0"
            )
        rows.append([int(number) for number in text.split(",")])
    return rows


def _nested(
    option: str, rows: list[list[Number]], given: Sequence[str], n_outputs: int, n_inputs: int
) -> Number | list[list[Number]]:
    """Spread numbers over outputs and inputs; a single one stays what it is."""
    if len(rows) == 1 and len(rows[0]) == 1:
        return rows[0][0]
    if len(rows) == 1:
        rows = rows * n_outputs
    if len(rows) != n_outputs or any(len(row) not in (1, n_inputs) for row in rows):
        raise ChannelCountError(
            f"found {' '.join(f'{option} {text}' for text in given)} for {n_outputs} outputs and "
            f"{n_inputs} inputs; expected it once, or once for each output, with one number or one "
            "for each input; correct it"
        )
    return [row * n_inputs if len(row) == 1 else row for row in rows]


BY_ITSELF = {"noise": "auto", "loss": "squared", "route": "auto", "controller": "unknown"}
"""Option of a method -> what it is where nobody asks."""


def chosen_method(name: str, **options: str) -> Method:
    """Make the method with its options.

    Parameters
    ----------
    name : str
        A key of `judgement.choice.METHODS` or `METHODS_IN_LOOP`.
    **options : str
        ``noise``, ``loss``, ``route``, ``controller``; what is at its default is not asked for.

    Returns
    -------
    Method

    Raises
    ------
    OptionError
        The method does not exist, or has no such choice.
    """
    from tridentify.judgement.choice import METHODS, METHODS_IN_LOOP

    known = {**METHODS, **METHODS_IN_LOOP}
    if name not in known:
        raise OptionError.found("--method ", name, f"one of {', '.join(known)}", "choose one")
    asked = {option: value for option, value in options.items() if value != BY_ITSELF[option]}
    for option, value in asked.items():
        if not _offers(known[name], option):
            able = ", ".join(key for key, make in known.items() if _offers(make, option))
            raise OptionError(
                f"found --{option} {value} with --method {name}, which has no choice of the "
                f"{option}; expected --{option} with --method {able} only; leave it out or choose "
                "another method"
            )
    plain: Any = known[name]()
    method: Method = replace(plain, **asked)
    return method


def _offers(make: Callable[[], Method], option: str) -> bool:
    return hasattr(make(), option)
