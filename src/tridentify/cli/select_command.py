"""``tridentify select``: files in, a table of candidates and a recommended structure out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from tridentify.cli import options
from tridentify.cli.groups import Along, Late, Measured, Reading, Way
from tridentify.cli.load import load
from tridentify.cli.run import load_compiled
from tridentify.cli.tables import describe_records, make_table
from tridentify.cli.terminal import Activity, paragraph
from tridentify.cli.work import at_work
from tridentify.errors import IdentifiabilityError, OrderError
from tridentify.estimation.answer.trust import unusable
from tridentify.record.record import Record
from tridentify.structure import Structure

if TYPE_CHECKING:
    from tridentify.judgement.selection import Selection

MOST = 200
"""Structures: a second each on a slow machine is three minutes."""


DEFAULT = "1:4"
"""Poles that are tried where only the zeros are stated."""


def select(
    measured: Measured,
    *,
    poles: Annotated[str, options.model_option(metavar="A:B")] = "auto",
    zeros: Annotated[str, options.model_option(metavar="A:B")] = "all",
    reading: Reading,
    validation: Annotated[
        list[Path] | None, options.record_option("--validation", metavar="FILE")
    ] = None,
    late: Late,
    along: Along,
    way: Way,
    jobs: Annotated[int, typer.Option(min=1, metavar="N")] = 1,
    out: Annotated[Path | None, options.result_option(metavar="DIR")] = None,
    as_json: options.AsJson = False,
) -> None:
    """Compare numbers of poles and zeros, and recommend one.

    Example: tridentify select flight.csv --input elevator --output q --poles 1:4

    Parameters
    ----------
    poles
        Numbers of poles to try: a range, or one number. Shared denominators. Left out, 1 to 4, and
        up to 8 where the record clearly asks for them; delays are tried, too.
    zeros
        Numbers of zeros to try: a range, one number, or all (every number below that of the poles;
        as many, too, where the output follows the input at once, and a pole at zero where it
        integrates). A range takes in as many zeros as poles where it reaches so far.
    validation
        A file to judge the fit on, with the same columns; may be repeated. Without it, blocks of
        the record are left out in turn.
    jobs
        Processes side by side; the result does not depend on it.
    out
        Write report.html, selection.json, model.json of the recommended row, and the pictures into
        this folder.
    """
    inputs, outputs = measured.columns()
    template = late.template(along, len(outputs), len(inputs))
    candidates: Sequence[Structure] | None = None
    every = zeros.strip() == "all"
    if not every or poles.strip() != "auto":
        candidates = candidates_from(DEFAULT if poles.strip() == "auto" else poles, zeros, template)
    chosen = way.chosen()
    sources = [reading.source(measured.files, inputs, outputs)]
    if validation:
        whole = replace(reading, start=None, stop=None)
        sources.append(whole.source(validation, inputs, outputs))
    with at_work(out) as work:
        activity = work.activity
        records, *unseen = (load(source, activity) for source in sources)
        load_compiled(activity)
        if every and candidates is not None:
            candidates = _with_direct_part(records, candidates, template)
        asked = candidates if candidates is not None else template
        selection = _selected(records, unseen, asked, chosen, jobs, activity, every)
        work.publish(lambda folder: _write(selection, records, folder, activity))
    work.answer(as_json, selection.to_dict, lambda: _blocks(selection, records))
    _refuse_none(selection)


def candidates_from(poles: str, zeros: str, template: Structure) -> list[Structure]:
    """Read the ranges of poles and zeros.

    Parameters
    ----------
    poles, zeros : str
        ``"1:4"``, ``"2"``; zeros also ``"all"``.
    template : Structure
        Everything but the orders.

    Returns
    -------
    list of Structure

    Raises
    ------
    OrderError
        A range cannot be read, or holds no candidate, or too many.

    Examples
    --------
    >>> [(s.poles, s.zeros) for s in candidates_from("1:2", "all", Structure(1, 0))]
    [(1, 0), (2, 0), (2, 1)]
    """
    low, high = _range("--poles", poles)
    few, many = (0, high) if zeros.strip() == "all" else _range("--zeros", zeros)
    every = zeros.strip() == "all"
    found = [
        replace(template, poles=n, zeros=m)
        for n in range(max(low, 1), high + 1)
        for m in range(few, min(many, n - every) + 1)
    ]
    if not found or len(found) > MOST:
        raise OrderError(
            f"found {len(found) or 'no'} candidates for --poles {poles} --zeros {zeros}; expected "
            f"1 to {MOST}, with at least one pole and no more zeros than poles; change the ranges"
        )
    return found


def _with_direct_part(
    records: Sequence[Record], candidates: Sequence[Structure], template: Structure
) -> list[Structure]:
    """The candidates and, where an output follows an input at once, as many zeros as poles."""
    from tridentify.judgement.selection import default_candidates

    orders = {one.poles for one in candidates}
    most = max(n for n in orders if isinstance(n, int))
    tried = default_candidates(records, template, most)
    direct = [one for one in tried if one.zeros == one.poles and one.poles in orders]
    return sorted([*candidates, *direct], key=lambda one: (one.common_poles, str(one.zeros)))


def _range(option: str, text: str) -> tuple[int, int]:
    match = re.fullmatch(r"\s*(\d{1,3})\s*(?::\s*(\d{1,3})\s*)?", text)
    if match is None:
        also = ", one number or all" if option == "--zeros" else " or one number"
        raise OrderError.found(f"{option} ", text, f"a range such as 1:4{also}")
    low = int(match[1])
    return low, low if match[2] is None else int(match[2])


def _selected(
    records: Sequence[Record],
    unseen: Sequence[Sequence[Record]],
    asked: Sequence[Structure] | Structure,
    method: Any,
    jobs: int,
    activity: Activity,
    every: bool,
) -> Selection:
    """Select; with several processes if that is asked for."""
    from tridentify.judgement.selection import select_structure
    from tridentify.studies.processes import process_pool

    with nullcontext() if jobs == 1 else process_pool(jobs) as pool:
        return select_structure(
            records,
            None if isinstance(asked, Structure) else asked,
            method=method,
            validation=unseen[0] if unseen else None,
            template=asked if isinstance(asked, Structure) else None,
            integrators=every,
            executor=pool,
            progress=activity.stage,
        )


def _write(
    selection: Selection, records: Sequence[Record], folder: Path, activity: Activity
) -> None:
    """Write selection.json, the recommended model, the page and the pictures."""
    from tridentify.report import write_selection_report

    activity.stage("writing the report and the figures")
    selection.save(folder / "selection.json")
    if selection.recommended is not None and selection.recommended.estimate is not None:
        selection.recommended.estimate.save(folder / "model.json")
    write_selection_report(selection, records, folder / "report.html", figures=folder)


def _blocks(selection: Selection, records: Sequence[Record]) -> list[str | Table]:
    """What is recommended and why, and the table of all candidates."""
    own = selection.recommended
    head = "no structure is recommended" if own is None else f"recommended: {own.label}"
    why = "" if own is None or own.estimate is None else unusable(own.estimate, selection.findings)
    cautions = [paragraph(why, "  ", "  ")] if why else []
    cautions += [paragraph(text, "  caution: ", "    ") for text in selection.cautions]
    return [
        describe_records(records),
        "\n".join((f"{head} (poles, zeros)", paragraph(selection.reason, "  ", "  "), *cautions)),
        make_table(selection.titles, [selection.table()]),
        "\n".join(paragraph(note, "- ") for note in selection.all_notes()),
    ]


def _refuse_none(selection: Selection) -> None:
    """An answer that there is none is an error, behind the table that says why."""
    if selection.recommended is None:
        labels = [row.label for row in selection.rows]
        tried = "; ".join(labels[:4]) + ("; and so on" if len(labels) > 4 else "")
        raise IdentifiabilityError(
            f"found no usable candidate among {len(labels)} ({tried}); expected one that the "
            "record determines; do what the reason above says, try fewer poles, or record longer"
        )
