"""``tridentify advise``: files in, what the record can tell before a model is chosen out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tridentify.cli import options
from tridentify.cli.groups import Measured, Reading
from tridentify.cli.tables import describe_findings, describe_records
from tridentify.cli.terminal import Activity, paragraph
from tridentify.cli.work import at_work
from tridentify.record.record import Record
from tridentify.writing.files import write_json

if TYPE_CHECKING:
    from tridentify.judgement.advice import Advice


def advise(
    measured: Measured,
    *,
    reading: Reading,
    out: Annotated[Path | None, options.result_option(metavar="DIR")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Say what a record can tell before anything is fitted: excited band, delay, bad samples.

    Example: tridentify advise flight.csv --input elevator --output q

    Parameters
    ----------
    out
        Write advice.json and frequency-response.svg into this folder.
    """
    from tridentify.judgement.advice import advise as look_at

    inputs, outputs = measured.columns()
    source = reading.source(measured.files, inputs, outputs)
    with at_work(out) as work:
        records = work.records(source)
        work.activity.stage("looking at the record")
        found = look_at(records)
        work.publish(lambda folder: _write(found, folder, work.activity))
    work.answer(as_json, found.to_dict, lambda: _blocks(found, records))


def _write(found: Advice, folder: Path, activity: Activity) -> None:
    from tridentify.plots import plot_frequency_response

    activity.stage("writing the figure")
    write_json(folder / "advice.json", found.to_dict())
    if found.frequency is not None:
        figure = plot_frequency_response(found.frequency)[0].get_figure(root=True)
        assert figure is not None
        figure.savefig(folder / "frequency-response.svg")


def _blocks(found: Advice, records: Sequence[Record]) -> list[str]:
    """Findings and facts."""
    return [
        describe_records(records),
        "\n".join(describe_findings(found.findings)) or "nothing stands in the way of an estimate",
        "\n".join(paragraph(f"{name}: {value}", "  ", "    ") for name, value in found.facts()[1:]),
        "\n".join(paragraph(note, "- ", "  ") for note in found.notes),
    ]
