"""``tridentify advise``: files in, what the record can tell before a model is chosen out."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tridentify.cli import options
from tridentify.cli.groups import Reading
from tridentify.cli.load import asked_channels, load
from tridentify.cli.results import ResultFolder
from tridentify.cli.run import describe_files, load_compiled
from tridentify.cli.tables import describe_records
from tridentify.cli.terminal import Activity, paragraph, show, show_json
from tridentify.record.record import Record
from tridentify.writing.files import write_atomically

if TYPE_CHECKING:
    from tridentify.judgement.advice import Advice

Out = Annotated[
    Path | None,
    options.result_option(
        metavar="DIR", help="Write advice.json and frequency-response.svg into this folder."
    ),
]


def advise(
    files: options.Files,
    inputs: options.NamedInputs = None,
    outputs: options.NamedOutputs = None,
    *,
    reading: Reading,
    out: Out = None,
    as_json: options.AsJson = False,
) -> None:
    """Say what a record can tell before anything is fitted: excited band, delay, bad samples.

    Example: tridentify advise flight.csv --input elevator --output q
    """
    inputs, outputs = asked_channels(files, inputs, outputs)
    source = reading.source(files, inputs, outputs)
    written: Sequence[Path] = ()
    with ExitStack() as stack:
        results = None if out is None else stack.enter_context(ResultFolder(out))
        activity = stack.enter_context(Activity())
        records = load(source, activity)
        load_compiled(activity)
        activity.stage("looking at the record")
        found = _advice(records)
        if results is not None:
            _write(found, results.draft, activity)
            written = results.publish()
    if as_json:
        show_json(found.to_dict() | {"files": [str(path) for path in written]})
    else:
        _show(found, records, written)


def _advice(records: Sequence[Record]) -> Advice:
    from tridentify.judgement.advice import advise as look_at

    return look_at(records)


def _write(found: Advice, folder: Path, activity: Activity) -> None:
    import json

    from tridentify.plots import plot_frequency_response

    activity.stage("writing the figure")
    text = json.dumps(found.to_dict(), indent=1, allow_nan=False)
    write_atomically(folder / "advice.json", text + "\n")
    if found.frequency is not None:
        figure = plot_frequency_response(found.frequency)[0].get_figure(root=True)
        assert figure is not None
        figure.savefig(folder / "frequency-response.svg")


def _show(found: Advice, records: Sequence[Record], written: Sequence[Path]) -> None:
    """Print findings and facts."""
    lines = [] if found.findings else ["nothing stands in the way of an estimate"]
    for finding in found.findings:
        said = f"{finding.message} {finding.effect}".strip()
        lines.append(paragraph(said, "! " if finding.matters else "- ", "  "))
        if finding.remedy:
            lines.append(paragraph(finding.remedy, "  what to do: ", "    "))
    show(
        describe_records(records),
        "\n".join(lines),
        "\n".join(paragraph(f"{name}: {value}", "  ", "    ") for name, value in found.facts()[1:]),
        "\n".join(paragraph(note, "- ", "  ") for note in found.notes),
        *describe_files(written),
    )
