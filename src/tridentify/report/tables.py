"""Tables of a report: coefficients, what follows from them, fit, and the course of the passes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.answer.estimate import Estimate, Parameter
from tridentify.judgement.validation import Validation
from tridentify.judgement.validation.result import Check
from tridentify.uncertainty import DerivedQuantity, derived
from tridentify.writing.layout import IN_TABLES, format_p, format_std, format_value, short

Row = Sequence[str]


NOT_DETERMINED = 1.0
"""Standard error over the value, from which the value says no more than its sign."""


@dataclass(frozen=True)
class ReportTable:
    """Heading, column titles and cells; the first ``n_left`` and last columns hold text.

    ``marked`` are the positions of rows that stand out.
    """

    heading: str
    titles: Row
    rows: Sequence[Row]
    n_left: int = 1
    note: str = ""
    marked: tuple[int, ...] = ()


def _along_note(estimate: Estimate) -> str:
    """What the nuisance terms mean."""
    note = estimate.offset_note()
    return "Offset and drift of the record, not part of the model" + (f"; {note}." if note else ".")


TITLES = ("", "value", "std error", "rel. error", "95 % from", "95 % to", "unit")


def result_tables(estimate: Estimate) -> list[ReportTable]:
    """Coefficients, derived quantities, nuisance terms and fit."""
    along = [DerivedQuantity(*row) for row in estimate.nuisance_rows()]
    parameters = tuple(estimate.parameters.values())
    notes = {item.name: estimate.held_note(item.name) for item in parameters}
    groups = (
        ("Coefficients", parameters, "Named by the power of s that they multiply."),
        ("Natural frequency, damping, gain", derived(estimate), ""),
    )
    tables = [quantity_table(head, items, note, notes) for head, items, note in groups if items]
    if along:
        # an error relative to an offset of zero says nothing
        rows = [(*row[:3], *row[4:]) for row in (quantity_row(item) for item in along)]
        titles = (*TITLES[:3], *TITLES[4:])
        tables.append(ReportTable("Estimated along", titles, rows, note=_along_note(estimate)))
    spread = np.sqrt(estimate.noise_variance)
    outputs = zip(estimate.output_names, estimate.fit, spread, strict=True)
    fits = [
        (short(n, IN_TABLES), f"{f:.1f}", f"{s:.3g}", short(estimate.units.get(n, ""), IN_TABLES))
        for n, f, s in outputs
    ]
    note = "Fit 100 % is a residual of zero, 0 % is no better than the mean of the output."
    tables.append(ReportTable("Fit", ("output", "fit [%]", "noise std", "unit"), fits, note=note))
    if levels := estimate.noise_level_rows():
        head = ("noise std", *(short(name, IN_TABLES) for name in estimate.output_names))
        note = "Samples count by the noise of their experiment."
        tables.append(ReportTable("Noise of each experiment", head, list(levels), note=note))
    return tables


def quantity_table(
    heading: str, items: Sequence[Parameter], note: str = "", held: Mapping[str, str] | None = None
) -> ReportTable:
    """Values with their errors.

    Parameters
    ----------
    heading : str
    items : sequence of Parameter
    note : str
    held : mapping of str to str, optional
        What is said in place of an error that is zero.
    """
    words = held or {}
    rows = [quantity_row(item, words.get(item.name, "")) for item in items]
    return ReportTable(heading, TITLES, rows, note=note)


def quantity_row(item: Parameter, held: str = "") -> Row:
    """Name, value, standard error, relative error, interval, unit."""
    value, std = item.value, item.std
    name, unit = short(item.name, IN_TABLES), short(item.unit, IN_TABLES)
    if math.isnan(value) or not item.determined:
        return (name, "not determined", "", "", "", "", unit)
    if not std > 0:
        return (name, format_value(value), held, "", "", "", unit)
    known = item.relative_std < NOT_DETERMINED
    relative = f"{100 * item.relative_std:.2g} %" if known else "not determined"
    shown = format_value(value, item.told_to), format_std(std), relative, *item.written_ends
    return (name, *shown, unit)


def course_tables(estimate: Estimate) -> list[ReportTable]:
    """Passes with their steps, coefficients after each pass, and starts."""
    steps: list[Row] = []
    after: list[Row] = []
    ends: list[int] = []
    for item in estimate.trace.passes:
        for step in item.steps:
            numbers = (f"{step.cost:.5g}", measured(step.condition, 3), "", "")
            steps.append((str(item.number), step.name, *numbers, step.note))
        numbers = (f"{item.cost:.5g}", "", measured(item.beta_distance), measured(item.gradient))
        ends.append(len(steps))
        steps.append((str(item.number), "pass ends", *numbers, item.note))
        after.append((str(item.number), *_filled(item.theta.tolist(), len(estimate.names))))
    measures = ("cost", "condition", "beta distance", "gradient")
    names = [short(name, IN_TABLES) for name in estimate.names]
    ranked = sorted(estimate.trace.starts, key=lambda start: start.cost)
    starts = [(s.name, f"{s.cost:.5g}", *_filled(s.theta.tolist(), len(names))) for s in ranked]
    tables = (
        ReportTable("Passes", ("pass", "step", *measures, "note"), steps, 2, marked=tuple(ends)),
        ReportTable("Coefficients after each pass", ("pass", *names, ""), after),
        ReportTable("Starts tried", ("start", "cost", *names, ""), starts),
    )
    return [table for table in tables if table.rows]


def _filled(theta: Sequence[float], count: int) -> tuple[str, ...]:
    """Cells of coefficients and of the empty last column; blank for delays not yet estimated."""
    cells = [f"{value:.5g}" for value in theta]
    return (*cells, *[""] * (count - len(cells)), "")


QUESTIONS = {
    "white": "is what the noise's model leaves free of a pattern in time?",
    "past inputs": "does it follow the inputs, as where part of the response is missing?",
    "feedback": "do later inputs answer to the output?",
    "level": "does its level wander, as with a drift or a slow disturbance?",
    "scale": "does its size change over the record?",
    "coefficients constant": "is it the same system from beginning to end?",
    "linear": "is the response in proportion to the input?",
    "Gaussian": "is it Gaussian, without samples far outside?",
    "same coefficients": "do the coefficients of this record agree with the estimate's?",
    "size of the noise": "is it as small as the estimate leads to expect?",
}
"""What each test of the residual asks."""


def validation_tables(checked: Validation) -> list[ReportTable]:
    """The tests of the residual; fit and R2_T, beside what is to be expected of another record."""
    outputs = list(checked.output_names)
    names = list(dict.fromkeys(test.name for test in checked.tests))
    cells = {(test.name, test.output): _tested(test) for test in checked.tests}
    # a test of all outputs together stands with the first
    cells = {(t.name, outputs[0]): _tested(t) for t in checked.tests if t.output == "all"} | cells
    rows = [
        (name, *(cells.get((name, output), "") for output in outputs), QUESTIONS.get(name, ""))
        for name in names
    ]
    titles = ("test", *(short(output, IN_TABLES) for output in outputs), "what it asks")
    rejected = tuple(
        k
        for k, name in enumerate(names)
        if any(t.rejected for t in checked.tests if t.name == name)
    )
    note = (
        "Numbers are p-values: the probability of so large a deviation if model and noise are "
        "right. A star marks what is rejected; all tests together reject "
        f"{1 - checked.level:.0%} of right models (Holm). A dash: the test could not be made."
    )
    found = ReportTable("Tests of the residual", titles, rows, 1, note, rejected)
    return [*([found] if rows else []), fit_table(checked)]


def _tested(test: Check) -> str:
    return format_p(test.p_value) + " *" * test.rejected


def fit_table(checked: Validation) -> ReportTable:
    """How well the simulated outputs follow the recorded ones."""
    expected = [""] * len(checked.output_names)
    if checked.transfer is not None:
        expected = [f"{best:.1f}" for best in checked.transfer.expected_fit]
    cells = zip(checked.output_names, checked.fit, expected, checked.r2, strict=True)
    rows: list[Row] = [
        (short(n, IN_TABLES), f"{f:.1f}", best, f"{r2:.4f}", "") for n, f, best, r2 in cells
    ]
    titles: Row = ("output", "fit [%]", "as good as can be [%]", "R2_T", "")
    note = "R2_T is the share of the output's variance that the model's response explains."
    if checked.transfer is None:
        rows = [(*row[:2], *row[3:]) for row in rows]
        titles = (*titles[:2], *titles[3:])
    else:
        note += (
            " As good as can be: the fit that the noise and the standard errors of the estimate "
            "lead to expect."
        )
    return ReportTable("Fit on this record", titles, rows, note=note)


def measured(value: float, digits: int = 2) -> str:
    """A number for a cell; empty for what was not measured."""
    return "" if math.isnan(value) else f"{value:.{digits}g}"
