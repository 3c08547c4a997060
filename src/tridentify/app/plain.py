"""Values as JSON has them: what is not finite becomes null, arrays become lists.

Advice in the words of the page: where Python or a switch is named, the field that does the same.

A finding says what to do as the package and the command line take it (``delay='free'``,
``--noise ar``). Whoever looks at the page has fields with labels instead.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tridentify.estimation.answer.finding import Finding
from tridentify.options import list_options

DIGITS = 7
"""Of what is drawn: a screen shows four, and the answer is a third of its size."""


def saved_as(name: str, ending: str) -> str:
    """The file that a model of this name is exported to.

    Examples
    --------
    >>> saved_as("Model 1", ".json")
    'Model_1.json'
    """
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", name).strip("_") or "model"
    return f"{stem}{ending}"


def number(value: float | None) -> float | None:
    """A float, or null where it is none."""
    if value is None or not math.isfinite(value):
        return None
    return float(value)


def listed(values: ArrayLike) -> list[float | None]:
    """A list of numbers to be drawn.

    Examples
    --------
    >>> listed([1.0, float("nan"), 2.123456789])
    [1.0, None, 2.123457]
    """
    array = np.asarray(values, dtype=float).ravel()
    finite = np.isfinite(array)
    size = np.where(finite & (array != 0), np.abs(array), 1.0)
    scale = 10.0 ** (DIGITS - 1 - np.floor(np.log10(size)))
    usable = finite & np.isfinite(scale) & (scale > 0.0)
    rounded = np.where(usable, np.round(np.where(usable, array * scale, 0.0)) / scale, array)
    found: list[float | None] = rounded.tolist()
    if not finite.all():
        for k in np.flatnonzero(~finite):
            found[k] = None
    return found


def finding(one: Finding) -> dict[str, Any]:
    """A finding as the page takes it."""
    return asdict(one) | {
        "advice": in_words_of_the_page(one.remedy),
        "outputs": list(one.outputs),
        "times": [number(t) for t in one.times],
        "effect": one.effect or None,
    }


def findings(found: Sequence[Finding]) -> list[dict[str, Any]]:
    """Findings as they are ranked."""
    return [finding(one) for one in found]


_BRACKETS = re.compile(r" ?\(([^()]*(?:\([^()]*\)[^()]*)*)\)")
_METHOD = re.compile(r"(?<!\.)\bThreeModel\(([^()]*)\)")
_VALUE = r"\{[^}]*\}|'[^']*'|\.\.\.|[-+\w]+(?:\.\w+)?"
_STATED = re.compile(rf"\b([a-z_]+)=({_VALUE})((?: or (?:'[^']*'|a number))*)")
_SWITCH = re.compile(r"--([a-z-]+)((?: [a-z0-9=]+)?(?: or [a-z0-9=]+)*)")
_ELSEWHERE = re.compile(r"--[a-z]|\bselect_structure\b|\bnan\b|\brecord\.[a-z]+\b")
_LABELS = {one.name: one.label.split(" [")[0] for one in list_options()}
_BY_SWITCH = {one.switch.lstrip("-"): _LABELS[one.name] for one in list_options()}


def in_words_of_the_page(remedy: str) -> str:
    """Advice with the fields of the page in place of arguments and switches.

    Parameters
    ----------
    remedy : str
        Of a finding.

    Returns
    -------
    str

    Examples
    --------
    >>> in_words_of_the_page("State the delay (delay=0.1; --delay), or mark them as missing (nan).")
    'State the delay (Delay: 0.1), or mark them as bad samples.'
    >>> in_words_of_the_page("Use noise='ar' (--noise ar), which estimates the noise along.")
    'Use Noise = ar, which estimates the noise along.'
    """
    told = _METHOD.sub(r"\1", remedy)
    told = _BRACKETS.sub(_bracket, told)
    told = _STATED.sub(lambda found: _stated(found, " = ") or found[0], told)
    for label in _LABELS.values():
        name = re.escape(label)
        told = re.sub(rf"(\b{name} = [^().,;]*?) \({name}(?:: [^)]*)?\)", r"\1", told)
    return told.replace("as missing", "as bad samples")


def _bracket(found: re.Match[str]) -> str:
    """What stands in brackets: a field and its value, nothing, or as it was."""
    inside = found[1]
    for one in _STATED.finditer(inside):
        field = _stated(one, ": ")
        if field:
            return f" ({field})"
    for one in _SWITCH.finditer(inside):
        label = _BY_SWITCH.get(one[1])
        if label:
            return f" ({label}:{one[2]})" if one[2] else f" ({label})"
    if "select_structure" in inside:
        return f" ({_LABELS['poles']}: auto)"
    return "" if _ELSEWHERE.search(inside) else found[0]


def _stated(found: re.Match[str], between: str) -> str | None:
    """``name='value'`` as a field and its value; None where the page has no such field."""
    label, value = _LABELS.get(found[1]), found[2]
    if label is None or value == "...":
        return None
    value = {"True": "yes", "False": "no"}.get(value, value)
    value = value.strip("{}").replace("': ", "=") if value.startswith("{") else value
    return f"{label}{between}{value}{found[3]}".replace("'", "")
