"""An estimate turned back into the problem that it solved, at the poles where it ended."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.answer import kept_point
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build, with_terms
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.numerics.arrays import Complex
from tridentify.numerics.kept import Beside
from tridentify.numerics.rational import scaled_roots
from tridentify.numerics.realization import sort_poles
from tridentify.record.record import Record


def stated(estimate: Estimate) -> Nuisances:
    """The nuisance terms that were decided on."""
    s = estimate.structure
    return Nuisances(str(s.initial_state), bool(s.offset), s.drift_degree)


def problem_of(estimate: Estimate, records: Sequence[Record], nuisances: Nuisances) -> Problem:
    """The problem of an estimate on some records, without its constraints.

    Parameters
    ----------
    estimate : Estimate
        Its orders, delays, and noise model.
    records : sequence of Record
    nuisances : Nuisances
        Terms that belong to the records.

    Returns
    -------
    Problem
        Whitened by the noise model of the estimate where time is even.
    """
    given = estimate.structure
    poles, zeros = cast("tuple[Any, Any]", (given.poles, given.zeros))
    delay = tuple(map(tuple, estimate.model.delay.tolist()))
    structure = with_terms(poles, zeros, delay, nuisances)
    problem = build(records, structure, nuisances)
    if not any(record.dt is None for record in records):
        problem = problem.whitened(estimate.noise_model)
    if given.delay == "free":
        problem = problem.freed(np.full(problem.n_inputs, np.inf))
    return problem


def poles_of_estimate(estimate: Estimate, problem: Problem) -> Complex:
    """Poles of every denominator, moved where a record cannot show them."""
    found = []
    for group in problem.groups:
        i, j = group.channels[0]
        found.append(sort_poles(scaled_roots(estimate.model.den[i][j])))
    return problem.admissible(np.concatenate(found))[0]


_POINTS = Beside[Point]("point")


def point_of(estimate: Estimate, records: Sequence[Record], nuisances: Nuisances) -> Point:
    """The problem of an estimate at its poles.

    The last one is kept: what else an input may do between its samples and what is left of the
    outputs are asked one after the other.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
    nuisances : Nuisances
        As of `problem_of`.
    """
    known = kept_point(estimate.model, records, nuisances)
    if known is not None:
        return known
    # of an estimate, what is said of it may have been added since
    parts = (estimate.structure, estimate.noise_model, *records)
    known = _POINTS.find(estimate.model, parts, nuisances)
    if known is not None:
        return known
    problem = problem_of(estimate, records, nuisances)
    found = evaluate(problem, poles_of_estimate(estimate, problem))
    return _POINTS.keep(found, estimate.model, parts, nuisances)


def without_outliers(estimate: Estimate, records: Sequence[Record]) -> list[Record]:
    """The records without the samples that a robust fit counts as outliers."""
    if not len(estimate.outliers):
        return list(records)
    found = []
    for e, record in enumerate(records):
        y = np.array(record.y)
        for _, i, k, _ in estimate.outliers[estimate.outliers[:, 0] == e]:
            if int(k) < len(y):
                y[int(k), int(i)] = np.nan
        found.append(record._derive(y=y))
    return found
