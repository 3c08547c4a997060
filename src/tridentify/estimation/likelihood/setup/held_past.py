"""For how long the inputs may be taken as held before the record began.

A free initial state stands for inputs before the record that nobody knows, and what they would
explain is left out. Of a step test they are known well enough: an input that rests when the record
begins, and later rests for longer still, rested before as well. Leaving out what it explains would
leave out the step itself, and a free state would explain the rise.
"""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

LEAST_AT_REST = 8
"""Samples at rest from which their noise is known, and with it whether anything moves."""
SIGMAS = 3.0
"""Standard errors within which the halves of a rest agree."""
SMALL = 0.05
"""Share of all that an output moves from which on such a difference would not be seen."""


def held_before(u: Array, since: Array) -> float:
    """How long before its first sample all inputs were zero, by all that the record tells [s].

    Parameters
    ----------
    u : (n_samples, n_inputs) array
        Inputs. Of one that does not begin at zero nothing is known.
    since : (n_samples,) array
        Instants from zero [s].

    Examples
    --------
    >>> u = np.concatenate([np.zeros(20), np.ones(80)])[:, None]
    >>> float(held_before(u, 0.5 * np.arange(100)))
    30.0
    """
    if np.any(u[0]):
        return 0.0
    end = 2.0 * since[-1] - since[-2]
    moving = [column for column in u.T if np.any(column)]
    return min((_held(column, since, end) for column in moving), default=0.0)


def _held(u: Array, since: Array, end: float) -> float:
    """For how long one input was held before: its rests tell how long one goes on that has begun.

    Of those that last as long as the first is seen to last, the shortest says how much of it came
    before the record. Where none does the record begins at a rest unlike all others, and what is
    seen of it is taken as the half.
    """
    changes = since[1:][np.diff(u) != 0.0]
    begun = float(changes[0])
    if begun == since[1]:
        return 0.0  # one sample is no rest
    rests = np.diff(np.append(changes, end))
    as_long = rests[rests >= begun]
    return float(as_long.min()) - begun if as_long.size else begun


def at_rest(record: Record, since: Array, longest: float) -> bool:
    """Whether a record begins in equilibrium, by what its first samples show.

    No input moves for a while, all were held long before, and no output moves meanwhile by more
    than its noise, which is small beside the response.

    Parameters
    ----------
    record : Record
    since : (n_samples,) array
        Instants from zero [s].
    longest : float
        For how long before the record the inputs must have been held [s].
    """
    moved = record.u - record.u[0]
    if not np.any(moved) or held_before(moved, since) < longest:
        return False
    rest = int(np.argmax(np.any(moved, axis=1)))
    if rest < LEAST_AT_REST:
        return False
    return all(_is_quiet(y[:rest], float(np.nanmax(y) - np.nanmin(y))) for y in record.y.T)


def _is_quiet(y: Array, span: float) -> bool:
    """Whether the halves of some samples differ by their noise alone."""
    y = y[np.isfinite(y)]
    if y.size < LEAST_AT_REST:
        return False
    middle = y.size // 2
    # of samples apart by one, so that a ramp counts little
    noise = float(np.sqrt(np.mean(np.diff(y) ** 2) / 2.0))
    sure = SIGMAS * noise * np.sqrt(4.0 / y.size)
    return bool(abs(y[:middle].mean() - y[middle:].mean()) <= sure <= SMALL * span) or not (
        np.ptp(y)
    )
