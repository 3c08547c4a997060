"""What is known of the coefficients: the method without it is the search, the end lies within it.

Where bounds are all that is known and the free estimate lies within them, that is the answer.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Trace
from tridentify.estimation.knowledge.free_problem import seen
from tridentify.estimation.knowledge.solve import Seeds, constrain, resolve
from tridentify.estimation.likelihood.answer import Ending, estimate_from
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Patience, coefficients
from tridentify.estimation.likelihood.noise.noise_model import NoiseChoice
from tridentify.estimation.methods.around_maximum.maximum import Maximiser
from tridentify.estimation.methods.around_maximum.predictor import predictor_noise
from tridentify.estimation.methods.base import Progress

NONE_ACTIVE = "constraints: the free estimate lies within all bounds, none active"


def within_constraints(
    method: Maximiser, asked: Request, say: Progress, patience: Patience, noise: NoiseChoice
) -> Estimate:
    """The maximum of the likelihood, and of the priors, within what is known.

    Parameters
    ----------
    method : Maximiser
        Looks for the maximum without the constraints.
    asked : Request
        The structure with its constraints.
    say : callable
        Is told what is going on.
    patience : Patience
        With the steps.
    noise : {"white", "ar", "auto"}
        What the noise is taken for.
    """
    known = resolve(asked.records, asked.structure)
    looked_at = seen(asked.records, asked.structure, known)
    forecast = predictor_noise([(r.u, r.y) for r in asked.records])
    seeds = Seeds((), (), Trace(()), forecast)
    if looked_at is not None:
        free = method.maximise(*looked_at, say)
        if free.nuisances.drift and not asked.structure.drift:
            # a slow disturbance that was found belongs to the record
            structure = replace(asked.structure, drift=free.nuisances.drift)
            asked = replace(asked, structure=structure)
        if known.only_bounds:
            ending = method.weighed(free, say)
            if _within_bounds(ending, asked):
                with suppress(UnsupportedOrderError):
                    return estimate_from(ending.told(NONE_ACTIVE), asked)
        tried = [one.theta for one in sorted(free.trace.starts, key=lambda start: start.cost)]
        ends = (coefficients(free.point), *tried)
        seeds = Seeds(ends, free.point.problem.noise, free.trace, forecast)
    return constrain(asked, known, seeds, say, patience, noise)


def _within_bounds(ending: Ending, asked: Request) -> bool:
    """Whether a free end meets the bounds: it is the constrained one then.

    A posterior mean too, if no draw lies beyond.
    """
    if not ending.status.ok:
        return False
    first = asked.records[0]
    names = asked.structure.names(first.input_names, first.output_names)
    draws = np.zeros((0, len(names))) if ending.spread is None else ending.spread.draws
    every = np.vstack([coefficients(ending.point), draws])
    for name, (low, high) in (asked.structure.bounds or {}).items():
        values = every[:, names.index(name)]
        if (low is not None and values.min() <= low) or (high is not None and values.max() >= high):
            return False
    return True
