"""Play between two parts: what is driven stands still wherever the motion turns.

A part that is driven through a gap of half width ``b`` follows the driving one as

    z_k = min(max(z_{k-1}, x_k - b), x_k + b)

(the play operator; Krasnosel'skii & Pokrovskii, *Systems with Hysteresis*, 1989; Nordin & Gutman,
Automatica 38, 2002, 1633-1649). It looks like dry friction, whose residual follows the direction of
motion as well, and like a delay, since every turn comes late; but a delay is as late whatever the
amplitude, and friction acts through the poles, where play acts on the output alone. So play is
fitted like the others, and the likelihood says which one it is.

*An output.* The distance of the driven part from the driving one, found with the present model, is
added to what was recorded; the model is fitted to that, and so on from there, as for a level in
`saturation`. It is compared on what was recorded. *An input.* What acted is the driven part. Of a
position that is held by a spring, or by its controller, dry friction does the same: what is driven
stops short by friction over stiffness, on the side from which it came. These two are named in one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt, promise
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival, one
from tridentify.judgement.causes.sensors.saturation import behind_outputs
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

ROUNDS = 6
"""Fits and widths in turn: a model that was fitted to what is late is late itself, and the first
width too small."""

STEPS = 10
"""Levenberg-Marquardt steps of each."""

WIDTHS = np.geomspace(0.002, 0.3, 22)
"""Half widths that are tried, over the range of the motion."""

INPUT_WIDTHS = np.geomspace(0.01, 0.2, 14)
"""The same for an input: one off by more than an eighth leaves room for friction."""

LEAST = 0.02
"""Share by which a gap has to lower the sum of squares to be one."""

NO_LINE = 0.05
"""Share of what a gap takes from an input, from its first move on, that a straight line in it has
to leave: play between two levels is a smaller gain, and at a level that is come to from one side
only it is a bend."""

COLUMN_WIDTHS = np.array([0.03, 0.1])
"""Half widths over the range of an input by whose gaps a residual is searched for play: wider ones
take much the same."""

LONGEST = 20_000
"""Samples of a record beyond which it is not tried: play is followed sample by sample."""

REMEDY = (
    "Preload the drive, record the part that moves behind the gap and identify from there, or "
    "identify stretches of one direction of motion; no order of a linear model stands for it."
)


def play(motion: Array, widths: Array, first: float) -> Array:
    """(n, k) positions of what is driven through gaps of k half widths.

    Parameters
    ----------
    motion : (n,) array
        Of the driving part; ``nan`` where it is not known, and nothing moves.
    widths : (k,) array
        Half of each gap, in the unit of the motion.
    first : float
        Where the driven part stands before; ``nan`` for the middle of the gap.

    Examples
    --------
    >>> play(np.array([0.0, 1.0, 0.5, -1.0]), np.array([0.25]), 0.0)[:, 0].tolist()
    [0.0, 0.75, 0.75, -0.75]
    """
    known = np.isfinite(motion)
    if not known.any():
        return np.full((motion.size, widths.size), first)
    # where nothing is known the last known place stands for it
    last = np.maximum.accumulate(np.where(known, np.arange(motion.size), int(np.argmax(known))))
    x = motion[last]
    ways = np.sign(np.diff(x, prepend=x[0]))
    # only turns matter: between two of them the driven part rests, then follows
    turns = np.flatnonzero((ways != 0.0) & (ways != _carried(ways)))
    begins = np.concatenate([[0], turns]) if not turns.size or turns[0] else turns
    here = np.full(widths.size, first if np.isfinite(first) else x[0])
    here = np.minimum(np.maximum(here, x[0] - widths), x[0] + widths)
    stands = np.empty((begins.size, widths.size))
    ends = np.append(begins[1:], x.size) - 1
    for k, end in enumerate(ends.tolist()):
        stands[k] = here
        here = np.minimum(np.maximum(here, x[end] - widths), x[end] + widths)
    whole = np.repeat(stands, np.diff(np.append(begins, x.size)), axis=0)
    return np.asarray(np.clip(whole, x[:, None] - widths, x[:, None] + widths))


def _carried(ways: Array) -> Array:
    """Direction of motion before each sample, that of the last one that moved."""
    moved = np.maximum.accumulate(np.where(ways != 0.0, np.arange(ways.size), 0))
    return np.asarray(np.concatenate([[0.0], ways[moved][:-1]]))


def taken_by_gaps(inputs: Sequence[Array]) -> list[Array] | None:
    """What gaps of `COLUMN_WIDTHS` take from an input, in each experiment.

    Parameters
    ----------
    inputs : sequence of (n_samples,) arrays
        One input, experiment by experiment.

    Returns
    -------
    list of (n_samples, k) arrays or None
        None where it tells no gap from a smaller gain.

    Examples
    --------
    >>> there_and_back = np.repeat([0.0, 1.0, 0.0, 1.0, 0.0], 9)
    >>> taken_by_gaps([there_and_back]) is None
    True
    >>> taken_by_gaps([np.repeat([0.0, 1.0, 0.0, -1.0, 0.0], 9)])[0][::9, 0].round(2).tolist()
    [0.0, -0.06, 0.06, 0.06, -0.06]
    """
    size = float(np.ptp(np.concatenate(inputs)))
    if not size > 0.0 or max(one.size for one in inputs) > LONGEST:
        return None
    taken = [play(one, size * COLUMN_WIDTHS, np.nan) - one[:, None] for one in inputs]
    moving = [np.logical_or.accumulate(one != one[0]) for one in inputs]
    pairs = list(zip(inputs, taken, moving, strict=True))
    line = np.concatenate([one[there] for one, _, there in pairs])
    line = np.column_stack([np.ones(line.size), line / size])
    most = np.concatenate([own[there, -1] for _, own, there in pairs])
    left = most - line @ np.linalg.lstsq(line, most)[0]
    return taken if left @ left > NO_LINE * (most @ most) else None


def backlash_rivals(present: Present, fitted: Sequence[Array]) -> Iterator[Rival]:
    """Play behind every output and before every input.

    Parameters
    ----------
    present : Present
    fitted : sequence of (n_samples, n_outputs) arrays
        Outputs of the present model.
    """
    if max(record.n_samples for record in present.records) > LONGEST:
        return
    for i in range(present.n_outputs):
        found = _of_output(present, fitted, i)
        if found is not None:
            yield found
    for j in range(present.records[0].n_inputs):
        found = _of_input(present, j)
        if found is not None:
            yield found


def _with_gap(i: int, half: float, records: Sequence[Record], end: Attempt) -> Attempt:
    """Where a fit to the driving part ended, compared with what was recorded of the driven one."""
    recorded, shown = [], []
    pairs = zip(records, end.point.outputs(), end.point.residuals(), strict=True)
    for record, outputs, residual in pairs:
        y = np.where(np.isfinite(residual), record.y, np.nan)
        driven = np.array(outputs)
        driven[:, i] = _driven(record.y[:, i], outputs[:, i], half)
        recorded.append(y)
        shown.append(driven)
    return behind_outputs(end, recorded, shown, 1)


def _driven(recorded: Array, motion: Array, half: float) -> Array:
    first = float(recorded[0]) if recorded.size else np.nan
    return np.asarray(play(motion, np.array([half]), first)[:, 0])


def _of_output(present: Present, fitted: Sequence[Array], i: int) -> Rival | None:
    """A gap behind an output."""
    outputs, poles, records = [np.asarray(f[:, i]) for f in fitted], present.poles, present.records
    half, part = 0.0, present
    for _ in range(ROUNDS):
        best = _half_width([record.y[:, i] for record in records], outputs)
        if best is None or best == half:
            break
        half, driving = best, []
        for record, motion in zip(records, outputs, strict=True):
            y = np.array(record.y)
            y[:, i] += motion - _driven(record.y[:, i], motion, half)
            driving.append(record._derive(y=y))
        part = replace(present, records=tuple(driving))
        try:
            problem = replace(part, noise=()).problem()
            end = attempt(problem, [poles], present.orders, steps=STEPS, rounds=0)
        except TridentifyError:
            return None
        if end is None:
            return None
        poles = end.point.poles
        outputs = [np.asarray(one[:, i]) for one in end.point.outputs()]
    if not half:
        return None
    name = records[0].output_names[i]
    what = f"play of about {2.0 * half:.3g} (backlash) between what is driven and {name}"
    rival = one("nonlinear", part, what, REMEDY, refits=False)
    return replace(
        rival, starts=((poles, present.poles),), behind=partial(_with_gap, i, half, records)
    )


def _half_width(recorded: Sequence[Array], fitted: Sequence[Array]) -> float | None:
    """Half width that leaves least of an output; None where none helps."""
    size = float(np.ptp(np.concatenate([one[np.isfinite(one)] for one in fitted])))
    if not size > 0.0:
        return None
    widths = size * WIDTHS
    total, energy = 0.0, np.zeros(widths.size)
    for y, motion in zip(recorded, fitted, strict=True):
        there = np.isfinite(y) & np.isfinite(motion)
        driven = play(motion, widths, float(y[0]))
        energy += np.sum((y[there, None] - driven[there]) ** 2, axis=0)
        total += float(np.sum((y[there] - motion[there]) ** 2))
    k = int(np.argmin(energy))
    return float(widths[k]) if total - energy[k] > LEAST * total else None


def _of_input(present: Present, j: int) -> Rival | None:
    """A gap between an input and what acts."""
    inputs = [np.asarray(record.u[:, j]) for record in present.records]
    if taken_by_gaps(inputs) is None:
        return None
    size = float(np.ptp(np.concatenate(inputs)))
    plain = replace(present, noise=())
    tried = size * INPUT_WIDTHS
    promised = [promise(_through(plain, j, half), present.poles) for half in tried]
    half = float(tried[int(np.argmin(promised))])
    if not min(promised) < promise(plain, present.poles):
        return None
    name = present.records[0].input_names[j]
    what = f"play or dry friction of {2.0 * half:.3g} between {name} and what it drives"
    rival = one("nonlinear", _through(present, j, half), what, REMEDY, refits=False)
    # its width was chosen by hand, as it were, but is an unknown all the same
    return replace(rival, price=2.0, calms=True, kind="friction")


def _through(present: Present, j: int, half: float) -> Present:
    return present.acted(j, lambda one: play(one.u[:, j], np.array([half]), np.nan)[:, 0])
