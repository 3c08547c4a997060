"""``tridentify compare``: stored models and files in, every model simulated on every file out."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, cast

import typer

from tridentify.cli import options
from tridentify.cli.stored_models import MODEL, in_folder
from tridentify.cli.tables import describe_records
from tridentify.cli.terminal import Activity
from tridentify.cli.validate_command import Columns, ReadAsBefore, columns_of, renamed
from tridentify.cli.work import at_work
from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.comparison import Comparison, compare
from tridentify.record.checks.samples import Intersample
from tridentify.transfer_function import TransferFunction
from tridentify.writing.files import write_json


def compare_models(
    files: Annotated[list[Path], typer.Argument(metavar="MODEL... FILE...")],
    *,
    columns: Columns,
    reading: ReadAsBefore,
    out: Annotated[Path | None, options.result_option(metavar="DIR")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Simulate models on records, with offset and initial state fitted to each record.

    Example: tridentify compare two/model.json three/model.json flight_2.csv --out compared

    Parameters
    ----------
    files
        Models: model.json, or the folder of identify --out. Files: records, several are several
        experiments.
    out
        Write comparison.json and comparison.svg into this folder.
    """
    places, tables = _told_apart(files)
    models = _models(places)
    channels = [_columns(models.values(), kind) for kind in ("input", "output")]
    source = reading.source(
        tables,
        columns_of("input", columns.inputs, channels[0], "models"),
        columns_of("output", columns.outputs, channels[1], "models"),
        _between(models.values()) if reading.intersample is None else None,
    )
    with at_work(out) as work:
        records = [renamed(record, *channels) for record in work.records(source)]
        work.activity.stage("simulating the models")
        found = compare(models, records)
        work.publish(lambda folder: _write(found, folder, work.activity))
    work.answer(as_json, found.to_dict, lambda: [describe_records(records), found.summary()])


def _told_apart(files: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """Files of models, and of records."""
    places = [in_folder(file) for file in files]
    models = [place for place in places if place.suffix.lower() == ".json"]
    tables = [place for place in places if place.suffix.lower() != ".json"]
    if not models or not tables:
        missing, wanted = ("model", "model.json or its folder") if tables else ("record", "a file")
        raise OptionError(
            f"found no {missing} among {', '.join(shown(str(file)) for file in files)}; expected "
            f"{wanted} too; write tridentify compare one/model.json other/model.json flight.csv"
        )
    return models, tables


def _models(places: Sequence[Path]) -> dict[str, Estimate | TransferFunction]:
    """The models by the names of their files, or of their folders."""
    from tridentify.export import read_json

    found: dict[str, Estimate | TransferFunction] = {}
    for place in places:
        folder = place.absolute().parent.name
        name = folder if place.name == MODEL and folder else place.stem
        if name in found:
            name = next(
                f"{name} {k}" for k in range(2, len(places) + 1) if f"{name} {k}" not in found
            )
        found[name] = read_json(place)
    return found


def _columns(models: Iterable[Estimate | TransferFunction], kind: str) -> tuple[str, ...]:
    """Channels of all models, each once."""
    rows = [one.input_names if kind == "input" else one.output_names for one in models]
    return tuple(dict.fromkeys(name for row in rows for name in row))


def _write(found: Comparison, folder: Path, activity: Activity) -> None:
    from tridentify.plots import plot_compared
    from tridentify.report.pictures import Drawing, picture_of, save_picture

    activity.stage("writing the figure")
    write_json(folder / "comparison.json", found.to_dict())
    drawing = Drawing("comparison", "Models over records", "", plot_compared(found).figure)
    save_picture(picture_of(drawing), folder)


def _between(models: Iterable[Estimate | TransferFunction]) -> Intersample:
    """As when the models were identified, where that was the same; else each as it was."""
    stated = {one.intersample if isinstance(one, Estimate) else "auto" for one in models}
    return cast("Intersample", stated.pop() if len(stated) == 1 else "auto")
