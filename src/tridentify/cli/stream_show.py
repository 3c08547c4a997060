"""What a stream shows: lines of JSON, a table that moves, and remarks that do not flood."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.live import Live

from tridentify.cli.stream_question import StreamPlace
from tridentify.cli.tables import make_table
from tridentify.cli.terminal import error_console, say
from tridentify.writing.layout import format_std, format_value, printable

if TYPE_CHECKING:
    from tridentify.estimation.answer.estimate import Estimate
    from tridentify.online import Flag, State

AT_ONCE = 5
"""Remarks that may follow each other without a pause."""
PAUSE = 1.0
"""Time between remarks after that [s]."""
DIGITS = 6
"""Significant digits of numbers in a line, at least: far more than a standard error has."""
LATEST = 20
"""Changes that a line lists."""
PLAIN_PAUSE = 5.0
"""Time between the plain lines that stand in for the table [s]."""


class Remarks:
    """Remarks on lines that were skipped, as many as can be read; the others are counted.

    Parameters
    ----------
    tell : callable
        Takes one line.
    clock : callable
        Gives the time [s].

    Examples
    --------
    >>> said = []
    >>> remarks = Remarks(said.append, clock=lambda: 0.0)
    >>> for number in range(8):
    ...     remarks.remark(f"remark {number}")
    >>> remarks.catch_up()
    >>> said[-2:]
    ['remark 4', '3 more remarks were not shown']
    """

    def __init__(
        self, tell: Callable[[str], None] = say, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._tell, self._clock = tell, clock
        self._credit, self._since = float(AT_ONCE), clock()
        self._hidden = 0

    def remark(self, text: str) -> None:
        """Say it, unless too much was said of late."""
        now = self._clock()
        self._credit = min(AT_ONCE, self._credit + (now - self._since) / PAUSE)
        self._since = now
        if self._credit < 1.0:
            self._hidden += 1
            return
        self._credit -= 1.0
        self.catch_up()
        self._tell(text)

    def catch_up(self) -> None:
        """Say how many remarks were left out."""
        if self._hidden:
            plural = "s were" if self._hidden > 1 else " was"
            self._tell(f"{self._hidden:,} more remark{plural} not shown")
            self._hidden = 0


def flag_words(flags: Flag) -> list[str]:
    """Name what is flagged, as in ``missing-output``."""
    return [str(one.name).lower().replace("_", "-") for one in flags]


def rounded(value: float, std: float = 0.0) -> float:
    """A number with the digits that tell something: six, or to a thousandth of its standard error.

    Examples
    --------
    >>> rounded(39.595574852443434), rounded(1234567.8912345, 0.01), rounded(float("inf"))
    (39.5956, 1234567.89123, inf)
    """
    if not math.isfinite(value) or not math.isfinite(std):
        return value
    telling = math.ceil(math.log10(abs(value / std))) + DIGITS // 2 if value and std else DIGITS
    return float(f"{value:.{min(max(telling, DIGITS), 17)}g}")


def line_of(
    state: State,
    estimate: Estimate | None,
    why: str,
    flags: Flag,
    at: StreamPlace,
    final: bool,
) -> dict[str, Any]:
    """Describe where the estimation is, for one line of JSON.

    Parameters
    ----------
    state : State
    estimate : Estimate or None
        None while the samples do not determine the coefficients.
    why : str
        What is missing then.
    flags : Flag
        Everything that was flagged since the line before.
    at : StreamPlace
        How far the stream was read, and how many lines came out before.
    final : bool
        Whether the stream has ended.

    Returns
    -------
    dict
        Plain values; not yet free of nan.
    """
    # none was seen yet: a zero would be a perfect prediction
    predicts = state.stage.method.is_ready(state)
    spread = [value if value or predicts else math.nan for value in state.noise_std.tolist()]
    noise = dict(zip(state.output_names, map(rounded, spread), strict=True))
    document: dict[str, Any] = {
        "number": at.emitted + 1,
        "time": at.time,
        "n_samples": state.n_samples,
        "ready": estimate is not None,
        "final": final,
        "intersample": state.stage.setting.intersample,
    }
    if estimate is None:
        document["reason"] = why
    else:
        document |= {
            "coefficients": {
                item.name: {"value": rounded(item.value, item.std), "std": rounded(item.std)}
                for item in estimate.parameters.values()
            },
            "noise_std": {
                name: rounded(math.sqrt(variance))
                for name, variance in zip(
                    estimate.output_names, estimate.noise_variance.tolist(), strict=True
                )
            },
            "fit": dict(
                zip(estimate.output_names, map(rounded, estimate.fit.tolist()), strict=True)
            ),
            "status": estimate.status.name,
        }
    lost = {} if at.dropped is None else {"dropped": at.dropped}
    return document | {
        "innovation_std": noise,
        "flags": flag_words(flags),
        "seen": flag_words(state.seen),
        "changes": list(state.changes[-LATEST:]),
        "change_times": [
            rounded(at.time + at.elapsed * (sample / max(state.n_samples - 1, 1) - 1.0))
            for sample in state.changes[-LATEST:]
        ],
        "n_changes": len(state.changes),
        "lines": at.line,
        "malformed": at.malformed,
        **lost,
    }


class LiveView:
    """The estimate as a table on standard error that is drawn anew; plain lines elsewhere.

    Parameters
    ----------
    wanted : bool
        Whether to show anything.
    name : str
        Where the lines come from.
    """

    def __init__(self, wanted: bool, name: str) -> None:
        self._name = name
        self._live: Live | None = None
        self._wanted = wanted
        self._began = self._told = time.monotonic()
        self._first = 0
        if not wanted:
            return
        console = error_console()
        if console.is_terminal and not console.is_dumb_terminal:
            # lines of JSON on the same terminal go above the table, instead of through it
            self._live = Live(
                console=console, redirect_stdout=sys.stdout.isatty(), redirect_stderr=True
            )

    def __enter__(self) -> LiveView:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def begin(self, n_samples: int) -> None:
        """Count samples from here."""
        self._began, self._first = time.monotonic(), n_samples

    def update(self, document: Mapping[str, Any]) -> None:
        """Show another estimate."""
        if not self._wanted:
            return
        now = time.monotonic()
        rate = (document["n_samples"] - self._first) / max(now - self._began, 1e-9)
        if self._live is not None:
            self._live.update(live_table(self._name, document, rate))
        elif now - self._told >= PLAIN_PAUSE or document["final"]:
            self._told = now
            say(plain_line(document, rate))


def live_table(name: str, document: Mapping[str, Any], rate: float) -> Group:
    """Make the table of one estimate, between where it is and what is the matter."""
    table = make_table(("coefficient", "value", "std error"), [_rows(document)])
    return Group(f"{printable(name)}: {_where(document, rate)}", table, _state(document))


def plain_line(document: Mapping[str, Any], rate: float) -> str:
    """Put one estimate on a line."""
    pairs = [f"{name} = {value} +- {std}" for name, value, std in _rows(document)]
    return "; ".join([_where(document, rate), *pairs, _state(document)])


def _where(document: Mapping[str, Any], rate: float) -> str:
    count = document["n_samples"]
    return f"{count:,} samples, {document['time']:.6g} s, {rate:,.0f} samples/s"


def _rows(document: Mapping[str, Any]) -> Sequence[tuple[str, ...]]:
    return [
        (name, format_value(item["value"], item["std"]), format_std(item["std"]))
        for name, item in document.get("coefficients", {}).items()
    ]


def _state(document: Mapping[str, Any]) -> str:
    said = ", ".join(document["flags"]) or "nothing flagged"
    if document["change_times"]:
        said += f"; changed at {document['change_times'][-1]:.6g} s"
    if document["malformed"]:
        said += f"; {document['malformed']:,} malformed lines"
    if document.get("dropped"):
        said += f"; {document['dropped']:,} datagrams dropped"
    return said
