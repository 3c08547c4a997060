"""``tridentify study NAME`` or ``FILE.toml``: a Monte Carlo study as a table and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tridentify.cli.terminal import Activity, plain, show, show_json
from tridentify.cli.work import at_work, chosen_workers, describe_files
from tridentify.errors import OptionError, shown
from tridentify.writing.files import write_atomically, write_json

if TYPE_CHECKING:
    from tridentify.studies import Study, StudyResult

DRAWS = 200
"""Of a study that is a program, where nothing is said; a file says itself how many."""
ENDING = ".toml"
TABLE, STATISTICS = "table", "statistics"
"""Files of a declared study; not its name, which might be that of the file of its settings."""


def study(
    name: Annotated[str, typer.Argument(metavar="NAME|FILE.toml")],
    draws: Annotated[int | None, typer.Option(min=1, metavar="N")] = None,
    seed: Annotated[int | None, typer.Option(min=0, metavar="N")] = None,
    workers: Annotated[int | None, typer.Option(min=1, metavar="N")] = None,
    scheduler: Annotated[str | None, typer.Option(metavar="URL")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    as_json: Annotated[bool, typer.Option("--json")] = False,
) -> None:
    """Run a study over many noise draws.

    Example: tridentify study aircraft --draws 50 --out study

    Example: tridentify study efficiency.toml --workers 2 --out efficiency

    Example: tridentify study efficiency.toml --scheduler tcp://127.0.0.1:8786 --out efficiency

    Parameters
    ----------
    name
        Which one, or a file that declares one; a wrong name lists them.
    draws
        Noise draws; by default 200, or what the file says.
    seed
        Seed of all draws; by default 0, or what the file says.
    workers
        Processes; by default as many as processors. The result does not depend on it.
    scheduler
        A Dask scheduler, such as tcp://host:8786, whose workers make the draws. The result does
        not depend on it.
    out
        Write the table, the numbers and the pictures there. The draws of a file are appended as
        they are done: a run that was ended goes on from there.
    as_json
        Print one JSON object instead of the table.
    """
    from tridentify.studies import STUDIES

    hands = chosen_workers(workers, scheduler)
    if name in STUDIES:
        count = DRAWS if draws is None else draws
        result, written = _program(STUDIES[name], count, seed or 0, hands, out)
    else:
        result, written = _declared(_file(name), draws, seed, hands, out)
    if as_json:
        show_json(plain(result.to_dict()) | {"files": [str(path) for path in written]})
    else:
        show(result.table(), *describe_files(written))


def _program(
    chosen: Study, draws: int, seed: int, workers: int | str | None, out: Path | None
) -> tuple[StudyResult, Sequence[Path]]:
    """A study that is a program: its folder appears at the end."""
    from tridentify.plots.study import save_study_figures

    with at_work(out) as work:
        activity = work.activity
        activity.stage(f"study {chosen.name}, {draws} draws")
        result = chosen.run(draws=draws, seed=seed, workers=workers, progress=activity.count)

        def write(folder: Path) -> None:
            activity.stage("drawing the pictures")
            _write(result, folder, chosen.name, chosen.name)
            save_study_figures(result, folder)

        work.publish(write)
    return result, work.written


def _declared(
    path: Path, draws: int | None, seed: int | None, workers: int | str | None, out: Path | None
) -> tuple[StudyResult, Sequence[Path]]:
    """A study that a file declares: its folder grows, so that it can be gone on with."""
    from tridentify.plots.study import save_study_figures
    from tridentify.studies import read_study, run_study

    chosen = read_study(path)
    count = chosen.draws if draws is None else draws
    with Activity() as activity:
        activity.stage(f"study {chosen.name}, {count} draws a cell")
        result = run_study(
            chosen, out=out, workers=workers, draws=draws, seed=seed, progress=activity.count
        )
        if out is None:
            return result, ()
        activity.stage("drawing the pictures")
        return result, (*_write(result, out, TABLE, STATISTICS), *save_study_figures(result, out))


def _write(result: StudyResult, folder: Path, text: str, document: str) -> tuple[Path, ...]:
    return (
        write_atomically(folder / f"{text}.txt", result.table() + "\n"),
        write_json(folder / f"{document}.json", plain(result.to_dict())),
    )


def _file(name: str) -> Path:
    """The file that is meant: one that is there, or one that comes with the package."""
    from tridentify.studies import SHIPPED, STUDIES, shipped_study

    path = Path(name)
    if path.is_file():
        return path
    if name.removesuffix(ENDING) in SHIPPED:
        return shipped_study(name)
    if path.suffix == ENDING:
        return path  # to be told that it is not there
    offered = [f"{key} ({item.description})" for key, item in STUDIES.items()]
    offered += [f"{key}{ENDING}" for key in SHIPPED]
    raise OptionError(
        f"found no study {shown(name)}; expected one of: {'; '.join(offered)}; or a file that ends "
        f"with {ENDING}; choose one"
    )
