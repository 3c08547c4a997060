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
"""The longest delay that is tried is this part of a record."""

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
    longest = min(record.n_samples for record in present.records) // SHARE
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
    first = present.records[0]
    name = first.input_names[j]
    where = name if len(rows) == first.n_outputs else f"{name} to {first.output_names[rows[0]]}"
    total = float(present.delay[rows[0], j]) + best * present.step
    return one(
        "delay",
        later(best),
        f"a delay of about {total:.3g} s of {where}",
        f"State the delay (delay={total:.3g}; --delay), or have it estimated (delay='free').",
    )
