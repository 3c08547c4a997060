"""The flow chart of the strategy, with what happened written beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.trace import Pass, Step
from tridentify.plots.diagrams import drawing
from tridentify.plots.diagrams.words import FINE, elided, number
from tridentify.writing.layout import IN_PICTURES, format_std, format_value, short

MOST_PASSES = 12
"""Rows that still make a chart; what is between is left out and said."""
MOST_STARTS = 4
"""The same of starts, the best first,"""
MOST_COEFFICIENTS = 8
"""and of coefficients."""
LEFT, WIDTH, GAP = 12.0, 318.0, 26.0
TABLE = 392.0
SMALL = 12.0

_STEPS = {
    "parallel": "Step 1: parallel model",
    "series-parallel": "Step 2: series-parallel model",
    "series": "Step 3: series model",
    "output error": "Step on the output error",
    "posterior": "Mean over all likely models",
}
_SHORT = {
    "parallel": "1",
    "series-parallel": "2",
    "series": "3",
    "output error": "output error",
    "posterior": "posterior",
}


def draw_flow_chart(estimate: Estimate) -> drawing.Diagram:
    """Draw the way to an estimate: steps, passes with their costs, and why they ended.

    Parameters
    ----------
    estimate : Estimate
        Of any method.

    Returns
    -------
    Diagram
        SVG text, which notebooks show as a picture. Of many passes the middle ones are left out.

    References
    ----------
    .. [1] Silvestrov et al., System Research and Information Technologies 2025(2), Fig. 4.
    """
    board = drawing.Board()
    board.text(LEFT, 24.0, "How the estimate was reached", size=16.0, bold=True)
    told = f"{estimate.method}: {estimate.status.message}"
    y = board.paragraph(LEFT, 44.0, told, board.width - 24.0, size=SMALL, colour=drawing.SOFT)
    bottom = max(_chart(board, estimate, y + 4.0), _table(board, estimate, y + 4.0))
    _remarks(board, estimate, bottom + 22.0)
    passes = estimate.trace.passes
    costs = f", cost {number(passes[0].cost)} to {number(passes[-1].cost)}" if passes else ""
    return board.svg(
        f"How the estimate was reached: {estimate.method}",
        f"{estimate.status.message}; {len(passes)} passes{costs}; {estimate.trace.stopped}",
    )


def _chart(board: drawing.Board, estimate: Estimate, y: float) -> float:
    """The boxes of the flow chart, one below the other; the height below them."""
    inputs, outputs = (
        ", ".join(short(name, IN_PICTURES) for name in names)
        for names in (estimate.input_names, estimate.output_names)
    )
    record = [
        "Record",
        *drawing.wrapped(
            f"{estimate.n_samples} samples of {inputs} and {outputs}".split(), WIDTH - 16.0, SMALL
        )[:4],
        *_sampled(estimate),
        _orders(estimate),
    ]
    box = _box(board, y, record, drawing.OBJECT)
    starts = estimate.trace.starts
    if starts:
        best = min(starts, key=lambda start: start.cost if start.cost == start.cost else math.inf)
        lines = [f"Starts tried: {len(starts)}"]
        for k in elided(len(starts), MOST_STARTS):
            if k < 0:
                lines.append(f"… {len(starts) - MOST_STARTS + 1} more")
                continue
            mark = " (least)" if len(starts) > 1 and starts[k] is best else ""
            cost = f": {number(starts[k].cost)}{mark}"
            lines.append(
                drawing.fitted(starts[k].name, WIDTH - 24.0 - 8.0 * len(cost), SMALL) + cost
            )
        box = _next(board, box, lines, drawing.MODEL)
    for group in _groups(estimate.trace.passes):
        top = None
        for step in _steps(group):
            box = _next(board, box, _step_lines(step, group), drawing.MODEL)
            if top is None and _times(step, group) > 1:
                top = box
        if top is not None:
            box = _decision(board, box, top, group)
    end = [
        f"End: {estimate.status.value}",
        *drawing.wrapped(estimate.trace.stopped.split(), WIDTH - 16.0, SMALL),
    ]
    box = _next(board, box, end, drawing.JUDGE)
    lines = ["Result", *_coefficients(estimate)]
    fits = ", ".join(
        f"{short(name, IN_PICTURES)} {fit:.1f} %"
        for name, fit in zip(estimate.output_names, estimate.fit, strict=True)
    )
    lines += drawing.wrapped(f"fit {fits}".split(), WIDTH - 16.0, SMALL)
    box = _next(board, box, lines, drawing.OBJECT)
    return box.bottom


def _sampled(estimate: Estimate) -> list[str]:
    if estimate.dt is None:
        return ["at times of their own"]
    return [f"every {number(estimate.dt)} s, inputs {estimate.intersample}"]


def _orders(estimate: Estimate) -> str:
    structure = estimate.structure
    poles, zeros = structure.poles, structure.zeros
    if isinstance(poles, int) and isinstance(zeros, int):
        return f"{poles} pole{'s' * (poles != 1)}, {zeros} zero{'s' * (zeros != 1)}"
    return f"poles {_plain(poles)}, zeros {_plain(zeros)}"


def _plain(orders: object) -> str:
    if isinstance(orders, int):
        return str(orders)
    return str(orders).replace(",)", ")")


def _box(board: drawing.Board, y: float, lines: list[str], fill: str) -> drawing.Rect:
    return board.box(LEFT, y, WIDTH, lines, fill=fill, size=SMALL, bold_first=True)


def _next(board: drawing.Board, above: drawing.Rect, lines: list[str], fill: str) -> drawing.Rect:
    box = _box(board, above.bottom + GAP, lines, fill)
    board.arrow((above.centre, above.bottom), (box.centre, box.y))
    return box


def _groups(passes: Sequence[Pass]) -> list[list[Pass]]:
    """Runs of passes through the same steps; one run where Steps 2 and 3 take turns."""
    found: list[list[Pass]] = []
    before: set[str] = set()
    whole: set[str] = set()
    for one in passes:
        names = {step.name for step in one.steps}
        in_turns = {"series-parallel", "series"} <= whole and names <= whole
        if found and (names == before or in_turns):
            found[-1].append(one)
        else:
            found.append([one])
            whole = set()
        whole |= names
        before = names
    return found


def _steps(group: list[Pass]) -> list[Step]:
    """One step of each kind, as last taken."""
    found: dict[str, Step] = {}
    for one in group:
        for step in one.steps:
            found[step.name] = step
    return list(found.values())


def _times(step: Step, group: list[Pass]) -> int:
    return sum(one.name == step.name for item in group for one in item.steps)


def _step_lines(step: Step, group: list[Pass]) -> list[str]:
    title = _STEPS.get(step.name, step.name)
    if step.name == "series-parallel" and any(
        one.name == "series" for item in group for one in item.steps
    ):
        title = "Steps 2 and 4: series-parallel"
    times = _times(step, group)
    told = f"{f'{times} times, at last ' if times > 1 else ''}cost {number(step.cost)}"
    if not math.isnan(step.condition):
        told += f", condition {number(step.condition, 3)}"
    lines = [title, *drawing.wrapped(told.split(), WIDTH - 16.0, SMALL)]
    if step.note:
        lines += drawing.wrapped(step.note.split(), WIDTH - 16.0, SMALL)[:2]
    if step.name == "series":
        distances = [p.beta_distance for p in group if not math.isnan(p.beta_distance)]
        if distances:
            lines.append(f"β within {number(distances[-1], 2)} of (1, 0, ..., 0)")
    return lines


def _decision(
    board: drawing.Board, above: drawing.Rect, top: drawing.Rect, group: list[Pass]
) -> drawing.Rect:
    """A diamond with the way back to the first step of the group."""
    y, half = above.bottom + GAP, 32.0
    centre, middle = above.centre, above.bottom + GAP + half
    reach = 96.0
    corners = (
        (centre, y),
        (centre + reach, middle),
        (centre, y + 2 * half),
        (centre - reach, middle),
    )
    board.shapes.append(drawing.Polygon(corners, drawing.JUDGE))
    board.arrow((above.centre, above.bottom), (centre, y))
    board.text(centre, middle + 4.5, "settled?", anchor="middle", bold=True, size=SMALL)
    side = LEFT + WIDTH + 26.0
    board.arrow(
        (centre + reach, middle), (side, middle), (side, top.middle), (top.right, top.middle)
    )
    board.text(centre + reach + 8.0, middle - 7.0, "no", size=SMALL)
    times = len(group) - 1
    board.text(
        side - 6.0, middle + 17.0, f"{times} time{'s' * (times != 1)}", anchor="end", size=SMALL,
        colour=drawing.SOFT,
    )  # fmt: skip
    board.text(centre + 8.0, y + 2 * half + 14.0, "yes", size=SMALL)
    return drawing.Rect(LEFT, y, WIDTH, 2 * half)


def _coefficients(estimate: Estimate) -> list[str]:
    words = []
    for k in elided(len(estimate.names), MOST_COEFFICIENTS):
        if k < 0:
            words.append(f"… {len(estimate.names) - MOST_COEFFICIENTS + 1} more …")
            continue
        std, size = float(estimate.std[k]), abs(float(estimate.theta[k]))
        value = format_value(float(estimate.theta[k]), max(std, FINE * size) if std > 0 else 0.0)
        error = f" ± {format_std(std)}" if std > 0 else ""
        words.append(f"{estimate.names[k]} = {value}{error}")
    lines = []
    for word in words:
        name, _, rest = word.partition(" = ")
        room = WIDTH - 24.0 - 8.2 * (len(rest) + 3)
        lines.append(f"{drawing.fitted(name, room, SMALL)} = {rest}" if rest else word)
    return lines


def _table(board: drawing.Board, estimate: Estimate, y: float) -> float:
    """Passes with cost and stop measures; the height below them."""
    passes = estimate.trace.passes
    places = (TABLE + 30.0, TABLE + 114.0, TABLE + 196.0, TABLE + 280.0)
    titles = ("pass", "cost", "|β − 1|", "gradient")
    y += 14.0
    board.text(TABLE, y, "Passes", bold=True, size=13.0)
    y += 22.0
    if not passes:
        board.text(TABLE, y, "none recorded", size=SMALL, colour=drawing.SOFT)
        return y
    for place, title in zip(places, titles, strict=True):
        board.text(place, y, title, anchor="end", size=SMALL, colour=drawing.SOFT)
    board.text(places[-1] + 12.0, y, "", size=SMALL)
    board.line((TABLE, y + 6.0), (board.width - 12.0, y + 6.0))
    y += 6.0
    for k in elided(len(passes), MOST_PASSES):
        y += 1.5 * drawing.LINE * SMALL if k < 0 else drawing.LINE * SMALL
        if k < 0:
            text = f"… {len(passes) - MOST_PASSES + 1} passes more …"
            board.text(TABLE + 8.0, y - 4.0, text, size=SMALL, colour=drawing.SOFT)
            continue
        one = passes[k]
        cells = (
            str(one.number),
            number(one.cost, 5),
            _cell(one.beta_distance),
            _cell(one.gradient),
        )
        for place, cell in zip(places, cells, strict=True):
            board.text(place, y, cell, anchor="end", size=SMALL)
    y += 10.0
    board.line((TABLE, y), (board.width - 12.0, y))
    y += 20.0
    y = _which_steps(board, passes, y)
    for line in (
        "cost: mean square of the output error, in units of the outputs squared",
        "|β − 1|: largest distance of β from (1, 0, ..., 0)",
        "gradient: share of the residual that a further step could remove",
    ):
        y = board.paragraph(
            TABLE, y, line, board.width - TABLE - 12.0, size=11.5, colour=drawing.SOFT
        )
    return _noted(board, passes, y + 10.0)


def _cell(value: float) -> str:
    return "·" if math.isnan(value) else number(value, 2)


def _which_steps(board: drawing.Board, passes: Sequence[Pass], y: float) -> float:
    """Which passes went through which steps."""
    runs: list[tuple[int, int, str]] = []
    for one in passes:
        kind = ", ".join(_SHORT.get(step.name, step.name) for step in one.steps) or "none"
        if runs and runs[-1][2] == kind:
            runs[-1] = (runs[-1][0], one.number, kind)
        else:
            runs.append((one.number, one.number, kind))
    for k in elided(len(runs), 6):
        if k < 0:
            text = "…"
        else:
            first, last, kind = runs[k]
            which = f"pass {first}" if first == last else f"passes {first} to {last}"
            text = f"{which}: {'Step' if kind[:1].isdigit() else ''} {kind}".replace(":  ", ": ")
        y = board.paragraph(TABLE, y, text, board.width - TABLE - 12.0, size=SMALL)
    return y + 8.0


def _noted(board: drawing.Board, passes: Sequence[Pass], y: float) -> float:
    """What was done to single passes: poles reflected or held, restarts."""
    notes: dict[str, list[int]] = {}
    for one in passes:
        if one.note:
            notes.setdefault(one.note, []).append(one.number)
    if not notes:
        return y
    board.text(TABLE, y + 6.0, "What happened on the way", bold=True, size=13.0)
    y += 26.0
    shown = list(notes.items())
    for note, where in shown[:6]:
        numbers = ", ".join(map(str, where[:4])) + (", ..." if len(where) > 4 else "")
        y = board.paragraph(
            TABLE, y, f"pass {numbers}: {note}", board.width - TABLE - 12.0, size=SMALL
        )
    if len(shown) > 6:
        board.text(TABLE, y, f"… {len(shown) - 6} notes more", size=SMALL, colour=drawing.SOFT)
        y += drawing.LINE * SMALL
    return y


def _remarks(board: drawing.Board, estimate: Estimate, y: float) -> None:
    """Decisions and cautions, below everything."""
    for title, lines in (
        ("Decided by the data", estimate.trace.decisions),
        ("Cautions", estimate.cautions),
    ):
        if lines:
            board.text(LEFT, y, title, bold=True, size=13.0)
            y += 18.0
            for line in lines:
                y = board.paragraph(LEFT, y, line, board.width - 24.0, size=SMALL)
            y += 10.0
