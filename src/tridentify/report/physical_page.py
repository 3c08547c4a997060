"""The page about physical parameters, and what speaks against their map."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.encoding import document_text
from tridentify.estimation.answer.estimate import SCHEMA
from tridentify.estimation.answer.finding import Finding, beside_errors, joined
from tridentify.estimation.answer.trust import HEADS, class_of, unusable
from tridentify.judgement.validation.residuals import look
from tridentify.physical import PhysicalEstimate
from tridentify.record.record import Record
from tridentify.report import first_screen, html
from tridentify.report.figures import fits_of_view, model_pictures, tests_pictures
from tridentify.report.page import Page, Section, beside
from tridentify.report.pictures import Picture
from tridentify.report.tables import ReportTable, quantity_table
from tridentify.writing.layout import IN_TABLES, p_in_words, short

CONTRADICTED = 0.01
"""p-value of the restrictions of a map, below which the record speaks against it."""

SLIGHT = 0.5
"""Fall of a fit [percent] that is no matter in practice, however significant it is."""

MOST_CORRELATED = 12
"""Parameters whose correlations still make a table that can be read."""


def write_physical_report(
    found: PhysicalEstimate,
    record: Record | Sequence[Record],
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    figures: str | os.PathLike[str] | None = None,
    progress: html.Progress | None = None,
) -> Path:
    """Write the physical parameters, what speaks against the map, and the coefficients behind them.

    Parameters
    ----------
    found : PhysicalEstimate
    record : Record or sequence of Record
        What was identified, with the channels of the estimate.
    path : path-like
        File to write.
    title : str, optional
        By default the name of the map and the channels.
    figures : path-like, optional
        A folder that gets the figures too, as SVG.
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
    page = _physical_page(found, html.settled(found.estimate, record), title, progress)
    return html.write_page(page, path, figures)


def _physical_page(
    found: PhysicalEstimate,
    records: Sequence[Record],
    title: str | None,
    progress: html.Progress | None,
) -> Page:
    """Judge the free coefficients, draw the figures and put the page together."""
    say = progress or (lambda _: None)
    free = found.estimate
    say("testing the residual")
    checked, untested = html.checked_on(free, records)
    say("writing the report and the figures")
    tests = () if checked is None else tests_pictures(checked)
    model = model_pictures(free, records)
    # what this page is about stands before what the coefficients have against them
    others = joined(checked.findings if checked else (), free.findings)
    findings = (*contradictions(found), *others)
    channels = first_screen.title_of(free.output_names, free.input_names)
    return Page(
        title or f"{found.model_name}: {channels}",
        "physical parameters",
        first_screen.subtitle_of(records),
        class_of(free, findings),
        _physical_headline(found, findings),
        first_screen.trust_of(free, findings, checked is not None),
        beside_errors(free.status.remedy, findings),
        _physical_numbers(found),
        _fits_of_map(found, records) or [p for p in model if p.place == "fit"],
        findings,
        (
            _parameter_section(found),
            _map_section(found),
            replace(html.model_section(free), heading="Free coefficients, without the map"),
            Section(
                "figures",
                "Responses and poles of the free coefficients",
                figures=beside([p for p in model if p.place == "response"]),
            ),
            html.validation_section(checked, tests, untested),
            *html.ends(free, records),
        ),
        document_text("schema", SCHEMA, free).replace("<", "\\u003c"),
    )


def contradictions(found: PhysicalEstimate) -> tuple[Finding, ...]:
    """What speaks against the map, with how much it matters."""
    if not found.p_value < CONTRADICTED:
        return ()
    falls = np.asarray(found.estimate.fit) - np.asarray(found.fit)
    names = found.estimate.output_names
    changes = [
        f"fit of {name} from {free:.2f} to {held:.2f} %"
        for name, free, held in zip(names, found.estimate.fit, found.fit, strict=True)
    ]
    slight = bool(np.all(falls < SLIGHT))
    word = "hardly shows it" if slight else "shows it"
    return (
        Finding(
            "contradiction",
            "note" if slight else "warning",
            f"The coefficients contradict the map {found.model_name} (chi-square "
            f"{found.statistic:.3g} with {found.freedom} "
            f"degree{'' if found.freedom == 1 else 's'} of freedom, "
            f"{p_in_words(found.p_value)}): what it demands of them is not what the record shows.",
            "Look for what the map leaves out, free a parameter that is taken as known, or correct "
            "units and signs of the channels.",
            effect=f"With the map: {', '.join(changes)}. A simulation {word}.",
        ),
    )


def _physical_headline(found: PhysicalEstimate, findings: Sequence[Finding]) -> str:
    if why := unusable(found.estimate, findings):
        return why
    head = HEADS[class_of(found.estimate, findings)]
    known = sum(np.isfinite(found.values))
    fits = first_screen.fits_in_words(found.estimate.output_names, found.fit.tolist())
    return f"{head}: {known} of {len(found.names)} parameters are determined; they fit {fits}."


def _physical_numbers(found: PhysicalEstimate) -> list[first_screen.KeyNumber]:
    """Parameters and combinations that the record determines, the first of them."""
    every = [*found.parameters.values(), *found.combinations]
    asked = [item for item in every if np.isfinite(item.value) and item.std > 0]
    return [first_screen.key_number(item) for item in asked[: first_screen.NUMBERS]]


def _fits_of_map(found: PhysicalEstimate, records: Sequence[Record]) -> list[Picture]:
    """Measured against the model of the map, its offsets and initial states fitted to the records.

    Empty where they are too short for that.
    """
    held = replace(found.estimate, model=found.model, theta=found.theta, record_fingerprint="")
    try:
        return fits_of_view(look(held, records, None))
    except TridentifyError:
        return []


def _parameter_section(found: PhysicalEstimate) -> Section:
    held = {name: "known" if not std > 0 else "" for name, (_, std) in found.known.items()}
    plain = quantity_table("Parameters", list(found.parameters.values()), "", held)
    rows = [(*row, text) for row, text in zip(plain.rows, found.descriptions, strict=True)]
    tables = [replace(plain, titles=(*plain.titles, "meaning"), rows=rows)]
    if found.combinations:
        tables.append(quantity_table("Combinations that are determined", found.combinations))
    tables += _correlations(found)
    return Section("parameters", "Physical parameters", tables=tables, notes=found.notes)


def _correlations(found: PhysicalEstimate) -> list[ReportTable]:
    """Correlations of the errors of what is determined."""
    std = found.std
    kept = [k for k in range(len(found.names)) if std[k] > 0]
    if not 1 < len(kept) <= MOST_CORRELATED:
        return []
    names = [found.names[k] for k in kept]
    table = found.cov[np.ix_(kept, kept)] / np.outer(std[kept], std[kept])
    rows = [
        (name, *(f"{value:.2f}" for value in table[k, : k + 1]), *[""] * (len(kept) - k - 1), "")
        for k, name in enumerate(names)
    ]
    note = (
        "Of the errors, from -1 to 1: near either end the record determines a combination of the "
        "two better than each by itself."
    )
    return [ReportTable("Correlations", ("", *names, ""), rows, note=note)]


def _map_section(found: PhysicalEstimate) -> Section:
    fits = [
        (short(name, IN_TABLES), f"{free:.2f}", f"{held:.2f}", f"{held - free:+.2f}", "")
        for name, free, held in zip(
            found.estimate.output_names, found.estimate.fit, found.fit, strict=True
        )
    ]
    titles = ("output", "free coefficients", "with the map", "change", "")
    told = found.test_note()
    said = f"{told[:1].upper()}{told[1:]}." if told else "There is nothing to test."
    return Section(
        "map",
        "What speaks against the map",
        paragraphs=[said],
        tables=[ReportTable("Fit [%]", titles, fits)],
    )
