"""Inputs of pulses or of levels: what their samples say of them, and what of these is noise.

An impact of a hammer is one-sided and lasts for some samples; for most of the record the input is
at rest. *Its noise.* What is recorded at rest is the noise of the force sensor, which moves
nothing; a model that is driven by it carries a response to it. Any function of the input that
presses small values down makes up for that, and passes for a bend. *Its size.* A pulse begins and
ends between two samples, so that held, joined by lines or band-limited its size is off by a little,
each time by another share: a response that is too large at some pulses and too small at others
looks like a bend as well. Both are tried before a bend is named.

An input that is switched between levels, with the noise of its sensor on them, is of the same kind
where the output follows at once: what is left of the output then follows the noise, and a later
sample of the input, which tells its level once more, explains some of it, as if it reacted.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival, one
from tridentify.judgement.causes.signals.levels_in_noise import (
    AT_REST,
    STANDS_OUT,
    are_repeated,
    is_noise_of_its_sensor,
    levels_of,
)
from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import median
from tridentify.numerics.robust import median_scale

FLOOR = 0.02
"""Share of the largest pulse from which it is one, where the input at rest is exact."""

BESIDE = 1
"""Samples beside a pulse that belong to it: its flanks may be below the floor."""

LONGEST = 20
"""Samples of a pulse from which its size is known well enough."""

FEWEST, MOST = 3, 24
"""Pulses: two sizes are explained by any bend, and more than these are more unknowns than a record
tells."""


def pulse_rivals(present: Present) -> Iterator[Rival]:
    """Inputs that are at rest between their pulses, and whose pulses have sizes of their own."""
    if len(present.records) > 1 or not isinstance(present.order, int):
        return
    (record,) = present.records
    for j, name in enumerate(record.input_names):
        own = pulses(record.u[:, j])
        if not own:
            continue
        yield from _without_noise(present, j, own)
        if not FEWEST <= len(own) <= MOST:
            continue
        other = present
        for k, (first, last) in enumerate(own[1:], start=2):
            alone = np.zeros(record.n_samples)
            alone[first:last] = record.u[first:last, j] - median(record.u[:, j])
            other = other.with_inputs([alone], f"pulse {k}", max(row[j] for row in present.zeros))
        late = np.array(other.delay)
        late[:, record.n_inputs :] = present.delay[:, [j]]
        yield one(
            "intersample",
            replace(other, delay=late),
            f"pulses of {name} whose size the few samples of each do not tell (another size for "
            "each of them)",
            f"Record {name} faster, or both through the same anti-alias filter and state "
            "intersample='band-limited'; the gain is that of the pulses on the average, poles do "
            "not depend on it.",
            refits=False,
        )


def _without_noise(present: Present, j: int, own: Sequence[tuple[int, int]]) -> Iterator[Rival]:
    """The input without what moves at rest, where anything does."""
    (record,) = present.records
    name = record.input_names[j]
    wide = [(max(first - BESIDE, 0), last + BESIDE) for first, last in own]
    edges = np.clip([0, *(edge for pair in wide for edge in pair), record.n_samples], 0, None)
    rests = [
        (int(a), min(int(b), record.n_samples))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
    levels = np.full(record.n_samples, np.nan)
    for first, last in rests:
        levels[first:last] = float(median(record.u[:, j]))
    yield from _at_levels(
        present,
        j,
        levels,
        f"an input {name} that stands still between its pulses",
        f"Set {name} to its level at rest between the pulses (a force window), if nothing acted "
        "there.",
    )


def level_rivals(present: Present) -> Iterator[Rival]:
    """Inputs that were switched between levels, without the noise that was recorded on these."""
    if len(present.records) > 1 or not isinstance(present.order, int):
        return
    (record,) = present.records
    for j, name in enumerate(record.input_names):
        u = record.u[:, j]
        levels = levels_of(u)
        rest = np.isfinite(levels)
        if not rest.any() or (pulses(u) and _is_one_rest(levels)):
            continue
        size = float(np.std(u[rest] - levels[rest]))
        yield from _at_levels(
            present,
            j,
            levels,
            f"an input {name} that stands still between its steps, without the noise of {size:.2g} "
            f"that was recorded there ({100.0 * size / float(np.std(u)):.2g} % of its spread),",
            f"Give what {name} was told to be (the command), or set it to its level between the "
            "steps (the mean of each), if nothing else acted.",
        )


def _is_one_rest(levels: Array) -> bool:
    """Whether what lies beside an input's pulses is its rest, not levels that it comes back to."""
    return np.unique(levels[np.isfinite(levels)]).size < 2 or not are_repeated(levels)


def _at_levels(present: Present, j: int, levels: Array, what: str, advice: str) -> Iterator[Rival]:
    """The input at its level at rest, where what moves there is noise of its sensor."""
    (record,) = present.records
    u, rest = np.array(record.u), np.isfinite(levels)
    if not (np.any(u[rest, j] != levels[rest]) and is_noise_of_its_sensor(record, j, levels)):
        return
    u[rest, j] = levels[rest]
    other = replace(present, records=(record._derive(u=u),))
    yield replace(one("input-noise", other, what, advice), calms=True)


def pulses(u: Array) -> list[tuple[int, int]]:
    """First sample of each pulse and the one after its last; empty for an input of another kind.

    Examples
    --------
    >>> u = np.zeros(100)
    >>> u[[20, 21, 60]] = 3.0
    >>> pulses(u)
    [(20, 22), (60, 61)]
    """
    away = np.abs(u - median(u))
    floor = max(STANDS_OUT * median_scale(away), FLOOR * float(away.max()))
    moved: NDArray[np.bool_] = away > floor
    if not moved.any() or float(np.mean(~moved)) < AT_REST:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moved, [False]]).astype(int)))
    found = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    wide = [(a - BESIDE, b + BESIDE) for a, b in found]
    apart = all(a[1] <= b[0] for a, b in pairwise(wide))
    return found if apart and max(b - a for a, b in found) <= LONGEST else []
