"""How uncertain delays are: a mixture of the minima and of the pieces between the kinks.

Near a maximum ``theta_k`` of the likelihood, where ``-2 log L = L_k``, the posterior density is a
Gaussian of the covariance ``C_k``. With the prior density ``p`` it holds the mass

    w_k = integral p exp(-(L_k + (theta - theta_k)' C_k^-1 (theta - theta_k)) / 2) d theta
        ~ p(theta_k) exp(-L_k / 2) sqrt(det C_k)

(Laplace's approximation: Tierney & Kadane 1986; for several maxima Gelman et al., Bayesian Data
Analysis, section 13.3). The prior is flat in the delays and, at known delays, that of Jeffreys in
all other unknowns, ``p = sqrt(det C_bb|t^-1)``. As ``det C = det C_tt det C_bb|t``, what is left is

    w_k = exp(-L_k / 2) sqrt(det C_tt) ,

the likelihood, all but the delays at its best, integrated over the delays. It does not depend on
how poles and zeros are expressed. A prior flat in the coefficients does: it gives a model with one
very fast pole, whose coefficients are large and have large errors, nearly all of the mass.

About the estimate ``theta_0`` the mixture has the second moments

    cov = sum_k w_k (C_k + (m_k - theta_0) (m_k - theta_0)') / sum_k w_k ,   m_k = theta_k .

A pole that ran out of the band may be anything from there to infinity, and trades places with a
delay by no more than its own time constant; a Gaussian of the coefficients says otherwise. Such
poles are held for ``C_k``.

Of a share below a hundredth no interval of 95 % knows, but its covariance may be without bounds:
such components are left out.

*Kinks.* Where a held input reaches the output with one zero less than there are poles, the slope
of the cost along a delay jumps at every whole step. Between two such steps, in a cell, the cost is
smooth, and its least value may lie at an end, with a slope ``g`` along the delays. The quadratic
model ``L_k + g' s + s' (C_k)_tt^-1 s`` of the cost along the delays, all else at its best, is the
Gaussian about ``m_k = theta_k - (C_k)_:t g / 2`` that is higher by ``exp(g' (C_k)_tt g / 8)`` and
of which only the part within the cell counts: the moments of a truncated Gaussian (one delay
after the other, which is exact for one or where they are not correlated). The cells
beside a cell with some share of the mass always belong to the mixture.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.curvature import Curvature
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    at_rounding,
    coefficients,
    finish,
)
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.likelihood.thresholds import (
    LEAST_MASS,
    NEAR,
    UNFINISHED,
    WHOLE_GAUSSIAN,
)
from tridentify.numerics.arrays import Array, Complex

LEAST_SHARE = 0.01
"""Share of the mass below which a component is left out: an interval of 95 % does not know of it,
but its covariance may be without bounds."""
MOST_CELLS = 24
"""Cells and other minima that are looked at: it bounds the time, some steps each."""
MOST_RIVAL_STEPS = 20
"""Steps to the least cost of one of them: it bounds the time."""
BEYOND_BAND = 1.4
"""Rate times sampling interval from which a pole is faster than the samples show: twice the fast
edge of the search's band (`starts.FAST_EDGE`)."""
INSET = 1e-6
"""Share of a cell by which its ends are moved inwards, so that it is clear on which side of the
kink a delay lies."""
SAME = 0.5
"""Standard errors of a delay within which two smooth minima are one."""
NODES, WEIGHTS = np.polynomial.legendre.leggauss(48)


class Component(NamedTuple):
    """One Gaussian: the log of its mass, mean and covariance of the coefficients."""

    log_mass: float
    mean: Array
    cov: Array

    @property
    def is_finite(self) -> bool:
        """Whether its mass and its moments are known."""
        moments = (self.mean, self.cov)
        return bool(np.isfinite(self.log_mass) and all(np.isfinite(one).all() for one in moments))

    def within(self, where: int, low: float, high: float) -> Component:
        """The part whose coefficient lies between two ends, by its first two moments."""
        center, variance = float(self.mean[where]), float(self.cov[where, where])
        if not variance > 0 or (np.isinf(low) and np.isinf(high)):
            return self
        nearest = min(max(center, low), high)
        reach = float(np.sqrt((nearest - center) ** 2 + WHOLE_GAUSSIAN * variance))
        first, last = max(low, center - reach), min(high, center + reach)
        s = 0.5 * (first + last) + 0.5 * (last - first) * NODES
        highest = -0.5 * (nearest - center) ** 2 / variance
        p = WEIGHTS * np.exp(-0.5 * (s - center) ** 2 / variance - highest)
        total = float(p.sum())
        mean = float(p @ s) / total
        spread = float(p @ (s - mean) ** 2) / total
        mass = np.log(0.5 * (last - first) * total) - 0.5 * np.log(2.0 * np.pi * variance)
        gain = self.cov[:, where] / variance
        return Component(
            self.log_mass + highest + float(mass),
            self.mean + gain * (mean - center),
            self.cov + np.outer(gain, gain) * (spread - variance),
        )


class Mixture(NamedTuple):
    """Shares of the components, and their moments about a point.

    Attributes
    ----------
    shares : (k,) array
    means : (k, n) array
    cov : (n, n) array
    """

    shares: Array
    means: Array
    cov: Array


def combined(components: Sequence[Component], about: Array) -> Mixture:
    """Second moments of a mixture about a point.

    Examples
    --------
    >>> two = [Component(0.0, np.array([m]), np.eye(1)) for m in (0.0, 2.0)]
    >>> combined(two, np.zeros(1)).cov
    array([[3.]])

    One whose curvature says nothing, not even how much it holds, does not count.

    >>> combined([*two, Component(np.nan, np.ones(1), np.eye(1))], np.zeros(1)).cov
    array([[3.]])
    """
    components = [one for one in components if one.is_finite]
    logs = np.array([one.log_mass for one in components])
    shares = np.exp(logs - logs.max())
    kept = np.flatnonzero(shares > LEAST_SHARE * shares.sum()).tolist()
    shares = shares[kept] / shares[kept].sum()
    means = np.array([components[k].mean for k in kept])
    away = means - about
    inner = np.einsum("k,kij->ij", shares, np.array([components[k].cov for k in kept]))
    return Mixture(shares, means, inner + (away.T * shares) @ away)


class Cell(NamedTuple):
    """Between which ends each delay lies; infinite where nothing there has a kink."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def around(cls, problem: Problem, delays: Array) -> Cell:
        """The cell that some delays lie in; of two that meet there the later one."""
        assert problem.limits is not None
        steps = [e.dt for e in problem.experiments if e.intersample == "zoh" and e.t is None]
        low, high = [], []
        for j, delay in enumerate(delays.tolist()):
            row = [(i, zeros[j]) for i, zeros in enumerate(problem.n_zeros)]
            if not steps or all(m < problem.order(i, j) - 1 for i, m in row):
                low.append(-np.inf)
                high.append(np.inf)
                continue
            whole = [float(np.floor(delay / dt + 1e-9)) for dt in steps]
            low.append(max(k * dt for k, dt in zip(whole, steps, strict=True)))
            ends = [(k + 1.0) * dt for k, dt in zip(whole, steps, strict=True)]
            high.append(min([*ends, max(float(problem.limits[j]), delay)]))
        return cls(tuple(low), tuple(high))

    @property
    def key(self) -> tuple[float, ...]:
        """Two cells are the same where this is."""
        return tuple(float(f"{low:.9g}") for low in self.low)

    @property
    def kinked(self) -> list[int]:
        """Delays with an end."""
        return [j for j, low in enumerate(self.low) if np.isfinite(low)]

    def beside(self, delays: Array) -> list[Array]:
        """Delays just within the neighbours, from some within."""
        found = []
        for j in self.kinked:
            width = self.high[j] - self.low[j]
            for end in (self.low[j] - INSET * width, self.high[j] + INSET * width):
                moved = delays.copy()
                moved[j] = end
                found.append(moved)
        return found

    def end(self, problem: Problem, delays: Array, poles: Complex) -> Point:
        """The least cost within, from some delays and poles."""
        assert problem.limits is not None
        low, high = np.array(self.low), np.array(self.high)
        with np.errstate(invalid="ignore"):
            inset = np.where(np.isfinite(low), INSET * (high - low), 0.0)
        floors = np.where(np.isfinite(low), low + inset, 0.0)
        limits = np.where(np.isfinite(low), high - inset, problem.limits)
        floors = np.where(low == 0.0, 0.0, floors)
        late = problem.delayed(np.clip(delays, floors, limits)).freed(limits, floors)
        at = partial(evaluate, late)
        return finish(at, at(poles), None, MOST_RIVAL_STEPS)[0]


def fast_poles(point: Point) -> Array:
    """(k, n_coefficients) derivatives of the logarithms of poles beyond the band."""
    problem = point.problem
    band = BEYOND_BAND / min(e.dt for e in problem.experiments)
    found = []
    for group, place in zip(problem.groups, problem.places()[0], strict=True):
        own = point.poles[group.poles]
        for k in np.flatnonzero((np.abs(own) > band) & (own.imag >= 0)):
            slope = -(own[k] ** np.arange(own.size - 2.0, -2.0, -1.0))
            slope = slope / np.prod(own[k] - np.delete(own, k))
            for part in (slope.real, slope.imag) if own[k].imag else (slope.real,):
                row = np.zeros(problem.n_coefficients)
                row[place] = part
                found.append(row)
    return np.array(found).reshape(-1, problem.n_coefficients)


def component(point: Point, cell: Cell, *, whole: bool = False) -> Component:
    """The Gaussian at a point, within its cell.

    Parameters
    ----------
    point : Point
        Where the cost is least in the cell.
    cell : Cell
    whole : bool
        Whether poles faster than the samples can show count with their standard errors.
    """
    full, theta = Curvature.at(point).covariance, coefficients(point)
    held = fast_poles(point)
    cov = Curvature.at(point, held=held).covariance if held.size else full
    first = theta.size - point.problem.n_delays
    ends = [first + j for j in cell.kinked]
    slopes = point.delay_slopes[cell.kinked]
    volume = float(np.linalg.slogdet(cov[first:, first:])[1])
    lift = 0.25 * float(slopes @ cov[np.ix_(ends, ends)] @ slopes)
    found = Component(
        -0.5 * (point.objective - lift) + 0.5 * volume,
        theta - 0.5 * cov[:, ends] @ slopes,
        cov,
    )
    for j, where in zip(cell.kinked, ends, strict=True):
        found = found.within(where, cell.low[j], cell.high[j])
    if whole and held.size:
        found = found._replace(cov=found.cov + full - cov)
    return found


def mixture(best: Point, others: Sequence[tuple[Array, Complex]]) -> Mixture | None:
    """All minima near the best, and the cells between kinks around them.

    Parameters
    ----------
    best : Point
        With free delays, where the cost is least.
    others : sequence of (delays, poles)
        Where else minima may lie.

    Returns
    -------
    Mixture or None
        About the coefficients of ``best``; None where that alone counts and has no kink beside it,
        or has no curvature.
    """
    if at_rounding(best):
        return None
    problem = best.problem
    home = Cell.around(problem, problem.delays)
    std = Curvature.at(best).std
    if not home.kinked and not others:
        return None
    first = home.end(problem, problem.delays, best.poles) if home.kinked else best
    ends = [(first, home)]
    found = [component(first, home, whole=True)]
    if not found[0].is_finite:
        return None
    tried = 0
    queue = [(np.inf, delays, poles) for delays, poles in others]
    queue += [(np.inf, one, best.poles) for one in home.beside(problem.delays)]
    seen = {home.key} if len(home.kinked) == problem.n_delays else set()
    while queue and tried < MOST_CELLS:
        _, delays, poles = queue.pop(max(range(len(queue)), key=lambda k: queue[k][0]))
        assert problem.limits is not None
        cell = Cell.around(problem, delays)
        if np.any(delays < 0) or np.any(delays > problem.limits) or cell.key in seen:
            continue
        if len(cell.kinked) == problem.n_delays:
            seen.add(cell.key)
        tried += 1
        end = cell.end(problem, delays, poles)
        if end.objective > best.objective + NEAR:
            continue
        if cell.key not in seen and end.decrease() > UNFINISHED:
            continue
        if _known(end, cell, ends, std):
            continue
        ends.append((end, cell))
        found.append(component(end, cell))
        if found[-1].log_mass > max(one.log_mass for one in found) - LEAST_MASS:
            mass = found[-1].log_mass
            queue += [(mass, one, end.poles) for one in cell.beside(end.problem.delays)]
    if len(found) == 1 and not home.kinked:
        return None
    return combined(found, coefficients(best))


def _known(end: Point, cell: Cell, ends: Sequence[tuple[Point, Cell]], std: Array) -> bool:
    """Whether a point is one of others, up to a share of its standard error where nothing ends."""
    open_ = np.setdiff1d(np.arange(end.problem.n_delays), cell.kinked)
    near = SAME * std[-end.problem.n_delays :][open_]
    return any(
        other.key == cell.key
        and bool(np.all(np.abs(end.problem.delays - one.problem.delays)[open_] <= near))
        for one, other in ends
    )
