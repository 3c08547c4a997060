"""What of an input its own past does not tell: where a controller shows, if one is at work.

A reference or an operator moves an input now and then, and far; a controller moves it at every
sample, by what the noise at the sensor is worth. So the input is predicted from its own past by a
fit that large surprises do not bend, and these are left out: what remains are the small moves. An
input that has none (held levels, pulses, a multisine) was commanded.

References: P. Rousseeuw & A. Leroy, *Robust Regression and Outlier Detection*, Wiley (1987).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.numerics.lagrange import span
from tridentify.numerics.quantiles import median
from tridentify.numerics.recent import recent
from tridentify.record.record import Record

PAST = 12
"""Past samples that an input is predicted from: more take degrees of freedom from short records."""

PER_PAST = 12
"""Samples for each of them, at least."""

LARGE = 3.0
"""Standard deviations of small surprises from which one is large: a move of a reference."""

KEPT = 4
"""Records whose surprises are kept: the quick look and the tests ask for the same."""

ROUNDS = 15
"""Weighted fits; the weights stand still after about ten."""

COMMANDED = 1e-6
"""Small surprises over the spread of the input, below which it has none but rounding."""

ROUNDING = 1e-12
"""Over the largest value of the input: what a fit leaves of a level that never moves."""

RESTS = 0.85
"""Share of the samples that an input does not move at, from which it is held: a fit that large
surprises do not bend leaves nothing of these. Of 2,222 such inputs of six kinds (held, stepped,
quantised, cut off) it left none anything; of 2,600 from 0.8 on, 31 quantised sines."""

FEWEST = 100
"""Samples between the limits of an input of which its small moves are told, at least."""

MOVING = 0.9
"""Share of these at which it moves."""

TO_AND_FRO = 0.3
"""Mean sign of the product of neighbouring moves below which an input goes to and fro."""

SETTLES = 8
"""Samples after a large surprise in which what follows it is told by when it came."""

CUTOFF = 1e-10
"""Singular value over the largest below which past inputs tell nothing new."""


def small_surprises(records: Sequence[Record], past: int = PAST) -> tuple[Array, ...]:
    """Small moves of the inputs that their past does not tell, large ones left out.

    Parameters
    ----------
    records : sequence of Record
    past : int
        Samples of each input that its surprises are told from, at most.

    Returns
    -------
    tuple of (n_samples, n_inputs) arrays
        Per experiment; zero where a surprise is large, for the first samples, and throughout for
        an input that was commanded.

    Examples
    --------
    >>> held = Record(np.repeat([0.0, 1.0, -1.0, 1.0], 10), np.zeros(40), dt=1.0)
    >>> bool(np.any(small_surprises([held])[0]))
    False
    """
    return tuple(_of_one(np.asarray(record.u), past) for record in records)


# the same test is often made on many plants
@recent(KEPT)
def _of_one(u: Array, past: int) -> Array:
    """Of the inputs of one experiment, which may be of another kind than those of the others.

    Nobody may write into them.
    """
    n_samples, n_inputs = u.shape
    most = max(1, min(past, n_samples // (PER_PAST * n_inputs)))
    found = np.zeros((n_samples, n_inputs))
    found.flags.writeable = n_samples > most and not all(_held(column) for column in u[most:].T)
    if not found.flags.writeable:
        return found
    known = _lagged(u, most)
    basis = np.ascontiguousarray(span(known, cutoff=CUTOFF).T)
    for j in range(n_inputs if known.size else 0):
        least = COMMANDED * float(np.std(u[:, j])) + ROUNDING * float(np.max(np.abs(u[:, j])))
        now = np.ascontiguousarray(u[most:, j])
        found[most:, j] = _small(basis, now, least)
        between = _between_limits(now)
        if between.any() and not found[:, j].any():
            rows = np.ascontiguousarray(span(known[between], cutoff=CUTOFF).T)
            found[most:, j][between] = _small(rows, np.ascontiguousarray(now[between]), least)
    found.flags.writeable = False
    return found


def at_rest(surprises: Array) -> Array:
    """Small surprises, none of them soon after a large one.

    Parameters
    ----------
    surprises : (n_samples, n_inputs) array
        Zero where one is large.

    Examples
    --------
    >>> found = at_rest(np.array([[1.0]] * 3 + [[0.0]] + [[1.0]] * 10))
    >>> np.flatnonzero(found[:, 0]).tolist()
    [0, 1, 2, 12, 13]
    """
    large = surprises == 0.0
    near = np.array(large)
    for lag in range(1, SETTLES + 1):
        near[lag:] |= large[:-lag]
    return np.where(near, 0.0, surprises)


def moved(signals: Array, lags: Sequence[int]) -> Array:
    """Signals so many samples ago (ahead, where negative), the ends held.

    Parameters
    ----------
    signals : (n_samples, k) array
    lags : sequence of int

    Returns
    -------
    (n_samples, k * len(lags)) array
        All signals at the first lag, then at the second.

    Examples
    --------
    >>> moved(np.array([[1.0], [2.0], [3.0]]), [1, -1]).tolist()
    [[1.0, 2.0], [1.0, 3.0], [2.0, 3.0]]
    """
    rows, last = np.arange(signals.shape[0]), signals.shape[0] - 1
    return np.hstack([signals[np.clip(rows - lag, 0, last)] for lag in lags])


def _held(now: Array) -> bool:
    """Whether an input rests from most samples to the next, and is commanded without a fit."""
    rests = np.count_nonzero(now[1:] == now[:-1]) >= RESTS * now.size
    return bool(rests and not _between_limits(now).any())


def _lagged(u: Array, most: int) -> Array:
    """Inputs 1 to so many samples ago, and a constant; of the samples after these."""
    rows = u.shape[0] - most
    since = u - np.array([median(column) for column in u.T])
    columns = [since[most - lag : most - lag + rows] for lag in range(1, most + 1)]
    return np.hstack([*columns, np.ones((max(rows, 0), 1))])


def _between_limits(now: Array) -> NDArray[np.bool_]:
    """Where an input that rests at its limits most of the time is between them, and moves there.

    A controller that is at its limit does not move, and the small moves it makes elsewhere are the
    fewer. Nowhere for an input that is held between its limits, too, or goes on as it went: it was
    set, and of a smooth one that was cut off past samples do not tell all that an output does.
    """
    between: NDArray[np.bool_] = (now > now.min()) & (now < now.max())
    count, nowhere = int(np.count_nonzero(between)), np.zeros_like(between)
    if count < FEWEST:
        return nowhere
    steps = np.diff(now)
    if not np.count_nonzero((steps != 0.0) & between[1:]) > MOVING * count:
        return nowhere
    one, other = steps[1:], steps[:-1]
    within = between[2:] & between[1:-1] & between[:-2]
    to_and_fro = float(np.sum(np.sign(one * other)[within]))
    return between if to_and_fro < TO_AND_FRO * int(within.sum()) else nowhere


def _small(basis: Array, now: Array, least: float) -> Array:
    """What a robust fit leaves, zero where that is large; all zero where it is rounding."""
    from tridentify.numerics.kernels.robust_fit import robustly

    left = np.empty(now.size)
    scale = robustly(basis, now, ROUNDS, least, left)
    return (
        np.where(np.abs(left) <= LARGE * scale, left, 0.0) if scale > least else np.zeros(now.size)
    )
