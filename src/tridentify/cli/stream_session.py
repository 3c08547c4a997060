"""A stream in progress: rows in, the estimator's state onward, a line at every tick of data time.

Rows are fed in blocks that end where a line is due, so that no line depends on how the bytes came.
Whatever is between two rows (position, counts, time) moves on together with the state; stopping
between any two of them leaves a whole that can be resumed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tridentify.cli.load import COMPARE
from tridentify.cli.stream_question import StreamPlace, StreamQuestion
from tridentify.cli.stream_show import Remarks, line_of
from tridentify.errors import EmptyFileError, TooFewSamplesError
from tridentify.numerics.arrays import Array
from tridentify.record.checks.values import check_keys, finite_number, whole_number
from tridentify.record.formats.streams.lines import WholeLines
from tridentify.record.formats.streams.read_rows import Rows
from tridentify.record.formats.streams.rows import RowReader
from tridentify.record.formats.streams.timeline import OPENING, Timeline, nominal_step

if TYPE_CHECKING:
    from tridentify.estimation.answer.estimate import Estimate
    from tridentify.online import NotReadyError, State

Ints = NDArray[np.int64]

BLOCK = 8192
"""Most samples between two looks at whether to stop."""
ROUNDING = 1e-9
"""Of a time over the interval between two lines."""
LONGEST_GAP = 10_000
"""Most missing samples that stand in for a gap."""
MOST_HELD = 1000
"""Remarks on lines that may wait, until the first samples have told the step."""
MOSTLY = 8
"""One in so many samples off the raster makes it not worth while to feed the others in blocks."""


@dataclass(frozen=True)
class _Block:
    """Samples that go forward in time."""

    u: Array
    y: Array
    interval: Array
    elapsed: Array
    time: Array
    lines: Ints
    stops: Ints
    real: NDArray[np.bool_]


@dataclass
class Session:
    """A stream in progress.

    Parameters
    ----------
    question : StreamQuestion
    emit : callable
        Takes each line as a mapping.
    tell : callable
        Takes remarks.
    stopped : callable
        Whether to stop.

    Attributes
    ----------
    repeats : bool
        Whether the last line that was made tells of the same samples as the one before.
    """

    question: StreamQuestion
    emit: Callable[[dict[str, Any]], None]
    tell: Callable[[str], None]
    stopped: Callable[[], bool] = lambda: False
    state: State | None = None
    timeline: Timeline | None = None
    place: StreamPlace = field(default_factory=StreamPlace)
    refused: NotReadyError | None = None

    def __post_init__(self) -> None:
        self.reader = RowReader(self.question.asked)
        self.remarks, self.notes = Remarks(self.tell), Remarks(self.tell)
        self._waiting: list[Rows] = []
        self._flags = 0
        self._problems: list[tuple[int, str, bool]] = []
        self._opening: tuple[Timeline, Array, Ints] | None = None
        self._told = (0, 0)
        self.repeats = False

    # -------------------------------------------------------------------------- saved and resumed
    def counts(self) -> dict[str, Any]:
        """Give what a checkpoint keeps of the place, as plain values."""
        kept = asdict(self.place) | {"flags": self._flags}
        del kept["position"]  # it is that of the mark
        return kept

    def timeline_here(self) -> dict[str, Any]:
        """Give the timeline as it was at the place, as plain values."""
        assert self.timeline is not None
        if self._opening is None:
            return self.timeline.to_dict()
        # that of the session has gone on to the end of the block
        begun, stamps, lines = self._opening
        here = replace(begun)
        here.intervals(stamps[: int(np.searchsorted(lines, self.place.line, side="right"))])
        return here.to_dict()

    def go_on_from(
        self,
        state: State,
        reader: Mapping[str, Any],
        timeline: Mapping[str, Any],
        counts: Mapping[str, Any],
        position: int,
    ) -> None:
        """Take up what a checkpoint kept.

        Raises
        ------
        AttributeError, LookupError, TypeError, ValueError, OverflowError
            No session of this question can have kept that.
        """
        from tridentify import online

        self._check_state(state)
        self.state = state
        self.timeline = Timeline.from_dict(timeline)
        if (self.timeline.dt, self.timeline.whole) != (state.dt, self._with_delays):
            raise ValueError("a timeline of another step")
        check_keys(counts, self.counts())
        every = online.Flag(0)
        for flag in online.Flag:
            every |= flag
        self._flags = whole_number(counts["flags"], every.value)
        line = whole_number(counts["line"])
        self.place = StreamPlace(
            position,
            line,
            whole_number(counts["malformed"], line),
            finite_number(counts["time"]),
            finite_number(counts["elapsed"], 0.0),
            whole_number(counts["emitted"]),
            None if counts["dropped"] is None else whole_number(counts["dropped"]),
        )
        self.reader.go_on_from({**reader, "lines": self.place.line})

    def _check_state(self, state: State) -> None:
        """Whether a state is one of this question."""
        question, asked = self.question, self.question.asked
        found = state.method.to_dict(), state.structure.to_dict()
        told = question.method.to_dict(), question.structure.to_dict()
        names = state.input_names, state.output_names, state.stage.setting.intersample
        same = found == told and names == (asked.inputs, asked.outputs, question.intersample)
        if not same or question.dt not in (None, state.dt):
            raise ValueError("a state of another question")

    @property
    def _with_delays(self) -> bool:
        asked = self.question.asked
        delays = self.question.structure.delay_matrix(len(asked.outputs), len(asked.inputs))
        return bool(np.any(delays))

    # ------------------------------------------------------------------------------------- onward
    def begin_at(self, position: int) -> None:
        """Note that another file, or part of it, follows."""
        self.place.position = position

    def take(self, lines: WholeLines) -> None:
        """Take in whole lines, unless stopped."""
        rows = self.reader.read(lines)
        if self.state is None:
            self._wait(rows)
        else:
            self._problems += [(problem.line, problem.text, True) for problem in rows.problems]
            self._advance(rows)
        if self.state is None:
            self._pass_waiting()
            self.place.position = lines.stop
        elif not self.stopped():
            self._pass(self.reader.lines)
            self.place.position = lines.stop

    def _wait(self, rows: Rows) -> None:
        """Keep the first rows until they tell the step."""
        self._problems += [(problem.line, problem.text, True) for problem in rows.problems]
        if len(rows.lines):
            self._waiting.append(rows)
        known = self.question.dt is not None
        if sum(len(kept.lines) for kept in self._waiting) >= (1 if known else OPENING):
            self.end_waiting()

    def _pass_waiting(self) -> None:
        """Say what is wrong with the lines before the first one that waits.

        What is wrong with later ones counts from their place on, as if all had come at once.
        """
        first = int(self._waiting[0].lines[0]) if self._waiting else self.reader.lines + 1
        held = len(self._problems) <= MOST_HELD
        self._pass(first - 1 if held else self.reader.lines)

    def end_waiting(self) -> None:
        """Begin with the rows that are there.

        Raises
        ------
        TooFewSamplesError
            They do not tell the step.
        """
        if self.state is not None:
            return
        if not self._waiting:
            self._pass(self.reader.lines)
            return
        rows = Rows(
            np.concatenate([kept.values for kept in self._waiting]),
            np.concatenate([kept.lines for kept in self._waiting]),
            np.concatenate([kept.stops for kept in self._waiting]),
            [],
        )
        self._waiting = []
        asked, question = self.question.asked, self.question
        step = question.dt if question.dt is not None else nominal_step(rows.values[:OPENING, 0])
        if step is None:
            raise TooFewSamplesError(
                f"found {min(len(rows.lines), OPENING)} sample of {asked.name} and no step between "
                "times; expected at least 2 to know the step; state it with --dt SECONDS, or "
                "record longer"
            )
        self.timeline = Timeline(step, whole=self._with_delays)
        self.state = question.method.init(
            question.structure,
            step,
            input_names=asked.inputs,
            output_names=asked.outputs,
            units=self.reader.units,
            intersample=question.intersample,
        )
        self._advance(rows)
        if not self.stopped():
            self._pass(self.reader.lines)

    def _advance(self, rows: Rows) -> None:
        """Feed rows, and emit the lines that are due."""
        block = self._block(rows)
        ticks = self._ticks(block.elapsed)
        before = np.concatenate([self._ticks(np.array([self.place.elapsed])), ticks[:-1]])
        due = np.flatnonzero(ticks > before) + 1
        ends = np.unique(np.concatenate([due, np.arange(BLOCK, len(ticks), BLOCK), [len(ticks)]]))
        begin = 0
        for end in ends.tolist():
            if end > begin:
                self._feed(block, begin, end)
                self._pass(int(block.lines[end - 1]))
                self.place.position = int(block.stops[end - 1])
                self.place.time = float(block.time[end - 1])
                self.place.elapsed = float(block.elapsed[end - 1])
                if ticks[end - 1] > before[end - 1]:
                    self.emit(self.line())
            begin = end
            if self.stopped() and block.real[min(end, len(ticks)) - 1]:
                return

    def _ticks(self, elapsed: Array) -> Array:
        ticks: Array = np.floor(elapsed / self.question.every + ROUNDING)
        return ticks

    def _block(self, rows: Rows) -> _Block:
        """Put rows in time."""
        assert self.state is not None
        assert self.timeline is not None
        asked, values = self.question.asked, rows.values
        n_inputs, first = len(asked.inputs), 0 if asked.uniform else 1
        u, y = values[:, first : first + n_inputs], values[:, first + n_inputs :]
        keep = np.ones(len(u), dtype=np.bool_)
        if self.state.n_samples == 0:
            # nothing to hold before the first input
            whole = np.isfinite(u).all(axis=1)
            keep[: int(np.argmax(whole)) if whole.any() else len(u)] = False
        if asked.uniform:
            n = self.state.n_samples
            elapsed = np.arange(n, n + int(keep.sum()), dtype=np.float64) * self.timeline.dt
            time, interval = elapsed, np.full(len(elapsed), self.timeline.dt)
        else:
            time = values[keep, 0]
            numbers = rows.lines[keep]
            self._opening = (replace(self.timeline), time, numbers)
            interval, elapsed, remarks = self.timeline.intervals(time)
            refused = np.isnan(interval)
            self._problems += [(int(numbers[k]), t, bool(refused[k])) for k, t in remarks.items()]
            self._problems.sort(key=lambda item: item[0])
            if refused.any():
                forward = ~refused
                keep[keep] = forward
                time, interval, elapsed = time[forward], interval[forward], elapsed[forward]
        block = _Block(
            np.ascontiguousarray(u[keep]),
            self._without(np.array(y[keep], order="C")),
            interval,
            elapsed,
            time,
            rows.lines[keep],
            rows.stops[keep],
            np.ones(len(time), dtype=np.bool_),
        )
        return self._filled(block) if self.timeline.whole else block

    def _filled(self, block: _Block) -> _Block:
        """Put missing samples into gaps of several steps, at the place of the row before."""
        assert self.timeline is not None
        steps = np.minimum(np.round(block.interval / self.timeline.dt), LONGEST_GAP + 1.0)
        missing = steps.astype(np.int64) - 1
        if not missing.any():
            return block
        row = np.repeat(np.arange(len(missing)), missing + 1)
        real = np.diff(row, append=len(missing)) > 0
        u, y = block.u[row], block.y[row]
        u[~real], y[~real] = np.nan, np.nan
        # of the row before, so that nothing falls due and nothing is passed before the row itself
        place = row - ~real
        here, before = self.place, place < 0
        return _Block(
            u,
            y,
            np.full(len(row), self.timeline.dt),
            np.where(before, here.elapsed, block.elapsed[place]),
            np.where(before, here.time, block.time[place]),
            np.where(before, here.line, block.lines[place]),
            np.where(before, here.position, block.stops[place]),
            real,
        )

    def _without(self, y: Array) -> Array:
        for rule in self.question.rules:
            column = self.question.asked.outputs.index(rule.channel)
            y[COMPARE[rule.sign](y[:, column], rule.limit), column] = np.nan
        return y

    def _feed(self, block: _Block, begin: int, end: int) -> None:
        assert self.timeline is not None
        odd = np.flatnonzero(block.interval[begin:end] != self.timeline.dt)
        if len(odd) * MOSTLY > end - begin:
            self._feed_piece(block, begin, end, uniform=False)
            return
        for place in (odd + begin).tolist():
            self._feed_piece(block, begin, place, uniform=True)
            self._feed_piece(block, place, place + 1, uniform=False)
            begin = place + 1
        self._feed_piece(block, begin, end, uniform=True)

    def _feed_piece(self, block: _Block, begin: int, end: int, *, uniform: bool) -> None:
        if end <= begin:
            return
        assert self.state is not None
        self.state, _, flags = self.question.method.feed(
            self.state,
            block.u[begin:end],
            block.y[begin:end],
            None if uniform else block.interval[begin:end],
        )
        self._flags |= int(np.bitwise_or.reduce(flags))

    def _pass(self, line: int) -> None:
        """Say what is wrong with the lines up to this one."""
        self.place.line = line
        done = 0
        for number, text, refused in self._problems:
            if number > line:
                break
            done += 1
            self.place.malformed += refused
            if refused:
                self.remarks.remark(f"line {number:,}: {text}; {self._fate}")
            else:
                # not to be lost among those that it follows
                self.notes.remark(f"line {number:,}: {text}")
        del self._problems[:done]

    @property
    def _fate(self) -> str:
        return "taken as a missing sample" if self.question.asked.uniform else "skipped"

    # ------------------------------------------------------------------------------------ results
    def line(self, *, final: bool = False) -> dict[str, Any]:
        """Describe where the estimation is; what was flagged begins anew.

        Raises
        ------
        EmptyFileError
            There was no sample.
        """
        from tridentify import online

        if self.state is None or self.state.n_samples == 0:
            bad = f" ({self.place.malformed:,} malformed)" if self.place.malformed else ""
            raise EmptyFileError(
                f"found no sample in {self.reader.lines:,} lines{bad} of "
                f"{self.question.asked.name}; expected lines of CSV or JSON; check the source"
            )
        estimate: Estimate | None = None
        self.refused = None
        try:
            estimate = self.question.method.estimate(self.state)
        except online.NotReadyError as error:
            self.refused = error
        # whether it is ready is a matter of now, and of whether this line has an answer
        flags = (online.Flag(self._flags) | self.state.flags) & ~online.Flag.NOT_READY
        if estimate is None:
            flags |= online.Flag.NOT_READY
        self._flags = 0
        at = replace(self.place)
        here = (self.place.line, self.state.n_samples)
        self.repeats, self._told = here == self._told, here
        # whoever goes on puts a line of this number in the place of the last one
        self.place.emitted += not final
        return line_of(self.state, estimate, str(self.refused or ""), flags, at, final)
