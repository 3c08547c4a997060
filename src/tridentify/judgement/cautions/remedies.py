"""What a remedy brings, tried before it is advised: the model of an estimate fitted once more.

The fit begins where the estimate ended, with samples left out or a term more. The fits that are
compared are of the same samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.estimation.search.search import search
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt
from tridentify.judgement.causes.attempts.explanation import CLEARLY
from tridentify.judgement.causes.attempts.first_samples import Predictions
from tridentify.judgement.causes.attempts.revisit import (
    poles_of_estimate,
    problem_of,
    stated,
    without_outliers,
)
from tridentify.judgement.cautions.sensors import stuck_samples
from tridentify.judgement.validation.explained import NOTHING_MOVES, RECORD_IT, most_moved
from tridentify.numerics.arrays import Array, Complex
from tridentify.record.record import Record

FEW_LEFT = 0.3
"""Share of an output's samples that has to be left for a fit without the others."""


def fitted_again(
    estimate: Estimate,
    records: Sequence[Record],
    nuisances: Nuisances | None = None,
    *,
    anew: bool = False,
) -> Attempt | None:
    """The model of an estimate on other samples or with other terms.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified, perhaps without some samples.
    nuisances : Nuisances, optional
        Terms that belong to the records; those of the estimate where they are left out.
    anew : bool
        Look for poles elsewhere too: what spoilt the estimate may have led it astray.

    Returns
    -------
    Attempt or None
        None where it cannot be had: a structure with constraints, which the fit does not know, or
        too few samples.
    """
    if estimate.structure.constrained or not estimate.status.ok:
        return None
    seen = without_outliers(estimate, records)
    try:
        problem = problem_of(estimate, seen, nuisances or stated(estimate))
        poles = poles_of_estimate(estimate, problem)
        starts = [poles, *(_found_anew(estimate, seen) if anew else ())]
        orders = [a.size for a in problem.noise] or [0] * problem.n_outputs
        ends = [attempt(problem, [one], orders) for one in starts]
        return min(filter(None, ends), key=lambda one: one.deviance, default=None)
    except (TridentifyError, np.linalg.LinAlgError):
        return None


def _found_anew(estimate: Estimate, records: Sequence[Record]) -> tuple[Complex, ...]:
    """Poles that a search of these records leads to."""
    if estimate.structure.delay == "free":
        return ()
    known = replace(estimate.structure, delay=tuple(map(tuple, estimate.model.delay.tolist())))
    return search(Question.of(records, known), 1).seeds


def brought(estimate: Estimate, before: Array, end: Attempt) -> str:
    """Fit from ... to ..., the coefficient that moves most from ... to ...; no full stop.

    Parameters
    ----------
    estimate : Estimate
    before : (n_outputs,) array
        Fit of the estimate [percent] to the samples that `end` was fitted to.
    end : Attempt
    """
    pairs = zip(estimate.output_names, before, end.fits, strict=True)
    said = [f"fit of {name} from {a:.2f} to {b:.2f} %" for name, a, b in pairs]
    moves = most_moved(estimate, end)
    if moves is not None:
        said.append(moves or NOTHING_MOVES)
    return ", ".join(said)


SPOILT_THERE = ("wraps-round", "stuck-sensor")
"""What spoils samples that are known, so that an estimate without them can be made."""


def with_stuck_tried(
    found: Sequence[Finding],
    estimate: Estimate,
    records: Sequence[Record],
    known: Predictions,
    recorded: Sequence[Record],
) -> list[Finding]:
    """With what the estimate would be without the samples of a sensor that hung.

    Parameters
    ----------
    found : sequence of Finding
        Those of `SPOILT_THERE` get an effect.
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    known : Predictions
    recorded : sequence of Record
        As the sensors gave them.
    """
    if not any(one.code in SPOILT_THERE for one in found):
        return list(found)
    pairs = zip(records, recorded, strict=True)
    stuck = [stuck_samples(estimate, a, e, known, b) for e, (a, b) in enumerate(pairs)]
    effect = _without(estimate, records, stuck, known)
    return [replace(one, effect=effect) if one.code in SPOILT_THERE else one for one in found]


def with_drift_tried(
    found: Sequence[Finding], estimate: Estimate, records: Sequence[Record]
) -> list[Finding]:
    """With a drift as the remedy of a slow disturbance where it explains the records better.

    Parameters
    ----------
    found : sequence of Finding
        Those of ``drift`` get a remedy, if there is one, and what it brings.
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    """
    if not any(one.code == "drift" for one in found) or estimate.structure.drift:
        return list(found)
    terms = stated(estimate)
    base = fitted_again(estimate, records)
    end = fitted_again(estimate, records, replace(terms, offset=True, drift=True))
    if base is None or end is None:
        return list(found)
    gain = base.criterion - end.criterion
    what = brought(estimate, base.fits, end)
    if gain > CLEARLY:
        remedy = "Estimate a drift along (drift=True, --drift yes)."
        effect = f"With a drift: AICc lower by {gain:.3g}, {what}."
    else:
        remedy = RECORD_IT
        which = f"higher by {-gain:.2g}" if gain < 0 else f"lower by {gain:.2g} alone"
        effect = f"A straight drift does not stand for it: with one, AICc is {which}, {what}."
    return [
        replace(one, remedy=remedy, effect=effect) if one.code == "drift" else one for one in found
    ]


def _without(
    estimate: Estimate,
    records: Sequence[Record],
    left_out: Sequence[NDArray[np.bool_]],
    known: Predictions,
) -> str:
    """What an estimate would be without some samples; empty where that cannot be tried."""
    if not any(one.any() for one in left_out):
        return ""
    kept = []
    for record, out in zip(records, left_out, strict=True):
        y = np.where(out, np.nan, record.y)
        there = np.isfinite(record.y).sum(axis=0)
        if np.any(np.isfinite(y).sum(axis=0) < FEW_LEFT * there):
            return ""
        kept.append(record._derive(y=y))
    end = fitted_again(estimate, kept, anew=True)
    if end is None:
        return ""
    said = brought(estimate, _fits(kept, known), end)
    return f"Without them: {said}. Both fits are of the samples that are left."


def _fits(records: Sequence[Record], known: Predictions) -> Array:
    """Fit of an estimate to its records, without samples that are left out of them [percent]."""
    energy, spread = 0.0, 0.0
    for e, record in enumerate(records):
        left = known.residual(record, e)
        energy = energy + np.nansum(left**2, axis=0)
        spread = spread + np.nansum((record.y - np.nanmean(record.y, axis=0)) ** 2, axis=0)
    return np.asarray(100.0 * (1.0 - np.sqrt(energy / np.where(spread > 0, spread, np.nan))))
