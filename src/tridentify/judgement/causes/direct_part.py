"""A direct part of the response: outputs that jump at the very sample at which an input jumps.

A strictly proper system answers a jump of its input by a slope, whatever the input does between its
samples. One with as many zeros as poles (a resistance beside its cells, a force measured as an
acceleration, a signal path around a filter) follows it in the same sample and in proportion, and no
number of poles without that part stands for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tridentify.numerics.arrays import Array
from tridentify.numerics.robust import median_scale
from tridentify.record.record import Record

FEWEST_JUMPS = 4
"""Jumps of an input that have to agree: two or three do so by chance too often."""

IN_PROPORTION = 0.9
"""Share of the outputs' jumps that those of the inputs explain."""

STANDS_OUT = 10.0
"""Step in usual ones from which it is no noise: Gaussian noise makes none."""

ALONE = 3.0
"""Step over those before and after it from which it is a jump and not a part of a slope."""


def has_direct_part(records: Sequence[Record]) -> bool:
    """Whether some output jumps with an input, in the same sample and in proportion to it.

    Parameters
    ----------
    records : sequence of Record

    Returns
    -------
    bool
        False too where no input jumps: a smooth one cannot tell.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.choice([-1.0, 0.0, 2.0], 20), 10)
    >>> y = 0.5 * u + 0.01 * rng.standard_normal(200)
    >>> has_direct_part([Record(u, y, dt=1.0)])
    True
    >>> has_direct_part([Record(u, 0.01 * np.cumsum(u) + 0.5 * y, dt=1.0).slice(0.0, 30.0)])
    False
    """
    return any(
        follows_at_once(record.u[:, j], record.y[:, i])
        for record in records
        for j in range(record.n_inputs)
        for i in range(record.n_outputs)
    )


def follows_at_once(u: Array, y: Array) -> bool:
    """Whether one output jumps with one input.

    Parameters
    ----------
    u, y : (n_samples,) arrays
        ``nan`` where a sample of the output is missing.
    """
    if u.size < FEWEST_JUMPS * 2:
        return False
    at = jumps_alone(u) & np.isfinite(np.diff(y))
    if at.sum() < FEWEST_JUMPS:
        return False
    own, moved = np.diff(u)[at], np.diff(y)[at]
    both = at & jumps_alone(y)
    if 2 * both.sum() < at.sum() or not moved @ moved > 0:
        return False
    return bool((own @ moved) ** 2 > IN_PROPORTION * (own @ own) * (moved @ moved))


def jumps_alone(x: Array) -> NDArray[np.bool_]:
    """(n_samples - 1,) steps that stand out, with neither of their neighbours beside them.

    Examples
    --------
    >>> jumps_alone(np.repeat([0.0, 1.0, 1.5, 2.0], [4, 4, 1, 4])).nonzero()[0].tolist()
    [3]
    """
    step = np.diff(x)
    before, after = np.append(0.0, step[:-1]), np.append(step[1:], 0.0)
    beside = np.maximum(np.abs(before), np.abs(after))
    seen = step[np.isfinite(step)]
    usual = median_scale(seen) if seen.size else 0.0
    with np.errstate(invalid="ignore"):
        return np.asarray(
            (np.abs(step) > STANDS_OUT * usual) & (np.abs(step) > ALONE * beside), dtype=bool
        )
