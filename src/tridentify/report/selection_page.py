"""The page about a selection of orders."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tridentify.estimation.answer.trust import class_of
from tridentify.judgement.selection import Selection
from tridentify.plots import plot_hankel, plot_selection
from tridentify.record.record import Record
from tridentify.report import first_screen
from tridentify.report.figures import identified_fits
from tridentify.report.html import model_section, settled, write_page
from tridentify.report.page import Page, Section, beside
from tridentify.report.pictures import Drawing, picture_of
from tridentify.report.settings import record_rows
from tridentify.report.sheet import Sheet
from tridentify.report.tables import ReportTable

CRITERIA = 1.9, 1.1, 1.1
"""Heights of the axes of a selection [inch]."""
VALUES = 2.0
"""Height of the Hankel singular values [inch]."""


def write_selection_report(
    selection: Selection,
    record: Record | Sequence[Record],
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    figures: str | os.PathLike[str] | None = None,
) -> Path:
    """Write which orders are recommended, why, and what the others have to say for themselves.

    Parameters
    ----------
    selection : Selection
    record : Record or sequence of Record
        What was identified.
    path : path-like
        File to write.
    title : str, optional
        By default the names of the channels.
    figures : path-like, optional
        A folder that gets the figures too, as SVG.

    Returns
    -------
    Path

    Raises
    ------
    OutputPathError
        The file cannot be written; nothing is left behind.
    """
    given = (record,) if isinstance(record, Record) else tuple(record)
    first = given[0]
    heading = title or f"Orders of {first_screen.title_of(first.output_names, first.input_names)}"
    return write_page(_selection_page(selection, given, heading), path, figures)


def _selection_page(selection: Selection, given: Sequence[Record], heading: str) -> Page:
    row = selection.recommended
    estimate = None if row is None else row.estimate
    named = heading, "selection of orders", first_screen.subtitle_of(given)
    sections = (
        _candidate_section(selection),
        Section("settings", "Data", settings=record_rows(given)),
    )
    if estimate is None:
        head = "No structure is recommended."
        return Page(*named, "bad", head, selection.reason, sections=sections)
    fits = first_screen.fits_in_words(estimate.output_names, estimate.fit.tolist())
    return Page(
        *named,
        class_of(estimate, estimate.findings),
        f"Recommended: {first_screen.orders_in_words(estimate.structure)}; the model fits {fits}.",
        selection.reason,
        "",
        first_screen.key_numbers(estimate),
        identified_fits(estimate, settled(estimate, given)),
        estimate.findings,
        (
            sections[0],
            replace(model_section(estimate), heading="The recommended model"),
            sections[1],
        ),
    )


def _candidate_section(selection: Selection) -> Section:
    rows = selection.table()
    marked = tuple(k for k, row in enumerate(selection.rows) if row is selection.recommended)
    title = "What identify gives for each"
    return Section(
        "candidates",
        "Candidates",
        tables=[ReportTable(title, selection.titles, rows, 2, marked=marked)],
        figures=beside([picture_of(drawing) for drawing in _draw_selection(selection)]),
        notes=selection.all_notes(),
    )


def _draw_selection(selection: Selection) -> list[Drawing]:
    sheet = Sheet(CRITERIA)
    plot_selection(selection, axes=sheet.axes)
    found = [
        Drawing(
            "selection",
            "Criteria, fits and certainty",
            "Criteria above the lowest of each, on one set of samples; fits on the samples that "
            "were fitted and on those that were held out, of several outputs the worst; the least "
            "certain coefficient. Hollow marks are estimates that are not usable.",
            sheet.settle(),
        )
    ]
    if selection.hankel is not None:
        values = Sheet([VALUES])
        plot_hankel(selection, axes=values.axes[0])
        found.append(
            Drawing(
                "hankel",
                "Hankel singular values",
                "Of the parallel model, which has no order of its own: what rises above the shaded "
                "floor is more than noise, a lower bound of the number of poles.",
                values.settle(),
            )
        )
    return found
