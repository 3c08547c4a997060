"""One self-contained page about an estimate: verdict, tables, figures, settings."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Callable, Sequence
from importlib.resources import files
from pathlib import Path

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.encoding import document_text
from tridentify.estimation.answer.estimate import SCHEMA, Estimate, Status
from tridentify.estimation.answer.finding import joined
from tridentify.judgement.validation import Validation, validate
from tridentify.record.record import Record
from tridentify.report.figures import (
    Drawing,
    draw_diagrams,
    draw_figures,
    inline_svg,
    save_drawing,
)
from tridentify.report.settings import code_again, settings_table
from tridentify.report.tables import course_tables, result_tables, validation_tables
from tridentify.writing.files import write_atomically
from tridentify.writing.layout import IN_TABLES, short


def write_report(
    estimate: Estimate,
    record: Record | Sequence[Record],
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    figures: str | os.PathLike[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Write the report as one HTML file that needs nothing else.

    Parameters
    ----------
    estimate : Estimate
    record : Record or sequence of Record
        What was identified; several experiments in their order.
    path : path-like
        File to write; missing folders are made, an existing file is replaced.
    title : str, optional
        Heading of the page; by default the names of the records.
    figures : path-like, optional
        A folder that gets the files of `save_figures` too, as PNG: each is drawn only once.
    progress : callable, optional
        Called with a few words at the start of each stage.

    Returns
    -------
    Path

    Raises
    ------
    OutputPathError
        The file cannot be written; nothing is left behind.
    """
    say = progress or (lambda _: None)
    from jinja2 import Environment

    given = (record,) if isinstance(record, Record) else tuple(record)
    records = tuple(one.settled(estimate.intersample) for one in given)
    named = dict.fromkeys(item.name for item in records if item.name)
    name = title or ", ".join(named) or "Identified model"
    say("testing the residual")
    checked, untested = checked_on(estimate, records)
    say("writing the report and the figures")
    template = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(
        _part("template.html.j2")
    )
    script = _part("page.js")
    page = template.render(
        title=name,
        subtitle=subtitle(estimate),
        verdict=verdict(estimate, checked),
        status=estimate.status,
        findings=joined(checked.findings if checked else (), estimate.findings),
        validation=checked,
        tests=validation_tables(checked) if checked else [],
        untested=untested,
        model=estimate.model_text(),
        results=result_tables(estimate),
        figures=_on_the_page(estimate, records, checked, figures),
        diagrams=draw_diagrams(estimate),
        course=course_tables(estimate),
        decisions=[note for note in (*estimate.trace.decisions, estimate.trace.stopped) if note],
        settings=settings_table(estimate, records),
        code=code_again(estimate, records),
        style=_part("page.css"),
        script=script,
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        # no tag can end inside the text
        document=document_text("schema", SCHEMA, estimate).replace("<", "\\u003c"),
    )
    return write_atomically(path, page)


def _on_the_page(
    estimate: Estimate,
    records: Sequence[Record],
    checked: Validation | None,
    folder: str | os.PathLike[str] | None,
) -> list[tuple[Drawing, str]]:
    """Figures of the page as SVG; on the way all figures into a folder, if there is one."""
    files = folder is not None
    found = []
    for item in draw_figures(
        estimate, records, with_record=files, validation=checked, with_residual=files
    ):
        if folder is not None and item.is_file:
            save_drawing(item, folder, "png")
        if item.on_page:
            found.append((item, inline_svg(item)))
    return found


def _part(name: str) -> str:
    """A file that belongs to the page."""
    return files("tridentify.report").joinpath(name).read_text(encoding="utf-8")


def subtitle(estimate: Estimate) -> str:
    """What was identified from what, in one line."""
    outputs, inputs = (
        ", ".join(short(name, IN_TABLES) for name in names)
        for names in (estimate.output_names, estimate.input_names)
    )
    several = len(estimate.nuisance)
    where = f" in {several} experiments" if several > 1 else ""
    return f"{outputs} from {inputs}: {estimate.n_samples:,} samples{where}, {estimate.method}"


def verdict(estimate: Estimate, checked: Validation | None = None) -> str:
    """Class of status and validation: "good", "caution" or "bad"."""
    if not estimate.status.ok:
        return "bad"
    sound = checked is None or checked.ok
    return "good" if sound and estimate.status is Status.CONVERGED else "caution"


def checked_on(estimate: Estimate, records: Sequence[Record]) -> tuple[Validation | None, str]:
    """Validation on the records of the report, or the reason why there is none."""
    try:
        return validate(estimate, records), ""
    except TridentifyError as error:
        return None, str(error)
