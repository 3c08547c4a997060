"""An estimate as tables for people and as one JSON object for programs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table

from tridentify.cli.terminal import paragraph
from tridentify.estimate import Estimate, Parameter
from tridentify.record import Record
from tridentify.report.html import warnings_about
from tridentify.text import format_std, format_value
from tridentify.uncertainty import DerivedQuantity, derived

HELD = {
    "zoh": "held between samples (zoh)",
    "foh": "joined by lines between samples (foh)",
    "band-limited": "band-limited",
}


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
        text = number == 0 or title == "unit"
        table.add_column(title, justify="left" if text else "right", no_wrap=True)
    for group in groups:
        table.add_section()
        for row in group:
            table.add_row(*row)
    return table


def coefficient_table(estimate: Estimate) -> Table:
    """Coefficients, then what follows from them, then what was estimated along."""
    titles = ("coefficient", "value", "std error", "95 % from", "to", "unit")
    groups = (estimate.parameters.values(), derived(estimate), along(estimate))
    return make_table(titles, [[_row(item) for item in group] for group in groups if group])


def fit_table(estimate: Estimate) -> Table:
    """Fit and noise of every output."""
    rows = [
        (item["output"], f"{item['fit']:.2f}", f"{item['noise_std']:.4g}", item["unit"])
        for item in fits(estimate)
    ]
    return make_table(("output", "fit [%]", "noise std", "unit"), [rows])


def along(estimate: Estimate) -> tuple[Parameter, ...]:
    """Offsets and drifts that were estimated along."""
    return tuple(DerivedQuantity(*row) for row in estimate.nuisance_rows())


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


def describe_record(record: Record) -> str:
    """Say what was identified from what."""
    step = "steps not uniform" if record.dt is None else f"step {record.dt:.6g} s"
    outputs, inputs = (
        ", ".join(f"{n} [{record.units[n]}]" if record.units.get(n) else n for n in names)
        for names in (record.output_names, record.input_names)
    )
    return paragraph(
        f"{record.name}: {outputs} from {inputs}; {record.n_samples:,} samples, "
        f"{record.t[0]:.6g} to {record.t[-1]:.6g} s, {step}; input {HELD[record.intersample]}"
    )


def describe_status(estimate: Estimate, record: Record) -> str:
    """Say how the estimation ended, and what to beware of."""
    lines = [paragraph(f"{estimate.method}: {estimate.status.message}")]
    if estimate.status.remedy:
        lines.append(paragraph(estimate.status.remedy, "  what to do: ", "    "))
    lines += [paragraph(text, "  caution: ", "    ") for text in warnings_about(estimate, [record])]
    return "\n".join(lines)


def describe_notes(estimate: Estimate) -> list[str]:
    """List what was decided on the way, in one block; nothing if nothing was."""
    lines = [paragraph(note, "- ") for note in notes(estimate)]
    return ["\n".join(lines)] if lines else []


def notes(estimate: Estimate) -> list[str]:
    """What was decided on the way, and why it stopped."""
    said = (estimate.offset_note(), *estimate.trace.decisions, estimate.trace.stopped)
    return [note for note in said if note]


def estimate_document(estimate: Estimate, record: Record) -> dict[str, Any]:
    """Everything that the tables show, by name.

    Parameters
    ----------
    estimate : Estimate
    record : Record
        What was identified.

    Returns
    -------
    dict
        Plain values and arrays; not yet free of nan.
    """
    status = estimate.status
    return {
        "record": {
            "name": record.name,
            "inputs": record.input_names,
            "outputs": record.output_names,
            "n_samples": record.n_samples,
            "start": float(record.t[0]),
            "stop": float(record.t[-1]),
            "dt": record.dt,
            "intersample": record.intersample,
        },
        "method": estimate.method,
        "status": {
            "name": status.name,
            "message": status.message,
            "remedy": status.remedy,
            "ok": status.ok,
        },
        "warnings": warnings_about(estimate, [record]),
        "parameters": [_entry(item) for item in estimate.parameters.values()],
        "derived": [_entry(item) for item in derived(estimate)],
        "estimated_along": [_entry(item) for item in along(estimate)],
        "fit": fits(estimate),
        "model": estimate.model.to_dict(),
        "decisions": notes(estimate),
    }


def _row(item: Parameter) -> tuple[str, ...]:
    ends = [format_value(end, item.std) for end in item.interval()] if item.std else ["", ""]
    value, std = format_value(item.value, item.std), format_std(item.std)
    return item.name, value, std, *ends, item.unit


def _entry(item: Parameter) -> Mapping[str, Any]:
    return {
        "name": item.name,
        "value": item.value,
        "std": item.std,
        "interval95": item.interval(),
        "unit": item.unit,
    }
