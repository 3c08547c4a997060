"""The page about a validation: whether an estimate holds on a record."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.validation import Validation
from tridentify.judgement.validation.residuals import look
from tridentify.record.record import Record
from tridentify.report.figures import fits_of_view, tests_pictures
from tridentify.report.first_screen import (
    NUMBERS,
    KeyNumber,
    fits_in_words,
    orders_in_words,
    subtitle_of,
    title_names,
    title_of,
)
from tridentify.report.html import model_section, settled, validation_section, write_page
from tridentify.report.page import Page, Section
from tridentify.report.settings import record_rows


def write_validation_report(
    estimate: Estimate,
    checked: Validation,
    record: Record | Sequence[Record],
    path: str | os.PathLike[str],
    *,
    experiment: int | None = None,
    title: str | None = None,
    figures: str | os.PathLike[str] | None = None,
) -> Path:
    """Write whether an estimate holds on a record.

    Parameters
    ----------
    estimate : Estimate
    checked : Validation
        Of `estimate` on the record.
    record : Record or sequence of Record
        As they were validated.
    path : path-like
        File to write.
    experiment : int, optional
        As in `validate`.
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
    records = settled(estimate, record)
    fits = fits_of_view(look(estimate, records, experiment))
    tests = tests_pictures(checked)
    verdict = "good" if checked.ok else "caution"
    page = Page(
        title or f"Validation of {title_of(checked.output_names, checked.input_names)}",
        "validation",
        subtitle_of(records),
        verdict,
        _validation_headline(estimate, checked),
        "" if checked.findings else checked.verdict,
        "",
        _validation_numbers(checked),
        fits,
        checked.findings,
        (
            replace(validation_section(checked, tests), heading="Tests"),
            model_section(estimate),
            Section("settings", "Data", settings=record_rows(records)),
        ),
    )
    return write_page(page, path, figures)


def _validation_headline(estimate: Estimate, checked: Validation) -> str:
    where = "the record that was identified" if checked.own else "this record"
    fits = fits_in_words(checked.output_names, checked.fit.tolist())
    words = orders_in_words(estimate.structure)
    head = (
        f"The model holds on {where}"
        if checked.ok
        else f"The model holds on {where}, the noise is another"
        if checked.model_ok
        else f"Something speaks against the model on {where}"
    )
    return f"{head}: {words} fit {fits}."


def _validation_numbers(checked: Validation) -> list[KeyNumber]:
    names = title_names(checked.output_names)
    found = [KeyNumber(f"fit of {names}", " / ".join(f"{f:.1f}" for f in checked.fit), "", "%")]
    if checked.transfer is not None:
        best = " / ".join(f"{f:.1f}" for f in checked.transfer.expected_fit)
        found.append(KeyNumber("as good as can be", best, "", "%"))
    found.append(KeyNumber(f"R2_T of {names}", " / ".join(f"{r:.3f}" for r in checked.r2)))
    if checked.tests:
        rejected = sum(test.rejected for test in checked.tests)
        found.append(KeyNumber("tests that reject", f"{rejected} of {len(checked.tests)}"))
    return found[:NUMBERS]
