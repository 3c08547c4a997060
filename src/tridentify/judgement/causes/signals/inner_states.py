"""What moves within a model between its input and its output, for non-linearity in there.

A clutch with play, friction in a gear or a stiffening coupling acts on a twist or a relative speed
that is nowhere recorded. Of ``y = b(p) / a(p) u`` every inner motion is a combination of the states
``p^k / a(p) u``, ``k = 0 .. n - 1``; for drives of masses and springs the leading ones are single
states themselves. What acts there comes out through numerators of its own: a force ``f(z)`` adds
``c(p) / a(p) f(z)``. The states carry no noise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.models.simulate import simulate_each
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

SOFT = 0.5
"""Standard deviations of a motion within which what takes hold of it is soft: ``tanh(z / SOFT)``
stands for play, friction and a stop alike; a third power stiffens."""

SAME = 1e-6
"""Difference of two speeds, over those at which friction is soft, below which they are one."""

MOST = 6
"""Poles up to which states are looked at: each is a test of its own."""


def inner_states(den: Array, delay: float, records: Sequence[Record], j: int) -> list[list[Array]]:
    """The states of a channel that is driven from rest, of standard deviation one.

    Parameters
    ----------
    den : (n + 1,) array
        Monic, descending powers.
    delay : float
        [s].
    records : sequence of Record
    j : int
        Of the input.

    Returns
    -------
    list of lists of (n_samples,) arrays
        Per state, one array per experiment; none where there are no states beside the output.
    """
    n = len(den) - 1
    if not 2 <= n <= MOST:
        return []
    numerators = [np.eye(k + 1)[0] for k in range(n)]
    moved = [
        simulate_each(
            numerators,
            den,
            delay,
            record._on_its_times(record.u),
            record.u[:, [j]] - record.u[0, j],
        )
        for record in records
    ]
    sizes = np.std(np.concatenate(moved), axis=0).tolist()
    return [[one[:, k] / size for one in moved] for k, size in enumerate(sizes) if size > 0.0]


def gripping(state: Sequence[Array]) -> list[Array]:
    """What takes hold of a motion beyond a small one."""
    return [np.asarray(np.tanh(one / SOFT)) for one in state]


def against(speed: Array, soft: float, *, held: bool = False) -> Array:
    """Against a motion, of one size; what stands still is held, by less.

    Where inputs are held, its mean over each sample, within which the speed moves on a line: the
    moment at which a motion turns is where a friction is told from what is smooth, and a direction
    that is taken from the beginning of each sample turns up to one of them late. The mean of
    ``tanh`` between two speeds is the difference of ``log cosh`` over that of the speeds.

    Parameters
    ----------
    speed : (n_samples,) array
    soft : float
        Speeds up to which it is less, over their root mean square.
    held : bool

    Examples
    --------
    >>> turning = np.array([2.0, 2.0, -1.0, -1.0])
    >>> against(turning, 0.01, held=True).round(2).tolist()
    [1.0, 0.33, -1.0, -1.0]
    """
    size = float(np.sqrt(np.mean(speed**2)))
    if not size > 0.0:
        return np.zeros(speed.size)
    over = speed / (soft * size)
    now = np.tanh(over)
    if not held:
        return np.asarray(now)
    ways = np.diff(over, append=over[-1:])
    risen = np.diff(np.logaddexp(over, -over), append=0.0)
    return np.asarray(np.divide(risen, ways, out=now, where=np.abs(ways) > SAME))


def on_the_way(signals: Sequence[Array], records: Sequence[Record]) -> list[Array]:
    """What moves while an input is held, as its mean over each sample.

    A force that is made of an output acts on from sample to sample; held at its value at the
    beginning of each it is half a sample late.

    Parameters
    ----------
    signals : sequence of (n_samples,) arrays
        Per experiment.
    records : sequence of Record
    """
    pairs = zip(signals, records, strict=True)
    return [
        np.asarray(0.5 * (one + np.append(one[1:], one[-1:])) if r.behaviour == "zoh" else one)
        for one, r in pairs
    ]


def turns(speed: Array) -> bool:
    """Whether a motion goes both ways, so that friction against it is more than an offset."""
    return bool(np.min(speed, initial=0.0) < 0.0 < np.max(speed, initial=0.0))
