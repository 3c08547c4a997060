"""A command at work: what it says on the way, the folder of its results, and its answer."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from tridentify.cli.load import RecordSource, load
from tridentify.cli.results import ResultFolder
from tridentify.cli.run import load_compiled
from tridentify.cli.terminal import Activity, paragraph, show, show_json
from tridentify.errors import OptionError
from tridentify.record.record import Record


@dataclass
class Work:
    """What a command has at hand between its first and its last word.

    Attributes
    ----------
    activity : Activity
        Progress, on standard error.
    results : ResultFolder or None
        Where the results go, if somewhere.
    written : tuple of Path
        What stands there now.
    """

    activity: Activity
    results: ResultFolder | None
    written: tuple[Path, ...] = ()

    def records(self, source: RecordSource) -> list[Record]:
        """Read the records, and load what is compiled."""
        found = load(source, self.activity)
        load_compiled(self.activity)
        return found

    def publish(self, write: Callable[[Path], object]) -> None:
        """Write results into a folder that appears when it is complete, if one was asked for."""
        if self.results is not None:
            write(self.results.draft)
            self.written = self.results.publish()

    def answer(
        self,
        as_json: bool,
        document: Callable[[], Mapping[str, Any]],
        blocks: Callable[[], Iterable[str | Table]],
    ) -> None:
        """Print the answer as one JSON object, or as text and tables; files come last."""
        if as_json:
            show_json({**document(), "files": [str(path) for path in self.written]})
        else:
            show(*blocks(), *describe_files(self.written))


@contextmanager
def at_work(out: Path | None) -> Iterator[Work]:
    """The work of a command, whose results go into a folder where one is named."""
    with ExitStack() as stack:
        results = None if out is None else stack.enter_context(ResultFolder(out))
        yield Work(stack.enter_context(Activity()), results)


def chosen_workers(workers: int | None, scheduler: str | None) -> int | str | None:
    """Who does the work: so many processes, or the workers of a scheduler.

    Raises
    ------
    OptionError
        Both are named.
    """
    if workers is not None and scheduler is not None:
        raise OptionError(
            "found --workers beside --scheduler; expected one of them: the scheduler knows its "
            "workers; leave one out"
        )
    return scheduler or workers


def describe_files(written: Iterable[Path]) -> list[str]:
    """Say which files were written, in one line; nothing if none were."""
    paths = list(written)
    if not paths:
        return []
    names = ", ".join(path.name for path in paths)
    return [paragraph(f"written to {paths[0].parent}: {names}", rest="  ")]
