"""Other explanations of a record, each the present one with one thing changed.

*Nonlinear.* A static non-linearity ``f`` of the actuator, ``u + k f(u)``, and a restoring force
``a(p) y + k f(y) = b(p) u`` are both one more input, ``f(u)`` or ``-f(y)``, of the same
denominator; ``y`` is the fitted output, which carries no noise. Even powers make what is not
symmetric, odd ones what stiffens or saturates, ``sign(dy/dt)`` is dry friction and ``|dy/dt|
dy/dt`` the damping of ships, dampers and valves, which grows where friction weighs less. ``u y`` is
an input whose gain changes with the output (Billings, *Nonlinear System Identification*, 2013,
chapter 2, for the classes).

*Varying.* Both halves of the record with coefficients of their own, the second from an initial
state of its own; *disagreeing experiments* likewise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.judgement.causes.attempts.attempt import Attempt
from tridentify.judgement.causes.attempts.direct_part import has_direct_part
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.told_apart import laws
from tridentify.judgement.causes.signals.inner_states import (
    against,
    gripping,
    inner_states,
    on_the_way,
    turns,
)
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import sort_poles
from tridentify.record.record import Record

MOST_POLES = 20
"""As many as `identify` takes."""

RATES = 6
"""Places over the band of the record at which another pole may begin."""

SHORTER = (0.0, 0.25, 0.5, 0.75)
"""Shares of an estimated delay beside which another pole is tried."""

LONG_ENOUGH = 40
"""Samples of a half record below which it is not fitted by itself."""


AFFINE = 1e-3
"""Share of a power that a straight line may leave for it to be no bend: a converter's steps, or
noise of a measured input of two levels."""


ALONG = "Estimate a drift along (drift=True; --drift yes)."
"""What to do where a line explains a drift."""

DISAGREEING = "disagreeing-experiments"
"""Code of what says that experiments differ."""

STICKS = 0.05
"""Share of the usual speed below which dry friction holds what moves, and does not brake it."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Between what one output stays.

    Attributes
    ----------
    output : int
    low, high : float
        Infinite where there is no limit.
    records : tuple of Record
        With the samples beyond, that a rival is fitted without.
    """

    output: int
    low: float
    high: float
    records: tuple[Record, ...]

    @property
    def count(self) -> int:
        """Levels."""
        return int(np.isfinite(self.low)) + int(np.isfinite(self.high))


@dataclass(frozen=True, eq=False)
class Rival:
    """One explanation that may be tried.

    Attributes
    ----------
    code : str
        Of the finding that names it (`finding.CODES`).
    parts : tuple of Present
        One, or several with coefficients of their own.
    starts : tuple of tuples of complex arrays
        Where the poles of each part may begin.
    what : str
        What it says is the case, in words that follow "the residual is explained by".
    advice : str
        What to do about it.
    refits : bool
        Whether the advice is to identify with what was changed here, so that its coefficients are
        those that the advice leads to.
    price : float
        What choosing it among many costs beside its unknowns, in ``-2 log L``.
    times : tuple of float
        Instants that it names [s].
    changes : int
        Remedies that it takes together.
    calms : bool
        Whether it takes away small moves of an input, in which feedback shows: it does not compete
        with that.
    exact : bool
        Whether it says one thing of the recording that little else can stand for: it is the cause
        where it explains most, and none where anything else explains as much.
    behind : callable or None
        From where a fit to other samples ended to how it compares on those that were recorded.
    headline : str
        What it is called, where it is not what its code says.
    kind : str
        That of its finding.
    experiment : int or None
        The one that it names of several.
    spoils : bool
        Whether the numbers are wrong with it, where its code does not say so.
    of_motion : bool
        Whether it is a function of a motion of the system: friction, damping, a stiffness.
    as_lags : bool
        Whether a linear lag may stand for it in these records, however exact it is.
    """

    code: str
    parts: tuple[Present, ...]
    starts: tuple[tuple[Complex, ...], ...]
    what: str
    advice: str
    refits: bool = True
    price: float = 0.0
    times: tuple[float, ...] = ()
    changes: int = 1
    calms: bool = False
    exact: bool = False
    behind: Callable[[Attempt], Attempt] | None = None
    headline: str = ""
    kind: str = ""
    experiment: int | None = None
    spoils: bool = False
    of_motion: bool = False
    as_lags: bool = False


def one(code: str, present: Present, what: str, advice: str, *, refits: bool = True) -> Rival:
    """A rival of one part that begins at the present poles."""
    return Rival(code, (present,), ((present.poles,),), what, advice, refits)


def nonlinear_rivals(present: Present, fitted: Sequence[Array]) -> Iterator[Rival]:
    """Even and odd powers of inputs and outputs, dry friction, and damping by the square of speeds.

    Parameters
    ----------
    present : Present
    fitted : sequence of (n_samples, n_outputs) arrays
        Outputs of the present model.
    """
    if not isinstance(present.order, int):
        return
    records = present.records
    advice = (
        "Use smaller amplitudes, or identify each operating point on its own; no order of a linear "
        "model stands for it."
    )
    larger = (
        "Use larger amplitudes, where play and dry friction weigh less, and away from standstill; "
        "no order of a linear model stands for them."
    )
    smaller = (
        "Use smaller amplitudes, at which the damping is that of small moves: it grows with "
        "larger ones, and no order of a linear model stands for it."
    )
    for j, name in enumerate(records[0].input_names):
        m = max(row[j] for row in present.zeros)
        for power, which in ((2, "even"), (3, "odd")):
            extra = _bent([record.u[:, j] for record in records], power)
            if extra is None:
                continue
            what = f"an {which} non-linearity of the input {name}"
            other = present.with_inputs(extra, "non-linear", m)
            yield one("nonlinear", other, what, advice, refits=False)
        for i, output in enumerate(records[0].output_names):
            what = f"a gain of the input {name} that changes with the output {output}"
            other = present.with_inputs(_scheduled(records, fitted, i, j), "non-linear", m)
            yield one("nonlinear", other, what, advice, refits=False)
    for i, name in enumerate(records[0].output_names):
        for power, which in ((2, "even"), (3, "odd")):
            extra = _bent([_filled(f[:, i]) for f in fitted], power)
            if extra is None:
                continue
            what = f"an {which} non-linearity in the output {name} (a stiffness, a level)"
            other = present.with_inputs(on_the_way(extra, records), "non-linear", 0)
            yield _of_motion(other, what, advice)
        slopes = [_smooth_slope(f[:, i]) for f in fitted]
        what = f"dry friction against the movement of {name}"
        yield _friction(_rubbing(present, slopes), what, larger)
        what = f"damping that grows with the speed of {name}, as its square (drag, a valve)"
        yield _of_motion(_dragging(present, slopes, 1), what, smaller)
        speeds = [_filled(f[:, i]) for f in fitted]
        if turns(np.concatenate(speeds)):
            what = f"dry friction against {name} itself, as of a speed"
            yield _friction(_rubbing(present, speeds), what, larger)
            what = f"damping that grows with {name} itself, as of a speed, as its square (drag)"
            if present.order > 1:
                what = (
                    f"an odd non-linearity in the output {name}, as its square (a stiffness or, "
                    "where it is a speed, drag)"
                )
            # as free as a stiffness, which it would pass for
            yield _of_motion(_dragging(present, speeds, 0), what, smaller)
    den = np.asarray(np.poly(present.poles).real)
    for j, name in enumerate(records[0].input_names):
        for state in inner_states(den, float(present.delay[0, j]), records, j):
            what = (
                f"what takes hold within the system, between {name} and the outputs (play or "
                "friction between its parts)"
            )
            held = on_the_way(gripping(state), records)
            other = present.with_inputs(held, "non-linear", present.order - 1)
            yield _friction(other, what, larger)


def _friction(present: Present, what: str, advice: str) -> Rival:
    return replace(_of_motion(present, what, advice), kind="friction")


def _of_motion(present: Present, what: str, advice: str) -> Rival:
    return replace(one("nonlinear", present, what, advice, refits=False), of_motion=True)


def _rubbing(present: Present, speeds: Sequence[Array]) -> Present:
    assert isinstance(present.order, int)
    pairs = zip(speeds, present.records, strict=True)
    extra = [against(one, STICKS, held=record.behaviour == "zoh") for one, record in pairs]
    return present.with_inputs(extra, "friction", min(1, present.order - 1))


def _dragging(present: Present, speeds: Sequence[Array], zeros: int) -> Present:
    assert isinstance(present.order, int)
    extra = [np.asarray(np.abs(one) * one) for one in speeds]
    return present.with_inputs(
        on_the_way(extra, present.records), "drag", min(zeros, present.order - 1)
    )


def _bent(signals: Sequence[Array], power: int) -> list[Array] | None:
    """What a power of a signal has beside a straight line; None where it has nothing.

    The line is what the model has already, and its constant an offset, which is another cause. Of
    an input of two levels nothing is left.
    """
    whole = np.concatenate(signals)
    size = float(np.ptp(whole))
    if not size > 0.0:
        return None
    whole = (whole - whole.mean()) / size
    line = np.column_stack([np.ones(whole.size), whole])
    bent = whole**power
    left = bent - line @ np.linalg.lstsq(line, bent)[0]
    if float(left @ left) < AFFINE**2 * float(bent @ bent):
        return None
    pieces = np.split(size**power * left, np.cumsum([one.size for one in signals])[:-1])
    # a start from rest is one without a bend, too: no constant begins to act there
    return [np.asarray(one - one[0]) for one in pieces]


def _scheduled(records: Sequence[Record], fitted: Sequence[Array], i: int, j: int) -> list[Array]:
    """An input times an output, both about their means."""
    u = [np.asarray(record.u[:, j]) for record in records]
    y = [_filled(one[:, i]) for one in fitted]
    middle, level = float(np.concatenate(u).mean()), float(np.concatenate(y).mean())
    products = [(a - middle) * (b - level) for a, b in zip(u, y, strict=True)]
    return [np.asarray(one - one[0]) for one in products]


def _filled(values: Array) -> Array:
    return np.nan_to_num(values, nan=float(np.nanmean(values)))


def _smooth_slope(values: Array) -> Array:
    return np.asarray(np.gradient(_filled(values)))


def drift_rivals(present: Present) -> Iterator[Rival]:
    """A straight line, and an offset where there is none."""
    terms = present.nuisances
    if not terms.offset:
        other = replace(present, nuisances=replace(terms, offset=True))
        yield one("drift", other, "an offset", "Estimate an offset (offset=True; --offset yes).")
    if not terms.drift:
        other = replace(present, nuisances=replace(terms, offset=True, drift=True))
        yield one("drift", other, "a drift of the output", ALONG)


def varying_rivals(present: Present) -> Iterator[Rival]:
    """Coefficients of their own in both halves, and in every experiment."""
    records = present.records
    if len(records) > 1:
        parts = tuple(replace(present, records=(record,)) for record in records)
        yield Rival(
            DISAGREEING,
            parts,
            ((present.poles,),) * len(parts),
            "coefficients that differ between the experiments",
            "Identify the experiments on their own and compare them; join only those of one system "
            "at one operating point.",
            refits=False,
        )
        return
    (record,) = records
    middle = record.n_samples // 2
    if middle < LONG_ENOUGH:
        return
    first, second = record.split(float(record.t[middle]))
    freed = replace(present.nuisances, initial_state="free")
    parts = (
        replace(present, records=(first,)),
        replace(present, records=(second,), nuisances=freed),
    )
    yield Rival(
        "varying",
        parts,
        ((present.poles,),) * 2,
        "coefficients that differ between the first and the second half",
        "Identify the parts on their own, or follow the coefficients with "
        "online.ThreeModel(forgetting=...).",
        refits=False,
    )


def order_rivals(present: Present) -> Iterator[Rival]:
    """One or two poles more, or another zero, and where their new poles may begin.

    As many zeros as poles too, where an output follows an input at once. Not where outputs alone
    tell an input: with a direct part that is the controller, backwards, which leaves nothing.
    """
    if not isinstance(present.order, int):
        return
    n, zeros = present.order, np.array(present.zeros)
    slow = 2.0 / max(record.duration for record in present.records)
    rates = np.geomspace(slow, 1.0 / present.step, RATES)
    real = tuple(sort_poles(np.append(present.poles, -w)) for w in rates)
    pairs = tuple(
        sort_poles(np.append(present.poles, [w * (-0.1 + 0.995j), w * (-0.1 - 0.995j)]))
        for w in rates
    )
    wanted: list[tuple[int, Array, tuple[Complex, ...]]] = []
    if np.all(zeros < n):
        wanted.append((n, zeros + 1, (present.poles,)))
    wanted += [(n + 1, zeros, real), (n + 1, zeros + 1, real), (n + 2, zeros + 2, pairs)]
    if np.any(zeros < n - 1) and has_direct_part(present.records):
        full = np.ones_like(zeros)
        wanted += [(n, n * full, (present.poles,)), (n + 1, (n + 1) * full, real)]
        wanted += [(n + 2, (n + 2) * full, pairs)]
    held = present.records[0].dt is not None and any(
        law.lags is not None for law in laws(present.records)
    )
    for order, m, starts in wanted:
        if order > MOST_POLES or (held and np.any(m >= order)):
            continue
        yield _of_order(present, order, m, starts)


def lag_rivals(present: Present) -> Iterator[Rival]:
    """Another pole beside a shorter delay, where the delay was estimated.

    A lag that is missing makes an estimated delay longer, and another pole beside that delay then
    explains little.
    """
    if not isinstance(present.order, int) or not np.any(present.delay > 0.0):
        return
    slow = 2.0 / max(record.duration for record in present.records)
    rates = np.geomspace(slow, 1.0 / present.step, RATES)
    n, zeros = present.order, np.array(present.zeros)
    starts = tuple(sort_poles(np.append(present.poles, -w)) for w in rates)
    for share in SHORTER if n < MOST_POLES else ():
        part = replace(present, delay=share * present.delay)
        for m in (zeros, zeros + 1):
            rival = _of_order(part, n + 1, m, starts)
            yield replace(
                rival,
                what=f"{rival.what} beside a shorter delay",
                advice=rival.advice.replace(", or", " (the delay estimated again), or", 1),
                price=2.0 * float(np.log(len(SHORTER))),
            )


def _of_order(present: Present, order: int, zeros: Array, starts: tuple[Complex, ...]) -> Rival:
    """Other numbers of poles and zeros."""
    most = int(zeros.max())
    several = "" if len(np.unique(zeros)) == 1 else "up to "
    changed = tuple(tuple(int(k) for k in row) for row in zeros)
    return Rival(
        "order-low",
        (replace(present, order=order, zeros=changed),),
        (starts,),
        f"{order} poles and {several}{most} zero{'' if most == 1 else 's'}",
        f"Use poles={order} and zeros={most}, or compare several orders "
        "(select_structure; tridentify select).",
    )
