"""What the commands that identify have in common: estimate, write the folder, print the tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from tridentify.cli import tables
from tridentify.cli.terminal import Activity
from tridentify.errors import ConvergenceError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import Method
from tridentify.record.record import Record
from tridentify.structure import AutoStructure, Structure

if TYPE_CHECKING:
    from tridentify.cli.artist import Beside


def load_compiled(activity: Activity) -> None:
    """Load the functions that every fit needs; the first time on a machine they are compiled."""
    from tridentify.estimation.machine_code import load_first

    said = "loading compiled functions (compiled once per machine: 20 to 40 s)"
    with activity.brief_stage(said):
        load_first()


def estimate_model(
    records: Record | Sequence[Record],
    structure: Structure | AutoStructure,
    method: Method | None = None,
    progress: Callable[[str], None] | None = None,
    artist: Beside | None = None,
) -> Estimate:
    """Identify one model from all records.

    Parameters
    ----------
    records : Record or sequence of Record
    structure : Structure or AutoStructure
    method : Method, optional
    progress : callable, optional
    artist : Beside, optional
        Draws the model while it is judged.

    Raises
    ------
    DataError, StructureError, IdentifiabilityError
        As the method refuses.
    ConvergenceError
        The method ended without a usable estimate.
    """
    from tridentify.identify import search

    found = search(records, structure, method, progress)
    if artist is not None and found.estimate.status.ok:
        artist.begin(found.estimate, found.records)
    estimate = found.judged()
    return usable(estimate)


def usable(estimate: Estimate) -> Estimate:
    """The estimate, if its method ended with one.

    Raises
    ------
    ConvergenceError
    """
    if not estimate.status.ok:
        raise ConvergenceError(
            f"found no usable estimate: {estimate.status.message}; expected a minimum that the "
            f"data can tell; {estimate.status.remedy}"
        )
    return estimate


def write_results(
    estimate: Estimate,
    records: Record | Sequence[Record],
    folder: Path,
    activity: Activity,
    title: str | None,
    artist: Beside | None = None,
) -> Estimate:
    """Write model.json, report.html and the figures into a folder.

    Returns
    -------
    Estimate
        With the findings of the report, whose judgement is the fuller one.
    """
    from tridentify.report.html import report_page, settled, write_page

    estimate.save(folder / "model.json")
    page = report_page(
        estimate, settled(estimate, records), title=title, progress=activity.stage, artist=artist
    )
    write_page(page, folder / "report.html", folder)
    return replace(estimate, findings=tuple(page.findings))


def estimate_blocks(
    estimate: Estimate, described: str, *, verbose: bool = False
) -> list[str | Table]:
    """Text and tables of an estimate; ``described`` says what the records are."""
    return [
        described,
        tables.describe_status(estimate),
        estimate.model_text(),
        tables.coefficient_table(estimate),
        tables.fit_table(estimate),
        *tables.noise_tables(estimate),
        *tables.describe_notes(estimate, verbose=verbose),
    ]
