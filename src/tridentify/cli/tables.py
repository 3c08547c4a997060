"""An estimate as tables for people and as one JSON object for programs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from tridentify.cli.terminal import paragraph
from tridentify.estimation.answer.estimate import Estimate, Parameter
from tridentify.estimation.answer.finding import Finding, beside_errors
from tridentify.estimation.answer.parameter import NOT_DETERMINED
from tridentify.estimation.answer.trust import unusable
from tridentify.record.record import Record
from tridentify.writing.layout import IN_TABLES, format_std, format_value, printable, short

HELD = {
    "zoh": "held between samples (zoh)",
    "foh": "joined by lines between samples (foh)",
    "band-limited": "band-limited",
    "auto": "compared as held, joined by lines and band-limited (auto)",
}


def sampling_text(record: Record) -> str:
    """Say how far apart the samples are."""
    if record.dt is not None:
        return f"step {record.dt:.6g} s"
    steps = np.diff(record.t)
    return f"steps {steps.min():.4g} to {steps.max():.4g} s"


def make_table(titles: Sequence[str], groups: Iterable[Iterable[Sequence[str]]]) -> Table:
    """Lay out rows: the first column and units to the left, numbers to the right.

    Parameters
    ----------
    titles : sequence of str
    groups : iterable of iterable of sequence of str
        Rows; a line is drawn between groups.

    Returns
    -------
    rich.table.Table
    """
    table = Table(
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        show_edge=False,
        header_style="bold",
    )
    for number, title in enumerate(titles):
        text = number == 0 or title in ("unit", "description")
        table.add_column(printable(title), justify="left" if text else "right", no_wrap=True)
    for group in groups:
        table.add_section()
        for row in group:
            table.add_row(*map(printable, row))
    return table


def coefficient_table(estimate: Estimate) -> Table:
    """Coefficients, then what follows from them, then what was estimated along."""
    from tridentify.uncertainty.roots import derived

    titles = ("coefficient", "value", "std error", "95 % from", "to", "unit")
    named = [
        parameter_row(item, estimate.held_note(item.name)) for item in estimate.parameters.values()
    ]
    groups = [
        [parameter_row(item) for item in group] for group in (derived(estimate), along(estimate))
    ]
    return make_table(titles, [group for group in (named, *groups) if group])


def fit_table(estimate: Estimate) -> Table:
    """Fit and noise of every output."""
    rows = [
        (
            short(item["output"], IN_TABLES),
            f"{item['fit']:.2f}",
            f"{item['noise_std']:.4g}",
            short(item["unit"], IN_TABLES),
        )
        for item in fits(estimate)
    ]
    return make_table(("output", "fit [%]", "noise std", "unit"), [rows])


def noise_tables(estimate: Estimate) -> list[Table]:
    """The noise of each experiment, where these have levels of their own."""
    levels = estimate.noise_level_rows()
    titles = ("noise std", *(short(name, IN_TABLES) for name in estimate.output_names))
    return [make_table(titles, [list(levels)])] if levels else []


def along(estimate: Estimate) -> tuple[Parameter, ...]:
    """Offsets and drifts that were estimated along."""
    return tuple(Parameter(*row) for row in estimate.nuisance_rows())


def fits(estimate: Estimate) -> list[dict[str, Any]]:
    """Fit [percent] and standard deviation of the residual of every output."""
    return [
        {
            "output": name,
            "fit": float(estimate.fit[i]),
            "noise_std": math.sqrt(estimate.noise_variance[i]),
            "unit": estimate.units.get(name, ""),
        }
        for i, name in enumerate(estimate.output_names)
    ]


def describe_records(records: Sequence[Record]) -> str:
    """Say what was identified from what, a paragraph for each experiment."""
    if len(records) == 1:
        return paragraph(_described(records[0]))
    lines = [
        paragraph(_described(record), f"experiment {number}, ", "  ")
        for number, record in enumerate(records, 1)
    ]
    return "\n".join(lines)


def _described(record: Record) -> str:
    missing = int(np.isnan(record.y).sum())
    outputs, inputs, references = (
        ", ".join(f"{n} [{record.units[n]}]" if record.units.get(n) else n for n in names)
        for names in (record.output_names, record.input_names, record.reference_names)
    )
    lost = f" ({missing:,} outputs missing)" if missing else ""
    return (
        f"{record.name}: {outputs} from {inputs}; {record.n_samples:,} samples{lost}, "
        f"{record.t[0]:.6g} to {record.t[-1]:.6g} s, {sampling_text(record)}; "
        f"input {HELD[record.intersample]}"
    ) + (f"; reference {references}, {HELD[str(record.reference_behaviour)]}" if references else "")


def describe_status(estimate: Estimate) -> str:
    """Say how the estimation ended, and what to beware of."""
    lines = [paragraph(f"{estimate.method}: {estimate.status.message}")]
    if estimate.status.ok and (why := unusable(estimate, estimate.findings)):
        lines.append(paragraph(why))
    if remedy := beside_errors(estimate.status.remedy, estimate.findings):
        lines.append(paragraph(remedy, "  what to do: ", "    "))
    lines += [paragraph(text, "  caution: ", "    ") for text in estimate.cautions]
    told = [finding.text for finding in estimate.findings if not finding.matters]
    lines += [paragraph(text, "  note: ", "    ") for text in told]
    return "\n".join(lines)


def describe_findings(findings: Iterable[Finding]) -> list[str]:
    """What was found, the serious marked, each with what to do about it."""
    lines = []
    for finding in findings:
        said = f"{finding.message} {finding.effect}".strip()
        lines.append(paragraph(said, "! " if finding.matters else "- ", "  "))
        if finding.remedy:
            lines.append(paragraph(finding.remedy, "  what to do: ", "    "))
    return lines


def describe_notes(estimate: Estimate, *, verbose: bool = False) -> list[str]:
    """List what was decided on the way, in one block; nothing if nothing was.

    Parameters
    ----------
    estimate : Estimate
    verbose : bool
        With the criteria of what was not chosen, and why the search ended.
    """
    lines = [paragraph(note, "- ") for note in estimate.notes(verbose=verbose)]
    return ["\n".join(lines)] if lines else []


def estimate_document(estimate: Estimate, records: Sequence[Record]) -> dict[str, Any]:
    """Everything that the tables show, by name.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        What was identified.

    Returns
    -------
    dict
        Plain values and arrays; not yet free of nan. ``record`` is the first of ``experiments``.
    """
    from tridentify.uncertainty.roots import derived

    status = estimate.status
    experiments = [_record_entry(record) for record in records]
    return {
        "record": experiments[0],
        "experiments": experiments,
        "units": dict(estimate.units),
        "method": estimate.method,
        "route": estimate.route,
        "structure": estimate.structure.to_dict(),
        "status": {
            "name": status.name,
            "message": status.message,
            "remedy": status.remedy,
            "ok": status.ok,
        },
        "warnings": estimate.cautions,
        "findings": [asdict(finding) for finding in estimate.findings],
        "parameters": [
            entry(item) | {"known": estimate.held_note(item.name)}
            for item in estimate.parameters.values()
        ],
        "delays": _delays(estimate),
        "derived": [entry(item) for item in derived(estimate)],
        "estimated_along": [entry(item) for item in along(estimate)],
        "fit": fits(estimate),
        "noise_levels": [one.tolist() for one in estimate.noise_levels],
        "errors": estimate.errors,
        "loss": estimate.loss,
        "outliers": _outliers(estimate),
        "noise_model": dict(zip(estimate.output_names, estimate.noise_model, strict=True)),
        "model": estimate.model.to_dict(),
        "decisions": estimate.notes(verbose=True),
    }


def _record_entry(record: Record) -> dict[str, Any]:
    return {
        "name": record.name,
        "inputs": record.input_names,
        "outputs": record.output_names,
        "n_samples": record.n_samples,
        "n_missing": int(np.isnan(record.y).sum()),
        "start": float(record.t[0]),
        "stop": float(record.t[-1]),
        "dt": record.dt,
        "intersample": record.intersample,
        "references": record.reference_names,
        "reference_intersample": record.reference_behaviour,
    }


def _delays(estimate: Estimate) -> list[dict[str, Any]]:
    """Dead time of every channel; the standard error is None where it is known."""
    found = []
    for i, output in enumerate(estimate.output_names):
        for j, source in enumerate(estimate.input_names):
            names = ("delay", f"delay[{source}]")
            own = next((estimate.parameters[n] for n in names if n in estimate.names), None)
            entry = {"output": output, "input": source, "value": estimate.model.delay[i, j]}
            found.append(entry | {"std": own.std if own else None, "unit": "s"})
    return found


def _outliers(estimate: Estimate) -> dict[str, Any]:
    """How many samples lie far out under a robust loss, in all and for each output."""
    columns = estimate.outliers[:, 1]
    counts = {n: int(np.sum(columns == i)) for i, n in enumerate(estimate.output_names)}
    return {"count": len(estimate.outliers), "by_output": counts}


def parameter_row(item: Parameter, held: str = "") -> tuple[str, ...]:
    """Name, value, error (or why it has none), 95 % interval and unit of a parameter."""
    if not item.determined or math.isnan(item.value):
        return short(item.name, IN_TABLES), NOT_DETERMINED, "", "", "", short(item.unit, IN_TABLES)
    value, std = format_value(item.value, item.told_to), format_std(item.std) or held
    ends = item.written_ends
    return short(item.name, IN_TABLES), value, std, *ends, short(item.unit, IN_TABLES)


def entry(item: Parameter) -> dict[str, Any]:
    """Value, standard error, 95 % interval and unit of a parameter."""
    return {
        "name": item.name,
        "value": item.value,
        "std": item.std,
        "interval95": item.interval(),
        "unit": item.unit,
    }
