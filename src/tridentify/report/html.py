"""One self-contained page about an estimate: result and trust, figures, tables, settings."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from tridentify.errors import SampleTypeError, TridentifyError
from tridentify.estimation.answer.encoding import document_text
from tridentify.estimation.answer.estimate import SCHEMA, Estimate
from tridentify.estimation.answer.finding import beside_errors, joined
from tridentify.estimation.answer.trust import class_of
from tridentify.judgement.validation import Validation, validate
from tridentify.record.record import Record
from tridentify.report.figures import Artist, Here, draw_diagrams
from tridentify.report.first_screen import headline_of, key_numbers, subtitle_of, title_of, trust_of
from tridentify.report.page import Page, Section, beside, prepare
from tridentify.report.pictures import Picture, save_picture
from tridentify.report.settings import code_again, settings_table, workbench_again
from tridentify.report.tables import course_tables, result_tables, validation_tables

Progress = Callable[[str], None]


def write_report(
    estimate: Estimate,
    record: Record | Sequence[Record],
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    figures: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
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
        Heading of the page; by default the names of the channels.
    figures : path-like, optional
        A folder that gets the figures too, as SVG: each is drawn only once.
    progress : callable, optional
        Called with a few words at the start of each stage.

    Returns
    -------
    Path

    Raises
    ------
    SampleTypeError
        The arguments are others, or in another order.
    OutputPathError
        The file cannot be written; nothing is left behind.
    """
    _check_order(estimate, record, path)
    page = report_page(estimate, settled(estimate, record), title=title, progress=progress)
    return write_page(page, path, figures)


def _check_order(estimate: object, record: object, path: object) -> None:
    """Refuse what is no estimate, records and path in this order, in one line."""
    records = record if isinstance(record, list | tuple) else [record]
    sound = all(isinstance(one, Record) for one in records)
    if not (isinstance(estimate, Estimate) and sound and isinstance(path, str | os.PathLike)):
        found = ", ".join(type(each).__name__ for each in (estimate, record, path))
        raise SampleTypeError(
            f"found {found}; expected an estimate, its record or records, and the file, in this "
            'order; write write_report(estimate, record, "page.html")'
        )


def settled(estimate: Estimate, record: Record | Sequence[Record]) -> tuple[Record, ...]:
    """The records, their inputs taken as when they were identified."""
    given = (record,) if isinstance(record, Record) else tuple(record)
    return tuple(one.settled(estimate.intersample) for one in given)


def write_page(
    page: Page, path: str | os.PathLike[str], figures: str | os.PathLike[str] | None = None
) -> Path:
    """Write a page, and its pictures as files of their own.

    Parameters
    ----------
    page : Page
    path : path-like
    figures : path-like, optional
        A folder.

    Raises
    ------
    OutputPathError
        A file cannot be written.
    """
    if figures is not None:
        for picture in pictures_of(page):
            save_picture(picture, figures)
    return page.write(path)


def pictures_of(page: Page) -> list[Picture]:
    """All pictures of a page, in their order."""
    found = list(page.fits)
    for section in page.sections:
        for block in section.figures:
            found += [block.wide] if block.wide else [p for part in block.columns for p in part]
    return found


def report_page(
    estimate: Estimate,
    records: Sequence[Record],
    *,
    title: str | None = None,
    progress: Progress | None = None,
    artist: Artist | None = None,
) -> Page:
    """Judge the estimate, draw its figures and put the page together.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Settled.
    title : str, optional
    progress : callable, optional
    artist : Artist, optional
        Who draws; by default this process.
    """
    say, draw = progress or (lambda _: None), artist or Here()
    say("testing the residual")
    checked, untested = checked_on(estimate, records)
    say("writing the report and the figures")
    tests = None if checked is None else draw.tests(checked)
    model = draw.model(estimate, records)
    findings = joined(checked.findings if checked else (), estimate.findings)
    placed = {place: [p for p in model if p.place == place] for place in ("response", "course")}
    before = (
        model_section(estimate),
        Section("figures", "Responses and poles", figures=beside(placed["response"])),
    )
    after = (_course_section(estimate, placed["course"]), *ends(estimate, records))
    prepare()
    return Page(
        title or title_of(estimate.output_names, estimate.input_names),
        "identified model",
        subtitle_of(records),
        class_of(estimate, findings),
        headline_of(estimate, findings),
        trust_of(estimate, findings, checked is not None),
        beside_errors(estimate.status.remedy, findings),
        key_numbers(estimate) if estimate.status.ok else (),
        [p for p in model if p.place == "fit"],
        findings,
        (*before, validation_section(checked, tests() if tests else (), untested), *after),
        # no tag can end inside the text
        document_text("schema", SCHEMA, estimate).replace("<", "\\u003c"),
    )


def model_section(estimate: Estimate) -> Section:
    """Formulas and coefficients."""
    return Section(
        "model",
        "Model",
        formulas=estimate.model_mathml(),
        formulas_as_text=estimate.model_text(),
        tables=result_tables(estimate),
    )


def validation_section(
    checked: Validation | None, tests: Sequence[Picture], untested: str = ""
) -> Section:
    """Tests of the residual with their pictures."""
    if checked is None:
        return Section("validation", "Validation", paragraphs=[f"Not tested: {untested}."])
    return Section(
        "validation",
        "Validation",
        paragraphs=[checked.verdict],
        tables=validation_tables(checked),
        figures=beside(tests),
        notes=checked.notes,
    )


def _course_section(estimate: Estimate, pictures: Sequence[Picture]) -> Section:
    """How the algorithm went, folded."""
    return Section(
        "course",
        "How it was reached",
        folded="Decisions, diagrams of the steps, passes and starts",
        figures=beside(pictures),
        notes=estimate.decisions(),
        diagrams=draw_diagrams(estimate),
        tables=course_tables(estimate),
    )


def ends(estimate: Estimate, records: Sequence[Record]) -> tuple[Section, ...]:
    """Settings and data, the lines that lead to the estimate again, and the workbench."""
    closer = (
        "To drag over other stretches, change what is asked and compare models: this opens the "
        "record in the browser, on a server of this machine alone (where the file has another "
        "ending than .csv, write that)."
    )
    again = (
        "The same samples (their fingerprint stands above) and these lines give the same estimate; "
        'Estimate.load("model.json") reads the one of this page.'
    )
    return (
        Section("settings", "Settings and data", settings=settings_table(estimate, records)),
        Section(
            "again",
            "Do it again",
            paragraphs=[again],
            code=code_again(estimate, records),
            keep=True,
        ),
        Section(
            "workbench",
            "Open in the workbench",
            paragraphs=[closer],
            code=workbench_again(records),
        ),
    )


def checked_on(estimate: Estimate, records: Sequence[Record]) -> tuple[Validation | None, str]:
    """Validation on the records of the report, or the reason why there is none."""
    try:
        return validate(estimate, records), ""
    except TridentifyError as error:
        return None, str(error)
