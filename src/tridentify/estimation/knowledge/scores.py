"""What the scores of a constrained maximum say of its covariance (`likelihood.scores`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tridentify.estimation.knowledge.fixed_denominator import HeldFit
from tridentify.estimation.likelihood.scores import (
    LONGEST_SCORED,
    ScoreScatter,
    judged_scatter,
    whitened_scores,
)
from tridentify.models.regression import Regression, response_of
from tridentify.numerics.arrays import Array


def constrained_scatter(
    here: HeldFit, along: Array, terms: dict[tuple[int, int], Array], noise: Array
) -> ScoreScatter | None:
    """The covariance of the scores, where it is larger than the likelihood's.

    Parameters
    ----------
    here : HeldFit
        At the maximum.
    along : (p, k) array
        Directions of the coefficients in which the covariance is the identity.
    terms : dict
        The nuisance terms along these directions, (n_terms, k) by (experiment, output).
    noise : (n_outputs,) array
        Variance of the innovations.

    Returns
    -------
    ScoreScatter or None
        None where the scores do not contradict the likelihood, or are too few to say.
    """
    if here.counts.sum() > LONGEST_SCORED or not np.all(noise > 0) or not along.shape[1]:
        return None
    problem = here.problem
    moved = [sensitivities(here, along, terms, i) for i in range(problem.n_outputs)]
    left = [
        e.standardised(one) for e, one in zip(problem.experiments, here.over_time(), strict=True)
    ]
    found = whitened_scores(left, moved, problem.noise, noise)
    directions, innovations = zip(*found, strict=True)
    # stretches of time alone: the inputs may react, which the constraints do not tell
    return judged_scatter(directions, innovations, reacts=True, along=along)


def sensitivities(
    here: HeldFit, along: Array, terms: dict[tuple[int, int], Array], output: int
) -> tuple[Array, ...]:
    """Derivatives of one output over its noise, (n_samples, k) an experiment.

    The derivatives are linear in the signals of the bank. In place of the triangle of an experiment
    stands the identity, which gives their weights.
    """
    place, problem = here.place, here.problem
    response = place.response(here.theta, here.terms)
    at = problem.n_poles + sum(m + 1 for zeros in problem.n_zeros[:output] for m in zeros)
    found = []
    for e, experiment in enumerate(problem.experiments):
        layout = place.regressions[e].layout
        n = layout.n_signals
        unit = Regression(
            layout,
            (np.eye(n),) * problem.n_outputs,
            (np.zeros(n),) * problem.n_outputs,
            (n,) * problem.n_outputs,
        )
        regressions = (*place.regressions[:e], unit, *place.regressions[e + 1 :])
        seen = replace(place, regressions=regressions)
        block = np.zeros((n, along.shape[0]))
        blocks = [
            seen.numerator_columns(e, output, j, m) for j, m in enumerate(problem.n_zeros[output])
        ]
        own = np.hstack(blocks)
        block[:, at : at + own.shape[1]] = own
        block[:, : place.inner.order] = -seen.filtered(response, e, output)
        rows = block @ along + seen.nuisance_columns(e, output) @ terms[e, output]
        signals = response_of(experiment, place.bank, rows.T, outputs=[output] * rows.shape[1])
        signals = signals / experiment.scale_of(output)
        found.append(np.where(np.isnan(experiment.y[:, [output]]), np.nan, signals))
    return tuple(found)
