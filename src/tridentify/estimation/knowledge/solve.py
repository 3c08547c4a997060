"""A constrained estimate from a free one.

A method searches as it always does, without the constraints (`free_problem.seen` gives the problem
it is to look at: with integrators the inputs are integrated and the poles at the origin left out).
Its end is one of the starts of the constrained steps (`starts`), beside the seeds it had. The
nuisance terms are those of the lowest AICc, each choice followed to its own constrained maximum; a
noise model is fitted to the constrained residual anew, in turn with the coefficients, until these
stand still (`likelihood.noise.noise_model`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import ContradictoryConstraintsError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate, Start, Status, Trace
from tridentify.estimation.knowledge.affine import (
    Knowledge,
    equalities_of,
    known_of,
    refuse_structure,
)
from tridentify.estimation.knowledge.answer import (
    criterion,
    described,
    estimate_of,
    passes_of,
    reference,
    standard_errors,
)
from tridentify.estimation.knowledge.contradiction import disagreement
from tridentify.estimation.knowledge.descend import (
    ConstrainedEnd,
    descend,
    fit_at,
    is_exact,
    is_stable,
    step,
)
from tridentify.estimation.knowledge.free_problem import widened
from tridentify.estimation.knowledge.reach import check_reach
from tridentify.estimation.knowledge.sizes import scale_of, spread_of
from tridentify.estimation.knowledge.starts import further_points, starting_points
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Patience
from tridentify.estimation.likelihood.noise.noise_model import (
    MOST_ROUNDS,
    PER_UNKNOWN,
    STILL,
    NoiseChoice,
)
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build, candidates
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.likelihood.thresholds import TRUSTED
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import deviance, fit_autoregression, most_coefficients
from tridentify.numerics.information import aicc_price
from tridentify.numerics.whiteness import is_white
from tridentify.record.record import Record
from tridentify.structure import Structure

MOST_PLAIN = 6
"""Plain denominators that are followed where no other start leads to a minimum: it bounds the time,
a full descent each."""
MOST_SEEDS = 3
"""Ends of the free search that are followed: it bounds the time."""
APART = 0.05
"""Difference in the log of every coefficient of the denominator below which two seeds are one."""
OF_FREE_SEARCH = (
    DecisionKind.INITIAL_STATE,
    DecisionKind.NOISE_WHITE,
    DecisionKind.NOISE_TAKEN_AS_WHITE,
    DecisionKind.NOISE_MODEL,
    DecisionKind.SLOW_AS_NOISE,
)


@dataclass(frozen=True, eq=False)
class Seeds:
    """What a free search found.

    Attributes
    ----------
    coefficients : tuple of (p',) arrays
        Of models of the problem it looked at, the best first; may be empty.
    noise : tuple of arrays
        Its model of the noise; the empty tuple for white.
    trace : Trace
        Its way.
    forecast : tuple of arrays
        Another model of the noise to begin with, which no fit has bent; the likelier end counts.
    """

    coefficients: tuple[Array, ...]
    noise: tuple[Array, ...]
    trace: Trace
    forecast: tuple[Array, ...] = ()


def resolve(records: Sequence[Record], structure: Structure) -> Knowledge:
    """What is known, for the channels of the records.

    Raises
    ------
    ContradictoryConstraintsError, UnsupportedError
        If it contradicts itself, or is for what cannot be constrained.
    ScaleError
        If numbers are out of all proportion to the record.
    """
    refuse_structure(structure)
    inputs, outputs = records[0].input_names, records[0].output_names
    scale, spread = scale_of(records, structure), spread_of(records, structure)
    rows = equalities_of(structure, inputs, outputs)
    check_reach(structure, structure.names(inputs, outputs), rows, scale, spread)
    return known_of(structure, inputs, outputs, scale)


def constrain(
    asked: Request,
    known: Knowledge,
    seeds: Seeds,
    say: Callable[[str], None],
    patience: Patience,
    noise: NoiseChoice,
) -> Estimate:
    """The constrained maximum and its covariance.

    Parameters
    ----------
    asked : Request
        The structure with its constraints.
    known : Knowledge
        From `resolve`.
    seeds : Seeds
        What the free search found.
    say : callable
        Is told what is going on.
    patience : Patience
        With the steps.
    noise : {"white", "ar", "auto"}
        What the noise is taken for.

    Raises
    ------
    ContradictoryConstraintsError
        If no stable model meets the constraints.
    UnsupportedOrderError
        If the data cannot tell the free coefficients apart.
    """
    say("the constraints")
    records, structure = asked.records, asked.structure
    choices = _choices(records, structure, known)
    starts = _distinct(
        [widened(one, records, structure, known) for one in seeds.coefficients], known
    )
    scale = scale_of(records, structure, starts[0] if starts else None, known)
    first = records[0]
    known = known_of(structure, first.input_names, first.output_names, scale)
    fullest = choices[-1]
    problem = problem_for(records, structure, fullest, known).whitened(seeds.noise)
    reached, tried = _from_all(problem, known, starts, scale, patience)
    doubts = disagreement(problem, reached, starts, structure, first, scale, patience)
    best, nuisances, told = _decided(records, structure, choices, reached, patience)
    model = seeds.noise
    if not seeds.coefficients and noise != "white":
        # no search has tested the residual
        best, nuisances = _tinted(records, structure, best, nuisances, noise, patience)
        model = best.fit.problem.noise
    if any(a.size for a in model):
        say("coloured noise, within the constraints")
        begun = best, nuisances, told
        best, nuisances, told = _coloured(records, structure, choices, begun, patience)
        if any(a.size for a in seeds.forecast):
            again = _coloured(records, structure, choices, begun, patience, seeds.forecast)
            if _with_noise(again[0]) < _with_noise(best):
                best, nuisances, told = again
    told += _whiteness(best, noise)
    trace = _trace(seeds.trace, best, tried, told)
    return estimate_of(best, asked, nuisances, trace, doubts)


def _from_all(
    problem: Problem, known: Knowledge, seeds: Sequence[Array], scale: Array, patience: Patience
) -> tuple[ConstrainedEnd, tuple[Start, ...]]:
    """The best end over all starts."""
    found: list[ConstrainedEnd] = []
    tried: list[Start] = []

    def follow(name: str, theta: Array) -> None:
        here = fit_at(problem, known, theta)
        tried.append(
            Start(f"constrained: {name}", theta, float(here.rss.sum() / here.counts.sum()))
        )
        found.append(descend(problem, known, theta, patience))

    for name, theta in starting_points(problem, known, seeds, scale):
        follow(name, theta)
    if not found and known.n_poles == known.integrators:
        follow("no pole to be found", known.origin)
    if not any(one.status is Status.CONVERGED for one in found):
        for name, theta in further_points(problem, known, seeds, scale, MOST_PLAIN):
            follow(name, theta)
    if not found:
        raise ContradictoryConstraintsError(
            "found no stable denominator that meets the constraints; expected one at least; "
            "correct or drop a constraint"
        )
    usable = [one for one in found if one.status.ok] or found
    return min(usable, key=lambda one: one.cost), tuple(tried)


def _decided(
    records: Sequence[Record],
    structure: Structure,
    choices: Sequence[Nuisances],
    reached: ConstrainedEnd,
    patience: Patience,
) -> tuple[ConstrainedEnd, Nuisances, tuple[str, ...]]:
    """The choice of nuisance terms with the lowest AICc at its constrained maximum.

    A Gauss-Newton step says what each promises; the most promising is followed to its end, then the
    next one, as long as its promise is below the lowest AICc reached
    (`likelihood.choose_nuisance`).
    """
    known, noise = reached.known, reached.fit.problem.noise
    if len(choices) == 1:
        return reached, choices[0], ()
    ends = {len(choices) - 1: reached}
    table = [np.inf] * len(choices)
    table[-1] = criterion(reached.fit, known)
    problems = [problem_for(records, structure, c, known).whitened(noise) for c in choices[:-1]]
    for k, problem in enumerate(problems):
        here = fit_at(problem, known, reached.fit.theta)
        trusted = np.inf if is_exact(here) else TRUSTED * float(here.counts.sum())
        table[k] = criterion(here, known, min(step(here, known, 0.0).fall, trusted))
    for k in np.argsort(table).tolist():
        if k in ends:
            continue
        if table[k] >= min(table[j] for j in ends):
            break
        ends[k] = descend(problems[k], known, reached.fit.theta, patience)
        table[k] = criterion(ends[k].fit, known)
    k = min(ends, key=lambda j: table[j])
    listed = "; ".join(
        f"{choices[j].label} {table[j] - table[k]:+.1f}" for j in np.argsort(table) if j != k
    )
    told = choices[k].told(f"lowest AICc within the constraints ({listed})")
    return ends[k], choices[k], (told,)


def _coloured(
    records: Sequence[Record],
    structure: Structure,
    choices: Sequence[Nuisances],
    begun: tuple[ConstrainedEnd, Nuisances, tuple[str, ...]],
    patience: Patience,
    first: tuple[Array, ...] | None = None,
) -> tuple[ConstrainedEnd, Nuisances, tuple[str, ...]]:
    """Noise model and constrained coefficients in turn, until the coefficients stand still.

    The first model of the noise is that of the residual, unless another is given.
    """
    best, nuisances, told = begun
    orders: list[int] | None = None
    for count in range(MOST_ROUNDS):
        noise = first if first and not count else _noise_model(best, orders)
        orders = [a.size for a in noise] if count else None
        before = best
        problem = problem_for(records, structure, choices[-1], best.known).whitened(noise)
        again = descend(problem, best.known, best.fit.theta, patience)
        best, nuisances, told = _decided(records, structure, choices, again, patience)
        moved = np.abs(best.fit.theta - before.fit.theta)
        if np.all(moved <= STILL * standard_errors(best)):
            break
    orders_found = ", ".join(str(a.size) for a in best.fit.problem.noise)
    order = DecisionKind.NOISE_MODEL.told(f" within the constraints: order {orders_found}")
    return best, nuisances, (*told, order)


def _with_noise(end: ConstrainedEnd) -> float:
    """AICc with the model of the noise, so that ends under different ones compare."""
    residuals = end.fit.over_time()
    found, unknowns = end.known.penalty(end.fit.theta), float(end.known.n_free)
    for i, a in enumerate(end.fit.problem.noise):
        found += deviance([one[:, i] for one in residuals], a)
        unknowns += a.size + 1.0
    unknowns += sum(one.size for one in end.fit.terms.values())
    return found + aicc_price(unknowns, float(end.fit.counts.sum()))


def _tinted(
    records: Sequence[Record],
    structure: Structure,
    best: ConstrainedEnd,
    nuisances: Nuisances,
    noise: NoiseChoice,
    patience: Patience,
) -> tuple[ConstrainedEnd, Nuisances]:
    """With a first model of the noise where it is asked for, or the residual is not white."""
    if is_exact(best.fit):
        return best, nuisances
    found = []
    for i in range(best.fit.problem.n_outputs):
        series = [one[:, i] for one in best.fit.over_time()]
        coloured = noise == "ar" or not is_white(series)
        room = int(best.fit.counts[i] - PER_UNKNOWN * best.fit.theta.size)
        most = most_coefficients(room) if coloured else 0
        found.append(fit_autoregression(series, most, fewest=1) if most else np.zeros(0))
    if not any(a.size for a in found):
        return best, nuisances
    problem = problem_for(records, structure, nuisances, best.known).whitened(tuple(found))
    return descend(problem, best.known, best.fit.theta, patience), nuisances


def _whiteness(best: ConstrainedEnd, noise: NoiseChoice) -> tuple[str, ...]:
    """What the residual within the constraints says of noise taken for white."""
    if noise == "white" or any(a.size for a in best.fit.problem.noise) or is_exact(best.fit):
        return ()
    residuals = best.fit.over_time()
    outputs = range(best.fit.problem.n_outputs)
    if all(is_white([one[:, i] for one in residuals]) for i in outputs):
        passed = ": the residual within the constraints passes the portmanteau test"
        return (DecisionKind.NOISE_WHITE.told(passed),)
    return (
        DecisionKind.NOISE_TAKEN_AS_WHITE.told(
            ": the residual within the constraints does not pass the portmanteau test"
        ),
    )


def _distinct(seeds: Sequence[Array], known: Knowledge) -> list[Array]:
    """Seeds with stable poles that are not near copies of one another."""
    kept: list[Array] = []
    for seed in seeds:
        moving = seed[known.moving]
        if not is_stable(moving):
            continue
        if all(np.any(np.abs(np.log(moving / k[known.moving])) > APART) for k in kept):
            kept.append(seed)
    return kept[:MOST_SEEDS] if known.n_poles > known.integrators else []


def _noise_model(reached: ConstrainedEnd, orders: list[int] | None) -> tuple[Array, ...]:
    here = reached.fit
    residuals = here.over_time()
    found = []
    for i, old in enumerate(here.problem.noise):
        if not old.size:
            found.append(np.zeros(0))
            continue
        own = sum(t.size for (_, output), t in here.terms.items() if output == i)
        room = int(here.counts[i] - PER_UNKNOWN * (own + reached.known.n_free))
        series = [one[:, i] for one in residuals]
        order = None if orders is None else orders[i]
        found.append(fit_autoregression(series, most_coefficients(room), order, fewest=1))
    return tuple(found)


def _choices(
    records: Sequence[Record], structure: Structure, known: Knowledge
) -> tuple[Nuisances, ...]:
    """The choices of nuisance terms, the fullest last.

    With an integrator the free response holds a constant, so an offset beside it says nothing new.
    """
    found = candidates(records, structure)
    if known.integrators and structure.offset == "auto":
        lean = [c for c in found if not (c.initial_state == "free" and c.offset and not c.drift)]
        found = tuple(lean) or found
    return found


def problem_for(
    records: Sequence[Record], structure: Structure, nuisances: Nuisances, known: Knowledge
) -> Problem:
    """The problem for one choice of nuisance terms; its input counts from `reference`."""
    problem = build(records, structure, nuisances, shift=False)
    experiments = []
    for e, record in zip(problem.experiments, records, strict=True):
        start = reference(record, nuisances, known)
        shifted = np.ascontiguousarray(e.u - start) if np.any(start) else e.u
        experiments.append(replace(e, u=shifted))
    return replace(problem, experiments=tuple(experiments))


def _trace(
    trace: Trace, reached: ConstrainedEnd, tried: tuple[Start, ...], told: tuple[str, ...]
) -> Trace:
    """The way of the free search, then that within the constraints."""
    p = reached.fit.theta.size
    passes = [one for one in trace.passes if one.theta.size == p]
    for one in passes_of(reached):
        passes.append(replace(one, number=len(passes) + 1))
    starts = tuple(one for one in trace.starts if one.theta.size == p) + tried
    # what the free search says of initial state and noise is not true of this residual
    gone = trace.about(*OF_FREE_SEARCH)
    kept = tuple(line for line in trace.decisions if line and line not in gone)
    return Trace(tuple(passes), starts, (*kept, *told, *described(reached)), reached.why)
