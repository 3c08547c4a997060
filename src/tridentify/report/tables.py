"""Tables of a report: coefficients, what follows from them, fit, and the course of the passes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.answer.estimate import Estimate, Parameter, Start
from tridentify.judgement.validation import Validation
from tridentify.uncertainty import DerivedQuantity, derived
from tridentify.writing.layout import IN_TABLES, format_std, format_value, short

Row = Sequence[str]


@dataclass(frozen=True)
class ReportTable:
    """Heading, column titles and cells; the first ``n_left`` and last columns hold text."""

    heading: str
    titles: Row
    rows: Sequence[Row]
    n_left: int = 1
    note: str = ""


def _along_note(estimate: Estimate) -> str:
    """What the nuisance terms mean."""
    note = estimate.offset_note()
    return "Offset and drift of the record, not part of the model" + (f"; {note}." if note else ".")


def result_tables(estimate: Estimate) -> list[ReportTable]:
    """Coefficients, derived quantities, nuisance terms and fit."""
    along = [DerivedQuantity(*row) for row in estimate.nuisance_rows()]
    titles = ("", "value", "std error", "rel. error", "95 % from", "95 % to", "unit")
    parameters = tuple(estimate.parameters.values())
    groups = (
        ("Coefficients", parameters, "Named by the power of s that they multiply."),
        ("Natural frequency, damping, gain", derived(estimate), ""),
        ("Estimated along", along, _along_note(estimate)),
    )
    tables = [
        ReportTable(heading, titles, [_quantity_row(estimate, item) for item in items], note=note)
        for heading, items, note in groups
        if items
    ]
    spread = np.sqrt(estimate.noise_variance)
    outputs = zip(estimate.output_names, estimate.fit, spread, strict=True)
    rows = [
        (short(n, IN_TABLES), f"{f:.2f}", f"{s:.4g}", short(estimate.units.get(n, ""), IN_TABLES))
        for n, f, s in outputs
    ]
    note = "Fit 100 % is a residual of zero, 0 % is no better than the mean of the output."
    tables.append(ReportTable("Fit", ("output", "fit [%]", "noise std", "unit"), rows, note=note))
    return tables


def _quantity_row(estimate: Estimate, item: Parameter) -> Row:
    value, std = item.value, item.std
    name, unit = short(item.name, IN_TABLES), short(item.unit, IN_TABLES)
    if not std > 0:
        held = estimate.held_note(item.name) if item.name in estimate.names else ""
        return (name, format_value(value), held, "", "", "", unit)
    ends = [format_value(end, std) for end in item.interval()]
    relative = f"{100 * item.relative_std:.2g} %"
    return (name, format_value(value, std), format_std(std), relative, *ends, unit)


def course_tables(estimate: Estimate) -> list[ReportTable]:
    """Passes with their steps, coefficients after each pass, and starts."""
    steps, after = [], []
    for item in estimate.trace.passes:
        for step in item.steps:
            numbers = (f"{step.cost:.6g}", measured(step.condition, 3), "", "")
            steps.append((str(item.number), step.name, *numbers, step.note))
        numbers = (f"{item.cost:.6g}", "", measured(item.beta_distance), measured(item.gradient))
        steps.append((str(item.number), "pass ends", *numbers, item.note))
        after.append((str(item.number), *_filled(item.theta.tolist(), len(estimate.names))))
    measures = ("cost", "condition", "beta distance", "gradient")
    names = [short(name, IN_TABLES) for name in estimate.names]
    starts = [
        (s.name, f"{s.cost:.6g}", *_filled(s.theta.tolist(), len(names))) for s in _ranked(estimate)
    ]
    tables = (
        ReportTable("Passes", ("pass", "step", *measures, "note"), steps, n_left=2),
        ReportTable("Coefficients after each pass", ("pass", *names, ""), after),
        ReportTable("Starts tried", ("start", "cost", *names, ""), starts),
    )
    return [table for table in tables if table.rows]


def _filled(theta: Sequence[float], count: int) -> tuple[str, ...]:
    """Cells of coefficients and of the empty last column; blank for delays not yet estimated."""
    cells = [f"{value:.6g}" for value in theta]
    return (*cells, *[""] * (count - len(cells)), "")


def _ranked(estimate: Estimate) -> list[Start]:
    return sorted(estimate.trace.starts, key=lambda start: start.cost)


def validation_tables(checked: Validation) -> list[ReportTable]:
    """The tests of the residual; fit and R2_T, beside what is to be expected of another record."""
    found = [
        (
            test.name,
            short(test.output, IN_TABLES),
            measured(test.p_value),
            "rejected" if test.rejected else "",
        )
        for test in checked.tests
    ]
    note = (
        "A p-value is the probability of so large a deviation if model and noise are right; "
        f"together they reject {1 - checked.level:.0%} of right models (Holm)."
    )
    tables = [
        ReportTable("Tests of the residual", ("test", "output", "p-value", ""), found, 2, note)
    ]
    if checked.transfer is not None:
        fits = zip(checked.output_names, checked.fit, checked.transfer.expected_fit, strict=True)
        rows = [(short(n, IN_TABLES), f"{fit:.2f}", f"{best:.2f}", "") for n, fit, best in fits]
        titles = ("output", "fit [%]", "as good as can be [%]", "")
        tables.append(ReportTable("Carried over to this record", titles, rows))
    return tables


def measured(value: float, digits: int = 2) -> str:
    """A number for a cell; empty for what was not measured."""
    return "" if math.isnan(value) else f"{value:.{digits}g}"
