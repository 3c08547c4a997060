"""Small stand-ins for a long record: the first steps need not see every sample.

Two of them complement each other.

*Averaged*: the input averaged over blocks of ``s`` samples and the output taken at the block
edges. The whole record in little, good for dynamics slower than a block.

*Window*: a stretch at the full rate, where the output moves most, with a free initial state.
Good for dynamics that are shorter than the window. A record that starts at rest, or in equilibrium,
gives its beginning, if the output moves there too: the initial state is known, which halves the
columns.

Delays stay what they are, in seconds. Where time is not uniform the averages are weighted by the
time between the samples.

Only starting poles come from them; the estimate itself is always that of the full record.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.models.regression import Experiment
from tridentify.numerics.arrays import Array
from tridentify.record.checks.times import typical_step

LARGE_RECORD = 5_000
"""Samples from which stand-ins are searched: two and a half windows, as a window saves little of
fewer."""
AS_GOOD = 0.5
"""Movement of a record's beginning over that of the liveliest stretch from which the known start is
worth more than the rest of the movement."""
SMALL = 2_000
"""Samples of a stand-in: more than 30 for each unknown of a model of twenty poles and zeros and a
free start."""


def is_large(problem: Problem) -> bool:
    """Whether the search should run on stand-ins."""
    return sum(e.n_samples for e in problem.experiments) > LARGE_RECORD


def is_usable(problem: Problem) -> bool:
    """Whether a stand-in has outputs that move, and more samples than unknowns."""
    samples = [
        sum(int(np.isfinite(e.y[:, i]).sum()) for e in problem.experiments)
        for i in range(problem.n_outputs)
    ]
    needed = problem.n_coefficients + problem.n_nuisance + 3
    return bool(np.all(problem.power > 0)) and min(samples) > needed


def averaged(problem: Problem) -> Problem:
    """Every experiment with blocks of samples averaged, to about ``SMALL`` samples in all."""
    total = sum(e.n_samples for e in problem.experiments)
    block = -(-total // SMALL)
    experiments = [_averaged(e, _visible(e, block)) for e in problem.experiments]
    return problem.over(experiments)


def _visible(e: Experiment, block: int) -> int:
    """A block length near the wanted one whose edges meet the samples that are there."""
    if not np.isnan(e.y.sum()):
        return block
    seen = np.isfinite(e.y)
    return max(range(block, 2 * block + 8), key=lambda step: (seen[::step].mean(0).min(), -step))


def _averaged(e: Experiment, block: int) -> Experiment:
    count = e.n_samples // block
    if count < 2:
        return e
    kept = count * block
    u = e.u[:kept].reshape(count, block, -1)
    if e.t is None:
        u = u.mean(axis=1)
    else:
        # in the last block the input is held to its end
        spans = np.diff(e.t[: kept + 1])
        spans = np.append(spans, spans[-1:])[:kept].reshape(count, block, 1)
        u = (u * spans).sum(axis=1) / spans.sum(axis=1)
    start = -(-e.start // block)
    y = e.y[:kept:block].copy()
    y[:start] = np.nan
    t = None if e.t is None else e.t[:kept:block]
    return replace(
        e,
        u=np.ascontiguousarray(u),
        y=y,
        dt=e.dt * block if t is None else typical_step(t),
        intersample="zoh",
        noise=(),
        t=t,
        start=start,
    )


def window(problem: Problem, samples: int = SMALL) -> Problem:
    """A stretch of the longest experiment where the output moves most.

    The initial state is free, but at the beginning of a record where it is known.

    Parameters
    ----------
    problem : Problem
    samples : int
        Its length.
    """
    e = max(problem.experiments, key=lambda one: one.n_samples)
    # what the delays take off the beginning is added
    longest = 0.0 if e.delays is None else float(e.delays.max())
    length = min(samples + int(np.ceil(longest / e.dt)), e.n_samples)
    starts = range(0, e.n_samples - length + 1, max(length // 2, 1))
    y = np.nan_to_num(e.y) if np.isnan(e.y.sum()) else e.y
    weights = 1.0 / np.where(problem.power > 0, problem.power, 1.0)
    edges = np.arange(0, e.n_samples + 1, max(length // 2, 1))
    halves = y[: edges[-1]].reshape(edges.size - 1, -1, y.shape[1])
    first = halves.sum(axis=1)
    second = np.einsum("kij,kij->kj", halves, halves)
    movement = [
        float(weights @ (second[k : k + 2].sum(0) - first[k : k + 2].sum(0) ** 2 / length))
        for k in range(len(starts))
    ]
    most = int(np.argmax(movement))
    known = not e.free and movement[0] >= AS_GOOD * movement[most]
    known = known and _is_driven(e.u[:length], e.u[starts[most] : starts[most] + length])
    start = 0 if known else starts[most]
    part = slice(start, start + length)
    since = None if e.t is None else e.t[part] - e.t[start]
    arrived = e.start
    if not known:
        late = np.arange(length) * e.dt if since is None else since
        arrived = int(np.searchsorted(late, longest - 1e-6 * e.dt)) if longest else 0
    y = e.y[part].copy()
    y[:arrived] = np.nan
    piece = replace(
        e,
        u=np.ascontiguousarray(e.u[part]),
        y=y,
        free=not known,
        t=since,
        start=arrived,
    )
    return problem.over([piece])


def _is_driven(begun: Array, other: Array) -> bool:
    """Whether inputs from rest do about as much in the one stretch as in the other."""
    moved = other - other.mean(axis=0)
    energy = np.einsum("ij,ij->j", begun, begun)
    return bool(np.all(energy >= AS_GOOD * np.einsum("ij,ij->j", moved, moved)) and np.all(energy))


def free_variant(problem: Problem) -> Variant:
    """The problem as it is: no nuisance term dropped."""
    e = problem.experiments[0]
    return Variant(e.free, e.offset, e.drift, (None,) * len(problem.experiments))
