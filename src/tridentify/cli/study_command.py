"""``tridentify study NAME``: a Monte Carlo study as a table and pictures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from tridentify.cli.results import ResultFolder
from tridentify.cli.run import describe_files
from tridentify.cli.terminal import Activity, plain, show, show_json
from tridentify.errors import OptionError, shown
from tridentify.writing.files import write_atomically


def study(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Which one; a wrong name lists them.")
    ],
    draws: Annotated[int, typer.Option(min=1, metavar="N", help="Noise draws.")] = 200,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of all draws.")] = 0,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Processes; by default as many as processors. The result does not depend on it.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write the table, the numbers and the pictures there."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of the table.")
    ] = False,
) -> None:
    """Run a study over many noise draws.

    Example: tridentify study aircraft --draws 50 --out study
    """
    from tridentify.plots.study import save_study_figures
    from tridentify.studies import STUDIES

    chosen = STUDIES.get(name)
    if chosen is None:
        offered = "; ".join(f"{key} ({item.description})" for key, item in STUDIES.items())
        raise OptionError(f"found no study {shown(name)}; expected one of: {offered}; choose one")
    written: Sequence[Path] = ()
    with ExitStack() as stack:
        results = None if out is None else stack.enter_context(ResultFolder(out))
        activity = stack.enter_context(Activity())
        activity.stage(f"study {chosen.name}, {draws} draws")
        result = chosen.run(draws=draws, seed=seed, workers=workers, progress=activity.count)
        if results is not None:
            activity.stage("drawing the pictures")
            write_atomically(results.draft / f"{name}.txt", result.table() + "\n")
            numbers = json.dumps(plain(result.to_dict()), indent=1, allow_nan=False)
            write_atomically(results.draft / f"{name}.json", numbers + "\n")
            save_study_figures(result, results.draft)
            written = results.publish()
    if as_json:
        show_json(plain(result.to_dict()) | {"files": [str(path) for path in written]})
    else:
        show(result.table(), *describe_files(written))
