"""A delay that is missing, looked for ever finer about the best so far."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tridentify.causes.attempt import promise
from tridentify.causes.present import Present
from tridentify.causes.rivals import Rival, one

GRID = 10
"""Delays tried over the whole range: neighbours differ by a factor of two at most up to 1,000
samples, and the best is refined."""

SHARE = 4
"""The longest delay that is tried is this part of a record, where what came before is stated."""

SHARE_FREE = 10
"""The same where the initial state is free: the samples before the delay are then explained by
nothing, and what is left may be a free response alone."""

FINER = (1.0, 0.5, 0.25)
"""Steps [samples] of the refinement."""


def delay_rivals(present: Present) -> Iterator[Rival]:
    """Each input later to all outputs, and to each one, by the delay that promises most."""
    n_outputs, n_inputs = present.delay.shape
    paths = [(tuple(range(n_outputs)), j) for j in range(n_inputs)]
    if n_outputs > 1:
        paths += [((i,), j) for i in range(n_outputs) for j in range(n_inputs)]
    for rows, j in paths:
        found = _best(present, rows, j)
        if found is not None:
            yield found


def _best(present: Present, rows: tuple[int, ...], j: int) -> Rival | None:
    share = SHARE_FREE if present.nuisances.initial_state == "free" else SHARE
    longest = min(record.n_samples for record in present.records) // share
    known: dict[float, float] = {}

    def later(steps: float) -> Present:
        late = np.array(present.delay)
        late[list(rows), j] += steps * present.step
        return replace(present, delay=late)

    def at(steps: float) -> float:
        if steps not in known:
            known[steps] = promise(later(steps), present.poles)
        return known[steps]

    grid = np.unique(np.round(np.geomspace(1, max(longest, 2), GRID)).astype(int)).tolist()
    best = float(min(grid, key=at))
    between = np.unique(np.round(np.linspace(best / 2.0, best * 2.0, 6))).tolist()
    best = min([best, *(k for k in between if 1 <= k <= longest)], key=at)
    for width in FINER:
        best = min([best, *(s for s in (best - width, best + width) if s > 0)], key=at)
    if not np.isfinite(at(best)):
        return None
    return _rival(later(best), rows, j)


def neighbours(present: Present, rival: Rival) -> Iterator[Rival]:
    """Delays beside that of a rival: a step ahead promises little more than where to begin."""
    (part,) = rival.parts
    moved = np.argwhere(part.delay != present.delay)
    rows, j = tuple(moved[:, 0].tolist()), int(moved[0, 1])
    steps = (part.delay[rows[0], j] - present.delay[rows[0], j]) / present.step
    near = {steps - 0.5, steps - 0.25, steps + 0.25, steps + 0.5}
    near |= {float(np.floor(steps)), float(np.ceil(steps))}
    for other in sorted(near - {steps}):
        if other > 0:
            late = np.array(present.delay)
            late[list(rows), j] += other * present.step
            yield _rival(replace(present, delay=late), rows, j)


def _rival(later: Present, rows: tuple[int, ...], j: int) -> Rival:
    first = later.records[0]
    name = first.input_names[j]
    where = name if len(rows) == first.n_outputs else f"{name} to {first.output_names[rows[0]]}"
    total = float(later.delay[rows[0], j])
    return one(
        "delay",
        later,
        f"a delay of about {total:.3g} s of {where}",
        f"State the delay (delay={total:.3g}; --delay), or have it estimated (delay='free').",
    )
