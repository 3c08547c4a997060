"""The two streams: results on standard output, progress, notes and errors on standard error."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import shutil
import sys
import textwrap
import threading
import time
import traceback
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO, cast

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn
from rich.progress import TimeElapsedColumn as Elapsed
from rich.progress import TimeRemainingColumn as Remaining
from rich.table import Table

from tridentify.errors import DataWarning, OutputPathError
from tridentify.writing.layout import printable

PROGRAM = "tridentify"
TEXT_WIDTH = 78
"""Columns of running text: two fewer than the narrowest usual terminal has."""
UNLIMITED = 10_000
"""Columns for what no person reads: a pipe cuts no table."""
SILENCE = 1.0
"""How long a stage that is mostly over at once may take before a plain line names it [s]."""


PAUSE = 2.0
"""Time between two plain lines of a stage that counts [s]."""
_COUNT = re.compile(r"\b(\d+) of (\d+)\b")


class ReaderGoneError(Exception):
    """Standard output was closed by who reads it, as ``head`` does when it has seen enough."""


class _Console(Console):
    """A console that takes names with brackets as they are, and leaves a closed pipe to `main`."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__(file=stream, markup=False, emoji=False, highlight=False)

    def on_broken_pipe(self) -> None:
        raise ReaderGoneError


def own_command() -> str:
    """How a user calls this program again, ready for a shell.

    Returns
    -------
    str
        The name alone if the shell finds this very program by it, else the path as it was called.

    Examples
    --------
    >>> own_command()
    'tridentify'
    """
    given = Path(sys.argv[0])
    if given.name == "__main__.py" and given.parent.name == PROGRAM:
        return f"{shlex.quote(sys.executable)} -m {PROGRAM}"
    if given.stem != PROGRAM or not given.is_file():
        return PROGRAM
    known = shutil.which(PROGRAM)
    if known is not None and os.path.samefile(known, given):
        return PROGRAM
    # a bare name would be looked up along PATH
    return shlex.quote(sys.argv[0] if given.name != sys.argv[0] else str(given.absolute()))


def show(*blocks: str | Table) -> None:
    """Print blocks on standard output, with an empty line between them.

    Parameters
    ----------
    *blocks : str or rich.table.Table
        What is wider than the terminal is left to the terminal to wrap: no number is cut.
    """
    console = _Console(sys.stdout)
    with _to_the_reader():
        for number, block in enumerate(block for block in blocks if block != ""):
            if number:
                console.print()
            if isinstance(block, str):
                console.print(printable_lines(block), soft_wrap=True)
            else:
                console.width = UNLIMITED
                console.width = console.measure(block).maximum
                console.print(block)


def printable_lines(text: str) -> str:
    r"""Escape what the terminal would obey, but for line feeds.

    Examples
    --------
    >>> printable_lines("one\ntwo\x07")
    'one\ntwo\\x07'
    """
    return "\n".join(map(printable, text.split("\n")))


def paragraph(text: str, first: str = "", rest: str | None = None) -> str:
    """Wrap a text to the width of a small terminal.

    Parameters
    ----------
    text : str
        Its line breaks do not count.
    first, rest : str
        What the first and the other lines begin with; by default blanks as long as `first`.

    Returns
    -------
    str

    Examples
    --------
    >>> print(paragraph("one fact " * 10, "- "))
    - one fact one fact one fact one fact one fact one fact one fact one fact one
      fact one fact
    """
    below = " " * len(first) if rest is None else rest
    return textwrap.fill(
        " ".join(text.split()),
        TEXT_WIDTH,
        initial_indent=first,
        subsequent_indent=below,
        break_long_words=False,
        break_on_hyphens=False,
    )


def show_json(document: Mapping[str, Any]) -> None:
    """Print one JSON object on standard output.

    Parameters
    ----------
    document : mapping
        Plain values; nan becomes null, an infinity the text "inf" or "-inf".
    """
    with _to_the_reader():
        print(json.dumps(plain(document), indent=1, allow_nan=False))


def show_json_line(document: Mapping[str, Any]) -> None:
    """Print one JSON object on a line of its own on standard output, and see it off.

    Parameters
    ----------
    document : mapping
        As for `show_json`.
    """
    with _to_the_reader():
        print(json.dumps(plain(document), allow_nan=False))


@contextmanager
def _to_the_reader() -> Iterator[None]:
    """Write to standard output for good, or close it so that nothing complains at the end."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError as error:
        give_up_output()
        raise ReaderGoneError from error
    except OSError:
        give_up_output()
        raise


def check_output() -> None:
    """Refuse to work without a standard output.

    Raises
    ------
    OutputPathError
    """
    if sys.stdout is None:
        raise OutputPathError(
            "found standard output closed; expected somewhere to write results to; redirect it to "
            "/dev/null if they are not wanted"
        )


def see_off() -> None:
    """Write what standard output still holds back.

    Raises
    ------
    ReaderGoneError
    OSError
    """
    with _to_the_reader():
        pass


def give_up_output() -> None:
    """Send what standard output still holds, and what follows, nowhere."""
    _to_nowhere(sys.stdout)


def _to_nowhere(stream: TextIO) -> None:
    try:
        number = stream.fileno()
    except (OSError, ValueError):
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, number)
    os.close(nowhere)


class _Forgiving:
    """Standard error that drops what can no longer be written: no reason to lose the results."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with self._or_nowhere():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with self._or_nowhere():
            self._stream.flush()

    @contextmanager
    def _or_nowhere(self) -> Iterator[None]:
        try:
            yield
        except (OSError, ValueError):
            _to_nowhere(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def plain(value: Any) -> Any:
    """Copy for JSON: mappings and lists of text, finite numbers, null and "inf".

    Examples
    --------
    >>> plain({"a": (1.0, float("nan"), float("-inf"))})
    {'a': [1.0, None, '-inf']}
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def say(text: str) -> None:
    """Write one line to standard error, whatever is in `text`."""
    print(f"{PROGRAM}: {printable(' '.join(text.split()))}", file=sys.stderr, flush=True)


def complain(text: str) -> None:
    """Write one line about an error to standard error."""
    say(f"error: {text}")


def complain_in_full(error: BaseException) -> None:
    """Write the traceback of an error to standard error."""
    sys.stderr.write(printable_lines("".join(traceback.format_exception(error))))


def error_console() -> Console:
    """Make a console on standard error."""
    return _Console(sys.stderr)


@dataclass(frozen=True)
class Pace:
    """When a count began, and with how many: what an earlier run has done says nothing of this one.

    Examples
    --------
    >>> Pace(since=10.0, first=50).left(now=12.0, done=60, total=100)
    8.0
    """

    since: float
    first: int

    def left(self, now: float, done: int, total: int) -> float | None:
        """Time that the rest takes at this pace [s]; None at the end, or while nothing is known."""
        if done <= self.first or done >= total:
            return None
        return (total - done) * (now - self.since) / (done - self.first)


class Activity:
    """What is going on, shown on standard error while it lasts.

    In a terminal one moving line that vanishes at the end; elsewhere a plain line for each stage,
    which tells the time since the beginning once that is a second. A stage that comes again has
    been told, and one that counts ("3 of 10") is told every `PAUSE` seconds.

    Examples
    --------
    >>> with Activity() as activity:
    ...     activity.stage("reading the record")
    """

    def __init__(self) -> None:
        console = error_console()
        self._bar: Progress | None = None
        if console.is_terminal and not console.is_dumb_terminal:
            spinner = "dots" if console.encoding.startswith("utf") else "line"
            columns = SpinnerColumn(spinner), TextColumn("{task.description}"), Elapsed()
            self._bar = Progress(*columns, console=console, transient=True)
            self._task = self._bar.add_task("", total=None)
            described = TextColumn("{task.description}")
            self._counted = (
                *(described, BarColumn(), MofNCompleteColumn()),
                *(Elapsed(), TextColumn("left"), Remaining()),
            )
        self._tenths = 0
        self._named = ""
        self._since = time.monotonic()
        self._said: set[str] = set()
        self._counted_at = -PAUSE
        self._pace: Pace | None = None

    def __enter__(self) -> Activity:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def stage(self, text: str) -> None:
        """Name what is done now; what goes on is not named again."""
        if text == self._named:
            return
        self._named = text
        if self._bar is not None:
            self._bar.update(self._task, description=printable(text))
        elif self._is_news(text):
            since = time.monotonic() - self._since
            say(f"{text} (after {since:.0f} s)" if since >= 1.0 else text)

    def _is_news(self, text: str) -> bool:
        """Whether a stage deserves a plain line."""
        counted = _COUNT.search(text)
        if counted is None:
            new = text not in self._said
            self._said.add(text)
            return new
        now = time.monotonic() - self._since
        last = counted[1] == counted[2]
        if not last and now - self._counted_at < PAUSE:
            return False
        self._counted_at = now
        return True

    @contextmanager
    def brief_stage(self, text: str) -> Iterator[None]:
        """Name what is done meanwhile; as a plain line only once it has taken a while.

        Parameters
        ----------
        text : str
        """
        if self._bar is not None:
            self.stage(text)
            yield
            return
        timer = threading.Timer(SILENCE, say, [text])
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()

    def count(self, done: int, total: int) -> None:
        """Say that `done` of `total` pieces are done; plain lines come at every tenth."""
        if self._bar is not None:
            self._bar.columns = self._counted
            self._bar.update(self._task, completed=done, total=total)
            return
        left = self._left(done, total)
        tenths = 10 * done // max(total, 1)
        if tenths > self._tenths or done == total:
            self._tenths = tenths
            since = time.monotonic() - self._since
            say(f"{done} of {total} done after {since:.0f} s{left}")

    def _left(self, done: int, total: int) -> str:
        """How long the rest may take, from the pace since the first count."""
        now = time.monotonic()
        if self._pace is None:
            self._pace = Pace(now, done)
        left = self._pace.left(now, done, total)
        return "" if left is None else f", about {left:.0f} s left"

    def note(self, text: str) -> None:
        """Write a line that stays."""
        if self._bar is not None:
            self._bar.console.print(f"{PROGRAM}: {printable(text)}", soft_wrap=True)
        else:
            say(text)


@contextmanager
def patient_streams() -> Iterator[None]:
    """Let no character and no warning of a library break or soil the output while this lasts.

    What a terminal cannot show is replaced by its escape; a `DataWarning` becomes a line on
    standard error, and other warnings, which only developers can act on, are dropped. Where
    standard error is closed or full, what goes there is dropped.
    """
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    with ExitStack() as stack:
        errors = sys.stderr
        if errors is None:
            errors = stack.enter_context(Path(os.devnull).open("w", encoding="utf-8"))
        stack.enter_context(redirect_stderr(cast("TextIO", _Forgiving(errors))))
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", DataWarning)
        warnings.showwarning = lambda message, *_args, **_options: say(f"warning: {message}")
        yield


def listed(names: Sequence[str]) -> str:
    """Names in a sentence.

    Examples
    --------
    >>> listed(["alpha", "q", "theta"])
    'alpha, q and theta'
    """
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1]))) if names else ""
