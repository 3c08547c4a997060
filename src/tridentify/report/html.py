"""One self-contained page about an estimate: verdict, tables, figures, settings."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
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
from tridentify.text import format_std, format_sum, format_value
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
        Heading of the page; by default the names of the records.

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
    named = dict.fromkeys(item.name for item in records if item.name)
    name = title or ", ".join(named) or "Identified model"
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
    several = len(estimate.nuisance)
    where = f" in {several} experiments" if several > 1 else ""
    return f"{outputs} from {inputs}: {estimate.n_samples:,} samples{where}, {estimate.method}"


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
        Table(heading, titles, [_quantity_row(estimate, item) for item in items], note=note)
        for heading, items, note in groups
        if items
    ]
    spread = np.sqrt(estimate.noise_variance)
    outputs = zip(estimate.output_names, estimate.fit, spread, strict=True)
    rows = [(n, f"{f:.2f}", f"{s:.4g}", estimate.units.get(n, "")) for n, f, s in outputs]
    note = "Fit 100 % is a residual of zero, 0 % is no better than the mean of the output."
    tables.append(Table("Fit", ("output", "fit [%]", "noise std", "unit"), rows, note=note))
    return tables


def _quantity_row(estimate: Estimate, item: Parameter) -> Row:
    value, std = item.value, item.std
    if not std > 0:
        held = estimate.held_note(item.name) if item.name in estimate.names else ""
        return (item.name, format_value(value), held, "", "", "", item.unit)
    ends = [format_value(end, std) for end in item.interval()]
    relative = f"{100 * item.relative_std:.2g} %"
    return (item.name, format_value(value, std), format_std(std), relative, *ends, item.unit)


def course_tables(estimate: Estimate) -> list[Table]:
    """Passes with their steps, coefficients after each pass, and starts."""
    steps, after = [], []
    for item in estimate.trace.passes:
        for step in item.steps:
            numbers = (f"{step.cost:.6g}", _measure(step.condition, 3), "", "")
            steps.append((str(item.number), step.name, *numbers, step.note))
        numbers = (f"{item.cost:.6g}", "", _measure(item.beta_distance), _measure(item.gradient))
        steps.append((str(item.number), "pass ends", *numbers, item.note))
        after.append((str(item.number), *_filled(item.theta.tolist(), len(estimate.names))))
    measures = ("cost", "condition", "beta distance", "gradient")
    names = estimate.names
    starts = [
        (s.name, f"{s.cost:.6g}", *_filled(s.theta.tolist(), len(names))) for s in _ranked(estimate)
    ]
    tables = (
        Table("Passes", ("pass", "step", *measures, "note"), steps, n_left=2),
        Table("Coefficients after each pass", ("pass", *names, ""), after),
        Table("Starts tried", ("start", "cost", *names, ""), starts),
    )
    return [table for table in tables if table.rows]


def _filled(theta: Sequence[float], count: int) -> tuple[str, ...]:
    """Cells of coefficients and of the empty last column; blank for delays not yet estimated."""
    cells = [f"{value:.6g}" for value in theta]
    return (*cells, *[""] * (count - len(cells)), "")


def _ranked(estimate: Estimate) -> list[Start]:
    return sorted(estimate.trace.starts, key=lambda start: start.cost)


def _measure(value: float, digits: int = 2) -> str:
    return "" if math.isnan(value) else f"{value:.{digits}g}"


def settings_table(estimate: Estimate, records: Sequence[Record]) -> list[tuple[str, str]]:
    """Everything needed to tell which data and which options led here."""
    from tridentify import __version__

    structure = estimate.structure
    priors = structure.priors or {}
    states = [terms.initial_state for terms in estimate.nuisance]
    channels = (*estimate.output_names, *estimate.input_names)
    units = [f"{name} [{estimate.units[name]}]" for name in channels if name in estimate.units]
    rows = [
        ("method", estimate.method),
        ("poles", _per_channel(estimate, structure.poles)),
        ("zeros", _per_channel(estimate, structure.zeros)),
        ("delay", _delay_text(estimate)),
        ("offset", _ESTIMATED.get(structure.offset, "")),
        ("drift", _ESTIMATED.get(structure.drift, "")),
        ("initial state", ", ".join(states) or f"{structure.initial_state}"),
        ("fixed", ", ".join(f"{k} = {v:g}" for k, v in (structure.fixed or {}).items())),
        ("bounds", ", ".join(_bound_text(k, *v) for k, v in (structure.bounds or {}).items())),
        ("equalities", "; ".join(_equality_text(*item) for item in structure.equalities or ())),
        ("priors", ", ".join(f"{k} = {m:g} +/- {s:g}" for k, (m, s) in priors.items())),
        ("static gain", _per_channel(estimate, structure.static_gain)),
        ("loss", _loss_text(estimate)),
        ("noise", _noise_text(estimate)),
        ("input between samples", _BETWEEN[estimate.intersample]),
        *_record_rows(records),
        ("units", ", ".join(units)),
        ("degrees of freedom", f"{estimate.degrees_of_freedom}"),
        ("cost", _measure(estimate.cost, 6)),
        ("AICc", _measure(estimate.aicc, 6)),
        ("condition", _measure(estimate.condition, 3)),
        ("relative gradient", _measure(estimate.gradient)),
        ("data fingerprint (SHA-256)", estimate.record_fingerprint),
        ("written", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC by tridentify {__version__}"),
    ]
    return [(label, value) for label, value in rows if value]


def _per_channel(estimate: Estimate, given: object) -> str:
    """Orders, delays or gains: one for all channels, or each with the name of its channel."""
    if given is None:
        return ""
    if not isinstance(given, tuple):
        return f"{given}"
    parts = []
    for output, row in zip(estimate.output_names, given, strict=True):
        for source, item in zip(estimate.input_names, row, strict=True):
            parts.append(f"{output} / {source}: {'unknown' if item is None else item}")
    return ", ".join(parts)


def _delay_text(estimate: Estimate) -> str:
    given = estimate.structure.delay
    if given != "free":
        text = _per_channel(estimate, given)
        return f"{text} s" if not isinstance(given, tuple) else f"{text} [s]"
    found = [p for name, p in estimate.parameters.items() if name.startswith("delay")]
    each = [f"{p.name} = {format_value(p.value, p.std)} +/- {format_std(p.std)} s" for p in found]
    return f"estimated: {', '.join(each)}"


def _bound_text(name: str, low: float | None, high: float | None) -> str:
    left = "" if low is None else f"{low:g} <= "
    return f"{left}{name}{'' if high is None else f' <= {high:g}'}"


def _equality_text(weights: Mapping[str, float], value: float) -> str:
    return f"{format_sum(weights)} = {value:g}"


def _loss_text(estimate: Estimate) -> str:
    if estimate.loss == "squared":
        return "squared"
    columns = estimate.outliers[:, 1]
    counts = [f"{n}: {int(np.sum(columns == i))}" for i, n in enumerate(estimate.output_names)]
    return f"{estimate.loss}; outliers beyond four standard deviations: {', '.join(counts)}"


def _noise_text(estimate: Estimate) -> str:
    models = zip(estimate.output_names, estimate.noise_model, strict=True)
    return ", ".join(f"{n}: {f'AR({a.size})' if a.size else 'white'}" for n, a in models)


def _record_rows(records: Sequence[Record]) -> list[tuple[str, str]]:
    """What every experiment is: name, stretch of time, samples, steps, gaps."""
    rows = []
    for number, record in enumerate(records, 1):
        steps = np.diff(record.t)
        step = (
            f"step {record.dt:.6g} s"
            if record.dt is not None
            else f"steps {steps.min():.4g} to {steps.max():.4g} s, not uniform"
        )
        missing = int(np.isnan(record.y).sum())
        lost = f", {missing:,} output samples missing" if missing else ""
        name = f"{record.name}: " if record.name else ""
        stretch = f"{record.t[0]:.6g} s to {record.t[-1]:.6g} s"
        label = "record" if len(records) == 1 else f"experiment {number}"
        text = f"{name}{stretch} ({record.n_samples:,} samples), {step}{lost}"
        rows.append((label, text))
    return rows
