"""Plain-text layout of results: values with errors, tables, polynomials, and units as products."""

from __future__ import annotations

import dataclasses
import html
import math
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction

MOST_POWER = 300
"""Of ten: beyond it a power leaves the range of a float."""

MOST_DIGITS = 9
"""Behind the point: `format_value` shows ten of a value at most."""

_SUPPORTED_UNIT = re.compile(r"[^\s/*^0-9()]+(\^-?\d+)?([*/][^\s/*^0-9()]+(\^-?\d+)?)*")


def printable(text: str) -> str:
    r"""Escape what a terminal would obey instead of show; everything else stays as it is.

    Parameters
    ----------
    text : str
        Such as the name of a file, which may hold anything.

    Returns
    -------
    str
        Without control characters, line breaks, marks of direction, characters of no width, and
        bytes of a file name that are no text.

    Examples
    --------
    >>> printable("température"), printable("a\u202eb\x1b[31m\n"), printable("caf\udce9")
    ('température', 'a\\u202eb\\x1b[31m\\n', 'caf\\udce9')
    """
    if text.isprintable():
        return text
    kept = (
        c if c.isprintable() or unicodedata.category(c) == "Zs" else ascii(c)[1:-1] for c in text
    )
    return "".join(kept)


def format_value(value: float, std: float = 0.0) -> str:
    """A value to the digits that its standard error leaves meaningful (two of the error).

    Examples
    --------
    >>> format_value(3.14159, 0.023), format_value(-12345.678, 210.0), format_value(0.5)
    ('3.142', '-12350', '0.5')
    >>> format_value(-3e-4, 0.059), format_value(1.2345e-9, 2e-12), format_value(1e-9, 3e-6)
    ('0.000', '1.2345e-09', '0')
    """
    if not (math.isfinite(value) and math.isfinite(std)) or std <= 0 or value == 0:
        return f"{value:.6g}"
    first = math.floor(math.log10(abs(value)))
    # two digits of the error, but ten of the value at most
    last = max(math.floor(math.log10(std)) - 1, first - 9)
    if round(value / 10.0**last) == 0:
        # nothing of it is known but that it is small against its error
        return f"{0.0:.{max(-last, 0) if last > -7 else 0}f}"
    first = max(first, last)
    if abs(value) < 1e7 and -10 < last < 7 and (first > -5 or last > -7):
        return f"{round(value, -last):.{max(-last, 0)}f}"
    return f"{value:.{first - last}e}"


def format_std(std: float) -> str:
    """A standard error to two digits; empty for zero or nan (not estimated, not known).

    Examples
    --------
    >>> format_std(0.0234), format_std(0.0), format_std(math.nan)
    ('0.023', '', '')
    """
    if std == 0 or math.isnan(std):
        return ""
    if math.isfinite(std) and 1e-4 <= std < 1e7:
        digits = 1 - math.floor(math.log10(std))
        return f"{round(std, digits):.{max(digits, 0)}f}"
    return f"{std:.1e}"


def format_pair(value: float, std: float, finer: float = math.inf) -> tuple[str, str, str]:
    """A value and its standard error in one notation: both numbers, and the exponent they share.

    The exponent is empty where both are short without one, or too far apart to share one. The value
    has the digits of the smaller of ``std`` and ``finer``.

    Examples
    --------
    >>> format_pair(5.2e-4, 6.7e-5), format_pair(1.02, 0.04), format_pair(1.5e8, 2e6)
    (('5.20', '0.67', 'e-04'), ('1.020', '0.040', ''), ('1.500', '0.020', 'e+08'))
    >>> format_pair(4.8, 120.0), format_pair(4.8, 120.0, 3.6)
    (('0', '120', ''), ('4.8', '120', ''))
    """
    told = min(std, finer)
    plain = format_value(value, told), format_std(std)
    if not any("e" in text for text in plain) or not (math.isfinite(value) and std < math.inf):
        return *plain, ""
    shared = math.floor(math.log10(max(abs(value), std)))
    digits = shared - math.floor(math.log10(told)) + 1
    if digits > MOST_DIGITS or abs(shared) > MOST_POWER:
        return *plain, ""
    scaled = round(value / 10.0**shared, digits) + 0.0  # no minus before a zero
    return f"{scaled:.{digits}f}", f"{std / 10.0**shared:.{digits}f}", f"e{shared:+03d}"


def with_error(value: float, std: float, finer: float = math.inf) -> str:
    """A value with its standard error in brackets, as text; ``finer`` as in `format_pair`.

    Examples
    --------
    >>> with_error(5.2e-4, 6.7e-5), with_error(1.02, 0.04)
    ('(5.20 +/- 0.67)e-04', '(1.020 +/- 0.040)')
    """
    number, error, power = format_pair(value, std, finer)
    return f"({number} +/- {error}){power}"


def format_p(p_value: float) -> str:
    """A p-value to the digits that say something; a dash where the test was not made.

    Examples
    --------
    >>> [format_p(p) for p in (7e-205, 0.0042, 0.0931, 0.5, 1.0, math.nan)]
    ['< 0.001', '0.004', '0.09', '0.50', '1.00', '-']
    """
    if math.isnan(p_value):
        return "-"
    if p_value < 0.001:
        return "< 0.001"
    return f"{p_value:.3f}" if p_value < 0.01 else f"{p_value:.2f}"


def p_in_words(p_value: float) -> str:
    """A p-value in a sentence.

    Examples
    --------
    >>> p_in_words(7e-205), p_in_words(0.0931)
    ('p < 0.001', 'p = 0.09')
    """
    shown = format_p(p_value)
    return f"p {shown}" if shown.startswith("<") else f"p = {shown}"


def format_polynomial(
    coefficients: Iterable[float], std: Iterable[float], finer: Iterable[float] | None = None
) -> str:
    """A polynomial in s with +/- one standard deviation on each coefficient.

    The values have the digits of ``finer`` where these are smaller (`format_pair`).

    Examples
    --------
    >>> format_polynomial([1.0, 1.02, -3.0], [0.0, 0.04, 0.0])
    's^2 + (1.020 +/- 0.040) s - 3'
    """
    text = ""
    pairs = list(zip(coefficients, std, strict=True))
    told = [math.inf] * len(pairs) if finer is None else list(finer)
    for k, (value, error) in enumerate(pairs, 1):
        power = len(pairs) - k
        factor = "" if power == 0 else "s" if power == 1 else f"s^{power}"
        if error and not math.isnan(error):
            number = with_error(value, error, told[k - 1])
            sign = "+"
        else:
            number = format_value(abs(value))
            number = "" if number == "1" and factor else number
            sign = "-" if value < 0 else "+"
        term = " ".join(filter(None, (number, factor)))
        text += f" {sign} {term}" if text else ("-" if sign == "-" else "") + term
    return text


def format_sum(weights: Mapping[str, float]) -> str:
    """A weighted sum of names, as one writes it.

    Examples
    --------
    >>> format_sum({"b0": 1.0, "a0": -1.0}), format_sum({"a1": -2.0, "b1": 0.5})
    ('b0 - a0', '-2 a1 + 0.5 b1')
    """
    text = ""
    for name, weight in weights.items():
        size = f"{abs(weight):g}"
        sign = "-" if weight < 0 else "+"
        term = name if size == "1" else f"{size} {name}"
        text += f" {sign} {term}" if text else f"{'-' if sign == '-' else ''}{term}"
    return text


IN_PICTURES = 40
"""Characters of a name in a picture: two beside each other fill a title of two lines."""
IN_TABLES = 60
"""Characters of a name in a table: beside it the numbers still stand on the page."""


def short(text: str, most: int) -> str:
    """Text of at most so many characters, its middle left out where it is longer.

    Examples
    --------
    >>> short("elevator", 10), short("elevator deflection", 10)
    ('elevator', 'elev...ion')
    """
    if len(text) <= most:
        return text
    tail = max((most - 3) // 2, 1)
    head = max(most - 3 - tail, 1)
    return f"{text[:head].rstrip()}...{text[-tail:].lstrip()}"


def format_table(
    titles: Sequence[str], rows: Sequence[Sequence[str]], *, width: int = 78
) -> list[str]:
    """Lines of a table: first column to the left, the last (a unit) too, numbers to the right.

    Examples
    --------
    >>> for line in format_table(("name", "value", "unit"), [("a0", "3", "1/s^2")], width=22):
    ...     print(line.rstrip())
    name      value  unit
    ----------------------
    a0            3  1/s^2
    """
    columns = list(zip(titles, *rows, strict=True))
    sizes = [max(map(len, column)) for column in columns]
    inner = range(1, len(sizes) - 1)
    spare = max(width - sum(sizes) - 2 * (len(sizes) - 1), 0)
    for k in inner:
        sizes[k] += min(spare // max(len(inner), 1), 12 - sizes[k]) if sizes[k] < 12 else 0
    lines = []
    for row in (titles, *rows):
        cells = [row[0].ljust(sizes[0])]
        cells += [row[k].rjust(sizes[k]) for k in inner]
        lines.append("  ".join((*cells, row[-1])).rstrip())
    return [lines[0], "-" * width, *lines[1:]]


def html_table(titles: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> str:
    """An HTML table; everything in it is escaped.

    Examples
    --------
    >>> html_table(("a", "b"), [("<1>", "2")])
    '<table><tr><th>a</th><th>b</th></tr><tr><td>&lt;1&gt;</td><td>2</td></tr></table>'
    """

    def line(tag: str, cells: Sequence[str]) -> str:
        inner = "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells)
        return f"<tr>{inner}</tr>"

    head = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    body = "".join(line("td", row) for row in rows)
    return f"<table>{head}{line('th', titles)}{body}</table>"


def unit_ratio(above: str, below: str, power: int = 0) -> str:
    """The unit of a ratio, divided by seconds to a power; "-" where nothing is left.

    Examples
    --------
    >>> unit_ratio("rad/s", "rad", 2), unit_ratio("m/s^2", "deg"), unit_ratio("rad", "rad")
    ('1/s^3', 'm/(s^2 deg)', '-')
    """
    factors = unit_factors(above)
    for symbol, exponent in unit_factors(below).items():
        factors[symbol] = factors.get(symbol, 0) - exponent
    factors["s"] = factors.get("s", 0) - power
    return unit_product(factors)


def unit_factors(unit: str) -> dict[str, int]:
    """Split ``"m/s^2"`` into exponents; what is not a product of powers stays one symbol.

    Examples
    --------
    >>> unit_factors("m/s^2"), unit_factors("-"), unit_factors("deg C")
    ({'m': 1, 's': -2}, {}, {'deg C': 1})
    """
    unit = unit.strip()
    if unit in ("", "-", "1"):
        return {}
    if not _SUPPORTED_UNIT.fullmatch(unit.removeprefix("1/")):
        return {unit: 1}
    factors: dict[str, int] = {}
    text = unit.removeprefix("1") if unit.startswith("1/") else "*" + unit
    for operation, symbol, power in re.findall(r"([*/])([^/*^]+)(?:\^(-?\d+))?", text):
        exponent = int(power or 1) * (1 if operation == "*" else -1)
        factors[symbol] = factors.get(symbol, 0) + exponent
    return factors


def unit_product(factors: Mapping[str, int]) -> str:
    """Write exponents as a unit; a ratio of equal units is "-".

    Examples
    --------
    >>> unit_product({"m": 1, "s": -2, "deg": -1}), unit_product({"s": -1}), unit_product({})
    ('m/(s^2 deg)', '1/s', '-')
    """
    return quotient(factors.items(), " ") or "-"


def quotient(powers: Iterable[tuple[str, int | Fraction]], times: str) -> str:
    """Write a product of powers as one quotient; empty where there are none.

    Examples
    --------
    >>> quotient([("K", 1), ("J", -1), ("L", -2)], "*")
    'K/(J*L^2)'
    """
    given = list(powers)

    def side(sign: int) -> list[str]:
        found = [(name, sign * power) for name, power in given if sign * power > 0]
        return [name if power == 1 else f"{name}^{power}" for name, power in found]

    above, below = side(1), side(-1)
    if not below:
        return times.join(above)
    divisor = below[0] if len(below) == 1 else f"({times.join(below)})"
    return f"{times.join(above) or '1'}/{divisor}"


def first_of(said: Sequence[str], most: int, rest: str = "more") -> str:
    """The first of a list in a sentence, the others counted.

    Examples
    --------
    >>> first_of(["a", "b"], 2), first_of(["a", "b", "c", "d"], 2)
    ('a, b', 'a, b and 2 more')
    """
    more = f" and {len(said) - most} {rest}" if len(said) > most else ""
    return f"{', '.join(said[:most])}{more}"


def as_call(value: object) -> str:
    """The call that makes a dataclass of options again, without what is left at its default.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Options:
    ...     poles: int
    ...     offset: bool | str = "auto"
    ...     fixed: dict[str, float] | None = None
    >>> as_call(Options(2, fixed={"a0": 3.0})), as_call(Options(1))
    ("Options(poles=2, fixed={'a0': 3.0})", 'Options(poles=1)')
    """
    if not dataclasses.is_dataclass(value):
        return repr(value)
    given = []
    for field in dataclasses.fields(value):
        item = _plain(getattr(value, field.name))
        empty = field.default is None and item in ({}, ())
        if field.init and not empty and not _same(item, field.default):
            given.append(f"{field.name}={item!r}")
    return f"{type(value).__name__}({', '.join(given)})"


def _plain(value: object) -> object:
    """Read-only mappings as what one writes for them."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return tuple(_plain(item) for item in value)
    return value


def _same(value: object, default: object) -> bool:
    return type(value) is type(default) and value == default
