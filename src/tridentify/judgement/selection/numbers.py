"""Numbers as a table and a sentence show them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

WORST = -100.0
"""Fit [percent] below which a number says nothing more: the error is twice the output's spread."""


def share(value: float) -> str:
    """A share in words.

    Examples
    --------
    >>> share(0.8), share(25.0)
    ('80 %', 'more than 1000 %')
    """
    return f"{100 * value:.0f} %" if value < 10 else "more than 1000 %"


def relative(value: float) -> str:
    """A standard error over its coefficient, for a table.

    Examples
    --------
    >>> relative(0.034), relative(25.0), relative(float("nan"))
    ('3.4 %', '> 999 %', '')
    """
    if math.isnan(value):
        return ""
    if value > 9.99:
        return "> 999 %"
    return f"{100 * value:.2g} %" if value < 1 else f"{100 * value:.0f} %"


def percent(values: NDArray[np.float64]) -> str:
    """Fit [percent]; of several outputs the least.

    Examples
    --------
    >>> percent(np.array([91.234, 80.0])), percent(np.array([-1e30])), percent(np.array([np.nan]))
    ('80.00', '< -100', '')
    """
    if np.any(values == -np.inf):
        return "unstable"
    seen = values[np.isfinite(values)]
    if not seen.size:
        return ""
    return f"{seen.min():.2f}" if seen.min() >= WORST else "< -100"
