"""The band of rates that a record can show, and poles placed over it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.numerics.arrays import Complex
from tridentify.numerics.realization import sort_poles

SLOW_EDGE = 3.0
"""Slowest rate times length of the record: it decays to 5 % within it."""
FAST_EDGE = 0.7
"""Fastest rate times sampling interval: nine samples a period. All grids hang on it: halved or
doubled, three of 28 estimates of the sensitivity benchmark move, none for the worse."""
BEYOND = 2.0
"""Over the fast edge, from which a pole has run out of the band."""
MOVED_DAMPING = 0.2
"""Damping of the pattern on which runaway poles are put back, where a pair is easiest drawn to a
resonance."""
MOVED_RADII = 10
"""Its radii over the band."""
SPREAD_DAMPING = (1.0, 0.3, 0.05)
"""Dampings of the poles spread over the band: real ones, and pairs for light and very light
damping. Doubled, two of 20 estimates end worse; halved, none."""


def rate_limits(problem: Problem) -> tuple[float, float]:
    """Slowest and fastest rate that the record can show [rad/s]: 3 / T and 0.7 / dt."""
    low = SLOW_EDGE / max(e.duration for e in problem.experiments)
    high = FAST_EDGE / min(e.dt for e in problem.experiments)
    if high > low:
        return low, high
    return float(np.sqrt(low * high)) * 0.99, float(np.sqrt(low * high)) * 1.01


def spread_poles(base: Problem, damping: float, count: int) -> Complex:
    """Poles over the whole band, real for a damping of 1 and in pairs below it."""
    return spread_between(*rate_limits(base), damping, count)


@lru_cache(maxsize=32)
def spread_between(low: float, high: float, damping: float, count: int) -> Complex:
    """The same between two rates; nobody may write into them."""
    if damping == 1.0:
        return -np.geomspace(low, 3.0 * high, count).astype(np.complex128)
    frequencies = np.geomspace(low, 3.0 * high, max(count // 2, 1))
    turn = -damping + 1j * np.sqrt(1.0 - damping**2)
    return sort_poles(np.concatenate([frequencies * turn, frequencies * turn.conjugate()]))


def relocated_poles(base: Problem, poles: Complex) -> list[Complex]:
    """Poles with those that ran out of the band put back into it, at several rates.

    Parameters
    ----------
    base : Problem
    poles : (n,) complex array
        Where a search ended. Poles faster than the band are moved, those of one denominator at a
        time; if there is none, the fastest pole or pair is.

    Returns
    -------
    list of (n,) complex arrays
        Admissible; the moved poles lie on a lightly damped pattern whose radius runs over the
        band.
    """
    low, high = rate_limits(base)
    found: list[Complex] = []
    fastest = max(range(len(base.groups)), key=lambda k: np.abs(poles[base.groups[k].poles]).max())
    for k, group in enumerate(base.groups):
        own = poles[group.poles]
        moved = np.abs(own) > BEYOND * high
        if not moved.any() and k == fastest:
            moved = np.isclose(np.abs(own), np.abs(own).max(), rtol=1e-9)
        if not moved.any():
            continue
        count = int(moved.sum())
        angles = np.pi / 2.0 + np.arcsin(MOVED_DAMPING) * (1.0 + np.arange(count // 2))
        pattern = np.concatenate([np.exp(1j * angles), np.exp(-1j * angles), -np.ones(count % 2)])
        for radius in np.geomspace(low, high, MOVED_RADII):
            whole = poles.copy()
            whole[group.poles] = sort_poles(np.concatenate([own[~moved], radius * pattern]))
            found.append(base.admissible(whole)[0])
    return found
