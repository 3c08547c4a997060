"""Step 1 as a picture: operators beside the object, weighted so that the sum is its output."""

from __future__ import annotations

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
from tridentify.plots.diagrams.drawing import SOFT, Board, Diagram
from tridentify.plots.diagrams.steps import Taken, taken
from tridentify.plots.diagrams.words import index, number


def draw_parallel(
    estimate: Estimate, *, output: int = 0, input_: int = 0, pass_number: int | None = None
) -> Diagram:
    """Draw the parallel model of Step 1 with the weights that were estimated.

    Parameters
    ----------
    estimate : Estimate
        Of `ThreeModel` or ``ThreeModel.paper``.
    output, input_ : int
        Positions of the channel that is drawn.
    pass_number : int, optional
        Default: the last pass that fitted a parallel model.

    Returns
    -------
    Diagram
        SVG text, which notebooks show as a picture.

    Raises
    ------
    StepNotTakenError
        The estimate came about without a parallel model.
    OptionError
        There is no such channel or pass.

    References
    ----------
    .. [1] Silvestrov et al., System Research and Information Technologies 2025(2), Fig. 1.
    """
    found = taken(estimate, "parallel", output, input_, pass_number)
    return parallel_board(found).svg(
        f"Step 1, parallel model: {found.where}",
        f"{found.weights().size} operators act on {found.names[1]}; their weighted sum is fitted "
        f"to {found.names[0]} with a mean square error of {number(found.step.cost)}.",
    )


def parallel_board(found: Taken) -> Board:
    """The drawing, before it is made SVG."""
    board = Board()
    top = heading(board, "Step 1: the parallel model", found) + 54.0
    output, input_ = found.names
    enters(board, 12.0, top, "x(t)", input_, 128.0)
    end, sum_x = 664.0, 560.0
    noisy = draw_object(board, 190.0, top, output, 130.0)
    board.arrow((12.0, top), (190.0, top))
    board.branch(140.0, top)
    board.arrow((noisy.right, top), (end - 11.0, top))
    weights = found.weights()
    # operators on the poles of another channel's denominator have no weight here
    own = [k for k in range(weights.size) if weights[k] or found.estimate.structure.shared]
    own = own or list(range(weights.size))
    labels = [operator_lines(found, k, 1) for k in own]
    names = [f"β{index(k + 1)}" for k in own]
    begin = top + 48.0
    rows, first, last = operator_rows(
        board, found, 164.0, begin, labels, weights[own].tolist(), names, (206.0, 124.0)
    )
    board.line((140.0, top), (140.0, rows[-1]))
    for y in rows:
        board.arrow((140.0, y), (164.0, y))
        if y < rows[-1]:
            board.branch(140.0, y)
    middle = rows[0]
    total = add_up(board, sum_x, rows, first.right)
    board.arrow((total.right, middle), (end, middle), (end, top + 11.0))
    board.text(total.right + 6.0, middle - 8.0, "y_M(t)", bold=True)
    board.sum(end, top)
    board.text(end + 8.0, top + 24.0, "−", bold=True)
    lines = [
        "Least squares: least mean square of ε",
        f"mean square {number(found.step.cost)}, condition {number(found.step.condition, 3)}",
    ]
    box = judge(board, 164.0, rows[-1] + 56.0, 396.0, lines)
    board.arrow((end + 11.0, top), (700.0, top), (700.0, box.middle), (box.right, box.middle))
    board.text(end + 16.0, top - 8.0, "ε(t)", bold=True)
    adjusts(board, (first.centre, box.y), (first.centre, last.bottom))
    board.text(first.centre + 8.0, box.y - 10.0, "sets β", size=11.5, colour=SOFT)
    note = operators_note(found)
    if found.other_inputs:
        note += f" y_M holds what the other inputs do as well: {', '.join(found.other_inputs)}."
    board.paragraph(12.0, box.bottom + 24.0, note, 696.0, size=12.0, colour=SOFT)
    return board
