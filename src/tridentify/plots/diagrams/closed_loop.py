"""The three models in closed loop as a picture: all of them are driven by the reference."""

from __future__ import annotations

from tridentify.errors import StepNotTakenError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.plots.diagrams.drawing import MODEL, OBJECT, PLAIN, SOFT, Board, Diagram, wrapped
from tridentify.plots.diagrams.words import adjusts, judge, terms
from tridentify.plots.style import channel

SMALL = 11.5
END = 690.0
"""Where lines turn down, at the right edge [px]."""


def draw_closed_loop(estimate: Estimate, *, output: int = 0, input_: int = 0) -> Diagram:
    """Draw the three models of the reference route, with the polynomials that were estimated.

    Parameters
    ----------
    estimate : Estimate
        By the reference route.
    output, input_ : int
        Positions of the channel that is drawn.

    Returns
    -------
    Diagram
        SVG text, which notebooks show as a picture.

    Raises
    ------
    StepNotTakenError
        The estimate came about without a reference.
    """
    if estimate.route != "reference":
        raise StepNotTakenError(
            f"found an estimate by the route {estimate.route!r}; expected one by the reference "
            "route, from records with a reference; use draw_three_models"
        )
    num, den, _ = estimate.channel(output, input_)
    where = channel(estimate, output, input_)
    whole = Board()
    for board in (_parallel(where), _series_parallel(list(num), list(den)), _series()):
        whole.put(board, whole.height if whole.shapes else 0.0)
    return whole.svg(
        f"The three models in closed loop: {where}",
        "From above: operators on the reference give what of input and output follows it; the "
        "equation error of the two gives the coefficients; what the model makes of the rest of the "
        "input is taken from the output, and what is left is fitted.",
    )


def _parallel(where: str) -> Board:
    """The loop, and the operators beside it."""
    board = Board()
    board.text(
        12.0, 24.0, "Step 1: the parallel model, driven by the reference", size=16, bold=True
    )
    board.paragraph(12.0, 44.0, where, board.width - 24.0, size=12.0, colour=SOFT)
    y, below = 112.0, 172.0
    controller = board.box(104.0, y - 24.0, 132.0, ["controller", "any; unknown"], fill=PLAIN)
    plant = board.box(304.0, y - 24.0, 150.0, ["object b*(p)/a*(p)", "unknown"], fill=OBJECT)
    board.text(12.0, y - 8.0, "r(t)", bold=True)
    board.arrow((12.0, y), (controller.x, y))
    board.branch(60.0, y)
    board.arrow((controller.right, y), (plant.x, y))
    board.text(270.0, y - 8.0, "u(t)", anchor="middle", bold=True)
    board.branch(290.0, y)
    board.arrow((plant.right, y), (509.0, y))
    board.arrow((520.0, y - 42.0), (520.0, y - 11.0))
    board.text(528.0, y - 30.0, "noise ζ", size=SMALL, colour=SOFT)
    board.sum(520.0, y)
    board.text(600.0, y - 8.0, "y(t)", anchor="middle", bold=True)
    board.line((531.0, y), (END, y))
    board.branch(560.0, y)
    board.arrow((560.0, y), (560.0, below), (170.0, below), (170.0, controller.bottom))
    told = "noise goes round the loop, into u"
    board.text(300.0, below - 7.0, told, size=SMALL, colour=SOFT)
    top = below + 34.0
    lines = ["parallel model", "weighted operators W(p) on r"]
    model = board.box(104.0, top, 240.0, lines, fill=MODEL, least=72.0, bold_first=True)
    board.arrow((60.0, y), (60.0, model.middle), (model.x, model.middle))
    upper, lower = model.y + 18.0, model.bottom - 18.0
    for at, name, over in ((upper, "u_M(t)", 620.0), (lower, "y_M(t)", END)):
        board.arrow((model.right, at), (over - 11.0, at))
        board.text(408.0, at - 7.0, name, anchor="middle", bold=True)
        board.sum(over, at)
        board.text(over - 26.0, at + 18.0, "−", bold=True)
    board.arrow((290.0, y), (290.0, below + 16.0), (620.0, below + 16.0), (620.0, upper - 11.0))
    board.arrow((END, y), (END, lower - 11.0))
    box = judge(board, 340.0, model.bottom + 26.0, 250.0, ["Least squares on both"])
    board.arrow((620.0, upper + 11.0), (620.0, box.middle), (box.right, box.middle))
    board.line((END, lower + 11.0), (END, box.middle), (620.0, box.middle))
    board.branch(620.0, box.middle)
    board.text(628.0, upper + 26.0, "ε_u(t)", bold=True)
    board.text(END - 8.0, lower + 42.0, "ε_y(t)", anchor="end", bold=True)
    adjusts(board, (box.x, box.middle), (224.0, box.middle), (224.0, model.bottom))
    board.text(232.0, box.middle - 7.0, "sets the weights", size=SMALL, colour=SOFT)
    note = "r knows nothing of the noise, so u_M and y_M are free of it, whatever the controller."
    board.paragraph(12.0, box.bottom + 22.0, note, 696.0, size=12.0, colour=SOFT)
    return board


def _series_parallel(num: list[float], den: list[float]) -> Board:
    """The equation error of the two signals without noise."""
    board, width = Board(), 260.0
    board.text(12.0, 32.0, "Step 2: the series-parallel model", size=16.0, bold=True)
    a_words, b_words = (
        [f"{name}(p) / c(p), {name}(p) =", *wrapped(terms(one, [0.0] * len(one)), width - 16.0)]
        for name, one in (("a", den), ("b", num))
    )
    upper = board.box(190.0, 56.0, width, a_words, fill=MODEL, least=52.0)
    lower = board.box(190.0, upper.bottom + 20.0, width, b_words, fill=MODEL, least=52.0)
    for box, name in ((upper, "y_M(t)"), (lower, "u_M(t)")):
        board.text(90.0, box.middle - 8.0, name, bold=True)
        board.arrow((90.0, box.middle), (box.x, box.middle))
    board.arrow((upper.right, upper.middle), (489.0, upper.middle))
    board.sum(500.0, upper.middle)
    board.arrow((lower.right, lower.middle), (500.0, lower.middle), (500.0, upper.middle + 11.0))
    board.text(480.0, upper.middle + 26.0, "−", bold=True)
    board.text(516.0, upper.middle - 8.0, "ε(t)", bold=True)
    found = judge(board, 190.0, lower.bottom + 30.0, width, ["Least squares on ε"])
    board.arrow(
        (511.0, upper.middle), (560.0, upper.middle), (560.0, found.middle),
        (found.right, found.middle),
    )  # fmt: skip
    adjusts(board, (320.0, found.y), (320.0, lower.bottom))
    adjusts(board, (320.0, lower.y), (320.0, upper.bottom))
    board.text(328.0, found.y - 10.0, "sets a and b", size=SMALL, colour=SOFT)
    return board


def _series() -> Board:
    """What the model leaves of the output, fitted to what the reference drives."""
    board = Board()
    board.text(12.0, 32.0, "Step 3: the series model, on what is left", size=16.0, bold=True)
    upper = board.box(190.0, 56.0, 200.0, ["model b(p) / a(p)", "as it is"], fill=MODEL, least=52.0)
    lower = board.box(
        190.0, upper.bottom + 40.0, 200.0, ["model b(p) / a(p)", "corrected: 1 + β W(p)"],
        fill=MODEL, least=52.0,
    )  # fmt: skip
    board.text(60.0, upper.middle - 8.0, "u(t) − u_M(t)", bold=True)
    board.arrow((60.0, upper.middle), (upper.x, upper.middle))
    board.text(90.0, lower.middle - 8.0, "u_M(t)", bold=True)
    board.arrow((90.0, lower.middle), (lower.x, lower.middle))
    board.text(430.0, 50.0, "y(t)", bold=True)
    board.arrow((470.0, 46.0), (500.0, 46.0), (500.0, upper.middle - 11.0))
    board.arrow((upper.right, upper.middle), (489.0, upper.middle))
    board.text(470.0, upper.middle + 20.0, "−", bold=True)
    board.sum(500.0, upper.middle)
    board.arrow((500.0, upper.middle + 11.0), (500.0, lower.middle - 11.0))
    board.text(
        510.0, (upper.middle + lower.middle) / 2 + 4.0, "what is left", size=SMALL, colour=SOFT
    )
    board.arrow((lower.right, lower.middle), (489.0, lower.middle))
    board.text(470.0, lower.middle + 20.0, "−", bold=True)
    board.sum(500.0, lower.middle)
    board.text(516.0, lower.middle - 8.0, "ε(t)", bold=True)
    found = judge(board, 190.0, lower.bottom + 30.0, 200.0, ["Least squares on ε"])
    board.arrow(
        (511.0, lower.middle), (560.0, lower.middle), (560.0, found.middle),
        (found.right, found.middle),
    )  # fmt: skip
    adjusts(board, (290.0, found.y), (290.0, lower.bottom))
    board.text(298.0, found.y - 10.0, "sets β", size=SMALL, colour=SOFT)
    note = (
        "The corrected model takes the other's place above, until both are the same: ε is then "
        "independent of all that the reference drives."
    )
    board.paragraph(12.0, found.bottom + 24.0, note, 696.0, size=12.0, colour=SOFT)
    return board
