"""Numbers and polynomials as the blocks of a diagram show them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tridentify.numerics.arrays import Array
from tridentify.writing.layout import format_std, format_value

FINE = 3e-5
"""Relative error below which further digits are not worth the room."""

_UP = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_DOWN = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def power(number: int) -> str:
    """An exponent.

    Examples
    --------
    >>> "p" + power(12)
    'p¹²'
    """
    return str(number).translate(_UP)


def index(number: int) -> str:
    """An index.

    Examples
    --------
    >>> "W" + index(10)
    'W₁₀'
    """
    return str(number).translate(_DOWN)


def number(value: float, digits: int = 4) -> str:
    """A number to some digits, with a true minus sign.

    Examples
    --------
    >>> number(-0.123456), number(1.2e-9, 2), number(float("nan"))
    ('−0.1235', '1.2e-09', 'unknown')
    """
    if math.isnan(value):
        return "unknown"
    text = f"{value:.{digits}g}"
    return f"−{text[1:]}" if text.startswith("-") else text


def terms(coefficients: Sequence[float] | Array, std: Sequence[float] | Array) -> list[str]:
    """A polynomial in p, term by term, with one standard error on each coefficient.

    Examples
    --------
    >>> terms([1.0, 1.02, -3.0], [0.0, 0.04, 0.0])
    ['p²', '+ (1.020 ± 0.040) p', '− 3']
    """
    found: list[str] = []
    for k, (value, error) in enumerate(zip(coefficients, std, strict=True)):
        degree = len(coefficients) - 1 - k
        factor = "" if degree == 0 else "p" if degree == 1 else f"p{power(degree)}"
        sign = "−" if value < 0 else "+"
        if error > 0 and math.isfinite(error):
            digits = max(error, FINE * abs(value))
            size = f"({format_value(abs(value), digits)} ± {format_std(error)})"
        else:
            size = format_value(abs(value))
            size = "" if size == "1" and factor else size
        term = " ".join(part for part in (size, factor) if part)
        first = f"− {term}" if sign == "−" else term
        found.append(f"{sign} {term}" if found else first)
    return found


def pole(real: float, imag: float) -> str:
    """A pole, its conjugate understood.

    Examples
    --------
    >>> pole(-0.5, 2.0), pole(-3.0, 0.0)
    ('−0.5 + 2j', '−3')
    """
    if not imag:
        return number(real)
    sign = "−" if imag < 0 else "+"
    return f"{number(real, 3)} {sign} {number(abs(imag), 3)}j"


def elided(count: int, most: int) -> list[int]:
    """Positions to show of many, -1 for those in the middle that are left out.

    Examples
    --------
    >>> elided(4, 5), elided(20, 5)
    ([0, 1, 2, 3], [0, 1, -1, 18, 19])
    """
    if count <= most:
        return list(range(count))
    head = most // 2
    tail = most - 1 - head
    return [*range(head), -1, *range(count - tail, count)]
