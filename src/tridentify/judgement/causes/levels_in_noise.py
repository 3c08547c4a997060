"""An input that stands at levels, and whether what is recorded on these is noise of its sensor."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.special import fdtrc

from tridentify.numerics.arrays import Array
from tridentify.numerics.robust import median_scale
from tridentify.record.record import Record

AT_REST = 0.8
"""Share of the samples at which an input of pulses stands at one level, one of steps at levels."""

STANDS_OUT = 8.0
"""Usual deviations of the input at rest from which it is a pulse or a step."""

LEAST_STRETCH = 8
"""Samples at one level that tell it to a third of what its noise is."""

PAST = 3
"""Samples of inputs and outputs that may tell what an input does at rest."""

PER_COLUMN = 10
"""Samples at rest for each of them, at least."""


def stretches(u: Array) -> list[tuple[int, int]]:
    """First sample and the one after the last of each level of an input of levels in noise.

    Empty for an input of another kind, and for levels that are exact.

    Examples
    --------
    >>> noise = 0.01 * np.random.default_rng(0).standard_normal(60)
    >>> stretches(np.repeat([0.0, 1.0, 3.0], 20) + noise)
    [(0, 20), (20, 40), (40, 60)]
    """
    steps = np.abs(np.diff(u))
    usual = median_scale(steps)
    jumps = np.flatnonzero(steps > STANDS_OUT * usual) + 1
    if not usual > 0.0 or not jumps.size:
        return []
    edges = [0, *jumps.tolist(), u.size]
    found = [(a, b) for a, b in pairwise(edges) if b - a >= LEAST_STRETCH]
    return found if sum(b - a for a, b in found) >= AT_REST * u.size else []


def chance_of_noise(record: Record, j: int, levels: Array, past: int = PAST) -> float:
    """p-value of what an input does at rest being white and following no output: sensor noise.

    A controller that answers to an output moves its input at rest, too, and that acts.

    Parameters
    ----------
    record : Record
    j : int
        Of the input.
    levels : (n_samples,) array
        Where it is at rest, and at what; ``nan`` elsewhere.
    past : int
        Samples of inputs and outputs that may tell what it does.
    """
    rest = np.isfinite(levels)
    now = np.flatnonzero(rest)
    now = now[now >= past]
    u = record.u[:, j] - np.where(rest, levels, 0.0)
    u = u - u[rest].mean()
    before = [u[now - lag] * rest[now - lag] for lag in range(1, past + 1)]
    beside = [record.y[now - lag] for lag in range(past + 1)]
    columns = np.column_stack([np.ones(now.size), *before, *beside])
    there = np.isfinite(columns).all(axis=1)
    columns, wanted = columns[there], u[now][there]
    if wanted.size < PER_COLUMN * columns.shape[1]:
        return 0.0
    scale = np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
    left = wanted - columns / scale @ np.linalg.lstsq(columns / scale, wanted, rcond=1e-10)[0]
    k, n = columns.shape[1] - 1, wanted.size
    spread = float(np.sum((wanted - wanted.mean()) ** 2))
    told = max(spread - float(left @ left), 0.0)
    return float(fdtrc(k, n - k - 1, told / k / (float(left @ left) / (n - k - 1))))
