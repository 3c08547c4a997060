"""Where the posterior is looked for first: anywhere, and about the end of a search.

Where a record shows some sections well and another not at all, hardly a draw from a box over the
band has the former right, and a kernel at the end of a search has the latter at one place of many.
So there are also draws with one section from the box and the others near the end, as far as the
likelihood lets them go while that one is held. They cover what one pole or pair too many leaves
open, and other places of one that lies wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.posterior.many_cascades import coordinates, phi_of_a
from tridentify.estimation.posterior.sampling import (
    Box,
    PartlyBox,
    Proposal,
    ProposalMixture,
    StudentKernels,
)
from tridentify.estimation.posterior.surface import surface, unit_of
from tridentify.numerics.arrays import Array, Complex, Flags

SEVERAL = 3
"""Poles from which there are several sections."""
SLOW_EDGE, FAST_EDGE = 0.3, 4.5
"""Box of the first draws: rates from 0.3 over the record's length to 4.5 over the sampling
interval, a factor of three beyond where the prior of `posterior.surface` begins to fall."""
LEAST_DAMPING, MOST_DAMPING = 0.02, 6.0
"""The same for the damping of a section: from light to two real poles a factor of 140 apart."""
SPREAD = (0.02, 1.0)
"""Least and largest standard deviation, in log rate and log damping, of the kernel at the end of a
search."""
FINE = 0.002
"""The least where the likelihood's curvature is known."""
WIDENED = 2.0
"""Standard deviations of these kernels over those of the likelihood with the section held."""
ANYWHERE = 0.2
"""Share of the first draws from all of the box."""
NEAR, PARTLY = 1.0, 3.0
"""Of the others, from kernels and from kernels with a section from the box, in this ratio: the
latter have more to cover."""
BEND = 2e-3
"""Step of central second differences of the log density, in log rate and log damping."""


def first_draws(problem: Problem, near: Sequence[tuple[Complex, Array | None]]) -> ProposalMixture:
    """A box over the recorded band, kernels at the ends of searches, and both, section by section.

    Parameters
    ----------
    problem : Problem
    near : sequence of (poles, covariance)
        As of `posterior.mean.posterior`.
    """
    box = _band(problem)
    kernels: list[Proposal] = []
    partly: list[Proposal] = []
    for poles, cov in near:
        phi = coordinates(poles * unit_of(problem))
        if not np.all(np.isfinite(phi)):
            continue
        partly += _by_section(problem, poles * unit_of(problem), box)
        if not np.any(_outside(phi, box)):
            kernels.append(_about(problem, phi, cov))
    groups = [(one, share) for one, share in ((kernels, NEAR), (partly, PARTLY)) if one]
    if not groups:
        return ProposalMixture((box,), (1.0,))
    known = sum(share for _, share in groups) / (1.0 - ANYWHERE)
    weights = [share / known / len(one) for one, share in groups for _ in one]
    return ProposalMixture((box, *kernels, *partly), (ANYWHERE, *weights))


def _band(problem: Problem) -> Box:
    """Coordinates of poles within the recorded band."""
    n = problem.n_poles
    length = max(e.duration for e in problem.experiments) / unit_of(problem)
    pairs, left = n // 2, n % 2
    low = np.log([SLOW_EDGE / length, LEAST_DAMPING] * pairs + [SLOW_EDGE / length] * left)
    return Box(low, np.log([FAST_EDGE, MOST_DAMPING] * pairs + [FAST_EDGE] * left))


def _about(problem: Problem, phi: Array, cov: Array | None) -> StudentKernels:
    """A kernel at the end of a search; ``cov`` is that of the denominator."""
    spread = SPREAD[1] ** 2 * 0.1 * np.eye(phi.size)
    if cov is not None and np.all(np.isfinite(cov)):
        scale = unit_of(problem) ** np.arange(1, phi.size + 1)
        inverse = phi_of_a(phi)
        spread = inverse @ (cov * np.outer(scale, scale)) @ inverse.T
    return StudentKernels(phi[None], _root(spread, SPREAD[0]))


def _outside(phi: Array, box: Box) -> Flags:
    """(n,) coordinates of rates far beyond the box; a search may have ended on any damping."""
    found = (phi < box.low - 1.0) | (phi > box.high + 1.0)
    found[1 : 2 * (phi.size // 2) : 2] = False
    return np.asarray(found)


def _by_section(problem: Problem, poles: Complex, box: Box) -> list[Proposal]:
    """One section from the box, widened to where it ended; the others near the end."""
    n = poles.size
    if n < SEVERAL:
        return []
    found: list[Proposal] = []
    for freed in _sections(poles):
        phi, free = _beside(poles[~freed], poles[freed])
        if np.any(_outside(phi, box) & ~free):
            continue
        spread = np.asarray(np.linalg.pinv(_bend(problem, phi, ~free), hermitian=True))
        kernels = StudentKernels(phi[None, ~free], _root(WIDENED**2 * spread, FINE))
        low, high = np.minimum(box.low, phi - 0.5)[free], np.maximum(box.high, phi + 0.5)[free]
        found.append(PartlyBox(free, Box(low, high), kernels))
    return found


def _sections(poles: Complex) -> list[Flags]:
    """(n,) each: complex pairs, real poles by twos and, where their number is odd, by themselves.

    A record that shows one of three real poles leaves the other two open, whichever they are.
    """
    place = np.arange(poles.size)
    real = place[poles.imag == 0].tolist()
    chosen: list[tuple[int, ...]] = [
        (k, int(np.argmin(np.abs(poles - poles[k].conjugate())))) for k in place[poles.imag > 0]
    ]
    chosen += combinations(real, 2)
    chosen += [(k,) for k in real if poles.size % 2]
    return [np.isin(place, one) for one in chosen]


def _beside(kept: Complex, freed: Complex) -> tuple[Array, Flags]:
    """(n,) coordinates of all poles with those freed as a section of their own, and which it is."""
    rest, own = coordinates(kept), coordinates(freed)
    at = 2 * (rest.size // 2)
    free = np.zeros(rest.size + own.size, dtype=bool)
    free[at : at + own.size] = True
    return np.concatenate([rest[:at], own, rest[at:]]), free


def _root(spread: Array, least: float) -> Array:
    """Of a scale matrix, with standard deviations from ``least`` to the largest of `SPREAD`."""
    values, vectors = np.linalg.eigh(0.5 * (spread + spread.T))
    values = np.clip(values, least**2, SPREAD[1] ** 2)
    return np.asarray(np.linalg.cholesky((vectors * values) @ vectors.T))


def _bend(problem: Problem, phi: Array, kept: Flags) -> Array:
    """(k, k) curvature of minus the log density, by central differences; no negative one."""
    steps = BEND * np.eye(phi.size)[kept]
    n = len(steps)
    pairs = [(i, j) for i in range(n) for j in range(i + 1)]
    signs = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))
    points = [phi + a * steps[i] + b * steps[j] for i, j in pairs for a, b in signs]
    values = surface(problem, np.array(points)).log_density.reshape(len(pairs), 4)
    found = np.zeros((n, n))
    for (i, j), (pp, pm, mp, mm) in zip(pairs, values, strict=True):
        found[i, j] = found[j, i] = -(pp - pm - mp + mm) / (4.0 * BEND**2)
    size, vectors = np.linalg.eigh(np.nan_to_num(found))
    return np.asarray((vectors * np.maximum(size, 0.0)) @ vectors.T)
