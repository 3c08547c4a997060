"""The three models of the strategy, one below the other."""

from __future__ import annotations

from tridentify.estimation.answer.estimate import Estimate
from tridentify.plots.diagrams.drawing import Board, Diagram
from tridentify.plots.diagrams.parallel import parallel_board
from tridentify.plots.diagrams.series import series_board
from tridentify.plots.diagrams.series_parallel import series_parallel_board
from tridentify.plots.diagrams.steps import taken
from tridentify.plots.style import channel


def draw_three_models(estimate: Estimate, *, output: int = 0, input_: int = 0) -> Diagram:
    """Draw the models of Steps 1 to 3 with the numbers just estimated.

    Parameters
    ----------
    estimate : Estimate
        Of `ThreeModel` or ``ThreeModel.paper``.
    output, input_ : int
        Positions of the channel that is drawn.

    Returns
    -------
    Diagram
        SVG text, which notebooks show as a picture. Each model is that of the last pass that
        fitted one.

    Raises
    ------
    StepNotTakenError
        The estimate came about without one of the three models.
    OptionError
        There is no such channel.
    """
    boards = [
        parallel_board(taken(estimate, "parallel", output, input_, None)),
        series_parallel_board(taken(estimate, "series-parallel", output, input_, None)),
        series_board(taken(estimate, "series", output, input_, None)),
    ]
    whole = Board()
    down = 0.0
    for board in boards:
        whole.put(board, down)
        down = whole.height + 16.0
    return whole.svg(
        f"The three models of {channel(estimate, output, input_)}",
        "From above: the parallel model of Step 1, the series-parallel model of Step 2 and the "
        "series model of Step 3, each with the numbers of the last pass that fitted it.",
    )
