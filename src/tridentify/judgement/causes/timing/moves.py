"""Inputs of levels whose moves fall between the samples, each at a time of its own.

What switches by itself, or is logged beside another clock, moves at any time between two samples; a
held value says the second of them. With ``f`` the part of a sample by which a move came earlier,
the value over that sample is ``(1 - f)`` the old one and ``f`` the new one: the area is exact, and
what is left is of the second order in the sampling interval. So by each ``f`` the output moves by

    C = du * (response to one sample of a held input),

and with the sensitivities ``G`` of the coefficients (whitened, ``G'G = I``) and the innovations
``e`` over their standard deviation, all eliminated but ``f``,

    D = C - G G'C,      H = D'D + I / s^2,      f <- f + H^-1 (D'e - (f - m) / s^2).

``m`` and ``s`` are those of a time that is evenly spread over the sample: what the output does not
tell stays there. What the held samples miss is known for a model, as the response to a step that
comes later by part of a sample is exact: it is taken from the outputs. ``H^-1`` is the covariance
of the times, and ``- L G'C H^-1/2`` what they move of the coefficients, whose covariance is
``L L'`` where times are known.

*Whether.* ``-2 log`` of the evidence (Laplace's approximation; Kass & Raftery 1995) is

    -2 log L + |f - m|^2 / s^2 + log det(I + s^2 D'D),

beside the ``-2 log L`` of an input that is held from its samples on, or joined by lines. Each time
costs what the output tells of it, so that many moves are no better than few. A zero that is left
out is a response that comes earlier, and so is a clock that is late: where one shift of all moves
explains as much, nothing speaks for times of their own.

References
----------
R. E. Kass, A. E. Raftery, J. American Statistical Association 90 (1995), 773-795.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.curvature import Curvature
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.scores import whitened_scores
from tridentify.judgement.causes.attempts.intersample import seems_held
from tridentify.models.simulate import simulate_each
from tridentify.numerics.arrays import Array, Indices
from tridentify.record.record import Record

SAMPLES_A_MOVE = 4
"""Least of them on the average: an input that moves more often is one of samples, not of levels."""

FEWEST, MOST = 2, 400
"""Moves: one time is told apart from a delay by none; each is a column to be fitted."""

MOVES = 16
"""From which all of them being at every k-th sample is no chance."""

EARLIER = 0.5
"""Mean of how much earlier a move came, over the interval in which it was not looked at."""

EVENLY_SPREAD = 1.0 / np.sqrt(12.0)
"""Its standard deviation, evenly spread."""


def moves_of(record: Record) -> Indices:
    """(m,) samples at which an input moves; empty where it is not one of levels.

    Examples
    --------
    >>> u = np.repeat([0.0, 1.0, -1.0, 0.0], 10)
    >>> moves_of(Record(u, u, dt=0.1)).tolist(), moves_of(Record(u.cumsum(), u, dt=0.1)).tolist()
    ([10, 20, 30], [])
    """
    jumps = np.flatnonzero(np.any(np.diff(record.u, axis=0) != 0.0, axis=1)) + 1
    few = FEWEST <= jumps.size <= min(record.n_samples / SAMPLES_A_MOVE, MOST)
    return jumps if few and seems_held([record]) else jumps[:0]


def repeats(jumps: Indices) -> int:
    """Samples of which all moves are whole multiples apart; 0 where there are too few moves.

    Parameters
    ----------
    jumps : (m,) integer array
        Where an input moves.

    Examples
    --------
    >>> repeats(4 * np.arange(20) + 3), repeats(np.arange(9))
    (4, 0)
    """
    return math.gcd(*np.diff(jumps).tolist()) if jumps.size >= MOVES else 0


def moved_earlier(record: Record, jumps: Indices, early: Array) -> Record:
    """With every move of the inputs earlier, held over each sample at the mean over it.

    Parameters
    ----------
    record : Record
        Of even time.
    jumps : (m,) integer array
        Where inputs move.
    early : (m,) array
        [samples]
    """
    n = record.n_samples
    at = np.maximum.accumulate(np.clip(jumps - early, 0.0, n))
    ends = np.concatenate([[-1.0], at, [n + 1.0]])
    columns = []
    for u in record.u.T:
        values = np.append(u[0], u[jumps])
        area = np.concatenate([[0.0], np.cumsum(values * np.diff(ends))])
        columns.append(np.diff(np.interp(np.arange(n + 1), ends, area)))
    return record._derive(u=np.stack(columns, axis=1)).between("zoh")


@dataclass(frozen=True, eq=False)
class Times:
    """What a model's outputs tell of when the moves came.

    Attributes
    ----------
    sooner : (m,) array
        How much earlier still [samples].
    price : float
        What the times cost in ``-2 log`` of the evidence where they are now.
    gain : float
        How much the step promises of the same.
    tied : (n_coefficients, m) array
        Moves of the coefficients, each as likely as a standard error.
    std : (m,) array
        Standard errors of the times [samples].
    alike : float
        What the price would rise by, and ``-2 log L``, if all moves came earlier by one shift.
    """

    sooner: Array
    price: float
    gain: float
    tied: Array
    std: Array
    alike: float


def times_told(
    point: Point, record: Record, delay: Array, jumps: Indices, early: Array, every: int = 1
) -> Times | None:
    """Times of the moves, beside all else that is estimated.

    Parameters
    ----------
    point : Point
        At its end for the record whose moves came ``early``.
    record : Record
        As it was recorded.
    delay : (n_outputs, n_inputs) array
        [s]
    jumps : (m,) integer array
    early : (m,) array
        [samples]
    every : int
        Samples over which a time is not known.

    Returns
    -------
    Times or None
        None where nothing is left that could tell.
    """
    curvature, problem = Curvature.at(point), point.problem
    if not np.all(curvature.noise > 0.0):
        return None
    outputs = range(problem.n_outputs)
    # at the limit only later is left
    begins = np.maximum(np.ceil(jumps - early).astype(int) - 1, jumps - every)
    pulses = _pulses(point, record, delay, jumps, np.maximum(begins, 0))
    (experiment,) = problem.experiments
    moved = []
    for i in outputs:
        (own,) = point.sensitivities(curvature.root, i)
        moved.append([np.hstack([own / experiment.scale_of(i), pulses[i]])])
    ((both, left),) = whitened_scores(point.standardised(), moved, problem.noise, curvature.noise)
    k = curvature.root.shape[1]
    rows, e = both.reshape(-1, both.shape[-1]), left.reshape(-1)
    g, c = rows[:, :k], rows[:, k:]
    tied = g.T @ c
    d = c - g @ tied
    mean, size = EARLIER * every, EVENLY_SPREAD * every
    away = early - mean
    precision = d.T @ d + np.eye(jumps.size) / size**2
    toward = d.T @ e - away / size**2
    lower = np.linalg.cholesky(precision)
    half = np.linalg.solve(lower, toward)
    sooner = np.linalg.solve(lower.T, half)
    spread = np.linalg.inv(lower)
    occam = 2.0 * float(np.log(np.diag(lower)).sum()) + 2.0 * jumps.size * float(np.log(size))
    price = float(away @ away) / size**2 + occam
    return Times(
        sooner=sooner,
        price=price,
        gain=float(half @ half),
        tied=-(curvature.along @ tied) @ spread.T,
        std=np.linalg.norm(spread, axis=0),
        alike=_by_one_shift(d.T @ d, early, away / size**2, mean, size) - price,
    )


def _by_one_shift(told: Array, early: Array, pull: Array, mean: float, size: float) -> float:
    """Price of one shift for all moves, and how much higher ``-2 log L`` is with the best one.

    Around the times at their best, where ``-2 log L`` pulls as much as what is known beforehand.
    """
    weight = told.sum(axis=0)
    shift = (float(weight @ early + pull.sum()) + mean / size**2) / (
        float(weight.sum()) + 1.0 / size**2
    )
    other = shift - early
    higher = float(other @ told @ other - 2.0 * pull @ other)
    return higher + ((shift - mean) / size) ** 2 + float(np.log1p(size**2 * weight.sum()))


def _pulses(
    point: Point, record: Record, delay: Array, jumps: Indices, begins: Indices
) -> list[Array]:
    """Per output, (n_samples, m) responses to every move over the sample in which it came."""
    count = record.n_samples
    steps = np.diff(record.u, axis=0)[jumps - 1]
    held, first = record.between("zoh"), np.zeros((count, 1))
    first[0] = 1.0
    found = [np.zeros((count, jumps.size)) for _ in point.problem.n_zeros]
    for i, j, num, den in _channels(point):
        one = simulate_each(num, den, float(delay[i, j]), held, first)[:, 0]
        for k, start in enumerate(begins):
            found[i][start:, k] += steps[k, j] * one[: count - start]
    return found


def less_what_is_missed(
    point: Point, record: Record, delay: Array, jumps: Indices, early: Array
) -> Record:
    """A record with its moves earlier, and its outputs without what the held samples miss of these.

    Parameters
    ----------
    point : Point
        The model.
    record : Record
        As it was recorded.
    delay : (n_outputs, n_inputs) array
        [s]
    jumps : (m,) integer array
    early : (m,) array
        [samples]
    """
    moved, step = moved_earlier(record, jumps, early), float(record.dt or 0.0)
    at = np.clip(jumps - early, 0.0, record.n_samples - 1.0)
    before = np.floor(at).astype(int)
    later = (at - before) * step
    steps, y = np.diff(record.u, axis=0)[jumps - 1], np.array(record.y)
    level = np.ones((record.n_samples, 1))
    for i, j, num, den in _channels(point):
        own = float(delay[i, j])
        change = moved.u[:, [j]] - record.u[0, j]
        y[:, i] += simulate_each(num, den, own, moved, change)[:, 0]
        for k, start in enumerate(before):
            one = simulate_each(num, den, own + float(later[k]), moved, level)[:, 0]
            y[start:, i] -= steps[k, j] * one[: record.n_samples - start]
    return moved._derive(y=y)


def _channels(point: Point) -> Iterator[tuple[int, int, Array, Array]]:
    """Output, input, numerator and denominator of each."""
    problem, theta = point.problem, coefficients(point)
    den, at = np.append(1.0, theta[: problem.n_poles]), problem.n_poles
    for i, row in enumerate(problem.n_zeros):
        for j, m in enumerate(row):
            yield i, j, theta[at : at + m + 1], den
            at += m + 1
