"""Inputs that act earlier than they were recorded, and delays that vary over the record.

What acted is the recorded input moved in time, ``u(t - d(t))``, averaged over each sample where it
is held. *Earlier*: ``d`` is negative. No model answers before its input, so that the channels are
not on one clock; the record with its output moved back by whole samples and a delay for the rest is
one that a model can answer. By less than a sample, an input that is taken as held moved before the
sample that shows it: that is what it does between its samples. *Varying*: the response to an input
that is later is a later response, whatever the poles, so that how late each stretch of the record
is can be read off the output of a model with one delay moved in time; the input that comes of this
is fitted, and so on from there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.search.repeated_input import EARLIEST
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt, promise
from tridentify.judgement.causes.attempts.intersample import IN_WORDS, is_staircase
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import LONG_ENOUGH, Rival, one
from tridentify.judgement.causes.timing.delay import FEW_STEPS
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.kept import cached_property
from tridentify.record.record import Record

LATE_LOG = "late-log"
"""Kind of what says so of inputs that are held."""

HALF = 0.5
"""Samples between the shifts that are tried."""

REACH = 10.0
"""Samples to either side of one delay that are looked at; the next round begins from there."""

FINE = 0.25
"""Samples between them."""

KNOTS = (2, 4, 8)
"""Of delays that move along straight lines: a ramp, and what is about as slow as a record."""

EDGES = 8
"""Moves of a held input from which each of them may be late by itself."""

SAMPLES_AN_EDGE = 4
"""Samples between two moves, on the mean, that tell how late each is."""

ROUNDS = 3
"""Fits and delays in turn: the first model has taken the mixture for slow poles."""

ONE_MORE = 2.0
"""Fall of ``-2 log L`` from which the delay of one move is another one (its price in AIC)."""

SWEEPS = 3
"""Times that each knot is moved with the others held."""


def moved_input(record: Record, late: Array) -> Record:
    """A record whose input at every sample acts later by a time of its own.

    Parameters
    ----------
    record : Record
        Of even time.
    late : (n_samples,) array
        [samples]; negative where it acts earlier.
    """
    n = record.n_samples
    at = np.maximum.accumulate(np.arange(n) + late)
    at = at + 1e-9 * np.arange(n)
    if record.behaviour != "zoh":
        columns = [np.interp(np.arange(n), at, own) for own in record.u.T]
        return record._derive(u=np.stack(columns, axis=1))
    ends = np.concatenate([[min(at[0], 0.0) - 1.0], at, [max(at[-1], n) + 1.0]])
    columns = []
    for own in record.u.T:
        held = np.concatenate([own[:1], own])
        area = np.concatenate([[0.0], np.cumsum(held * np.diff(ends))])
        columns.append(np.diff(np.interp(np.arange(n + 1), ends, area)))
    return record._derive(u=np.stack(columns, axis=1))


def early_rivals(present: Present) -> Iterator[Rival]:
    """All inputs earlier than recorded, by the shift that promises most."""
    if any(record.dt is None for record in present.records) or not np.all(present.delay == 0.0):
        return
    plain = replace(present, noise=())
    known: dict[float, float] = {}
    poles: dict[float, Complex] = {}

    def at(shift: float) -> float:
        if shift not in known:
            try:
                part = _earlier(plain, shift)
                end = attempt(
                    part.problem(), [present.poles], present.orders, steps=FEW_STEPS, rounds=0
                )
            except TridentifyError:
                end = None
            known[shift] = np.inf if end is None else end.deviance / end.count
            poles[shift] = present.poles if end is None else end.point.poles
        return known[shift]

    best = min(np.arange(HALF, EARLIEST + HALF, HALF), key=at)
    best = min((best - FINE, best, best + FINE), key=at)
    if not np.isfinite(at(best)):
        return
    whole, rest, dt = int(np.ceil(best)), np.ceil(best) - best, present.step
    advice = (
        f"Check the clock of each channel. If that is it, pair every output with the input {whole} "
        f"sample{'' if whole == 1 else 's'} later (Record(u[{whole}:], y[:-{whole}], ...))"
    )
    advice += f" and state delay={rest * dt:.3g}." if rest else "."
    what = (
        f"outputs that are recorded {best * dt:.3g} s ({best:g} samples) before the input that "
        "moves them (a negative delay; the channels are not on one clock)"
    )
    code, kind, headline = "delay", "", "an output comes before its input"
    if best < 1.0 and all(record.behaviour == "zoh" for record in present.records):
        # what is recorded of the next sample acted before it: the input moved in between
        code, kind, headline = "intersample", "between", "an input moves between its samples"
        what = (
            f"inputs that moved {best * dt:.3g} s ({best:g} samples) before the sample that shows "
            "it, where they are taken as held from there on (a measured input, or channels that "
            "are not on one clock)"
        )
        advice = (
            "Where the input was measured, state what it does between its samples "
            f"(intersample='foh'; --intersample foh). Else: {advice[0].lower()}{advice[1:]}"
        )
    found = one(code, _earlier(present, best), what, advice)
    yield replace(
        found,
        starts=((poles[best], present.poles),),
        exact=True,
        headline=headline,
        kind=kind,
    )


def late_log_rivals(present: Present) -> Iterator[Rival]:
    """All inputs held from one sample earlier on: logged at the end of the interval they acted in.

    A logger that averages writes the mean over the interval that ends; held over that interval it
    moves the system as what was averaged did, but for what is faster than the samples. A command
    that is read back after it acted comes as late.
    """
    if any(record.dt is None for record in present.records) or not np.all(present.delay == 0.0):
        return
    now = present.records[0].behaviour
    held = replace(present, records=tuple(one.between("zoh") for one in present.records))
    what = (
        "inputs that were logged at the end of the interval in which they acted (the mean over it, "
        "or a held value one sample late)"
    )
    if now != "zoh":
        what += f", where they are taken as {IN_WORDS[now]}"
    advice = (
        "Pair every output with the input one sample later, and have that held "
        "(Record(u[1:], y[:-1], ..., intersample='zoh'))."
    )
    found = one("intersample", _earlier(held, 1.0), what, advice)
    yield replace(found, headline="an input is logged after it acted", kind=LATE_LOG)


def _earlier(present: Present, shift: float) -> Present:
    """Outputs paired with the input of some samples later, and a delay for part of a sample."""
    whole = int(np.ceil(shift))
    records = []
    for record in present.records:
        u = np.vstack([record.u[whole:], np.repeat(record.u[-1:], whole, axis=0)])
        y = np.array(record.y)
        y[record.n_samples - whole :] = np.nan
        records.append(record._derive(u=u, y=y))
    late = present.delay + (whole - shift) * present.step
    # a record that began at rest does not begin there once its first inputs are gone
    freed = replace(present.nuisances, initial_state="free")
    return replace(present, records=tuple(records), delay=late, nuisances=freed)


def wandering_rivals(present: Present, late: Sequence[Rival]) -> Iterator[Rival]:
    """Delays of a held input that move along straight lines, and one for each of its moves.

    Parameters
    ----------
    present : Present
    late : sequence of Rival
        One delay more, for all the record.
    """
    if len(present.records) > 1 or present.records[0].dt is None:
        return
    # where every sample moves, what is late by a time of its own follows any other misfit too
    if not is_staircase(present.records):
        return
    (record,) = present.records
    n = record.n_samples
    if n < 2 * LONG_ENOUGH:
        return
    jumps = np.flatnonzero(np.any(np.diff(record.u, axis=0) != 0.0, axis=1)) + 1
    places = [np.linspace(0.0, n - 1.0, k) for k in KNOTS if n > k * LONG_ENOUGH]
    if EDGES <= jumps.size < n / SAMPLES_AN_EDGE:
        places.append(np.concatenate([[0.0], jumps]))
    starts = [_Start(present)]
    for rival in late:
        (part,) = rival.parts
        same = np.ptp(part.delay - present.delay) == 0.0 and part.records is present.records
        starts += [_Start(replace(part, poles=rival.starts[0][0]))] if same else []
    for knots in places:
        own = [_by_pieces(start, knots) for start in starts]
        found = [rival for rival in own if rival is not None]
        if found:
            yield min(found, key=lambda r: promise(r.parts[0], r.starts[0][0]))


@dataclass(frozen=True, eq=False)
class _Start:
    """Where delays of all kinds begin to move: fitted once, compared once over each reach."""

    present: Present

    @cached_property
    def end(self) -> Attempt | None:
        return quickly_fitted(self.present, self.present.poles)

    @cached_property
    def near(self) -> tuple[Array, Array]:
        assert self.end is not None
        return _misfits(self.end, self.present, True)

    @cached_property
    def far(self) -> tuple[Array, Array]:
        assert self.end is not None
        return _misfits(self.end, self.present, False)


def _by_pieces(start: _Start, knots: Array) -> Rival | None:
    present = start.present
    (record,) = present.records
    base = float(present.delay.min())
    held = replace(present, delay=present.delay - base)
    own, steps = np.zeros(knots.size), base / present.step
    part, end, by_edge = present, start.end, knots.size > max(KNOTS)
    for k in range(ROUNDS):
        if end is None:
            return None
        if k == 0:
            cost, tried = start.near if by_edge else start.far
        else:
            cost, tried = _misfits(end, part, by_edge)
        if by_edge:
            more = _edge_delays(cost, tried, knots + own + steps)
        else:
            more = _knots(cost, tried, knots)
        own = np.maximum(own + more, -steps)
        moved = moved_input(record, _at(own, knots, record) + steps)
        y = np.array(record.y)
        # what acted there was not recorded: one delay leaves these samples out too
        y[: int(np.ceil(steps + own.max()))] = np.nan
        part = replace(held, records=(moved._derive(y=y),))
        end = quickly_fitted(part, end.point.poles)
    if end is None or not np.ptp(own) > 0.0:
        return None
    thirds = np.array_split(_at(own, knots, record) + steps, 3)
    means = ", ".join(f"{part.mean() * present.step:.3g}" for part in thirds)
    low, high = (round(float(f(own + steps)), 9) * present.step for f in (np.min, np.max))
    what = (
        f"a delay that varies between {low:.3g} and {high:.3g} s (on the mean {means} s in the "
        "thirds of the record)"
    )
    if by_edge:
        what = f"a delay of each move of the input of its own, that varies{what[19:]}"
    found = one(
        "varying",
        part,
        what,
        "Record when the input acted (the time stamp of the receiver, the position of the "
        "actuator) and use that as the input; no order and no single delay stands for it, and the "
        "standard errors do not allow for it.",
        refits=False,
    )
    price = 2.0 * (knots.size + float(np.log(record.n_samples)))
    return replace(
        found,
        starts=((end.point.poles,),),
        price=price,
        exact=True,
        headline="a delay is not the same throughout",
    )


def quickly_fitted(part: Present, poles: Complex) -> Attempt | None:
    """Where a few steps from some poles end under the noise model that is held."""
    try:
        problem = part.problem()
        return attempt(problem, [poles], part.orders, steps=FEW_STEPS, rounds=0)
    except TridentifyError:
        return None


def _at(own: Array, knots: Array, record: Record) -> Array:
    """Delay at every sample: along lines, or held from move to move."""
    place = np.arange(record.n_samples)
    if knots.size <= max(KNOTS):
        return np.interp(place, knots, own)
    return np.asarray(own[np.searchsorted(knots, place, side="right") - 1])


def _misfits(end: Attempt, part: Present, by_edge: bool) -> tuple[Array, Array]:
    """(n, k) squares of what the outputs leave, moved by each of k times, over their variance."""
    (record,) = part.records
    noise = end.point.problem.noise
    reach = REACH / 2.0 if by_edge else REACH
    tried = np.arange(-reach, reach + FINE / 2, FINE)
    place = np.arange(record.n_samples)
    total = np.zeros((place.size, tried.size))
    for i, f in enumerate(end.point.outputs()[0].T):
        y, a = record.y[:, i], noise[i] if noise else np.zeros(0)
        f = np.nan_to_num(f, nan=float(np.nanmean(f)))
        left = [y - np.interp(place - by, place, f) for by in tried]
        if a.size:
            left = [whiten(np.ascontiguousarray(one), a)[0] for one in left]
        squares = np.nan_to_num(np.stack(left, axis=1) ** 2)
        total += squares / max(float(squares.mean(axis=0).min()), np.finfo(float).tiny)
    return total, tried


def _edge_delays(cost: Array, tried: Array, begins: Array) -> Array:
    """The time of least cost of each stretch, none where all cost about the same."""
    n = cost.shape[0]
    edges = np.append(np.clip(np.maximum.accumulate(np.rint(begins)), 0, n), n).astype(int)
    whole = np.vstack([np.zeros(tried.size), np.cumsum(cost, axis=0)])
    sums = whole[edges[1:]] - whole[edges[:-1]]
    sums[:, int(np.argmin(np.abs(tried)))] -= ONE_MORE
    return np.asarray(tried[np.argmin(sums, axis=1)])


def _knots(cost: Array, tried: Array, knots: Array) -> Array:
    """Times at the knots that cost least, each in turn."""
    place, own = np.arange(cost.shape[0]), np.zeros(knots.size)
    flat, rows = np.ravel(cost), tried.size * place
    piece = np.minimum(np.searchsorted(knots, place, side="right"), knots.size - 1) - 1
    since, lengths = place - knots[piece], np.diff(knots)

    def sums(several: Array) -> Array:
        """Of the delays at the knots, a row each."""
        slopes = np.diff(several, axis=1) / lengths
        along = slopes[:, piece] * since + several[:, piece]
        at = np.rint((along - tried[0]) / FINE).astype(int)
        return np.asarray(flat[rows + np.clip(at, 0, tried.size - 1)].sum(axis=1))

    wide = tried[:: max(tried.size // 20, 1)]
    for sweep in range(SWEEPS):
        near = wide if sweep == 0 else np.arange(-4, 5) * FINE
        for k in range(knots.size):
            about = 0.0 if sweep == 0 else own[k]
            every = np.unique(np.append(np.clip(about + near, tried[0], tried[-1]), own[k]))
            several = np.repeat(own[None], every.size, axis=0)
            several[:, k] = every
            own[k] = every[np.argmin(sums(several))]
    return own
