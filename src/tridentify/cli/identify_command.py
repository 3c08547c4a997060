"""``tridentify identify``: files and a structure in, coefficients with standard errors out."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tridentify.cli import options, tables
from tridentify.cli.groups import Along, Known, Late, Reading, Way, asked_structure
from tridentify.cli.load import RecordSource, asked_channels, load
from tridentify.cli.long_record import answer, long_record
from tridentify.cli.results import ResultFolder
from tridentify.cli.run import estimate_model, load_compiled, show_estimate, write_results
from tridentify.cli.terminal import Activity, show_json
from tridentify.estimation.methods.base import Method
from tridentify.structure import AutoStructure, Structure

if TYPE_CHECKING:
    from tridentify.cli.artist import Beside


def identify(
    files: options.Files,
    inputs: options.NamedInputs = None,
    outputs: options.NamedOutputs = None,
    *,
    poles: options.PolesOrAuto = None,
    zeros: options.ZerosOrAuto = None,
    reading: Reading,
    late: Late,
    along: Along,
    known: Known,
    way: Way,
    loss: options.Losses = "squared",
    out: options.Out = None,
    title: options.Title = None,
    as_json: options.AsJson = False,
    verbose: options.Verbose = False,
) -> None:
    """Identify the coefficients of a model from records in files.

    Without --poles the orders are chosen. Example: tridentify identify flight.csv --input elevator
    --output q --poles 2 --zeros 1
    """
    inputs, outputs = asked_channels(files, inputs, outputs)
    structure = asked_structure(
        poles or (), zeros or (), late, along, known, len(outputs), len(inputs)
    )
    source = reading.source(files, inputs, outputs)
    _answer(source, structure, way.chosen(loss), out, title, as_json=as_json, verbose=verbose)


def drawn_beside() -> AbstractContextManager[Beside | None]:
    """Another process for the figures, where there is a processor for it."""
    from tridentify.cli.artist import hired

    return hired()


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
    written: Sequence[Path] = ()
    with ExitStack() as stack:
        results = None if out is None else stack.enter_context(ResultFolder(out))
        activity = stack.enter_context(Activity())
        long = long_record(source, structure, method, activity)
        records = load(source, activity) if long is None else []
        artist = None if results is None else stack.enter_context(drawn_beside())
        load_compiled(activity)
        if isinstance(structure, AutoStructure):
            activity.stage("no --poles: the numbers of poles and zeros are chosen")
        found = None if long is None else answer(long, structure, method, activity)
        if found is None:
            estimate = estimate_model(records, structure, method, activity.stage, artist)
        else:
            estimate, records = found.estimate, [found.stretch]
        if results is not None:
            estimate = write_results(estimate, records, results.draft, activity, title, artist)
            written = results.publish()
    if as_json:
        document = (
            tables.estimate_document(estimate, records)
            if found is None
            else replace(found, estimate=estimate).document()
        )
        show_json(document | {"files": [str(path) for path in written]})
    else:
        described = None if found is None else found.text()
        show_estimate(estimate, records, written, verbose=verbose, described=described)
