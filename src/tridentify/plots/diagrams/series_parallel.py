"""Step 2 as a picture: a and b behind the filter 1/c, so that the error is linear in them."""

from __future__ import annotations

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.plots.diagrams.blocks import adjusts, enters, heading, judge
from tridentify.plots.diagrams.drawing import MODEL, OBJECT, SOFT, Board, Diagram, wrapped
from tridentify.plots.diagrams.steps import Taken, taken, took
from tridentify.plots.diagrams.words import number, terms


def draw_series_parallel(
    estimate: Estimate, *, output: int = 0, input_: int = 0, pass_number: int | None = None
) -> Diagram:
    """Draw the series-parallel model of Step 2 with the polynomials that were estimated.

    Parameters
    ----------
    estimate : Estimate
        Of any method that fits such a model. Where no parallel model stands before it, the object
        itself does, with its noise.
    output, input_ : int
        Positions of the channel that is drawn.
    pass_number : int, optional
        Default: the last pass that fitted a series-parallel model.

    Returns
    -------
    Diagram
        SVG text, which notebooks show as a picture.

    Raises
    ------
    StepNotTakenError
        The estimate came about without a series-parallel model.
    OptionError
        There is no such channel or pass.

    References
    ----------
    .. [1] Silvestrov et al., System Research and Information Technologies 2025(2), Figs. 2 and 7.
    """
    found = taken(estimate, "series-parallel", output, input_, pass_number)
    num, den = found.polynomials()
    zeros_a, zeros_b = np.zeros(den.size), np.zeros(num.size)
    return series_parallel_board(found).svg(
        f"Step 2, series-parallel model: {found.where}",
        f"a(p) = {' '.join(terms(den, zeros_a))}; b(p) = {' '.join(terms(num, zeros_b))}; "
        f"cost {number(found.step.cost)}.",
    )


def series_parallel_board(found: Taken) -> Board:
    """The drawing, before it is made SVG."""
    board = Board()
    on_model = took(found.estimate, "parallel")
    title = "Step 2: the series-parallel model"
    top = heading(board, title if on_model else f"{title} on the object itself", found) + 20.0
    (num, den), (num_std, den_std) = found.polynomials(), found.errors()
    _, input_ = found.names
    x, width, sum_x = 330.0, 260.0, 634.0
    source = _source(found, on_model)
    a_lines = ["a(p) / c(p), a(p) =", *wrapped(terms(den, den_std), width - 16.0)]
    b_lines = ["b(p) / c(p), b(p) =", *wrapped(terms(num, num_std), width - 16.0)]
    upper = board.box(x, top, width, a_lines, fill=MODEL, least=52.0)
    lower = board.box(x, upper.bottom + 30.0, width, b_lines, fill=MODEL, least=52.0)
    rect = board.box(
        130.0, upper.middle - 26.0, 122.0, source, fill=MODEL if on_model else OBJECT, least=52.0
    )
    enters(board, 12.0, upper.middle, "x(t)", input_, 76.0)
    board.arrow((12.0, upper.middle), (130.0, upper.middle))
    board.branch(104.0, upper.middle)
    board.arrow((104.0, upper.middle), (104.0, lower.middle), (x, lower.middle))
    board.arrow((rect.right, upper.middle), (x, upper.middle))
    board.text(
        (rect.right + x) / 2 - 3.0, upper.middle - 8.0, "y_M(t)" if on_model else "y(t)",
        anchor="middle", bold=True,
    )  # fmt: skip
    middle = upper.middle
    board.arrow((upper.right, middle), (sum_x - 11.0, middle))
    board.sum(sum_x, middle)
    board.arrow((lower.right, lower.middle), (sum_x, lower.middle), (sum_x, middle + 11.0))
    board.text(sum_x - 22.0, middle + 24.0, "−", bold=True)
    box = judge(board, x, lower.bottom + 40.0, width, _verdict(found))
    board.arrow(
        (sum_x + 11.0, middle), (690.0, middle), (690.0, box.middle), (box.right, box.middle)
    )
    board.text(sum_x + 15.0, middle - 8.0, "ε_y(t)", bold=True)
    adjusts(board, (x + width / 2, box.y), (x + width / 2, lower.bottom))
    adjusts(board, (x + width / 2, lower.y), (x + width / 2, upper.bottom))
    board.text(x + width / 2 + 8.0, box.y - 14.0, "sets a and b", size=11.5, colour=SOFT)
    y = _filter(board, found, 12.0, lower.bottom + 40.0, x - 40.0)
    notes = ""
    if np.any(num_std > 0) or np.any(den_std > 0):
        notes = "± is one standard error of the final estimate."
    if found.other_inputs and on_model:
        notes += (
            f" ε_y holds b(p)/c(p) of the other inputs as well: {', '.join(found.other_inputs)}."
        )
    board.paragraph(12.0, max(y, box.bottom) + 22.0, notes, 696.0, size=12.0, colour=SOFT)
    return board


def _source(found: Taken, on_model: bool) -> list[str]:
    if not on_model:
        return ["object", "and noise ζ"]
    at = found.its_pass.steps.index(found.step)
    own = [step.name for step in found.its_pass.steps[:at]]
    before = [
        step.name
        for one in found.estimate.trace.passes
        if one.number < found.its_pass.number
        for step in one.steps
    ]
    names = [name for name in (*before, *own) if name in ("parallel", "series")]
    return (
        ["series model", "of Step 3"]
        if names and names[-1] == "series"
        else [
            "parallel model",
            "of Step 1",
        ]
    )


def _verdict(found: Taken) -> list[str]:
    instruments = "instrument" in found.step.note
    return [
        "Instrumental variables" if instruments else "Least squares on ε_y",
        f"cost {number(found.step.cost)}",
        f"condition {number(found.step.condition, 3)}",
    ]


def _filter(board: Board, found: Taken, x: float, y: float, width: float) -> float:
    """The filter, in numbers where they are known; the height below it."""
    poles = np.asarray(found.step.poles)
    lines = ["The filter 1 / c(p):"]
    if len(poles) and (found.estimate.structure.shared or not found.step.note.startswith("filter")):
        c = np.asarray(np.poly(poles[:, 0] + 1j * poles[:, 1]).real, dtype=np.float64)
        words = terms(c, np.zeros(c.size))
        words[0] = f"c(p) = {words[0]}"
        lines += wrapped(words, width - 16.0, 12.0)
    if found.step.note:
        lines += wrapped(found.step.note.split(), width - 16.0, 12.0)
    return board.box(x, y, width, lines, size=12.0, left=True, bold_first=True).bottom
