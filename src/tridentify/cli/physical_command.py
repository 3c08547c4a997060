"""``tridentify physical``: files and a ready-made model in, physical parameters out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from tridentify.cli import options, tables
from tridentify.cli.ask import nested_delays
from tridentify.cli.groups import Along, Reading
from tridentify.cli.load import RecordSource
from tridentify.cli.physical_models import (
    Known,
    channels_of,
    check_units,
    chosen_model,
    known_parameters,
    show_models,
)
from tridentify.cli.terminal import Activity, listed, paragraph
from tridentify.cli.work import at_work
from tridentify.errors import MissingColumnError, OptionError, UndeterminedError, shown
from tridentify.physical import PhysicalEstimate, PhysicalModel, estimate_physical
from tridentify.record.record import Record

TITLES = ("parameter", "value", "std error", "95 % from", "to", "unit")


def physical(
    files: Annotated[list[Path] | None, typer.Argument(metavar="FILE")] = None,
    model: Annotated[str | None, options.model_option(metavar="NAME")] = None,
    inputs: Annotated[list[str] | None, options.record_option("--input", metavar="NAME")] = None,
    outputs: Annotated[list[str] | None, options.record_option("--output", metavar="NAME")] = None,
    *,
    reading: Reading,
    known: Annotated[list[str] | None, options.known_option(metavar="P=X")] = None,
    delay: Annotated[str | None, options.model_option(metavar="SECONDS")] = None,
    along: Along,
    out: options.Out = None,
    title: options.Title = None,
    as_json: options.AsJson = False,
    list_models: Annotated[bool, typer.Option("--list")] = False,
) -> None:
    """Estimate the physical parameters of a ready-made model from records in files.

    Columns are taken to be in the units that go with those of the parameters (--list shows them).
    With --out the folder also gets physical.json.

    Example: tridentify physical run.csv --model mass-spring-damper --input force --output position

    Parameters
    ----------
    files
        As for identify; several are several experiments.
    model
        Ready-made model; --list shows them.
    inputs
        Column of each input, by name (elevator=u_elevator) or in their order.
    outputs
        Column of each output, by name (q=y_q) or in their order.
    known
        A parameter that is known: R1=1e4, or with its standard deviation R1=1e4+-100.
    delay
        Known dead time of the input.
    list_models
        Show the ready-made models and their parameters.
    """
    if list_models:
        show_models(as_json)
        return
    chosen = chosen_model(model, files)
    mapping = channels_of(chosen, inputs or [], outputs or [])
    wished = replace(chosen.structure, delay=_delay_of(chosen, delay), **along.terms())
    source = reading.source(
        files or (),
        [mapping[ours] for ours in chosen.input_names],
        [mapping[ours] for ours in chosen.output_names],
    )
    asked = replace(chosen, structure=wished), mapping, known_parameters(known or ())
    _answer(source, *asked, out, title, as_json)


def _delay_of(model: PhysicalModel, given: str | None) -> Any:
    """The known dead time, or that of a model that has one among its parameters."""
    if model.structure.delay == "free":
        if given is not None:
            raise OptionError(
                f"found --delay {shown(given)} for {model.name}, which has a dead time of its own; "
                "expected none; write --known D=SECONDS if it is known"
            )
        return "free"
    seconds = nested_delays([] if given is None else [given], 1, 1)
    if not isinstance(seconds, float):
        raise OptionError(
            f"found --delay {shown(given)}; expected seconds, since the coefficients of this "
            "model hold no delay; find it with identify --delay free first"
        )
    return seconds


def _answer(
    source: RecordSource,
    model: PhysicalModel,
    channels: Mapping[str, str],
    known: Known,
    out: Path | None,
    title: str | None,
    as_json: bool,
) -> None:
    """Read, estimate, write, print."""
    with at_work(out) as work:
        activity = work.activity
        records = work.records(source)
        named = _names_in(records[0], channels)
        check_units(records, named)
        found = estimate_physical(
            model, records, known=known, channels=named, progress=activity.stage
        )
        _refuse_silence(found)
        order = [[named[n] for n in names] for names in (model.input_names, model.output_names)]
        ordered = [record.select(*order) for record in records]
        work.publish(lambda folder: _write(found, ordered, folder, activity, title))
    work.answer(
        as_json,
        lambda: physical_document(found, records, named),
        lambda: _account(found, records, named),
    )


def _write(
    found: PhysicalEstimate,
    records: Sequence[Record],
    folder: Path,
    activity: Activity,
    title: str | None,
) -> None:
    """Write physical.json, model.json of the free coefficients, the page and the figures."""
    from tridentify.report import write_physical_report

    found.save(folder / "physical.json")
    found.estimate.save(folder / "model.json")
    page = folder / "report.html"
    write_physical_report(
        found, records, page, title=title, figures=folder, progress=activity.stage
    )


def _names_in(record: Record, channels: Mapping[str, str]) -> dict[str, str]:
    """Channels under the names that the record gives them: a column may be asked for in full."""
    there = (*record.input_names, *record.output_names)
    named = {}
    for ours, asked in channels.items():
        fits = [name for name in there if name == asked or asked.startswith(f"{name} ")]
        if not fits:
            raise MissingColumnError(
                f"found {', '.join(there)} in the record; expected {shown(asked)}; name the column "
                "without its unit"
            )
        named[ours] = fits[0]
    return named


def _refuse_silence(found: PhysicalEstimate) -> None:
    """Refuse an answer that says nothing about any parameter that was not known."""
    asked = [name for name in found.names if found.known.get(name, (0.0, 1.0))[1] > 0]
    said = any(np.isfinite(found.parameters[name].value) for name in asked)
    if not said and not found.combinations:
        raise UndeterminedError(
            f"found no parameter of {found.model_name} that the record determines: "
            f"{'; '.join(found.notes)}; expected at least one; state some with --known"
        )


def _account(
    found: PhysicalEstimate, records: Sequence[Record], named: Mapping[str, str]
) -> list[str | Table]:
    renamed = [f"{ours} is {theirs}" for ours, theirs in named.items() if ours != theirs]
    text = f"{found.model_name}{': ' if renamed else ''}{listed(renamed)}"
    groups = [
        [tables.parameter_row(item, "known" if item.name in found.known else "") for item in group]
        for group in (found.parameters.values(), found.combinations)
        if group
    ]
    fits = [
        (name, f"{one:.2f}", f"{free:.2f}")
        for name, one, free in zip(
            found.estimate.output_names, found.fit, found.estimate.fit, strict=True
        )
    ]
    said = [note for note in (found.test_note(), *found.notes) if note]
    notes = ["\n".join(paragraph(note, "- ") for note in said)] if said else []
    return [
        tables.describe_records(records),
        tables.describe_status(found.estimate),
        paragraph(text),
        tables.make_table(TITLES, groups),
        tables.make_table(("output", "fit [%]", "of free coefficients [%]"), [fits]),
        *notes,
    ]


def physical_document(
    found: PhysicalEstimate, records: Sequence[Record], named: Mapping[str, str]
) -> dict[str, Any]:
    """Everything that the tables show, by name; the coefficients as `identify` gives them.

    Parameters
    ----------
    found : PhysicalEstimate
    records : sequence of Record
    named : mapping of str to str
        Channel of the model -> channel of the records.

    Returns
    -------
    dict
        Plain values and arrays; nan for what is not determined.
    """
    rows = zip(found.parameters.values(), found.descriptions, strict=True)
    return {
        "model": found.model_name,
        "channels": dict(named),
        "parameters": [
            tables.entry(item) | {"description": text, "known": item.name in found.known}
            for item, text in rows
        ],
        "combinations": [tables.entry(item) for item in found.combinations],
        "alternatives": [
            dict(zip(found.names, row, strict=True)) for row in found.alternatives.tolist()
        ],
        "fit": dict(zip(found.estimate.output_names, found.fit, strict=True)),
        "restrictions": {
            "statistic": found.statistic,
            "freedom": found.freedom,
            "p_value": found.p_value,
        },
        "notes": found.notes,
        "coefficients": tables.estimate_document(found.estimate, records),
    }
