"""Step 3 as a picture: operators behind the model just found make good what it lacks."""

from __future__ import annotations

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.plots.diagrams.blocks import (
    add_up,
    adjusts,
    draw_object,
    enters,
    heading,
    judge,
    operator_lines,
    operator_rows,
    operators_note,
)
from tridentify.plots.diagrams.drawing import MODEL, SOFT, Board, Diagram, wrapped
from tridentify.plots.diagrams.steps import Taken, taken
from tridentify.plots.diagrams.words import index, number, terms


def draw_series(
    estimate: Estimate, *, output: int = 0, input_: int = 0, pass_number: int | None = None
) -> Diagram:
    """Draw the series model of Step 3 with the weights that were estimated.

    Parameters
    ----------
    estimate : Estimate
        Of `ThreeModel` or ``ThreeModel.paper``.
    output, input_ : int
        Positions of the channel that is drawn.
    pass_number : int, optional
        Default: the last pass that fitted a series model, which is the check of the end.

    Returns
    -------
    Diagram
        SVG text, which notebooks show as a picture.

    Raises
    ------
    StepNotTakenError
        The estimate came about without a series model.
    OptionError
        There is no such channel or pass.

    References
    ----------
    .. [1] Silvestrov et al., System Research and Information Technologies 2025(2), Fig. 3.
    """
    found = taken(estimate, "series", output, input_, pass_number)
    return series_board(found).svg(
        f"Step 3, series model: {found.where}",
        "The weights of the operators behind b(p) / a(p) are "
        f"{', '.join(number(one) for one in found.weights())}; they lie within "
        f"{number(found.its_pass.beta_distance, 2)} of (1, 0, ..., 0).",
    )


def series_board(found: Taken) -> Board:
    """The drawing, before it is made SVG."""
    board = Board()
    top = heading(board, "Step 3: the series model", found) + 54.0
    output, input_ = found.names
    end, sum_x = 668.0, 616.0
    enters(board, 12.0, top, "x(t)", input_, 120.0)
    noisy = draw_object(board, 190.0, top, output, 130.0)
    board.arrow((12.0, top), (190.0, top))
    board.arrow((noisy.right, top), (end - 11.0, top))
    (num, den), (num_std, den_std) = found.polynomials(), found.errors()
    lines = ["model b(p) / a(p)", "b(p) ="]
    lines += wrapped(terms(num, num_std), 184.0, 12.0)
    lines += ["a(p) =", *wrapped(terms(den, den_std), 184.0, 12.0)]
    begin = top + 50.0
    model = board.box(40.0, begin, 200.0, lines, fill=MODEL, size=12.0, bold_first=True)
    weights = found.weights()
    heads = max(weights.size - len(found.step.poles), 1) if len(found.step.poles) else 1
    labels = [
        [f"W{index(0)} = 1"] if k < heads else operator_lines(found, k - heads, 1)
        for k in range(weights.size)
    ]
    names = [f"β{index(max(k - heads + 1, 0))}" for k in range(weights.size)]
    rows, first, last = operator_rows(
        board, found, 284.0, begin, labels, weights.tolist(), names, (172.0, 118.0)
    )
    at = min(max(rows[0], model.y + 14.0), model.bottom - 14.0)
    board.line((22.0, top), (22.0, at))
    board.branch(22.0, top)
    board.arrow((22.0, at), (40.0, at))
    board.arrow((model.right, rows[0]), (284.0, rows[0]))
    board.text((model.right + 262.0) / 2 + 2.0, rows[0] - 8.0, "ŷ", anchor="middle", bold=True)
    board.line((262.0, rows[0]), (262.0, rows[-1]))
    board.branch(262.0, rows[0])
    for y in rows[1:]:
        board.arrow((262.0, y), (284.0, y))
    total = add_up(board, sum_x, rows, first.right)
    board.arrow((total.right, rows[0]), (end, rows[0]), (end, top + 11.0))
    board.sum(end, top)
    board.text(end - 18.0, top + 26.0, "−", bold=True)
    distance = found.its_pass.beta_distance
    verdict = [
        "Least squares: least mean square of ε",
        f"mean square {number(found.step.cost)}, condition {number(found.step.condition, 3)}",
        f"largest |β − (1, 0, ..., 0)| = {number(distance, 2)}",
    ]
    box = judge(board, 284.0, max(rows[-1] + 56.0, model.bottom + 20.0), 342.0, verdict)
    board.arrow((end + 11.0, top), (704.0, top), (704.0, box.middle), (box.right, box.middle))
    board.text(end + 12.0, top - 8.0, "ε(t)", bold=True)
    adjusts(board, (first.centre, box.y), (first.centre, last.bottom))
    board.text(first.centre + 8.0, box.y - 10.0, "sets β", size=11.5, colour=SOFT)
    note = operators_note(found)
    if np.any(num_std > 0) or np.any(den_std > 0):
        note += " ± is one standard error of the final estimate."
    if heads > 1:
        note += " What each denominator does to ŷ has weights, and a W₀ = 1, of its own."
    if found.other_inputs:
        note += f" ŷ holds what the other inputs do as well: {', '.join(found.other_inputs)}."
    board.paragraph(12.0, box.bottom + 24.0, note, 696.0, size=12.0, colour=SOFT)
    return board
