"""The end of the direct route: plant and noise found together (`closed_loop.joint`).

The search of the direct route keeps to stable plants, and finds plant and noise in turn. From its
end, from the equation error of input and output as they are, and from the best forecast of the
output (`closed_loop.long_past`), both are found together, whether or not the plant is stable. Where
that leads elsewhere, it is the estimate; where it leads to the same place, what else is nearly as
likely joins the covariance.

*Open loop.* The forces on a plant with two integrators come out as noise whose power grows with the
third power of time. An autoregression of stationary noise tells little of it, and the steps in turn
end where gain and noise make up for one another. The mirrored predictor takes both integrators out
of the noise before it is modelled, so that plant and noise are found together here, too.

*Between the samples.* A controller that works on samples holds the input. Nobody recorded what it
did between two samples otherwise, and a continuous controller moved it there with the noise: taken
as a straight line to the next sample, the input knows of noise that was yet to come, which no model
of the noise makes good. Taken as held, it knows nothing of that, nor of its own motion; taken as on
its way to what its past foretells, and moving by the rest at the sample, it is right for noise that
a sensor holds. None is better than the others for all loops. So where nobody states that it was
held, all three are tried, and their distances join the covariance, each counted as likely as the
others; where they are many standard errors apart, the record cannot tell the plant. A record that
says held is believed, as its samples seldom tell, and what hangs on that is said; it is not
believed where the input that moves at the samples, which knows of the past alone too, is clearly
likelier. Where the input follows from the recorded samples to the last digit, a controller that
works on them made it, and held it (`closed_loop.input_rule`): that is known then, whoever says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.trace import Status
from tridentify.estimation.closed_loop.as_recorded import Foretold
from tridentify.estimation.closed_loop.between_samples import Loop, with_input
from tridentify.estimation.closed_loop.input_rule import InputRule, input_rule
from tridentify.estimation.closed_loop.joint import Together
from tridentify.estimation.closed_loop.linear_errors import slowest
from tridentify.estimation.closed_loop.long_past import plants_of_forecast
from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.estimation.closed_loop.settled import MANY, Settled, nearest, together
from tridentify.estimation.closed_loop.sought import Sought
from tridentify.estimation.closed_loop.unstable_answer import estimate_of, open_loops
from tridentify.estimation.closed_loop.unstable_starts import starting_plants
from tridentify.estimation.likelihood.thresholds import CLEARLY
from tridentify.estimation.methods.by_reference.controller_kind import may_integrate
from tridentify.numerics.arrays import Array
from tridentify.record.checks.samples import Behaviour
from tridentify.record.record import Record
from tridentify.structure import Structure

ELSEWHERE = 1.0
"""Standard errors from which the steps on all unknowns lead to another place."""
NO_END = DecisionKind.NO_END_TOGETHER.told(": the record hardly tells one from the other")
NOT_HELD = "held, as the record says, is clearly less likely than moved"
"""End of one."""
MOVES = "coefficients move by up to"
TWICE = 2
"""Integrators from which an autoregression is no model of what forces make of the output."""
LONGEST = 50_000
"""Samples up to which it is tried: every step simulates the plant twice for each coefficient."""


def found_together(found: Estimate, records: Sequence[Record], *, stated: bool = True) -> Estimate:
    """An estimate with its end and its errors those of plant and noise together.

    Parameters
    ----------
    found : Estimate
        By the direct route, or of a plant whose noise wanders.
    records : sequence of Record
        With the behaviour of their inputs settled.
    stated : bool
        Whether somebody stated that behaviour.
    """
    sought = looked_for(records, found.structure)
    if sought is None:
        return found
    asked = Request.of(records, found.structure, found.method, route=found.route)
    loops = open_loops(asked.records)
    known = plant_of(found)
    best = from_many(sought, loops, known)
    if best is None or sought.exceeded(best.found):
        return replace(found, trace=found.trace.told(NO_END))
    away = best.found.plant.theta - known.theta
    errors = np.maximum(best.errors, 1e-300)
    told: tuple[str, ...]
    spread, told = np.zeros_like(found.cov), ()
    if found.route == "direct":
        spread, told = _between(found, asked.records, best, stated)
    if not best.found.moved < MANY:
        told = (NO_END, *told)
    elif best.rival:
        apart = f", off by up to {best.rival:.0f} standard errors"
        told = (DecisionKind.ANOTHER_PLANT.told(apart), *told)
    other = found.status is not Status.CONVERGED or np.max(np.abs(away) / errors) > ELSEWHERE
    if other:
        cov = best.found.cov + best.spread + spread
        return _instead(found, asked, loops, best, cov, told)
    return replace(found, cov=found.cov + best.spread + spread, trace=found.trace.told(*told))


def wanders(found: Estimate, records: Sequence[Record]) -> bool:
    """Whether the noise of a plant in open loop may be forces that it integrates twice.

    Parameters
    ----------
    found : Estimate
    records : sequence of Record
    """
    if found.route != "open-loop" or not any(one.size for one in found.noise_model):
        return False
    sought = looked_for(records, found.structure)
    return sought is not None and sought.known().integrators >= TWICE


def looked_for(records: Sequence[Record], structure: Structure) -> Sought | None:
    """What plant and noise are found together of; None for what they are not.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
    """
    sought = Sought.of(records, structure)
    if sought is None or sought.late:
        return None
    # of a plant that integrates, a level of its input is a drift
    if isinstance(structure.drift, int) and structure.drift > sought.known().integrators:
        return None
    return None if sum(one.n_samples for one in records) > LONGEST else sought


def from_many(sought: Sought, loops: Sequence[Loop], known: Plant) -> Settled | None:
    """Plant and noise together, from a plant and from what record and forecast suggest.

    Parameters
    ----------
    sought : Sought
    loops : sequence of Loop
    known : Plant

    Returns
    -------
    Settled or None
        None where no start leads anywhere.
    """
    orders = sought.poles, sought.zeros
    within = sought.known(known.scale)
    try:
        others = [
            *starting_plants(loops, *orders),
            *plants_of_forecast(loops, *orders, within.integrators),
        ]
        return together(loops, [sought.within(one, None, within) for one in (known, *others)])
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return None


def _instead(
    found: Estimate,
    asked: Request,
    loops: Sequence[Loop],
    best: Settled,
    cov: Array,
    told: Sequence[str],
) -> Estimate:
    """The estimate of plant and noise together, in place of that of the steps in turn."""
    end = replace(best.found, cov=cov)
    words = f"plant and noise found together, order {end.noise.size} of the noise"
    made = estimate_of(asked, loops, end, (words, *told))
    if not np.any(end.plant.poles.real > -slowest(loops)):
        made = replace(made, loop=None)
    decisions = (*found.trace.about(DecisionKind.DIRECT_ROUTE), *made.trace.decisions)
    return replace(made, trace=replace(made.trace, decisions=decisions))


def plant_of(estimate: Estimate) -> Plant:
    """The plant of a model with one output and one denominator."""
    n = estimate.model.den[0][0].size - 1
    counts = [
        m + 1 for m in np.ravel(estimate.structure.zeros_matrix(1, len(estimate.input_names)))
    ]
    parts = np.split(estimate.theta[n:], np.cumsum(counts)[:-1])
    return Plant(np.array(estimate.theta[:n]), tuple(parts))


def made_on_samples(found: Estimate, records: Sequence[Record]) -> InputRule | None:
    """What shows in the inputs of a loop that a controller on their samples made them, if anything.

    Without a loop, an input without noise follows from what it did, and this says nothing.

    Parameters
    ----------
    found : Estimate
        Of the plant: one that may integrate leaves a rule that is shorter by one.
    records : sequence of Record
        Without references.
    """
    poles = int(np.max(np.asarray(found.structure.poles)))
    rule = input_rule(records, poles - may_integrate(found, records))
    return rule if rule in (InputRule.SAMPLED, InputRule.HELD) else None


def _between(
    found: Estimate, records: Sequence[Record], best: Settled, stated: bool
) -> tuple[Array, tuple[str, ...]]:
    """Spread over what the input may do between its samples, and a word where it decides."""
    plant = best.found.plant
    n = plant.theta.size
    held = all(one.behaviour == "zoh" for one in records)
    rule = made_on_samples(found, records) if held else None
    if rule is not None:
        return np.zeros((n, n)), (DecisionKind.SEEN_HELD.told(f": {rule.value}"),)
    straight: Behaviour = "foh" if held else "zoh"
    # of a held record the input that is foretold would be held too
    moved = _settled(plant, [Loop(Foretold.of(_with(one, "foh")), "continuous") for one in records])
    others = (_settled(plant, open_loops([_with(one, straight) for one in records])), moved)
    ends = [one for one in others if one is not None]
    most = max((_apart(one, best) for one in ends), default=0.0)
    contradicted = held and stated and _is_likelier(moved, best)
    if held and stated and not contradicted:
        moves = f"; if it moves there, {MOVES} {most:.0f} standard errors"
        told = DecisionKind.RESTS_ON_HELD.told(moves)
        return np.zeros((n, n)), (told,) if most >= MANY else ()
    away = [np.zeros(n), *(one.plant.theta - plant.theta for one in ends)]
    spread = sum((np.outer(one, one) for one in away), np.zeros((n, n))) / len(away)
    if most < MANY and len(ends) == len(others):
        return spread, ()
    by = f"{MOVES} {most:.0f} standard errors" if most else "no plant is found"
    by = f"{by}; {NOT_HELD}" if contradicted else by
    told = DecisionKind.BETWEEN_DECIDES.told(f": held, straight, or moved at the samples, {by}")
    return spread, (told,)


def _with(record: Record, between: Behaviour) -> Record:
    return with_input(record, np.asarray(record.u), between)


def _settled(plant: Plant, loops: Sequence[Loop]) -> Together | None:
    try:
        return nearest(loops, plant)
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return None


def _is_likelier(other: Together | None, best: Settled) -> bool:
    """Whether the record itself speaks for another input; what is foretold knows the past alone."""
    return other is not None and other.criterion < best.criterion - CLEARLY


def _apart(other: Together, best: Settled) -> float:
    """Largest distance of two plants [standard errors]."""
    away = other.plant.theta - best.found.plant.theta
    return float(np.max(np.abs(away) / np.maximum(best.errors, 1e-300)))
