"""One self-contained page about an estimate: verdict, tables, figures, settings."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path

import numpy as np

from tridentify.cautions import cautions
from tridentify.estimate import Estimate, Parameter, Start, Status
from tridentify.files import write_atomically
from tridentify.record import Record
from tridentify.report.figures import draw_figures, inline_svg
from tridentify.text import format_std, format_value
from tridentify.uncertainty import DerivedQuantity, derived

Row = Sequence[str]

ROUNDING = 1e-9
"""Of the root mean square of an output: a residual below this is not noise."""
_ESTIMATED = {True: "estimated", False: "none", "auto": "chosen by AICc"}
_BETWEEN = {
    "zoh": "held between samples (zoh)",
    "foh": "linear between samples (foh)",
    "band-limited": "band-limited",
}


@dataclass(frozen=True)
class Table:
    """Heading, column titles and cells; the first ``n_left`` and last columns hold text."""

    heading: str
    titles: Row
    rows: Sequence[Row]
    n_left: int = 1
    note: str = ""


def write_report(
    estimate: Estimate,
    record: Record | Sequence[Record],
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
) -> Path:
    """Write the report as one HTML file that needs nothing else.

    Parameters
    ----------
    estimate : Estimate
    record : Record or sequence of Record
        What was identified; several experiments in their order.
    path : path-like
        File to write; missing folders are made, an existing file is replaced.
    title : str, optional
        Heading of the page; by default the name of the record.

    Returns
    -------
    Path

    Raises
    ------
    OutputPathError
        The file cannot be written; nothing is left behind.
    """
    from jinja2 import Environment

    records = (record,) if isinstance(record, Record) else tuple(record)
    name = title or next((item.name for item in records if item.name), "") or "Identified model"
    source = files("tridentify.report").joinpath("template.html.j2").read_text(encoding="utf-8")
    template = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(
        source
    )
    page = template.render(
        title=name,
        subtitle=subtitle(estimate),
        verdict=verdict(estimate),
        status=estimate.status,
        warnings=warnings_about(estimate, records),
        model=estimate.model_text(),
        results=result_tables(estimate),
        figures=[(item, inline_svg(item)) for item in draw_figures(estimate, records)],
        course=course_tables(estimate),
        decisions=[note for note in (*estimate.trace.decisions, estimate.trace.stopped) if note],
        settings=settings_table(estimate, records),
    )
    return write_atomically(path, page)


def subtitle(estimate: Estimate) -> str:
    """What was identified from what, in one line."""
    outputs, inputs = ", ".join(estimate.output_names), ", ".join(estimate.input_names)
    return f"{outputs} from {inputs}: {estimate.n_samples:,} samples, {estimate.method}"


def verdict(estimate: Estimate) -> str:
    """Class of the status: "good", "caution" or "bad"."""
    if estimate.status is Status.CONVERGED:
        return "good"
    return "caution" if estimate.status.ok else "bad"


def warnings_about(estimate: Estimate, records: Sequence[Record]) -> list[str]:
    """What a reader should know before using the numbers.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record

    Returns
    -------
    list of str
        Found, and what to do; empty when nothing stands out.
    """
    return list(cautions(estimate, records))


def _along_note(estimate: Estimate) -> str:
    """What the nuisance terms mean."""
    note = estimate.offset_note()
    return "Offset and drift of the record, not part of the model" + (f"; {note}." if note else ".")


def result_tables(estimate: Estimate) -> list[Table]:
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
        Table(heading, titles, [_quantity_row(item) for item in items], note=note)
        for heading, items, note in groups
        if items
    ]
    spread = np.sqrt(estimate.noise_variance)
    outputs = zip(estimate.output_names, estimate.fit, spread, strict=True)
    rows = [(n, f"{f:.2f}", f"{s:.4g}", estimate.units.get(n, "")) for n, f, s in outputs]
    note = "Fit 100 % is a residual of zero, 0 % is no better than the mean of the output."
    tables.append(Table("Fit", ("output", "fit [%]", "noise std", "unit"), rows, note=note))
    return tables


def _quantity_row(item: Parameter) -> Row:
    value, std = item.value, item.std
    if std == 0:
        return (item.name, format_value(value), "", "", "", "", item.unit)
    ends = [format_value(end, std) for end in item.interval()]
    relative = f"{100 * item.relative_std:.2g} %"
    return (item.name, format_value(value, std), format_std(std), relative, *ends, item.unit)


def course_tables(estimate: Estimate) -> list[Table]:
    """Passes with their steps, coefficients after each pass, and starts."""
    steps, after = [], []
    for item in estimate.trace.passes:
        for step in item.steps:
            numbers = (f"{step.cost:.6g}", f"{step.condition:.3g}", "", "")
            steps.append((str(item.number), step.name, *numbers, step.note))
        numbers = (f"{item.cost:.6g}", "", _measure(item.beta_distance), _measure(item.gradient))
        steps.append((str(item.number), "pass ends", *numbers, item.note))
        after.append((str(item.number), *(f"{value:.6g}" for value in item.theta), ""))
    measures = ("cost", "condition", "beta distance", "gradient")
    starts = [
        (s.name, f"{s.cost:.6g}", *(f"{v:.6g}" for v in s.theta), "") for s in _ranked(estimate)
    ]
    names = estimate.names
    tables = (
        Table("Passes", ("pass", "step", *measures, "note"), steps, n_left=2),
        Table("Coefficients after each pass", ("pass", *names, ""), after),
        Table("Starts tried", ("start", "cost", *names, ""), starts),
    )
    return [table for table in tables if table.rows]


def _ranked(estimate: Estimate) -> list[Start]:
    return sorted(estimate.trace.starts, key=lambda start: start.cost)


def _measure(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2g}"


def settings_table(estimate: Estimate, records: Sequence[Record]) -> list[tuple[str, str]]:
    """Everything needed to tell which data and which options led here."""
    from tridentify import __version__

    structure = estimate.structure
    priors = structure.priors or {}
    step = "not uniform" if estimate.dt is None else f"{estimate.dt:.6g} s"
    stretches = [f"{r.t[0]:.6g} s to {r.t[-1]:.6g} s ({r.n_samples:,} samples)" for r in records]
    states = [terms.initial_state for terms in estimate.nuisance]
    channels = (*estimate.output_names, *estimate.input_names)
    units = [f"{name} [{estimate.units[name]}]" for name in channels if name in estimate.units]
    rows = [
        ("method", estimate.method),
        ("poles, zeros", f"{structure.poles}, {structure.zeros}"),
        ("delay [s]", f"{structure.delay}"),
        ("offset", _ESTIMATED.get(structure.offset, "")),
        ("drift", _ESTIMATED.get(structure.drift, "")),
        ("initial state", ", ".join(states) or f"{structure.initial_state}"),
        ("fixed", ", ".join(f"{k} = {v:g}" for k, v in (structure.fixed or {}).items())),
        ("bounds", ", ".join(f"{k} in {v}" for k, v in (structure.bounds or {}).items())),
        ("equalities", "; ".join(f"{dict(w)} = {v:g}" for w, v in structure.equalities or ())),
        ("priors", ", ".join(f"{k} = {m:g} +/- {s:g}" for k, (m, s) in priors.items())),
        ("static gain", "" if structure.static_gain is None else f"{structure.static_gain}"),
        ("sampling", f"{step}, input {_BETWEEN[estimate.intersample]}"),
        ("records", "; ".join(stretches)),
        ("units", ", ".join(units)),
        ("degrees of freedom", f"{estimate.degrees_of_freedom}"),
        ("cost, AICc", f"{estimate.cost:.6g}, {estimate.aicc:.6g}"),
        ("condition, relative gradient", f"{estimate.condition:.3g}, {estimate.gradient:.2g}"),
        ("data fingerprint (SHA-256)", estimate.record_fingerprint),
        ("written", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC by tridentify {__version__}"),
    ]
    return [(label, value) for label, value in rows if value]
