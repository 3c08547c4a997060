"""Numbers and polynomials as the blocks of a diagram show them.

Parts that several diagrams share: headings, the object with its noise, rows of operators.

What the passes of an estimate say of one step: which one is drawn, and its numbers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.errors import OptionError, StepNotTakenError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.trace import Pass, Step
from tridentify.numerics.arrays import Array
from tridentify.plots.diagrams.drawing import (
    ADJUST,
    JUDGE,
    MODEL,
    OBJECT,
    SOFT,
    Board,
    Rect,
    fitted,
    text_width,
)
from tridentify.writing.layout import IN_PICTURES, format_std, format_value, short

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


MOST_ROWS = 6
ROW = 38.0
SMALL = 11.5


def heading(board: Board, title: str, found: Taken) -> float:
    """Title and channel; the height below them."""
    board.text(12.0, 24.0, title, size=16.0, bold=True)
    return board.paragraph(12.0, 44.0, found.where, board.width - 24.0, size=12.0, colour=SOFT)


def enters(board: Board, x: float, y: float, symbol: str, name: str, room: float) -> None:
    """A signal with the name of its channel, above the start of its line."""
    board.text(x, y - 8.0, symbol, bold=True)
    after = x + text_width(symbol, bold=True) + 5.0
    board.text(after, y - 8.0, fitted(name, room, SMALL), size=SMALL, colour=SOFT)


def draw_object(board: Board, x: float, y: float, output: str, room: float) -> Rect:
    """The object, and the noise that is added to what it does; the circle where it is added.

    Returns the circle's place as a rectangle.
    """
    rect = board.box(x, y - 22.0, 160.0, ["object b*(p)/a*(p)", "unknown"], fill=OBJECT)
    at = x + 240.0
    board.arrow((rect.right, y), (at - 11.0, y))
    board.text((rect.right + at - 11.0) / 2, y - 8.0, "y*(t)", anchor="middle")
    board.arrow((at, y - 42.0), (at, y - 11.0))
    board.text(at + 8.0, y - 30.0, "noise ζ", size=SMALL, colour=SOFT)
    board.sum(at, y)
    board.text(at + 24.0, y + 17.0, fitted(output, room, SMALL), size=SMALL, colour=SOFT)
    board.text(at + 24.0, y - 8.0, "y(t)", bold=True)
    return Rect(at - 11.0, y - 11.0, 22.0, 22.0)


def operator_lines(found: Taken, k: int, first: int) -> list[str]:
    """Name and formula of operator number ``k`` (from zero) of a bank whose index starts so."""
    poles = np.asarray(found.step.poles)
    name = f"W{index(k + first)}"
    if k >= len(poles):
        return [f"{name} = 1" if len(poles) else f"{name}(p)"]
    if found.step.kind == "allpass":
        return [f"{name} = ((p − γ)/(p + γ)){power(k + 1)}"]
    if found.step.kind == "laguerre":
        top = "" if k == 0 else f" (p − γ){power(k)}"
        return [f"{name} = √(2γ){top}/(p + γ){power(k + 1)}"]
    return [f"{name}: pole {pole(*poles[k])}"]


def operators_note(found: Taken) -> str:
    """Of what kind the operators are."""
    poles = np.asarray(found.step.poles)
    if found.step.kind in ("allpass", "laguerre") and len(poles):
        kind = "all-pass powers" if found.step.kind == "allpass" else "Laguerre functions"
        return f"Operators: {kind}, γ = {number(-poles[0, 0])} rad/s."
    if found.step.kind == "orthonormal":
        return (
            "Operators: orthonormal functions; each has its own pole and those of all before it "
            "[rad/s]."
        )
    return f"Operators: {found.step.note}." if found.step.note else ""


def operator_rows(
    board: Board,
    x: float,
    y: float,
    labels: Sequence[list[str]],
    weights: Sequence[float],
    names: Sequence[str],
    widths: tuple[float, float],
) -> tuple[list[float], Rect, Rect]:
    """Rows of operator and weight, the middle left out where there are many.

    Returns
    -------
    heights : list of float
        Of the rows that are drawn.
    first, last : Rect
        The upper and the lower weight.
    """
    drawn: list[float] = []
    betas: list[Rect] = []
    for k in elided(len(labels), MOST_ROWS):
        middle = y + ROW / 2
        if k < 0:
            count = len(labels) - MOST_ROWS + 1
            board.text(
                x + widths[0] / 2, middle - 1.0, f"⋮ {count} more", anchor="middle", colour=SOFT
            )
            y += ROW - 10.0
            continue
        size = 12.0 if max(map(text_width, labels[k])) > widths[0] - 12.0 else 13.0
        first = board.box(x, y + 2.0, widths[0], labels[k], fill=MODEL, size=size, least=ROW - 8.0)
        text = next(
            one
            for one in (f"{names[k]} = {number(weights[k], digits)}" for digits in (4, 3, 2, 1))
            if text_width(one) <= widths[1] - 12.0 or one.endswith(number(weights[k], 1))
        )
        beta = board.box(
            first.right + 30.0, y + 2.0, widths[1], [text], fill=MODEL, least=ROW - 8.0
        )
        board.arrow((first.right, first.middle), (beta.x, first.middle))
        betas.append(beta)
        drawn.append(first.middle)
        y += ROW
    return drawn, betas[0], betas[-1]


def add_up(board: Board, x: float, rows: Sequence[float], start: float) -> Rect:
    """The box in which the weighted signals of all rows add up, from where they start."""
    height = rows[-1] - rows[0] + 28.0
    box = board.box(x, rows[0] - 14.0, 28.0, ["Σ"], least=height)
    for y in rows:
        board.arrow((start, y), (x, y))
    return box


def judge(board: Board, x: float, y: float, width: float, lines: Sequence[str]) -> Rect:
    """The box that chooses the coefficients."""
    return board.box(x, y, width, lines, fill=JUDGE, bold_first=True)


def adjusts(board: Board, *points: tuple[float, float]) -> None:
    """A dashed arrow: this sets the numbers there."""
    board.arrow(*points, colour=ADJUST, dashed=True)


_TITLES = {
    "parallel": "parallel model (Step 1)",
    "series-parallel": "series-parallel model (Step 2)",
    "series": "series model (Step 3)",
}


@dataclass(frozen=True, eq=False)
class Taken:
    """A step of one pass, seen from one channel.

    Attributes
    ----------
    estimate : Estimate
    step : Step
    its_pass : Pass
    output, input_ : int
        Positions of the channel.
    """

    estimate: Estimate
    step: Step
    its_pass: Pass
    output: int
    input_: int

    @property
    def names(self) -> tuple[str, str]:
        """Of the output and the input, long ones without their middles."""
        estimate = self.estimate
        output, input_ = estimate.output_names[self.output], estimate.input_names[self.input_]
        return short(output, IN_PICTURES), short(input_, IN_PICTURES)

    @property
    def where(self) -> str:
        """Channel and pass, in words."""
        estimate, (output, input_) = self.estimate, self.names
        n_outputs, n_inputs = len(estimate.output_names), len(estimate.input_names)
        channel = f"{output} / {input_}"
        if n_outputs * n_inputs > 1:
            number = self.output * n_inputs + self.input_ + 1
            channel += f" (channel {number} of {n_outputs * n_inputs})"
        last = estimate.trace.passes[-1].number
        return f"{channel}, pass {self.its_pass.number} of {last}, {estimate.method}"

    @property
    def other_inputs(self) -> tuple[str, ...]:
        """Names of the inputs that add to the same output."""
        names = self.estimate.input_names
        return tuple(short(name, IN_PICTURES) for k, name in enumerate(names) if k != self.input_)

    def polynomials(self) -> tuple[Array, Array]:
        """Numerator and denominator of the channel that the step found, descending powers.

        Where the step tells the denominator alone, the numerator is that of the pass.
        """
        theta = np.array(self.estimate.theta)
        whole = np.asarray(self.its_pass.theta)
        theta[: whole.size] = whole
        found = np.asarray(self.step.coefficients)
        delays = sum(name.startswith("delay") for name in self.estimate.names)
        if self.step.name in ("parallel", "series"):
            pass
        elif found.size >= theta.size - delays:
            theta[: found.size] = found
        else:
            lower = [k for k, name in enumerate(self.estimate.names) if name.startswith("a")]
            if len(lower) == found.size:
                theta[lower] = found
        num, den, _ = self.estimate.channel_draws(theta[None], self.output, self.input_)
        return num[0], den[0]

    def errors(self) -> tuple[Array, Array]:
        """Standard errors of numerator and (monic) denominator, of the final estimate."""
        num, den, cov = self.estimate.channel(self.output, self.input_)
        std = np.sqrt(np.maximum(np.diag(cov), 0.0))
        n = den.size - 1
        return std[n : n + num.size], np.concatenate([[0.0], std[:n]])

    def weights(self) -> Array:
        """``beta`` of the channel (parallel), or of the output (series)."""
        flat = np.asarray(self.step.coefficients)
        n_outputs, n_inputs = len(self.estimate.output_names), len(self.estimate.input_names)
        if self.step.name == "series":
            return np.asarray(flat.reshape(n_outputs, -1)[self.output])
        return np.asarray(flat.reshape(n_outputs, n_inputs, -1)[self.output, self.input_])


def taken(
    estimate: Estimate, name: str, output: int, input_: int, pass_number: int | None
) -> Taken:
    """Find a step in the trace.

    Parameters
    ----------
    estimate : Estimate
    name : str
    output, input_ : int
    pass_number : int, optional
        Default: the last pass that has the step.

    Raises
    ------
    StepNotTakenError
        The estimate came about without it.
    OptionError
        There is no such channel or pass.
    """
    for what, value, count in (
        ("output", output, len(estimate.output_names)),
        ("input_", input_, len(estimate.input_names)),
    ):
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < count:
            raise OptionError.found(f"{what}=", value, f"a number from 0 to {count - 1}")
    numbers = [one.number for one in estimate.trace.passes]
    if pass_number is not None and pass_number not in numbers:
        raise OptionError.found("pass_number=", pass_number, f"one of {numbers}")
    for one in reversed(estimate.trace.passes):
        if pass_number is None or one.number == pass_number:
            for step in reversed(one.steps):
                if step.name == name:
                    return Taken(estimate, step, one, output, input_)
    steps = dict.fromkeys(step.name for one in estimate.trace.passes for step in one.steps)
    where = "in its passes" if pass_number is None else f"in pass {pass_number}"
    raise StepNotTakenError(
        f"found no {_TITLES[name]} {where} of {estimate.method}, whose steps are "
        f"{', '.join(steps) or 'not recorded'}; expected an estimate of ThreeModel that went "
        "through it; use draw_flow_chart, which shows what was done"
    )


def took(estimate: Estimate, name: str) -> bool:
    """Whether any pass has the step."""
    return any(step.name == name for one in estimate.trace.passes for step in one.steps)
