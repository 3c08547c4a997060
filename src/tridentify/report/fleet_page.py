"""The page about a fleet: how many, what failed and why, who is unlike the others."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.fleet.run import QUARTILES, Run, coefficients, distribution
from tridentify.numerics.arrays import Array
from tridentify.plots.fleet import HEIGHT, plot_fleet
from tridentify.report.first_screen import KeyNumber
from tridentify.report.html import write_page, write_report
from tridentify.report.page import Page, Section, beside
from tridentify.report.pictures import Drawing, picture_of
from tridentify.report.sheet import Sheet
from tridentify.report.tables import ReportTable
from tridentify.writing.layout import format_value, short

MOST_CAUSES = 30
"""Rows of the table of failures."""

MOST_UNLIKE = 30
"""Rows of the table of units that are unlike the others."""

FAR = 5.0
"""Distance from the median in robust standard deviations, the unit's own error included, from which
a unit is told as unlike the others where the fleet was not pooled."""

MANY_FAILED = 0.1
"""Share of units without an estimate from which the page begins with a caution."""

LONGEST = 110
"""Characters of a message in a table."""

UNITS = "units"
"""Folder beside the page for the reports of single units."""

Unlike = tuple[str, float, str]


def write_fleet_report(
    run: Run,
    path: str | os.PathLike[str],
    *,
    title: str = "Fleet",
    reports: int = 0,
    figures: str | os.PathLike[str] | None = None,
) -> Path:
    """Write what came of a fleet: distributions, failures by cause, units unlike the others.

    Parameters
    ----------
    run : Run
    path : path-like
        File to write.
    title : str
        Heading.
    reports : int
        How many units that are unlike the others get a report of their own, made from their
        records and linked; the furthest first.
    figures : path-like, optional
        A folder that gets the figure too, as SVG.

    Returns
    -------
    Path

    Raises
    ------
    OutputPathError
        The file cannot be written; nothing is left behind.
    """
    unlike = _unlike(run)
    links = _own_reports(run, [key for key, _, _ in unlike[:reports]], Path(path).parent)
    return write_page(_page(run, title, unlike, links), path, figures)


def _own_reports(run: Run, keys: Sequence[str], folder: Path) -> dict[str, str]:
    """Key -> where its report is, below a folder."""
    links = {}
    for key in keys:
        name = f"{re.sub(r'[^A-Za-z0-9._-]+', '_', key)[-80:]}.html"
        try:
            records = run.records(key)
            write_report(run.estimate(key), records, folder / UNITS / name, title=key)
        except TridentifyError:
            continue  # its record is gone, or was given only once
        links[key] = f"{UNITS}/{name}"
    return links


def _page(run: Run, title: str, unlike: Sequence[Unlike], links: Mapping[str, str]) -> Page:
    rows = run.rows()
    good = rows.filter(rows["ok"])
    failed = rows.height - good.height
    share = failed / max(rows.height, 1)
    head = f"{good.height} of {rows.height} units have an estimate."
    many = "is" if len(unlike) == 1 else "are"
    trust = f"{len(unlike) or 'None'} {many if unlike else 'is'} unlike the others."
    names, values = coefficients(good)
    sections = [
        _coefficient_section(run, names, values, good),
        _unlike_section(unlike, links),
        _failure_section(rows.filter(~rows["ok"])),
        _caution_section(rows),
    ]
    sections += _common_sections(run)
    sections.append(_settings_section(run))
    verdict = "bad" if not good.height else "caution" if share > MANY_FAILED else "good"
    return Page(
        title,
        "fleet",
        f"{rows.height} units, {int(rows['n_samples'].sum() or 0)} samples with an estimate",
        verdict,
        head,
        trust if good.height else "",
        "look at the failures below" if share > MANY_FAILED else "",
        [
            KeyNumber("units", f"{rows.height}"),
            KeyNumber("without an estimate", f"{failed}", "", f"({100 * share:.2g} %)"),
            *_medians(names, values),
        ],
        sections=[section for section in sections if section is not None],
    )


def _medians(names: Sequence[str], values: Array) -> list[KeyNumber]:
    found = []
    for name, column in zip(names, values.T, strict=True):
        middle = float(np.median(column))
        spread = _robust_spread(column)
        value = format_value(middle, spread)
        found.append(KeyNumber(f"{name}, median", value, f"{spread:.2g}"))
    return found


def _robust_spread(column: Array) -> float:
    """Standard deviation of a Gaussian with the same quartiles."""
    low, high = np.quantile(column, [0.25, 0.75])
    return float(high - low) / 1.349


def _coefficient_section(
    run: Run, names: Sequence[str], values: Array, good: Any
) -> Section | None:
    if not names:
        return None
    titles = ("coefficient", *(f"{100 * q:.0f} %" for q in QUARTILES), "std error of one", "")
    rows = [(*row, "") for row in distribution(names, values, good)]
    sheet = Sheet([HEIGHT] * len(names), share=False)
    plot_fleet(run, axes=sheet.axes)
    drawing = Drawing(
        "fleet",
        "Distribution of the coefficients",
        "Own estimates of all units; what lies beyond the scale is counted in the last bar.",
        sheet.settle(),
    )
    note = "Quantiles over the units; the standard error of a typical one is the median of theirs."
    return Section(
        "coefficients",
        "Coefficients",
        tables=[ReportTable("Over all units", titles, rows, 1, note)],
        figures=beside([picture_of(drawing)]),
    )


def _unlike(run: Run) -> list[Unlike]:
    """Key, distance and what is unlike, the furthest first."""
    rows = run.rows(["key", "ok", "names", "coefficients", "standard_errors"])
    good = rows.filter(rows["ok"])
    names, values = coefficients(good)
    if not names:
        return []
    keys = good["key"].to_list()
    errors = np.stack(good["standard_errors"].to_list())
    middle = np.median(values, axis=0)
    spread = np.array([_robust_spread(column) for column in values.T])
    off = (values - middle) / np.sqrt(np.maximum(spread**2 + errors**2, 1e-300))
    worst = np.argmax(np.abs(off), axis=1)
    told = {
        key: (abs(float(off[k, w])), f"{names[w]} = {values[k, w]:.4g}, median {middle[w]:.4g}")
        for k, (key, w) in enumerate(zip(keys, worst.tolist(), strict=True))
    }
    pool = run.population
    chosen = [k for k in told if told[k][0] > FAR] if pool is None else pool.outliers
    found = [(key, *told.get(key, (np.nan, "no estimate of its own"))) for key in chosen]
    return sorted(found, key=lambda one: -one[1]) if pool is None else found


def _unlike_section(unlike: Sequence[Unlike], links: Mapping[str, str]) -> Section:
    from markupsafe import Markup, escape

    def linked(key: str) -> str:
        shown = escape(short(key, 60))
        if key not in links:
            return str(short(key, 60))
        return Markup('<a href="{}">{}</a>').format(links[key], shown)

    rows = [
        (linked(key), f"{distance:.1f}", words) for key, distance, words in unlike[:MOST_UNLIKE]
    ]
    more = len(unlike) - MOST_UNLIKE
    notes = [f"{more} more are in the table of the run."] if more > 0 else []
    notes.append("run.estimate(key).report(path, run.records(key)) makes the report of any unit.")
    if not rows:
        return Section(
            "unlike", "Units unlike the others", paragraphs=["There is none."], notes=notes
        )
    note = "Distance of the worst coefficient from the median, in standard deviations of the units."
    table = ReportTable("The furthest first", ("unit", "distance", "what"), rows, 1, note)
    return Section("unlike", "Units unlike the others", tables=[table], notes=notes)


def _failure_section(failed: Any) -> Section:
    if not failed.height:
        return Section("failures", "Failures", paragraphs=["Every unit has an estimate."])
    causes: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for row in failed.select("key", "status", "exception", "message").iter_rows():
        key, status, exception, message = row
        causes.setdefault((status, exception), []).append((key, message))
    ordered = sorted(causes.items(), key=lambda pair: -len(pair[1]))
    rows = [
        (
            status,
            exception,
            str(len(units)),
            f"{short(units[0][0], 40)}: {short(units[0][1], LONGEST)}",
        )
        for (status, exception), units in ordered[:MOST_CAUSES]
    ]
    titles = ("status", "exception", "units", "for example")
    return Section("failures", "Failures", tables=[ReportTable("By cause", titles, rows, 2)])


def _caution_section(rows: Any) -> Section | None:
    counts = Counter(chain.from_iterable(rows["cautions"].to_list()))
    if not counts:
        return None
    body = [
        (code, str(n), f"{100 * n / rows.height:.2g} %", "") for code, n in counts.most_common()
    ]
    table = ReportTable("Findings that matter", ("code", "units", "share", ""), body, 1)
    return Section("cautions", "Cautions", tables=[table])


def _common_sections(run: Run) -> list[Section | None]:
    found: list[Section | None] = []
    common, pool = run.common, run.population
    if common is not None:
        rows = [(*row, "") for row in common.table()]
        table = ReportTable(
            f"{common.n_units} units, {common.n_samples} samples",
            ("coefficient", "value", "std error", ""),
            rows,
            1,
            f"Nuisance terms of every unit: {common.nuisance}; fit "
            f"{', '.join(f'{f:.1f} %' for f in common.fit)}.",
        )
        found.append(Section("together", "One model for all", tables=[table]))
    if pool is not None:
        rows = [(*row, "") for row in pool.table()]
        table = ReportTable(
            f"{len(pool.keys)} units, {len(pool.outliers)} of them deviate",
            ("coefficient", "centre", "spread", ""),
            rows,
            1,
            "Spread: standard deviation among the units, what the records' noise adds taken off. "
            "Estimates of all units in the light of the others: pool.parquet.",
        )
        found.append(Section("population", "Population", tables=[table]))
    return found


def _settings_section(run: Run) -> Section:
    asked = run.question.job.in_words()
    rows = [(name, str(asked[name])) for name in ("structure", "method", "judge")]
    reading = asked["reading"] or {}
    rows += [(f"read: {k}", str(v)) for k, v in reading.items() if v]
    rows.append(("rows", f"{run.store.parts.name}/*.parquet"))
    return Section("settings", "Settings", settings=rows)
