"""``tridentify validate``: a stored model and files in, whether to trust the model out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, cast

import typer
from rich.table import Table

from tridentify.cli import options
from tridentify.cli.groups import Reading
from tridentify.cli.stored_models import model_file
from tridentify.cli.tables import describe_findings, describe_records, make_table
from tridentify.cli.terminal import Activity, paragraph
from tridentify.cli.work import at_work
from tridentify.errors import ChannelNameError, DataError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.validation import Validation
from tridentify.record.checks.samples import Intersample
from tridentify.record.record import Record
from tridentify.writing.files import write_json
from tridentify.writing.layout import format_p

NOT_TRUSTED = 1


Held = Annotated[Intersample | None, options.record_option(metavar="HOW")]


@dataclass(frozen=True)
class Columns:
    """Columns of the channels of a model.

    Attributes
    ----------
    inputs
        Column of an input, in the order of the model's; by default by the model's names.
    outputs
        Column of an output, in the order of the model's; by default by the model's names.
    """

    inputs: Annotated[list[str] | None, options.record_option("--input", metavar="NAME")] = None
    outputs: Annotated[list[str] | None, options.record_option("--output", metavar="NAME")] = None


@dataclass(frozen=True)
class ReadAsBefore(Reading):
    """The same, the input as when the model was identified.

    Attributes
    ----------
    intersample
        What the input does between samples: zoh, foh or band-limited; by default as when the model
        was identified.
    """

    intersample: Held = None  # type: ignore[assignment]


def validate(
    model: Annotated[Path, typer.Argument(metavar="MODEL")],
    files: Annotated[list[Path], typer.Argument(metavar="FILE")],
    *,
    columns: Columns,
    reading: ReadAsBefore,
    experiment: Annotated[int | None, options.record_option(metavar="N")] = None,
    level: Annotated[float, options.result_option(metavar="P")] = 0.99,
    out: Annotated[Path | None, options.result_option(metavar="DIR")] = None,
    as_json: options.AsJson = False,
    check: Annotated[bool, options.result_option("--check")] = False,
) -> None:
    """Test whether a model explains records but for noise, and say what it misses.

    Example: tridentify validate result/model.json flight.csv

    Parameters
    ----------
    model
        model.json, as identify --out or save writes it, or the folder of identify --out.
    files
        The file that was identified, or another one; several are several experiments.
    experiment
        The file is experiment N of the model (1 is the first): its offset and initial state are
        used. By default they are fitted, unless the files are those that were identified.
    level
        Probability that a right model passes all tests together.
    out
        Write report.html, validation.json and the pictures into this folder.
    check
        Exit with code 1 if anything serious is found.
    """
    from tridentify.judgement.validation import validate as judge

    order = "tridentify validate result/model.json flight.csv"
    estimate = Estimate.load(model_file(model, order, files))
    source = reading.source(
        files,
        columns_of("input", columns.inputs, estimate.input_names),
        columns_of("output", columns.outputs, estimate.output_names),
        cast("Intersample", estimate.intersample) if reading.intersample is None else None,
    )
    if not (columns.inputs or columns.outputs):
        source = replace(source, usual_step=estimate.dt)
    with at_work(out) as work:
        activity = work.activity
        channels = estimate.input_names, estimate.output_names
        records = [renamed(record, *channels) for record in work.records(source)]
        activity.stage("testing the residual")
        which = _experiment(estimate, records, experiment)
        found = judge(estimate, records, experiment=which, level=level)
        work.publish(lambda folder: _write(estimate, found, records, which, folder, activity))
    work.answer(as_json, found.to_dict, lambda: _blocks(found, records))
    if check and not found.ok:
        raise typer.Exit(NOT_TRUSTED)


def columns_of(
    what: str, given: Sequence[str] | None, names: Sequence[str], whose: str = "a model"
) -> tuple[str, ...]:
    """Columns of the channels, in the order of the model's.

    Raises
    ------
    ChannelNameError
        They are not as many.
    """
    if not given:
        return tuple(names)
    if len(given) != len(names):
        raise ChannelNameError(
            f"found {len(given)} --{what} for {whose} with {len(names)} ({', '.join(names)}); "
            "expected one for each, in that order; name them all or none"
        )
    return tuple(given)


def renamed(record: Record, inputs: Sequence[str], outputs: Sequence[str]) -> Record:
    """The same record under the names of a model's channels."""
    old = (*record.input_names, *record.output_names)
    new = (*inputs, *outputs)
    if old == new:
        return record
    kept = [*zip(old, new, strict=True), *((r, r) for r in record.reference_names)]
    units = {b: record.units[a] for a, b in kept if a in record.units}
    by_step = record.dt is not None and not record.t[0]
    sampling = {"dt": record.dt} if by_step else {"t": record.t}
    return Record(
        record.u,
        record.y,
        **cast("dict[str, Any]", sampling),
        intersample=record.intersample,
        **record._loop,
        input_names=inputs,
        output_names=outputs,
        units=units,
        name=record.name,
    )


def _experiment(
    estimate: Estimate, records: Sequence[Record], experiment: int | None
) -> int | None:
    """Position of the experiment that was named.

    Raises
    ------
    DataError
        There is no such experiment, or there are several files.
    """
    most = len(estimate.nuisance)
    if experiment is not None and (len(records) > 1 or not 1 <= experiment <= most):
        many = "1 file" if len(records) == 1 else f"{len(records)} files"
        wanted = "1" if most == 1 else f"one from 1 to {most}"
        raise DataError(
            f"found --experiment {experiment} with {many}; expected {wanted}, the experiments of "
            "the model, and a single file; correct it, or leave it out to fit a start of its own"
        )
    return None if experiment is None else experiment - 1


def _write(
    estimate: Estimate,
    found: Validation,
    records: Sequence[Record],
    which: int | None,
    folder: Path,
    activity: Activity,
) -> None:
    from tridentify.report import write_validation_report

    activity.stage("writing the report and the figures")
    write_json(folder / "validation.json", found.to_dict())
    page = folder / "report.html"
    write_validation_report(estimate, found, records, page, experiment=which, figures=folder)


def _blocks(found: Validation, records: Sequence[Record]) -> list[str | Table]:
    """Verdict, findings and tables."""
    expected = [""] * len(found.output_names)
    if found.transfer is not None:
        expected = [f"{fit:.2f}" for fit in found.transfer.expected_fit]
    fits = [
        (name, f"{fit:.2f}", best, f"{r2:.4f}")
        for name, fit, best, r2 in zip(
            found.output_names, found.fit, expected, found.r2, strict=True
        )
    ]
    tests = [
        (f"{test.name} ({test.output})", format_p(test.p_value), "rejected" * test.rejected)
        for test in found.tests
    ]
    return [
        describe_records(records),
        "\n".join([paragraph(found.verdict), *describe_findings(found.findings)]),
        make_table(("output", "fit [%]", "expected", "R2_T"), [fits]),
        *([make_table(("test", "p-value", ""), [tests])] if tests else []),
        "\n".join(paragraph(note, "- ", "  ") for note in found.notes),
    ]
