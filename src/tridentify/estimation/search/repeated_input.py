"""After how long an input repeats itself, and which delays the record can tell for that.

An input that comes again, as it was or inverted, explains an output as well with a delay of that
time more, the gain reversed if it is inverted. An output that comes a little *before* its input, as
one does where an edge lies within a sample, then looks late by nearly that time.

In a cycle of a loop that switches, as of a ship steered in a zigzag, an input comes again nearly,
and lags of the plant are as good as fewer of them, the gain reversed, and a delay of some of half a
cycle. The loop's own delay is less: an integrator switched by a relay that hears of it late turns
after two delays, and later where there are more lags or the relay waits.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.numerics.correlation import products_at_shifts
from tridentify.record.record import Record

LONGEST = 0.3
"""Share of a record within which delays are looked for where its start is not known."""

LONGEST_STATED = 0.6
"""Longest delay over the shortest record where the start is known, and leaves no sample out: the
rest must show the response."""

EARLIEST = 5
"""Samples by which an output may come before its input; a shift of more is seen in a plot."""

# correlation with itself, later, at which an input repeats itself, and below which it has moved
# on before that
REPEATED, MOVED_ON = 0.99, 0.5

NEARLY = 0.9
"""The same at which it does so nearly: four fifths of what it drives come again."""

LEAST = 0.5
"""Share of the time after which an input repeats itself within which delays are always told."""


def longest_told(records: Sequence[Record], channel: int) -> float:
    """Delay from which on an output may as well come before its input [s].

    Parameters
    ----------
    records : sequence of Record
    channel : int
        Position of the input.

    Returns
    -------
    float
        Infinite where the input of a record does not repeat itself.

    Examples
    --------
    >>> u = np.tile(np.repeat([1.0, -1.0], 20), 5)
    >>> longest_told([Record(u, u, dt=0.5)], 0)
    7.5
    """
    return min(_longest_told(record, channel) for record in records)


def _longest_told(record: Record, channel: int) -> float:
    exact = repeats(record, channel, LONGEST_STATED)
    nearly = repeats(record, channel, LONGEST, NEARLY)
    if nearly is not None and (exact is None or nearly[0] < exact[0]):
        return LEAST * nearly[0]
    if exact is None or record.dt is None:
        return np.inf
    return max(exact[0] - EARLIEST * record.dt, LEAST * exact[0])


def repeats(
    record: Record, channel: int, within: float = LONGEST, likeness: float = REPEATED
) -> tuple[float, int] | None:
    """After how long an input repeats itself, within the range where delays are looked for.

    Parameters
    ----------
    record : Record
    channel : int
        Position of the input.
    within : float
        That range, as a share of the record.
    likeness : float
        Correlation with itself, later, at which it is said to repeat itself.

    Returns
    -------
    tuple or None
        The time [s] and the sign with which it comes again; None where it does not, or where time
        is not uniform.

    Examples
    --------
    >>> u = np.tile([1.0, 1.0, 1.0, 0.0], 20)
    >>> repeats(Record(u, u, dt=0.5), 0)
    (2.0, 1)
    """
    if record.dt is None:
        return None
    n = record.n_samples
    u = record.u[:, channel] - record.u[:, channel].mean()
    most = int(within * n)
    if most < 2 or not np.any(u):
        return None
    # each of the two stretches about a mean of its own: inverted or not, a constant may be in both
    shifts = np.arange(most)
    products = products_at_shifts(u, u)[n - 1 : n - 1 + most]
    (first, last), (size, late) = (
        (sums[n - 1 - shifts], sums[-1] - np.concatenate([[0.0], sums[: most - 1]]))
        for sums in (np.cumsum(u), np.cumsum(u * u))
    )
    squares = (size - first**2 / (n - shifts)) * (late - last**2 / (n - shifts))
    # a stretch in which the input rests is like no other
    least = (np.finfo(float).eps * n * size[0]) ** 2
    alike = (products - first * last / (n - shifts)) / np.sqrt(np.maximum(squares, least))
    correlation = np.where(squares > least, alike, 0.0)
    away = np.flatnonzero(correlation < MOVED_ON)
    if not away.size:
        return None
    again = np.flatnonzero(np.abs(correlation[away[0] :]) > likeness)
    if not again.size:
        return None
    # the highest of those beside each other
    k = int(away[0] + again[0])
    while k + 1 < most and abs(correlation[k + 1]) > abs(correlation[k]):
        k += 1
    return k * record.dt, int(np.sign(correlation[k]))
