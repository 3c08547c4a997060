"""Inputs that were recorded slower than the outputs, each value repeated until the next one.

Such an input moves at every ``k``-th sample only. So does a command that was set so on purpose,
which is the usual case, and only the response tells the two apart. *Smooth*: what was recorded
lies on the input at these instants, and lines from one to the next follow it better than the steps
do. *Held*: it moved at any time since the last recording, so that the response begins up to ``k``
samples before the recorded move, at a time of its own for each. How much earlier each move acted is
read off what the output leaves against the response to a move that comes a little earlier, and so
on from there; neither one shift, nor clocks that run apart, are spread like that.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tridentify.judgement.causes.attempts.intersample import CLEARLY
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import LONG_ENOUGH, Rival, one
from tridentify.judgement.causes.timing.moves import moved_earlier, moves_of, repeats, times_told
from tridentify.judgement.causes.timing.shifts import quickly_fitted
from tridentify.numerics.arrays import Array, Indices

SLOWEST = 10
"""Samples a value is repeated for, at most: of less the outputs tell little more than the input."""

NEARLY_ALL = 0.8
"""Share of the instants at which a smooth input moves."""

SPREAD = 0.15
"""Standard deviation of how much earlier the moves acted, over ``k``: 0.29 where evenly spread."""

HEADLINE = "an input was recorded slower than the outputs"
BETWEEN = "an input moves between the samples"

ROUNDS = 5
"""Fits and times in turn: the times of each round stand beside the coefficients."""


def slow_input_rivals(present: Present) -> Iterator[Rival]:
    """Inputs that move at every k-th sample, joined by lines or moved each by its own time.

    Parameters
    ----------
    present : Present
    """
    if len(present.records) > 1 or present.records[0].dt is None:
        return
    (record,) = present.records
    jumps = np.flatnonzero(np.any(np.diff(record.u, axis=0) != 0.0, axis=1)) + 1
    every = repeats(jumps) or 1
    if every > SLOWEST or record.n_samples < 2 * LONG_ENOUGH:
        return
    if every == 1 and not moves_of(record).size:
        return
    if every > 1 and jumps.size > NEARLY_ALL * record.n_samples / every:
        yield from _joined(present, every, int(jumps[0]) % every)
    elif isinstance(present.order, int) and present.order == present.poles.size:
        found = _earlier_each(present, every, jumps)
        if found is not None:
            yield found


def _said(present: Present, every: int) -> str:
    names = " and ".join(present.records[0].input_names)
    return f"{names} recorded at every {_th(every)} sample and repeated until the next"


def _th(number: int) -> str:
    return {2: "2nd", 3: "3rd"}.get(number, f"{number}th")


def _joined(present: Present, every: int, first: int) -> Iterator[Rival]:
    """By lines, and by a smooth curve where lines cut the corners of what is nearly as fast."""
    from scipy.interpolate import CubicSpline

    (record,) = present.records
    n, dt = record.n_samples, float(record.dt or 0.0)
    places, time = np.arange(first, n, every), np.arange(n)
    lines = np.stack([np.interp(time, places, u[places]) for u in record.u.T], axis=1)
    curve = CubicSpline(places, record.u[places])(time)
    begin, own = (f"{first}:", f"y[{first}:]") if first else (":", "y")
    rates = f"(u[{begin}:{every}], {own}, u_dt={every * dt:.6g}, y_dt={dt:.6g}, intersample='foh')"
    of_lines = f"Keep every {_th(every)} value and join them by lines (Record.from_rates{rates})"
    of_curve = (
        f"Keep every {_th(every)} value and join them by a smooth curve (u = scipy.interpolate."
        f"CubicSpline(t[{begin}:{every}], u[{begin}:{every}])(t), intersample='foh')"
    )
    # neither the beginning of the first piece nor the end of the last one was recorded
    y = np.array(record.y)
    y[places[-1] + 1 :] = np.nan
    y[:first] = np.nan
    freed = replace(present.nuisances, initial_state="free") if first else present.nuisances
    for u, joined, advice in ((lines, "lines", of_lines), (curve, "a smooth curve", of_curve)):
        other = record._derive(u=u, y=y).between("foh")
        what = f"{_said(present, every)}, where it moves all the time (joined by {joined})"
        advice += ", or record the inputs as often as the outputs."
        part = replace(present, records=(other,), nuisances=freed)
        found = one("intersample", part, what, advice)
        yield replace(found, headline=HEADLINE, kind="repeated")


def _earlier_each(present: Present, every: int, jumps: Indices) -> Rival | None:
    early = np.full(jumps.size, 0.5 * max(every - 1, 1))
    end = quickly_fitted(_moved(present, jumps, early), present.poles)
    for _ in range(ROUNDS):
        if end is None:
            return None
        told = times_told(end.point, present.records[0], present.delay, jumps, early, every)
        if told is None:
            return None
        early = np.clip(early + told.sooner, 0.0, float(every))
        end = quickly_fitted(_moved(present, jumps, early), end.point.poles)
    if end is None or float(np.std(early)) < SPREAD * every:
        return None
    dt, nearer = present.step, every == 1 and _lines_are_nearer(present)
    by = f"by {early.mean() * dt:.2g} s on the mean"
    if every == 1:
        names = " and ".join(present.records[0].input_names)
        what = (
            f"an input that moves between the samples ({names}; each time up to a sample before "
            f"that was recorded, {by}: when it moved is known to {dt:.3g} s only)"
        )
        record = (
            "State intersample='auto' (--intersample auto): when they moved is then estimated "
            "along. Or record the inputs faster, or when they moved (a trigger, a counter)"
        )
    else:
        what = (
            f"{_said(present, every)}, so that each move acted up to {every} samples before it was "
            f"recorded ({by}): when it moved is known to {every * dt:.3g} s only"
        )
        record = "Record the inputs as often as the outputs, or when they moved"
    advice = (
        f"{record}; no delay and no other clock stands for it, and the standard errors do not "
        "allow for it."
    )
    found = one("intersample", _moved(present, jumps, early), what, advice, refits=False)
    return replace(
        found,
        starts=((end.point.poles,),),
        price=2.0 * jumps.size,
        exact=True,
        headline=BETWEEN if every == 1 else HEADLINE,
        kind="between" if every == 1 else "repeated",
        spoils=nearer,
    )


def _lines_are_nearer(present: Present) -> bool:
    """Whether an input that is taken as held follows better where it is joined by lines."""
    if present.records[0].behaviour != "zoh":
        return False
    lines = replace(present, records=tuple(one.between("foh") for one in present.records))
    ends = [quickly_fitted(one, present.poles) for one in (present, lines)]
    held, joined = (np.inf if end is None else end.deviance for end in ends)
    return bool(joined < held - CLEARLY)


def _moved(present: Present, jumps: Indices, early: Array) -> Present:
    (record,) = present.records
    return replace(present, records=(moved_earlier(record, jumps, early),))
