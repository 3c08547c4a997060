"""``tridentify fleet``: thousands of records in, a row for each of them out."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tridentify.cli import options
from tridentify.cli.groups import Along, Known, Late, Orders, ReadingMany, Way, asked_structure
from tridentify.cli.terminal import Activity, plain, show, show_json
from tridentify.cli.work import chosen_workers, describe_files
from tridentify.errors import IdentifiabilityError, OptionError, TooFewSamplesError

if TYPE_CHECKING:
    from tridentify.fleet import Run

work_option = partial(typer.Option, rich_help_panel="The work")


def fleet(
    files: Annotated[list[str], typer.Argument(metavar="PATTERN...")],
    inputs: Annotated[list[str] | None, options.record_option("--input", metavar="NAME")] = None,
    outputs: Annotated[list[str] | None, options.record_option("--output", metavar="NAME")] = None,
    *,
    orders: Orders,
    key: Annotated[str | None, options.record_option(metavar="NAME")] = None,
    reading: ReadingMany,
    late: Late,
    along: Along,
    way: Way,
    known: Known,
    workers: Annotated[int | None, work_option("--workers", min=1, metavar="N")] = None,
    scheduler: Annotated[str | None, work_option(metavar="URL")] = None,
    resume: Annotated[bool, work_option("--resume/--no-resume")] = True,
    time_limit: Annotated[float, work_option(min=0.01, metavar="SECONDS")] = 60.0,
    judge: Annotated[bool, work_option("--judge/--no-judge")] = True,
    together: Annotated[bool, options.result_option("--together")] = False,
    pool: Annotated[bool, options.result_option("--pool")] = False,
    out: Annotated[Path, options.result_option(metavar="DIR")] = Path("results"),
    reports: Annotated[int, options.result_option(min=0, metavar="N")] = 3,
    as_json: options.AsJson = False,
) -> None:
    """Identify every unit of a fleet and leave one row for each, whatever comes of it.

    Example: tridentify fleet 'logs/**/*.parquet' --input u --output y --poles 2 --zeros 1

    Parameters
    ----------
    files
        Files, one a unit: a pattern such as 'logs/**/*.parquet' in quotation marks, or several
        files; with --key a Parquet file or a folder of them.
    inputs
        Column of an input; may be repeated. By default u.
    outputs
        Column of an output; may be repeated. By default y.
    key
        Column that tells the units apart, where a file holds many of them.
    workers
        Processes of this machine; by default 1.
    scheduler
        A Dask scheduler, such as tcp://host:8786; its workers.
    resume
        Keep the rows that are there, or remove them and begin anew.
    time_limit
        What one record may take, reading included.
    judge
        Look for findings (cautions), which takes about as long as the estimate.
    together
        Also one model for all records at once.
    pool
        Also the population that the units come from, every unit in its light, and the units that
        deviate.
    out
        Folder of the rows; a run that was ended goes on from what is there.
    reports
        Units unlike the others that get a report of their own, linked from report.html.
    """
    from tridentify.fleet import fit
    from tridentify.report import write_fleet_report

    hands = chosen_workers(workers, scheduler)
    sources, drains = tuple(inputs or ("u",)), tuple(outputs or ("y",))
    structure = asked_structure(orders, late, along, known, len(drains), len(sources))
    with Activity() as activity:
        activity.stage("looking for the units")
        run = fit(
            _source(files, key),
            structure,
            way.chosen(),
            key=key,
            inputs=sources,
            outputs=drains,
            **reading.options(),
            out=out,
            workers=hands,
            resume=resume,
            judge=judge,
            together=together,
            pool=pool,
            time_limit=time_limit,
            progress=_told(activity),
        )
        for note in run.notes:
            activity.note(note)
        activity.stage("writing the report")
        written = write_fleet_report(run, out / "report.html", reports=reports)
    _show(run, [written, *run.written], as_json)
    if pool and run.population is None:
        raise TooFewSamplesError(run.notes[-1])


def _source(files: Sequence[str], key: str | None) -> Any:
    if key is not None and len(files) > 1:
        raise OptionError(
            f"found {len(files)} files with --key; expected one Parquet file or one folder; give "
            "the folder"
        )
    return files[0] if len(files) == 1 else list(files)


def _told(activity: Activity) -> Any:
    def tell(done: int, total: int | None) -> None:
        if total is None:
            activity.stage(f"{done} of ? records")
        else:
            activity.count(done, total)

    return tell


def _show(run: Run, written: Sequence[Path], as_json: bool) -> None:
    """Print; a fleet without a single estimate is an error."""
    rows = run.rows(["ok", "status", "message"])
    if as_json:
        show_json(plain(run.to_dict()) | {"files": [str(path) for path in written]})
    else:
        where = f"rows: {run.store.parts} (Parquet)"
        show(run.summary(), where, *describe_files(written))
    if rows.height and not rows["ok"].any():
        kinds = ", ".join(sorted(set(rows["status"])))
        raise IdentifiabilityError(
            f"found no usable estimate among {rows.height} records ({kinds}); expected some; look "
            f"at the messages in the rows, of which the first is: {rows['message'][0]}"
        )
