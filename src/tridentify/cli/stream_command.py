"""``tridentify stream``: lines of samples in, an estimate that follows them out."""

from __future__ import annotations

import signal
import sys
import time as clock
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, Literal

import numpy as np
import typer

from tridentify.cli import options
from tridentify.cli import stream_options as own
from tridentify.cli.ask import nested_poles, nested_zeros
from tridentify.cli.groups import Along, Late
from tridentify.cli.load import check_rules, rules_from, units_from
from tridentify.cli.stream_checkpoint import (
    Snapshot,
    prove_writable,
    read_checkpoint,
    undamaged,
    write_checkpoint,
)
from tridentify.cli.stream_question import StreamQuestion, check_every
from tridentify.cli.stream_session import Session
from tridentify.cli.stream_show import LiveView
from tridentify.cli.terminal import Activity, say, show_json_line
from tridentify.errors import (
    OptionError,
    OutputPathError,
    UnreadableFileError,
    shown,
)
from tridentify.record.formats.streams.datagrams import UdpSource, loopback_address
from tridentify.record.formats.streams.header import Asked, split_columns
from tridentify.record.formats.streams.lines import LineCutter
from tridentify.record.formats.streams.sources import ByteSource, PipeSource, source_of_file
from tridentify.writing.interruption import SIGNALS, on_signals


def stream(
    inputs: Annotated[list[str], options.record_option("--input", metavar="NAME")],
    outputs: Annotated[list[str], options.record_option("--output", metavar="NAME")],
    poles: Annotated[list[str], options.model_option(metavar="N")],
    zeros: Annotated[list[str], options.model_option(metavar="M")],
    *,
    source: Annotated[str, typer.Argument(metavar="SOURCE")] = "-",
    time: Annotated[str | None, options.record_option(metavar="NAME")] = None,
    dt: Annotated[float | None, options.record_option(metavar="SECONDS")] = None,
    intersample: Annotated[Literal["zoh", "foh"], options.record_option(metavar="HOW")] = "zoh",
    columns: Annotated[str | None, options.record_option("--columns", metavar="NAMES")] = None,
    form: Annotated[
        Literal["auto", "csv", "json"], options.record_option("--format", metavar="F")
    ] = "auto",
    decimal: Annotated[Literal[".", ","], options.record_option("--decimal", metavar="SIGN")] = ".",
    missing: options.Missing = None,
    units: options.Units = None,
    follow: Annotated[bool, options.record_option("--follow")] = False,
    idle: Annotated[float | None, options.record_option(metavar="SECONDS")] = None,
    late: Late,
    along: Along,
    asking: own.Asking,
    every: Annotated[float, options.result_option(metavar="SECONDS")] = 1.0,
    live: Annotated[bool, options.result_option("--live")] = False,
    checkpoint: Annotated[Path | None, options.result_option(metavar="FILE")] = None,
    resume: Annotated[bool, options.result_option("--resume")] = False,
) -> None:
    """Follow the coefficients of a model while samples arrive, a line of JSON at a time.

    Example: tridentify stream flight.csv --input elevator --output q --poles 2 --zeros 1 --every 5

    Parameters
    ----------
    inputs
        Column of an input; may be repeated.
    outputs
        Column of an output; may be repeated.
    poles
        Degree of the denominator that all channels share; or denominators of their own: once for
        each output with a number for each input (--poles 2,1).
    zeros
        Degree of the numerators: once for all channels, or once for each output in their order
        (--zeros 1 --zeros 0); with several inputs also a number for each of them (--zeros 1,0).
    source
        Where lines come from: - (standard input), a file, or udp://127.0.0.1:PORT (datagrams to
        this machine from itself; port 0 takes a free one).
    time
        Column of time; by default, without --dt, the one called t or time.
    dt
        Nominal sampling interval; alone it is the time between lines, with --time the intervals are
        those of the column. By default it is taken from the first samples.
    intersample
        What the input does between samples: zoh (held) or foh. Unlike identify, stream compares no
        behaviours: pass the one that identify found.
    columns
        Names of the columns, such as t,u,y, without a header.
    form
        Lines are csv, json, or auto (by the first one).
    decimal
        Decimal sign of CSV: . or ,
    follow
        Wait for more at the end of the file, also when it is replaced or cut.
    idle
        End when nothing has come for so long.
    every
        Time of the data between two lines; inf for the last.
    live
        Show a table that follows the estimate.
    checkpoint
        Keep the state in this file, at every line and the end.
    resume
        Go on from the checkpoint; begin anew where there is none.
    """
    check_every(every)
    _check_resumable(checkpoint, resume)
    shape = len(outputs), len(inputs)
    structure = replace(
        late.template(along, *shape),
        poles=nested_poles(poles, *shape),
        zeros=nested_zeros(zeros, *shape),
    )
    chosen = asking.chosen()
    with ExitStack() as stack:
        origin = _source(source, follow)
        stack.callback(origin.close)
        asked = Asked(
            tuple(inputs),
            tuple(outputs),
            time,
            uniform=time is None and dt is not None,
            columns=split_columns(columns) if columns else (),
            form="" if form == "auto" else form,
            decimal=decimal,
            units=tuple(units_from(units or ()).items()),
            name=origin.name,
        )
        rules = rules_from(missing or ())
        check_rules(rules, outputs)
        question = StreamQuestion(asked, structure, chosen, dt, intersample, rules, every)
        _try_out(question)
        run = _StreamRun(question, origin, checkpoint, idle)
        if resume:
            run.go_on()
        run.until_the_end(live, stack)


def _source(text: str, follow: bool) -> ByteSource:
    """Open the source that is named."""
    path = Path(text)
    if text == "-" or text.startswith("udp:"):
        if follow:
            raise OptionError(
                f"found --follow with {shown(text)}; expected a file; leave --follow out, since "
                "this source is waited for anyway"
            )
        if text == "-":
            if sys.stdin is None:
                raise UnreadableFileError(
                    "found standard input closed; expected lines of samples; name a file or "
                    "udp://127.0.0.1:PORT"
                )
            if sys.stdin.isatty():
                say("reading lines from this terminal; end them with Ctrl-D")
            return PipeSource("standard input", lambda: sys.stdin.buffer)
        source = UdpSource(*loopback_address(text))
        say(f"listening at {source.name}")
        return source
    if "://" in text and not path.exists():
        raise OptionError.found("the source ", text, "-, a file, or udp://127.0.0.1:PORT")
    opened = source_of_file(path, follow, say)
    if follow and isinstance(opened, PipeSource):
        raise OptionError.found("--follow with the pipe ", text, "a file", "leave --follow out")
    return opened


def _try_out(question: StreamQuestion) -> None:
    """Let the method refuse what it cannot do, and compile its loops, before anything comes."""
    asked, method = question.asked, question.method
    state = method.init(
        question.structure,
        1.0 if question.dt is None else question.dt,
        input_names=asked.inputs,
        output_names=asked.outputs,
        intersample=question.intersample,
    )
    said = "loading the sample loop (compiled once per machine, which takes seconds)"
    with Activity() as activity, activity.brief_stage(said):
        u, y = np.zeros((1, len(asked.inputs))), np.zeros((1, len(asked.outputs)))
        for intervals in (None, np.full(1, state.dt)):
            method.feed(state, u, y, intervals)


def _check_resumable(checkpoint: Path | None, resume: bool) -> None:
    if resume and checkpoint is None:
        raise OptionError(
            "found --resume without --checkpoint; expected the file to go on from; name it"
        )
    if checkpoint is None:
        return
    prove_writable(checkpoint)
    if checkpoint.exists() and not resume:
        raise OptionError(
            f"found a checkpoint in {checkpoint}; expected --resume to go on from it, or another "
            "name; add --resume, or remove the file"
        )


class _Stop:
    """Whether the user, or the system, asked to stop."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self) -> bool:
        return self.asked

    def ask(self, _number: int, _frame: FrameType | None) -> None:
        """Let the first request end the stream between two samples; the next one at once."""
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True


def _counts(handler: Any) -> bool:
    """Whether a signal is not ignored."""
    return handler is not signal.SIG_IGN


@dataclass
class _StreamRun:
    """From the source through the session to the lines and the checkpoint."""

    question: StreamQuestion
    source: ByteSource
    checkpoint: Path | None
    idle: float | None

    def __post_init__(self) -> None:
        self.stop = _Stop()
        self.session = Session(self.question, self._emit, say, self.stop)
        self.view = LiveView(False, "")
        self._complained = False
        self._dropped_before: int | None = None

    def go_on(self) -> None:
        """Take up the checkpoint, if there is one."""
        assert self.checkpoint is not None
        if not self.checkpoint.exists():
            say(f"no checkpoint in {self.checkpoint} yet; beginning anew")
            return
        found = read_checkpoint(self.checkpoint, self.question.to_dict())
        position = 0
        if self.source.positioned:
            self.source.seek(found.mark)
            position = 0 if found.mark is None else found.mark.position
        with undamaged(self.checkpoint):
            self.session.go_on_from(
                found.state, found.reader, found.timeline, found.counts, position
            )
        self._dropped_before = self.session.place.dropped
        where = f"byte {position:,}" if self.source.positioned else "what comes"
        say(
            f"going on from {self.checkpoint} at sample {found.state.n_samples:,}, with {where} of "
            f"{self.source.name}"
        )

    def until_the_end(self, live: bool, stack: ExitStack) -> None:
        """Run until the source ends or a signal comes; the last line and checkpoint follow.

        Raises
        ------
        NotReadyError
            The samples did not determine the coefficients.
        """
        stack.enter_context(on_signals(SIGNALS, self.stop.ask, _counts))
        self.view = stack.enter_context(LiveView(live, self.source.name))
        session = self.session
        self.view.begin(session.state.n_samples if session.state else 0)
        cutter = LineCutter(session.place.position)
        ended = self._read(cutter)
        session.end_waiting()
        whole = self._snapshot() if self.source.positioned else None
        if ended and not self.stop():
            for lines in cutter.rest():
                session.take(lines)
            session.end_waiting()
        self._count_dropped()
        last = session.line(final=True)
        session.remarks.catch_up()
        self.view.update(last)
        if self.stop() or not session.repeats:
            show_json_line(last)
        self._keep(whole or self._snapshot(), last=True)
        if last["malformed"]:
            say(f"{last['malformed']:,} of {last['lines']:,} lines were malformed")
        if last.get("dropped"):
            say(
                f"{last['dropped']:,} datagrams were dropped by the system since those before were "
                "not read yet; send fewer, or more lines in each"
            )
        if session.refused is not None:
            raise session.refused

    def _read(self, cutter: LineCutter) -> bool:
        """Read until nothing more comes; say whether the source ended by itself."""
        heard = clock.monotonic()
        for piece in self.source.pieces():
            if self.stop():
                return False
            if piece is None:
                self.session.remarks.catch_up()
                if self.idle is not None and clock.monotonic() - heard > self.idle:
                    return False
                continue
            heard = clock.monotonic()
            self._count_dropped()
            if piece.fresh:
                cutter.begin_at(piece.position)
                self.session.begin_at(piece.position)
            for lines in cutter.cut(piece.data):
                self.session.take(lines)
                if self.stop():
                    return False
        return True

    def _count_dropped(self) -> None:
        """Add what the system dropped in this run to what it had dropped in those before."""
        if self.source.dropped is not None:
            self.session.place.dropped = (self._dropped_before or 0) + self.source.dropped

    def _emit(self, document: dict[str, Any]) -> None:
        self.view.update(document)
        show_json_line(document)
        if self.checkpoint is not None:
            self._keep(self._snapshot())

    def _snapshot(self) -> Snapshot | None:
        session = self.session
        if self.checkpoint is None or session.state is None or session.timeline is None:
            return None
        return Snapshot(
            self.question.to_dict(),
            session.reader.to_dict(session.place.line),
            session.timeline_here(),
            session.counts(),
            self.source.mark(session.place.position),
            session.state,
        )

    def _keep(self, snapshot: Snapshot | None, *, last: bool = False) -> None:
        """Write the checkpoint; while the stream runs, a full disk is no reason to end it."""
        if snapshot is None or self.checkpoint is None:
            return
        try:
            write_checkpoint(self.checkpoint, snapshot)
            self._complained = False
        except OutputPathError as error:
            if last:
                raise
            if not self._complained:
                say(f"warning: {error}")
            self._complained = True
