"""A delay that is missing, looked for ever finer about the best so far.

A delay and another behaviour of the input between its samples, together.

Each explains some of the other: a held input taken for one that moves comes half a sample early,
and a delay that is not stated makes any smoother behaviour look better. Where both are wrong, each
remedy alone leaves what the other would explain. So both are tried together, and are told together
where that explains clearly more than either.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt
from tridentify.judgement.causes.attempts.intersample import IN_WORDS
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival, one
from tridentify.numerics.arrays import Complex
from tridentify.structure import Structure

GROWTH = 1.3
"""Ratio of neighbouring delays of the first search: where a numerator makes up for a delay that is
short by two of six samples, wider ones miss the right one (4 of 32 records with 1.6, none so)."""

FEW_STEPS = 5
"""Levenberg-Marquardt steps of each: the poles of a model without the delay are far off, so that
what a single step promises there says little."""

SHARE = 4
"""The longest delay that is tried is this part of a record, where what came before is stated."""

SHARE_FREE = 10
"""The same where the initial state is free: the samples before the delay are then explained by
nothing, and what is left may be a free response alone."""

PLACES = 2
"""Delays of the first search about which finer ones are tried: each may lie in a valley of its
own."""

FINER = (1.0, 0.5, 0.25)
"""Steps [samples] of the refinement; whole ones alone where a part of a sample says nothing."""


def delay_rivals(present: Present) -> Iterator[Rival]:
    """Inputs later to outputs, each and all, by the delay that promises most.

    All inputs together are late where a sensor, or what lies before it, is: each of them alone
    explains little then.
    """
    n_outputs, n_inputs = present.delay.shape
    every = tuple(range(n_inputs))
    inputs = [(j,) for j in every] + ([every] if n_inputs > 1 else [])
    paths = [(tuple(range(n_outputs)), columns) for columns in inputs]
    if n_outputs > 1:
        paths += [((i,), columns) for i in range(n_outputs) for columns in inputs]
    for rows, columns in paths:
        found = _best(present, rows, columns)
        if found is not None:
            yield found


def _best(present: Present, rows: tuple[int, ...], columns: tuple[int, ...]) -> Rival | None:
    share = SHARE_FREE if present.nuisances.initial_state == "free" else SHARE
    longest = min(record.n_samples for record in present.records) // share
    plain = replace(present, noise=())
    known: dict[float, Attempt | None] = {}

    def at(steps: float, *starts: Complex) -> float:
        if steps not in known:
            try:
                problem = _later(plain, rows, columns, steps).problem()
                known[steps] = attempt(problem, starts, present.orders, steps=FEW_STEPS, rounds=0)
            except TridentifyError:
                known[steps] = None
        end = known[steps]
        return np.inf if end is None else end.deviance / end.count

    grid = [1.0]
    while grid[-1] * GROWTH < longest:
        grid.append(float(np.ceil(grid[-1] * GROWTH)))
    for steps in grid:
        ends = [end.point.poles for end in known.values() if end is not None]
        at(steps, present.poles, *ends[-1:])
    finest = FINER[:1] if _in_samples(present) else FINER

    def refined(best: float) -> float:
        for width in (max(round(best / 4.0), 1.0), *finest):
            before = 0.0
            while best != before and np.isfinite(at(best)):
                end, before = known.pop(best), best
                assert end is not None
                poles = end.point.poles
                near = [best, *(s for s in (best - width, best + width) if 0 < s <= longest)]
                best = min(near, key=lambda steps: at(steps, poles))
        return best

    best = min([refined(steps) for steps in sorted(grid, key=at)[:PLACES]], key=at)
    end = known[best]
    if end is None:
        return None
    found = _rival(_later(present, rows, columns, best), rows, columns)
    return replace(found, starts=((end.point.poles, present.poles),))


def _later(
    present: Present, rows: tuple[int, ...], columns: tuple[int, ...], steps: float
) -> Present:
    late = np.array(present.delay)
    late[np.ix_(rows, columns)] += steps * present.step
    return replace(present, delay=late)


def neighbours(present: Present, rival: Rival) -> Iterator[Rival]:
    """Delays beside that of a rival: a step ahead promises little more than where to begin."""
    (part,) = rival.parts
    rows, columns = _moved(present, part)
    first = rows[0], columns[0]
    steps = (part.delay[first] - present.delay[first]) / present.step
    near = {float(np.floor(steps)), float(np.ceil(steps))}
    if _in_samples(present):
        near |= {steps - 1.0, steps + 1.0}
    else:
        near |= {steps - 0.5, steps - 0.25, steps + 0.25, steps + 0.5}
    for other in sorted(near - {steps}):
        if other > 0:
            near_it = _rival(_later(present, rows, columns, other), rows, columns)
            yield replace(near_it, starts=rival.starts)


def is_later(present: Present, rival: Rival) -> bool:
    """Whether a rival has another delay: an output that runs ahead moves the samples instead."""
    return len(rival.parts) == 1 and bool(np.any(rival.parts[0].delay != present.delay))


def shifted(present: Present, rival: Rival, steps: float) -> Rival:
    """A rival whose delay is some samples more, or less, whatever else it changes.

    Parameters
    ----------
    present : Present
    rival : Rival
        With a delay that the present explanation does not have.
    steps : float
        Samples.
    """
    (part,) = rival.parts
    rows, columns = _moved(present, part)
    here, there = (_rival(one, rows, columns) for one in (part, _later(part, rows, columns, steps)))
    return replace(
        rival,
        parts=there.parts,
        what=rival.what.replace(here.what, there.what),
        advice=rival.advice.replace(here.advice[1:], there.advice[1:]),
    )


def _moved(present: Present, part: Present) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Outputs and inputs between which a delay is another one."""
    rows, columns = np.nonzero(part.delay != present.delay)
    return tuple(np.unique(rows).tolist()), tuple(np.unique(columns).tolist())


def _rival(later: Present, rows: tuple[int, ...], columns: tuple[int, ...]) -> Rival:
    first = later.records[0]
    name = first.input_names[columns[0]] if len(columns) == 1 else "every input"
    where = name if len(rows) == first.n_outputs else f"{name} to {first.output_names[rows[0]]}"
    total = float(later.delay[rows[0], columns[0]])
    return one("delay", later, f"a delay of about {total:.3g} s of {where}", _advice(later, total))


def _advice(later: Present, total: float) -> str:
    """To have the delay estimated, where it can be: not beside a direct part."""
    stated = f"tate the delay (delay={total:.3g}; --delay)"
    if any(map(any, _direct(later))):
        return f"S{stated}."
    return f"Have it estimated (delay='free'; --delay free), or s{stated}."


def _direct(present: Present) -> list[list[bool]]:
    """[output][input] whether there are as many zeros as poles."""
    poles = Structure(present.order, present.zeros).poles_matrix(*present.delay.shape)
    pairs = zip(poles, present.zeros, strict=True)
    return [[m == n for n, m in zip(row, line, strict=True)] for row, line in pairs]


def _in_samples(present: Present) -> bool:
    """Whether delays that end within the same sample are one: held inputs, direct parts everywhere.

    The output of a sample follows one value of such an input whatever part of the sample it has
    acted for, and the numerator makes up for the rest.
    """
    held = all(record.behaviour == "zoh" for record in present.records)
    return held and all(map(all, _direct(present)))


def both_rivals(present: Present, behaviours: tuple[Rival, ...]) -> Iterator[Rival]:
    """Every other behaviour with the delay that promises most beside it.

    Parameters
    ----------
    present : Present
    behaviours : tuple of Rival
        Those of the input between its samples, which were fitted.
    """
    now = present.records[0].behaviour
    for other in behaviours:
        (part,) = other.parts
        behaviour = part.records[0].behaviour
        if behaviour == now:
            continue
        for late in delay_rivals(part):
            yield replace(
                late,
                code="intersample",
                changes=2,
                what=f"an input that is {IN_WORDS[behaviour]} together with {late.what}",
                advice=f"{other.advice.rstrip('.')}, and with it: "
                f"{late.advice[0].lower()}{late.advice[1:]}",
            )
