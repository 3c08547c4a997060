"""An input of pulses of a few samples: what its samples say of it, and what of them is noise.

An impact of a hammer is one-sided and lasts for some samples; for most of the record the input is
at rest. *Its noise.* What is recorded at rest is the noise of the force sensor, which moves
nothing; a model that is driven by it carries a response to it. Any function of the input that
presses small values down makes up for that, and passes for a bend. *Its size.* A pulse begins and
ends between two samples, so that held, joined by lines or band-limited its size is off by a little,
each time by another share: a response that is too large at some pulses and too small at others
looks like a bend as well. Both are tried before a bend is named.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from tridentify.judgement.causes.present import Present
from tridentify.judgement.causes.rivals import Rival, one
from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import median
from tridentify.numerics.robust import median_scale
from tridentify.record.record import Record

AT_REST = 0.8
"""Share of the samples at which an input of pulses stands at one level."""

STANDS_OUT = 8.0
"""Usual deviations of the input at rest from which it is a pulse."""

FLOOR = 0.02
"""Share of the largest pulse from which it is one, where the input at rest is exact."""

BESIDE = 1
"""Samples beside a pulse that belong to it: its flanks may be below the floor."""

PAST = 3
"""Samples of inputs and outputs that may tell what an input does at rest."""

PER_COLUMN = 10
"""Samples at rest for each of them, at least."""

NO_NOISE = 1e-3
"""p-value from which they do tell it."""

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
    u = np.array(record.u)
    kept = np.zeros(record.n_samples, dtype=bool)
    for first, last in own:
        kept[max(first - BESIDE, 0) : last + BESIDE] = True
    if not (np.ptp(u[~kept, j]) > 0.0 and _by_itself(record, j, ~kept)):
        return
    u[~kept, j] = median(u[~kept, j])
    found = one(
        "input-noise",
        replace(present, records=(record._derive(u=u),)),
        f"an input {name} that stands still between its pulses",
        f"Set {name} to its level at rest between the pulses (a force window), if nothing acted "
        "there.",
    )
    yield replace(found, calms=True)


def _by_itself(record: Record, j: int, rest: NDArray[np.bool_]) -> bool:
    """Whether what an input does at rest is white and follows no output: noise of its own sensor.

    A controller that answers to an output moves its input at rest, too, and that acts.
    """
    now = np.flatnonzero(rest)
    now = now[now >= PAST]
    u = record.u[:, j] - record.u[rest, j].mean()
    before = [u[now - lag] * rest[now - lag] for lag in range(1, PAST + 1)]
    beside = [record.y[now - lag] for lag in range(PAST + 1)]
    columns = np.column_stack([np.ones(now.size), *before, *beside])
    there = np.isfinite(columns).all(axis=1)
    columns, wanted = columns[there], u[now][there]
    if wanted.size < PER_COLUMN * columns.shape[1]:
        return False
    scale = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    left = wanted - columns / scale @ np.linalg.lstsq(columns / scale, wanted, rcond=1e-10)[0]
    k, n = columns.shape[1] - 1, wanted.size
    spread = float(np.sum((wanted - wanted.mean()) ** 2))
    told = max(spread - float(left @ left), 0.0)
    p_value = float(fdtrc(k, n - k - 1, told / k / (float(left @ left) / (n - k - 1))))
    return p_value > NO_NOISE


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
