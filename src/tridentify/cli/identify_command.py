"""``tridentify identify``: files and a structure in, coefficients with standard errors out."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from tridentify.cli import options, tables
from tridentify.cli.groups import (
    Along,
    Known,
    Late,
    Measured,
    Orders,
    Reading,
    Way,
    asked_structure,
)
from tridentify.cli.load import RecordSource, load
from tridentify.cli.long_record import answer, long_record
from tridentify.cli.run import estimate_blocks, estimate_model, load_compiled, write_results
from tridentify.cli.work import at_work
from tridentify.estimation.methods.base import Method
from tridentify.structure import AutoStructure, Structure


def identify(
    measured: Measured,
    *,
    orders: Orders,
    reading: Reading,
    late: Late,
    along: Along,
    known: Known,
    way: Way,
    loss: Annotated[
        Literal["squared", "huber", "student"], options.model_option(metavar="HOW")
    ] = "squared",
    out: options.Out = None,
    title: options.Title = None,
    as_json: options.AsJson = False,
    verbose: Annotated[bool, options.result_option("--verbose")] = False,
) -> None:
    """Identify the coefficients of a model from records in files.

    Without --poles the orders are chosen. Example: tridentify identify flight.csv --input elevator
    --output q --poles 2 --zeros 1

    Parameters
    ----------
    loss
        What is minimised: squared, or huber or student (robust, for outliers and noise with heavy
        tails).
    verbose
        Also tell by how much every decision was won, and why the search ended.
    """
    inputs, outputs = measured.columns()
    structure = asked_structure(orders, late, along, known, len(outputs), len(inputs))
    source = reading.source(measured.files, inputs, outputs)
    _answer(source, structure, way.chosen(loss), out, title, as_json=as_json, verbose=verbose)


def _answer(
    source: RecordSource,
    structure: Structure | AutoStructure,
    method: Method,
    out: Path | None,
    title: str | None,
    *,
    as_json: bool,
    verbose: bool,
) -> None:
    """Read, estimate, write, print."""
    with ExitStack() as stack:
        work = stack.enter_context(at_work(out))
        activity = work.activity
        long = long_record(source, structure, method, activity)
        records = load(source, activity) if long is None else []
        artist = None
        if out is not None:
            from tridentify.cli.artist import hired

            artist = stack.enter_context(hired())
        load_compiled(activity)
        if isinstance(structure, AutoStructure):
            activity.stage("no --poles: the numbers of poles and zeros are chosen")
        found = None if long is None else answer(long, structure, method, activity)
        if found is None:
            estimate = estimate_model(records, structure, method, activity.stage, artist)
        else:
            estimate, records = found.estimate, [found.stretch]
        if work.results is not None:
            folder = work.results.draft
            estimate = write_results(estimate, records, folder, activity, title, artist)
            work.written = work.results.publish()
    described = tables.describe_records(records) if found is None else found.text()
    work.answer(
        as_json,
        lambda: (
            tables.estimate_document(estimate, records)
            if found is None
            else replace(found, estimate=estimate).document()
        ),
        lambda: estimate_blocks(estimate, described, verbose=verbose),
    )
