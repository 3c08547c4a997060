"""A small drawing board for block diagrams: boxes, sums, arrows and text, given out as SVG.

Everything is placed by its coordinates [px], and text by an estimate of its width that is on the
wide side of common fonts, so that what fits here fits in any browser. Arrow heads are shapes of
their own and nothing has an id, so that several drawings can stand in one page.
"""

from __future__ import annotations

import html
import math
import os
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from tridentify.writing.files import write_atomically

FONT = "'DejaVu Sans', Verdana, 'Segoe UI', Arial, sans-serif"
INK, SOFT, ADJUST = "#1a1a1a", "#4d4d4d", "#a83c00"
OBJECT, MODEL, JUDGE, PLAIN = "#f0f0f0", "#e6f0f8", "#fdf1dc", "#ffffff"
SIZE = 13.0
LINE = 1.36
"""Distance of lines over the size of the font."""
WIDE, BOLD = 1.0, 1.14
NARROWEST = 0.2
"""Of a letter, in its height: so many at most are tried in a place."""
RADIUS = 11.0
HEAD = 9.0

_WIDTHS = {
    0.36: "ijl' ,.;:|",
    0.46: 'I!()[]ftrJ`-/\\·"',
    0.64: "0123456789abcdeghknopqsuvxyzF_ELST?*$",
    0.78: "ABCDGHKNOPQRUVXYZ&w",
    0.86: "+=<>~^#±−≈→×≤≥∞√",
    1.0: "mMW%@—…",
}
_WIDTH = {char: width for width, chars in _WIDTHS.items() for char in chars}


def text_width(text: str, size: float = SIZE, *, bold: bool = False) -> float:
    """Width that a text takes at most in one of the common fonts [px].

    Examples
    --------
    >>> text_width("ill") < text_width("elm") < text_width("elm", bold=True)
    True
    """
    return sum(map(_char_width, text)) * size * WIDE * (BOLD if bold else 1.0)


def _char_width(char: str) -> float:
    if char in _WIDTH:
        return _WIDTH[char]
    if unicodedata.combining(char) or unicodedata.category(char) == "Cf":
        return 0.0
    if char in "⁰¹²³⁴⁵⁶⁷⁸⁹₀₁₂₃₄₅₆₇₈₉⁻":
        return 0.45
    return 1.05 if unicodedata.east_asian_width(char) in "WF" else 0.75


def fitted(text: str, width: float, size: float = SIZE, *, bold: bool = False) -> str:
    """The text, its middle left out where it is too long.

    Examples
    --------
    >>> fitted("elevator", 80.0), fitted("elevator deflection of the left wing", 90.0)
    ('elevator', 'elevat…wing')
    """
    if text_width(text, size, bold=bold) <= width:
        return text
    most = int(width / (NARROWEST * size * WIDE)) + 1
    for count in range(min(len(text) - 1, most), 1, -1):
        short = f"{text[: (count + 1) // 2].rstrip()}…{text[len(text) - count // 2 :].lstrip()}"
        if text_width(short, size, bold=bold) <= width:
            return short
    return "…"


def wrapped(words: Sequence[str], width: float, size: float = SIZE) -> list[str]:
    """Words (or terms of words) in lines of at most a width; a longer word loses its middle.

    Examples
    --------
    >>> wrapped(["p^2", "+ 1.02 p", "+ 3"], 100.0)
    ['p^2 + 1.02 p', '+ 3']
    """
    lines: list[str] = []
    for word in words:
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and text_width(longer, size) <= width:
            lines[-1] = longer
        elif " " in word.strip() and text_width(word, size) > width:
            lines += wrapped(word.split(), width, size)
        else:
            lines.append(fitted(word, width, size))
    return lines


@dataclass(frozen=True)
class Rect:
    """A rectangle from its upper left corner."""

    x: float
    y: float
    width: float
    height: float
    fill: str = PLAIN
    rounded: float = 3.0

    @property
    def right(self) -> float:
        """Right edge."""
        return self.x + self.width

    @property
    def bottom(self) -> float:
        """Lower edge."""
        return self.y + self.height

    @property
    def middle(self) -> float:
        """Height of the centre."""
        return self.y + self.height / 2

    @property
    def centre(self) -> float:
        """Horizontal place of the centre."""
        return self.x + self.width / 2

    def svg(self) -> str:
        """As an element."""
        return (
            f'<rect x="{self.x:.1f}" y="{self.y:.1f}" width="{self.width:.1f}" '
            f'height="{self.height:.1f}" rx="{self.rounded:g}" fill="{self.fill}" '
            f'stroke="{INK}" stroke-width="1.2"/>'
        )


@dataclass(frozen=True)
class Text:
    """One line of text at its base line."""

    x: float
    y: float
    text: str
    size: float = SIZE
    anchor: str = "start"
    colour: str = INK
    bold: bool = False

    @property
    def room(self) -> Rect:
        """The rectangle that it takes at most."""
        width = text_width(self.text, self.size, bold=self.bold)
        left = self.x - {"start": 0.0, "middle": width / 2, "end": width}[self.anchor]
        return Rect(left, self.y - 0.8 * self.size, width, 1.05 * self.size)

    def svg(self) -> str:
        """As an element."""
        weight = ' font-weight="bold"' if self.bold else ""
        return (
            f'<text x="{self.x:.1f}" y="{self.y:.1f}" font-size="{self.size:g}" '
            f'text-anchor="{self.anchor}" fill="{self.colour}"{weight}>'
            f"{html.escape(printable(self.text))}</text>"
        )


@dataclass(frozen=True)
class Line:
    """A polyline, with an arrow head at its end or without."""

    points: tuple[tuple[float, float], ...]
    arrow: bool = True
    colour: str = INK
    dashed: bool = False

    def svg(self) -> str:
        """As elements."""
        (x, y), (x_0, y_0) = self.points[-1], self.points[-2]
        length = math.hypot(x - x_0, y - y_0) or 1.0
        u, v = (x - x_0) / length, (y - y_0) / length
        points = list(self.points)
        head = ""
        if self.arrow:
            points[-1] = (x - 0.8 * HEAD * u, y - 0.8 * HEAD * v)
            base, half = (x - HEAD * u, y - HEAD * v), 0.42 * HEAD
            corners = [
                (x, y),
                (base[0] - half * v, base[1] + half * u),
                (base[0] + half * v, base[1] - half * u),
            ]
            text = " ".join(f"{a:.1f},{b:.1f}" for a, b in corners)
            head = f'<polygon points="{text}" fill="{self.colour}"/>'
        text = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
        dash = ' stroke-dasharray="5 4"' if self.dashed else ""
        return (
            f'<polyline points="{text}" fill="none" stroke="{self.colour}" '
            f'stroke-width="1.3"{dash}/>{head}'
        )


@dataclass(frozen=True)
class Circle:
    """A sum (empty), or a branch (small and filled)."""

    x: float
    y: float
    radius: float = RADIUS
    fill: str = PLAIN

    def svg(self) -> str:
        """As an element."""
        return (
            f'<circle cx="{self.x:.1f}" cy="{self.y:.1f}" r="{self.radius:g}" '
            f'fill="{self.fill}" stroke="{INK}" stroke-width="1.2"/>'
        )


@dataclass(frozen=True)
class Polygon:
    """A closed shape with straight sides."""

    points: tuple[tuple[float, float], ...]
    fill: str = PLAIN

    def svg(self) -> str:
        """As an element."""
        text = " ".join(f"{a:.1f},{b:.1f}" for a, b in self.points)
        return f'<polygon points="{text}" fill="{self.fill}" stroke="{INK}" stroke-width="1.2"/>'


Shape = Rect | Text | Line | Circle | Polygon


class Diagram(str):
    """SVG text that a notebook shows as a picture."""

    __slots__ = ()

    def _repr_svg_(self) -> str:
        return str(self)


@dataclass(eq=False)
class Board:
    """Shapes put down one after the other.

    Attributes
    ----------
    width : float
        [px].
    shapes : list
        In the order of drawing.
    """

    width: float = 720.0
    shapes: list[Shape] = field(default_factory=list)

    @property
    def height(self) -> float:
        """Down to the lowest shape, with a margin."""
        lowest = 0.0
        for shape in self.shapes:
            if isinstance(shape, Rect):
                lowest = max(lowest, shape.bottom)
            elif isinstance(shape, Text):
                lowest = max(lowest, shape.room.bottom)
            elif isinstance(shape, Circle):
                lowest = max(lowest, shape.y + shape.radius)
            else:
                lowest = max(lowest, *(y for _, y in shape.points))
        return lowest + 12.0

    @property
    def texts(self) -> list[Text]:
        """Every line of text."""
        return [shape for shape in self.shapes if isinstance(shape, Text)]

    def text(
        self,
        x: float,
        y: float,
        text: str,
        *,
        size: float = SIZE,
        anchor: str = "start",
        colour: str = INK,
        bold: bool = False,
    ) -> None:
        """Put down one line."""
        self.shapes.append(Text(x, y, text, size, anchor, colour, bold))

    def paragraph(
        self,
        x: float,
        y: float,
        text: str,
        width: float,
        *,
        size: float = SIZE,
        colour: str = INK,
    ) -> float:
        """Put down words in lines; the base line after the last one."""
        for line in wrapped(text.split(), width, size):
            self.text(x, y, line, size=size, colour=colour)
            y += LINE * size
        return y

    def box(
        self,
        x: float,
        y: float,
        width: float,
        lines: Sequence[str],
        *,
        fill: str = PLAIN,
        size: float = SIZE,
        least: float = 0.0,
        left: bool = False,
        bold_first: bool = False,
    ) -> Rect:
        """A box that is as high as its lines need; lines that are too long lose their middle."""
        inner = len(lines) * LINE * size
        height = max(inner + 0.7 * size, least)
        rect = Rect(x, y, width, height, fill)
        self.shapes.append(rect)
        at = y + (height - inner) / 2 + 1.02 * size
        for k, line in enumerate(lines):
            bold = bold_first and k == 0
            shown = fitted(line, width - 12.0, size, bold=bold)
            place = x + 6.0 if left else x + width / 2
            anchor = "start" if left else "middle"
            self.text(place, at, shown, size=size, anchor=anchor, bold=bold)
            at += LINE * size
        return rect

    def arrow(self, *points: tuple[float, float], colour: str = INK, dashed: bool = False) -> None:
        """An arrow along points."""
        self.shapes.append(Line(points, True, colour, dashed))

    def line(self, *points: tuple[float, float]) -> None:
        """A line along points."""
        self.shapes.append(Line(points, False, INK, False))

    def branch(self, x: float, y: float) -> None:
        """The point where a signal goes two ways."""
        self.shapes.append(Circle(x, y, 2.6, INK))

    def sum(self, x: float, y: float) -> None:
        """A circle in which signals add."""
        self.shapes.append(Circle(x, y))
        self.line((x - 5.0, y), (x + 5.0, y))
        self.line((x, y - 5.0), (x, y + 5.0))

    def put(self, other: Board, down: float) -> None:
        """Everything on another board, moved down."""
        self.shapes += [_moved(shape, down) for shape in other.shapes]

    def svg(self, title: str, description: str) -> Diagram:
        """The drawing, self-contained, with what a screen reader says of it."""
        named, told = (html.escape(printable(text)) for text in (title, description))
        label = html.escape(printable(title), quote=True)
        parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:g} '
            f'{self.height:.0f}" width="{self.width:g}" height="{self.height:.0f}" role="img" '
            f'aria-label="{label}" font-family="{html.escape(FONT)}" '
            'style="max-width:100%;height:auto;background:#ffffff">',
            f"<title>{named}</title>",
            f"<desc>{told}</desc>",
            f'<rect width="{self.width:g}" height="{self.height:.0f}" fill="#ffffff"/>',
            *(shape.svg() for shape in self.shapes),
            "</svg>",
        ]
        return Diagram("\n".join(parts) + "\n")


def _moved(shape: Shape, down: float) -> Shape:
    if isinstance(shape, (Line, Polygon)):
        return replace(shape, points=tuple((x, y + down) for x, y in shape.points))
    return replace(shape, y=shape.y + down)


def printable(text: str) -> str:
    r"""Text without the characters that XML does not allow.

    Examples
    --------
    >>> printable("a\x00b\nc")
    'a b c'
    """
    kept = (
        char
        if char >= " " and not 0xD800 <= ord(char) <= 0xDFFF and ord(char) & 0xFFFE != 0xFFFE
        else " "
        for char in text
    )
    return "".join(kept)


def write_diagram(svg: str, path: str | os.PathLike[str]) -> Path:
    """Write a diagram to a file that is either complete or absent.

    Parameters
    ----------
    svg : str
        What one of the drawing functions gave.
    path : path-like
        Missing folders are made.

    Returns
    -------
    Path

    Raises
    ------
    OutputPathError
        The file cannot be written.
    """
    return write_atomically(path, svg)
