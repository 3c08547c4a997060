"""``tridentify simulate``: a stored model and the inputs of a file in, the outputs out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, cast

import typer

from tridentify.cli import options
from tridentify.cli.stored_models import model_file
from tridentify.cli.terminal import Activity, show, show_json
from tridentify.cli.validate_command import ReadAsBefore, columns_of
from tridentify.cli.work import Work, describe_files
from tridentify.errors import OptionError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.models.simulate import simulate
from tridentify.record.checks.samples import Intersample
from tridentify.record.formats.assemble import InputsAlone
from tridentify.writing.files import columns_over_time, write_atomically


def simulate_file(
    model: Annotated[Path, typer.Argument(metavar="MODEL")],
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    *,
    inputs: Annotated[list[str] | None, options.record_option("--input", metavar="NAME")] = None,
    reading: ReadAsBefore,
    out: Annotated[Path | None, options.result_option(metavar="FILE.csv")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Simulate a model for the inputs of a file, from rest, and give its outputs as CSV.

    Example: tridentify simulate result/model.json flight.csv --out predicted.csv

    Parameters
    ----------
    model
        model.json, as identify --out or save writes it, or the folder of identify --out.
    file
        Time and inputs; outputs need not be there. Before its first sample inputs count as zero:
        compare fits offset and initial state to recorded outputs.
    inputs
        Column of an input, in the order of the model's; by default by the model's names.
    out
        Write the table into this file, in place of standard output.
    """
    from tridentify.export import read_json

    found = read_json(model_file(model, "tridentify simulate result/model.json flight.csv", [file]))
    columns = columns_of("input", inputs, found.input_names)
    stated = found.intersample if isinstance(found, Estimate) else "auto"
    between = cast("Intersample", stated) if reading.intersample is None else None
    source = reading.source([file], columns, found.output_names, between)
    source = replace(source, wanted=InputsAlone(**{**vars(source.wanted), "outputs": ()}))
    with Activity() as activity:
        records = Work(activity, None).records(source)
        if len(records) != 1:
            raise OptionError(
                f"found {len(records)} records in {file.name}; expected one; name one --range"
            )
        record, plant = records[0], found.model if isinstance(found, Estimate) else found
        y = simulate(plant, record)
    if as_json and out is None:
        rows = dict(zip(plant.output_names, y.T.tolist(), strict=True))
        show_json({"model": str(model), "time": record.t.tolist(), "outputs": rows})
        return
    units = found.units if isinstance(found, Estimate) else None
    text = columns_over_time(record.t, y, plant.output_names, units or {})
    if out is None:
        typer.echo(text, nl=False)
        return
    written = [write_atomically(out, text)]
    if as_json:
        show_json({"model": str(model), "files": [str(path) for path in written]})
    else:
        show(*describe_files(written))
