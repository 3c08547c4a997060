r"""The cost over two coefficients: the ravine of the output error, and the bowl of Step 2.

*Output error.* At given poles all else is linear, and eliminated by least squares
(`tridentify.estimation.likelihood.cost`). A numerator coefficient that is held at ``v`` instead
raises an output's residual sum of squares by the quadratic ``(v - T x)' (T (M' M)^{-1} T')^{-1} (v
- T x)``, with the fit ``x`` of the columns ``M`` and the map ``T`` from them to the coefficient.
Both are exact, so that every number is the cost itself and no model of it. Further denominator
coefficients, of models of higher than second order, follow the two along the plane of their
conditional means, ``a_r = \hat a_r + C_{r,12} C_{12}^{-1} (a_{12} - \hat a_{12})``, where they
would go if the cost were a paraboloid; where there is no covariance they stay.

*Step 2.* With the filter ``1 / c`` on the denominator ``c`` of one pass, and the output ``y_M`` of
its parallel model, the equation error ``(a / c) y_M - (b / c) x`` is linear in all coefficients
(`tridentify.models.series_parallel`). Its mean square over two of them, the others at their best,
is a quadratic: an elliptic bowl with one minimum, which is the next pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tridentify.errors import ChannelCountError, OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.setup.nuisance import build, candidates
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.search.passes import parallel_model
from tridentify.models.series_parallel import Filtering, equation_error, polynomial
from tridentify.numerics.arrays import Array
from tridentify.numerics.least_squares import column_norms, solve
from tridentify.numerics.realization import Cascade, DegreeBasis, denominator, numerators
from tridentify.record.record import Record

ALMOST = 1e-6
"""Real part relative to the magnitude of a pole from which it counts as unstable: rounding of
roots."""


@dataclass(frozen=True, eq=False)
class CostSurface:
    """Mean-square output error over two coefficients.

    Attributes
    ----------
    names : tuple of str
        Of the two.
    first, second : ndarray, shape (n_first,), (n_second,)
        Their values.
    cost : ndarray, shape (n_first, n_second)
        In units of the outputs squared (geometric mean over several outputs); ``nan`` where the
        model is not stable.
    """

    names: tuple[str, str]
    first: Array
    second: Array
    cost: Array


@dataclass(frozen=True, eq=False)
class Bowl:
    """A mean square that is quadratic in two coefficients.

    Attributes
    ----------
    centre : ndarray, shape (2,)
        Where it is least.
    least : float
    curvature : ndarray, shape (2, 2)
        ``cost = least + d' curvature d`` at ``d`` from the centre.
    """

    centre: Array
    least: float
    curvature: Array

    def cost(self, first: npt.ArrayLike, second: npt.ArrayLike) -> Array:
        """The mean square at points; arguments are broadcast."""
        x = np.asarray(first, dtype=np.float64) - self.centre[0]
        y = np.asarray(second, dtype=np.float64) - self.centre[1]
        c = self.curvature
        return np.asarray(self.least + c[0, 0] * x * x + 2 * c[0, 1] * x * y + c[1, 1] * y * y)


def cost_surface(
    estimate: Estimate,
    records: Record | Sequence[Record],
    coefficients: tuple[str, str],
    first: npt.ArrayLike,
    second: npt.ArrayLike,
) -> CostSurface:
    """Mean-square output error over two coefficients, all others at their best.

    Parameters
    ----------
    estimate : Estimate
    records : Record or sequence of Record
        What was identified.
    coefficients : tuple of two str
        Names of the estimate; delays are not among them.
    first, second : array_like
        Values of the two.

    Returns
    -------
    CostSurface

    Raises
    ------
    ChannelCountError
        The record has other channels.
    OptionError
        The coefficients are not two of the estimate's.

    Notes
    -----
    Offset, drift and initial state are eliminated where the estimate has them. A model of the
    noise whitens the residual, as in the estimation; a robust loss is not used.

    Examples
    --------
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> u = np.repeat([1.0, -1.0, 1.0, -1.0], 25)
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))
    >>> record = Record(u, y, dt=0.02)
    >>> estimate = identify(record, Structure(1, 0))
    >>> surface = cost_surface(estimate, record, ("a0", "b0"), [4.0, 5.0], [2.0])
    >>> bool(surface.cost[0, 0] < 1e-12 < surface.cost[1, 0])
    True
    """
    pair = _positions(estimate, coefficients)
    problem = problem_of(estimate, records)
    x, y = (np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in (first, second))
    cost = np.full((x.size, y.size), np.nan)
    known: dict[bytes, Point | None] = {}
    for i, value in enumerate(x.tolist()):
        for j, other in enumerate(y.tolist()):
            theta = _followed(estimate, problem, pair, np.array([value, other]))
            key = theta[problem.denominator_places()].tobytes()
            if key not in known:
                known.clear()
                known[key] = point_at(problem, theta)
            point = known[key]
            if point is not None:
                cost[i, j] = _mean_square(problem, point, pair, (value, other))
    return CostSurface((coefficients[0], coefficients[1]), x, y, cost)


def step_2_bowl(
    estimate: Estimate,
    records: Record | Sequence[Record],
    coefficients: tuple[str, str],
    theta: npt.ArrayLike,
) -> Bowl:
    """What Step 2 minimises, over two coefficients with all others at their best.

    Parameters
    ----------
    estimate : Estimate
    records : Record or sequence of Record
        What was identified.
    coefficients : tuple of two str
        Names of the estimate; delays are not among them.
    theta : array_like
        Coefficients of the pass whose denominator is the filter, in the order of the estimate.

    Returns
    -------
    Bowl
        Mean square of the equation error, each output in units of its own residual.

    Raises
    ------
    ChannelCountError
        The record has other channels.
    OptionError
        The coefficients are not two of the estimate's, or the pass has an unstable denominator.
    """
    pair = _positions(estimate, coefficients)
    problem = problem_of(estimate, records)
    point = point_at(problem, np.asarray(theta, dtype=np.float64), repeats=3)
    if point is None:
        raise OptionError(
            "found a pass with an unstable denominator; expected a stable one to filter with; "
            "choose another pass"
        )
    filterings = [Filtering.adapted(branch) for branch in point.branches]
    columns, matrix, target = equation_error(
        point.regressions,
        parallel_model(point).response,
        filterings,
        problem.n_zeros,
        point.weights,
    )
    solution = solve(matrix, target)
    maps = np.zeros((2, matrix.shape[1]))
    start = np.zeros(2)
    a_places, b_places = problem.places()
    for row, k in enumerate(pair):
        for g, (place, one) in enumerate(zip(a_places, filterings, strict=True)):
            if place.start <= k < place.stop:
                table = one.basis.rows[: one.n_poles] @ numerators(one.filter_bank.poles)
                maps[row, columns.width["a", g]] = table[:, k - place.start]
                start[row] = denominator(one.filter_bank.poles)[1 + k - place.start]
        for (i, j), place in b_places.items():
            if place.start <= k < place.stop:
                one = next(f for f in filterings if f.channels[i, j])
                own = columns.width["b", i, j]
                maps[row, own] = _numerator_map(
                    one.filter_bank, one.basis, own.stop - own.start, problem.n_zeros[i][j]
                )[:, k - place.start]
    count = float(point.counts.sum())
    curvature = np.asarray(np.linalg.inv(_spread(matrix, maps)) / count, dtype=np.float64)
    return Bowl(start + maps @ solution.x, solution.cost / count, curvature)


def problem_of(estimate: Estimate, records: Record | Sequence[Record]) -> Problem:
    """The records with the structure, nuisance terms, delays and noise of an estimate."""
    given = (records,) if isinstance(records, Record) else tuple(records)
    several = tuple(one.settled(estimate.intersample) for one in given)
    wanted = len(estimate.input_names), len(estimate.output_names)
    for one in several:
        if (one.n_inputs, one.n_outputs) != wanted:
            raise ChannelCountError(
                f"found a record with {one.n_inputs} inputs and {one.n_outputs} outputs; expected "
                f"{wanted[0]} and {wanted[1]} as identified; give the record that was identified"
            )
    structure = replace(
        estimate.structure,
        delay=tuple(map(tuple, np.asarray(estimate.model.delay).tolist())),
        fixed=None,
        bounds=None,
        equalities=None,
        priors=None,
        static_gain=None,
    )
    problem = build(several, structure, candidates(several, structure)[0])
    if any(a.size for a in estimate.noise_model):
        problem = problem.whitened(estimate.noise_model)
    return problem


def point_at(problem: Problem, theta: Array, repeats: int = 1) -> Point | None:
    """The best fit at the denominators of a parameter vector; None where one is not stable."""
    poles = np.concatenate(
        [np.roots(np.append(1.0, theta[place])) for place in problem.places()[0]]
    ).astype(np.complex128)
    if not np.all(np.isfinite(poles)) or np.any(poles.real > ALMOST * np.abs(poles)):
        return None
    return evaluate(problem, problem.admissible(poles)[0], repeats)


def _positions(estimate: Estimate, coefficients: tuple[str, str]) -> tuple[int, int]:
    names = [name for name in estimate.names if not name.startswith("delay")]
    given = tuple(coefficients)
    if len(given) != 2 or given[0] == given[1] or any(name not in names for name in given):
        raise OptionError(
            f"found coefficients={shown(given)}; expected two different ones of "
            f"{', '.join(names[:8])}{', ...' if len(names) > 8 else ''}; correct the names"
        )
    return names.index(given[0]), names.index(given[1])


def _followed(estimate: Estimate, problem: Problem, pair: tuple[int, int], values: Array) -> Array:
    """The estimate's coefficients with two of them moved, the other ``a`` along with them."""
    theta = np.array(estimate.theta)
    two = list(pair)
    moved = values - theta[two]
    rest = [k for k in problem.denominator_places().tolist() if k not in two]
    cov = np.asarray(estimate.cov)
    block = cov[np.ix_(two, two)]
    if rest and np.all(np.isfinite(cov)) and np.all(np.diag(block) > 0):
        unit = np.sqrt(np.diag(block))
        scaled = np.linalg.lstsq(block / np.outer(unit, unit), moved / unit, rcond=1e-12)[0]
        theta[rest] += cov[np.ix_(rest, two)] @ (scaled / unit)
    theta[two] = values
    return theta


def _mean_square(
    problem: Problem, point: Point, pair: tuple[int, int], values: tuple[float, float]
) -> float:
    """Cost at a point, with the numerator coefficients of the pair at their values."""
    rss = point.rss.copy()
    held: dict[int, list[tuple[Array, float]]] = {}
    for (i, j), place in problem.places()[1].items():
        for k, value in zip(pair, values, strict=True):
            if place.start <= k < place.stop:
                branch = next(one for one in point.branches if one.channels[i, j])
                fit = point.fits[i]
                own = fit.columns.width["b", j]
                row = np.zeros(fit.matrix.shape[1])
                row[own] = _numerator_map(
                    branch.inner, branch.basis, own.stop - own.start, problem.n_zeros[i][j]
                )[:, k - place.start]
                held.setdefault(i, []).append((row, value))
    for i, rows in held.items():
        maps = np.array([row for row, _ in rows])
        away = np.array([value for _, value in rows]) - maps @ point.fits[i].solution.x
        rss[i] += float(away @ np.linalg.solve(_spread(point.fits[i].matrix, maps), away))
    variance = rss / point.counts
    if np.any(variance <= 0):
        return 0.0
    return float(np.exp(point.counts @ np.log(variance) / point.counts.sum()))


def _numerator_map(bank: Cascade, basis: DegreeBasis, count: int, degree: int) -> Array:
    """(count, degree + 1): coefficients of a numerator by its weights."""
    return np.array([polynomial(bank, basis, unit, degree) for unit in np.eye(count)])


def _spread(matrix: Array, maps: Array) -> Array:
    """``T (M' M)^{-1} T'``."""
    norms = column_norms(matrix)
    _, s, vt = np.linalg.svd(matrix / norms, full_matrices=False)
    root = (maps / norms) @ (vt.T / np.where(s > 1e-15 * s[0], s, np.inf))
    return np.asarray(root @ root.T)
