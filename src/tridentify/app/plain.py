"""Values as JSON has them: what is not finite becomes null, arrays become lists."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tridentify.app.wording import in_words_of_the_page
from tridentify.estimation.answer.finding import Finding

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
