"""Small pieces of a page for notebooks: a fraction in s as MathML, a signal as a tiny drawing."""

from __future__ import annotations

import html
import itertools
import math
from collections.abc import Iterable, Sequence

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.writing.layout import format_pair, format_value

WIDTH, HEIGHT = 260, 36
COLUMNS = 260
INK = "#0072B2"


def fraction(
    left: str, num: Sequence[tuple[float, ...]], den: Sequence[tuple[float, ...]], factor: str
) -> str:
    """``left = factor num / den`` as MathML.

    Parameters
    ----------
    left : str
        What the fraction is.
    num, den : sequence of (float, float) or (float, float, float)
        Coefficients in descending powers of s with their standard errors, and to what they are told
        where that is finer (`layout.format_pair`).
    factor : str
        Text before the fraction; may be empty.

    Returns
    -------
    str

    Examples
    --------
    >>> text = fraction("y / u", [(2.0, 0.1)], [(1.0, 0.0), (4.0, 0.2)], "")
    >>> "<mfrac>" in text, "&#177;" in text
    (True, True)
    """
    before = f"<mtext>{html.escape(factor)}</mtext>" if factor else ""
    over = f"<mfrac>{_polynomial(num)}{_polynomial(den)}</mfrac>"
    name = f"<mtext>{html.escape(left)}</mtext>"
    return f'<math display="block">{name}<mo>=</mo>{before}{over}</math>'


def _polynomial(pairs: Sequence[tuple[float, ...]]) -> str:
    terms: list[str] = []
    for k, (value, error, *finer) in enumerate(pairs, 1):
        power = len(pairs) - k
        known = bool(error) and not math.isnan(error)
        sign = "-" if value < 0 and not known else "+"
        if known:
            number, spread, exponent = format_pair(value, error, *finer)
            shown = f"<mo>(</mo>{_number(number)}<mo>&#177;</mo>{_number(spread)}<mo>)</mo>"
            shown = f"<mrow>{shown}{_power(exponent)}</mrow>"
        else:
            number = format_value(abs(value))
            shown = "" if number == "1" and power else _number(number)
        base = "<mi>s</mi>" if power else ""
        raised = f"<msup>{base}<mn>{power}</mn></msup>" if power > 1 else base
        if terms or sign == "-":
            terms.append(f"<mo>{'&#8722;' if sign == '-' else '+'}</mo>")
        terms.append(shown + raised)
    return f"<mrow>{''.join(terms)}</mrow>"


def _number(text: str) -> str:
    """A number, with its exponent as one writes it."""
    digits, _, power = text.partition("e")
    minus = "<mo>&#8722;</mo>" if digits.startswith("-") else ""
    body = f"{minus}<mn>{digits.lstrip('-')}</mn>"
    return body + _power(power)


def _power(exponent: str) -> str:
    """A power of ten behind a number; empty without one."""
    if not exponent:
        return ""
    power = int(exponent.removeprefix("e"))
    return f"<mo>&#183;</mo><msup><mn>10</mn><mn>{power}</mn></msup>"


def sparkline(values: Array, label: str) -> str:
    """A signal as a drawing of a few kilobytes at most; gaps where it is missing.

    Parameters
    ----------
    values : ndarray, shape (n_samples,)
        ``nan`` where missing.
    label : str
        For readers that do not see it.

    Returns
    -------
    str
        An SVG element.

    Examples
    --------
    >>> sparkline(np.array([0.0, 1.0, 0.0]), "u").count("M")
    1
    """
    there = values[np.isfinite(values)]
    low, high = (float(there.min()), float(there.max())) if there.size else (0.0, 1.0)
    size = max(high - low, 1e-300)
    edges = np.unique(np.linspace(0, values.size, min(COLUMNS, values.size) + 1).astype(int))
    path: list[str] = []
    pen = "M"
    for start, stop in itertools.pairwise(edges):
        piece = values[start:stop]
        piece = piece[np.isfinite(piece)]
        if not piece.size:
            pen = "M"
            continue
        x = WIDTH * (start + stop) / 2 / values.size
        for value in _ends(piece):
            y = HEIGHT - 2 - (HEIGHT - 4) * ((value - low) / size if high > low else 0.5)
            path.append(f"{pen}{x:.1f} {y:.1f}")
            pen = "L"
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" role="img" '
        f'aria-label="{html.escape(label, quote=True)}"><path d="{"".join(path)}" fill="none" '
        f'stroke="{INK}" stroke-width="1.2"/></svg>'
    )


def _ends(piece: Array) -> Iterable[float]:
    """Least and greatest value of a stretch in their order; one of a single sample."""
    if piece.size == 1:
        return (float(piece[0]),)
    places = sorted((int(np.argmin(piece)), int(np.argmax(piece))))
    return tuple(float(piece[k]) for k in places)
