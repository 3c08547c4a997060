"""What the commands that identify have in common: estimate, write the folder, print the tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from tridentify.cli import tables
from tridentify.cli.terminal import Activity, paragraph, show
from tridentify.errors import ConvergenceError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import Method
from tridentify.record.record import Record
from tridentify.structure import AutoStructure, Structure


def load_sample_loop(activity: Activity) -> None:
    """Load the compiled recursion over samples; the first time on a machine it is compiled."""
    from tridentify.numerics.propagate import warm_up

    said = "loading the sample loop (compiled once per machine, which takes seconds)"
    with activity.brief_stage(said):
        warm_up()


def estimate_model(
    records: Record | Sequence[Record],
    structure: Structure | AutoStructure,
    method: Method | None = None,
    progress: Callable[[str], None] | None = None,
) -> Estimate:
    """Identify one model from all records.

    Raises
    ------
    DataError, StructureError, IdentifiabilityError
        As the method refuses.
    ConvergenceError
        The method ended without a usable estimate.
    """
    from tridentify.identify import identify

    estimate = identify(records, structure, method, throw=False, progress=progress)
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
) -> None:
    """Write model.json, report.html and the figures into a folder."""
    from tridentify.report import write_report

    estimate.save(folder / "model.json")
    page = folder / "report.html"
    write_report(estimate, records, page, title=title, figures=folder, progress=activity.stage)


def show_estimate(
    estimate: Estimate,
    records: Sequence[Record],
    written: Sequence[Path],
    *,
    verbose: bool = False,
) -> None:
    """Print the tables."""
    show(
        tables.describe_records(records),
        tables.describe_status(estimate),
        estimate.model_text(),
        tables.coefficient_table(estimate),
        tables.fit_table(estimate),
        *tables.describe_notes(estimate, verbose=verbose),
        *describe_files(written),
    )


def describe_files(written: Sequence[Path]) -> list[str]:
    """Say which files were written, in one line; nothing if none were."""
    if not written:
        return []
    names = ", ".join(path.name for path in written)
    return [paragraph(f"written to {written[0].parent}: {names}", rest="  ")]
