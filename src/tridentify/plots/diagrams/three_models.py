"""The three models of the strategy, one below the other.

Step 1 as a picture: operators beside the object, weighted so that the sum is its output.

Step 2 as a picture: a and b behind the filter 1/c, so that the error is linear in them.

Step 3 as a picture: operators behind the model just found make good what it lacks.
"""

from __future__ import annotations

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.plots.diagrams.drawing import MODEL, OBJECT, SOFT, Board, Diagram, wrapped
from tridentify.plots.diagrams.words import (
    Taken,
    add_up,
    adjusts,
    draw_object,
    enters,
    heading,
    index,
    judge,
    number,
    operator_lines,
    operator_rows,
    operators_note,
    taken,
    terms,
    took,
)
from tridentify.plots.style import channel


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
        board, 164.0, begin, labels, weights[own].tolist(), names, (206.0, 124.0)
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
        board, 284.0, begin, labels, weights.tolist(), names, (172.0, 118.0)
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
