"""Steps 1 to 4 on what an estimator has seen so far, and the estimate that comes of it.

*Standard errors* of few samples that are still kept, with a model of their noise. Blocks of scores
(`online.scatter`) are of what the model so far did not expect. Where the noise is slow beside the
samples, this is little: least squares has bent the coefficients after it, now and then into another
valley, whose errors look small. But as long as the samples are kept they can be asked once more:
the coefficients are taken to the minimum for an autoregression of what they leave
(`online.residual.refined`). No estimate for white noise is better than that one (Gauss and Markov),
and the truth is near it: so a standard error is at least that of these coefficients, and at least
the distance to them.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError, ZeroOutputError
from tridentify.estimation.answer.assemble import Request, assemble
from tridentify.estimation.answer.estimate import Estimate, Step, Trace
from tridentify.estimation.likelihood.answer import Ending, solved_at
from tridentify.estimation.likelihood.choose_nuisance import Finished
from tridentify.estimation.likelihood.cost import Point, evaluate_variant
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Recorder,
    criterion,
    finishing,
)
from tridentify.estimation.likelihood.setup.linear_columns import linear_blocks
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.thresholds import EQUAL, SETTLED_LONG, TRUSTED
from tridentify.estimation.search.passes import adapting, series_model
from tridentify.models.regression import Regression
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.slices import Slices, drain
from tridentify.online.equation_plan import from_directions
from tridentify.online.findings import noise_finding
from tridentify.online.kernels import slots
from tridentify.online.layout import Blueprint, Setting, smallest_channel
from tridentify.online.residual import refined
from tridentify.online.scatter import tells, with_scatter
from tridentify.online.search import record_of
from tridentify.online.summary import change_columns, on_order, seen, summarise, transfer
from tridentify.online.unexplained import doubt_finding, doubting
from tridentify.record.record import Record

CLEARLY = 1.25
"""Ratio of standard errors below which nothing is said: a noise model of few samples of white noise
makes them a few per cent larger."""


def doubted(setting: Setting, samples: Array, theta: Array, cov: Array) -> Array:
    """The covariance, with standard errors that what the samples say with a noise model allows.

    Parameters
    ----------
    setting : Setting
    samples : (k, n_inputs + n_outputs + 1) array
    theta : (n,) array
        Coefficients for white noise.
    cov : (n, n) array
        Their covariance so far.

    Returns
    -------
    (n, n) array
        ``cov`` itself where the samples say nothing, or hardly anything else.
    """
    std = np.sqrt(np.diagonal(cov))
    if not np.all(std > 0.0):
        return cov
    try:
        found = drain(refined(setting, record_of(setting, samples), theta, std))
    except (TridentifyError, np.linalg.LinAlgError):
        return cov
    if found is None:
        return cov
    least = np.maximum(np.sqrt(np.diagonal(found.cov)), np.abs(found.theta - theta))
    ratio = np.maximum(least / std, 1.0)
    return cov if np.all(ratio < CLEARLY) else ratio[:, None] * cov * ratio


ELSEWHERE = 0.5
"""Distance of poles over their decay rates from which others are begun from too: between two ticks
poles that the samples tell move by less."""
PASSES = 4
"""Adapted passes at most: from the poles of the tick before one or two do."""


def problem_of(setting: Setting, blueprint: Blueprint, x: Array) -> Problem:
    """The problem behind the triangles."""
    summary = summarise(blueprint, x)
    seconds = float(x[slots.TIME] - x[slots.BORN])
    problem = Problem.of([seen(setting, summary, seconds)], setting.n_poles, setting.zeros)
    return replace(problem, power=summary.power, size=summary.power + summary.mean**2)


def solve_steps(
    setting: Setting,
    blueprint: Blueprint,
    x: Array,
    poles: Complex,
    *,
    choose: bool,
    passes: int = PASSES,
) -> Finished:
    """Steps 1 and 2 with filter and basis re-adapted, to the minimum of the output error.

    Parameters
    ----------
    setting : Setting
    blueprint : Blueprint
    x : array
        Of the estimator.
    poles : (n,) complex array
        Where to begin.
    choose : bool
        Whether nuisance terms that the structure leaves open may be dropped; by AICc.
    passes : int
        Most passes of Steps 1 and 2 before the last steps on the output error.

    Raises
    ------
    IdentifiabilityError, numpy.linalg.LinAlgError
        The samples do not determine the coefficients.
    ZeroOutputError
        An output has not moved.
    """
    return drain(solving(setting, blueprint, x, poles, choose=choose, passes=passes))


def solving(
    setting: Setting,
    blueprint: Blueprint,
    x: Array,
    poles: Complex,
    *,
    choose: bool,
    passes: int = PASSES,
) -> Slices[Finished]:
    """`solve_steps` in slices."""
    base = problem_of(setting, blueprint, x)
    if not np.all(base.size > 0.0) or smallest_channel(blueprint, x) < slots.SMALLEST:
        raise ZeroOutputError(
            "found an output at zero, or a channel too small to be squared, so far; expected a "
            "response to the input; wait for it, or choose another unit"
        )
    full = blueprint.nuisance
    start = "free" if full.free else setting.structure.initial_state
    every = Nuisances(start, full.offset, full.drift)
    best = yield from _solved(base, every, None, poles, passes)
    ends = [best]
    bank = base.admissible(blueprint.poles[: setting.n_poles])[0]
    if distance_of(best.point.poles, bank) > ELSEWHERE:
        # a search found the bank's; with all terms a short record may end at a pole that is none
        ends.append((yield from _solved(base, every, None, bank, 0)))
        best = min(ends, key=lambda one: one.criterion)
    if not choose:
        return best
    begun_anew = x[slots.BORN] > 0.0
    at = int(blueprint.ints[slots.AT_FIRST_INPUT])
    promised = []
    for nuisances, end in itertools.product(_others(setting, every, begun_anew), ends):
        yield
        shifted = nuisances.initial_state == "equilibrium"
        constants = -x[at : at + setting.n_inputs] if shifted else None
        point = evaluate_variant(base, _variant(nuisances, constants), end.point.poles)
        # as off-line: what a step cannot promise is not followed (`likelihood.choose_nuisance`)
        fall = min(point.decrease(), TRUSTED * float(point.counts.sum()))
        promised.append((criterion(point, fall), nuisances, constants, end.point.poles))
    for least, nuisances, constants, begin in sorted(promised, key=lambda one: one[0]):
        if least >= best.criterion + EQUAL:
            break
        found = yield from _solved(base, nuisances, constants, begin, 0)
        if found.criterion < best.criterion:
            best = found
    return best


def distance_of(poles: Complex, bank: Complex) -> float:
    """Largest move of a pole over its decay rate."""
    rates = np.maximum(-bank.real, 1e-6 * np.abs(bank))
    return float(np.max(np.abs(poles - bank) / rates))


def _variant(nuisances: Nuisances, constants: Array | None) -> Variant:
    return Variant(
        nuisances.initial_state == "free", nuisances.offset, nuisances.drift, (constants,)
    )


def _others(setting: Setting, full: Nuisances, begun_anew: bool) -> Sequence[Nuisances]:
    """Leaner choices that the structure allows."""
    structure = setting.structure
    starts = [full.initial_state]
    if structure.initial_state == "auto" and not setting.late and not begun_anew:
        starts += ["rest", "equilibrium"]
    offsets = [True, False] if structure.offset == "auto" else [full.offset]
    drifts = [full.drift, False] if structure.drift == "auto" else [full.drift]
    found = [
        Nuisances(start, offset, drift)
        for start in starts
        for offset in offsets
        for drift in drifts
        if not (start == "equilibrium" and not offset)
    ]
    return [one for one in dict.fromkeys(found) if one != full]


def _solved(
    base: Problem, nuisances: Nuisances, constants: Array | None, poles: Complex, passes: int
) -> Slices[Finished]:
    variant = _variant(nuisances, constants)
    recorder = Recorder()
    admissible, _ = base.admissible(poles)
    if passes:
        admissible = (yield from adapting(base, variant, admissible, recorder, passes)).poles

    def at(trial: Complex) -> Point:
        return evaluate_variant(base, variant, trial)

    yield
    start = at(admissible)
    point, status, why = yield from finishing(at, start, recorder, settled=SETTLED_LONG)
    return Finished(nuisances, point, status, why, criterion(point), recorder)


def directions_of(setting: Setting, blueprint: Blueprint, solution: Finished) -> Array:
    """Sensitivities of the outputs to the coefficients and a constant, on the running columns.

    Parameters
    ----------
    setting : Setting
    blueprint : Blueprint
    solution : Finished
        With all nuisance terms of the blueprint.

    Returns
    -------
    (n_outputs, n_directions, n_columns) array
    """
    point, n = solution.point, blueprint.n_columns
    layout = point.regressions[0].layout
    unit = Regression(
        layout, (np.eye(layout.n_signals),) * setting.n_outputs,
        (np.zeros(layout.n_signals),) * setting.n_outputs,
        (layout.n_signals,) * setting.n_outputs,
    )  # fmt: skip
    whole = on_order(layout, blueprint.poles.size)
    columns = change_columns(np.eye(n), whole, transfer(blueprint.bank, point.bank))
    found = np.zeros((setting.n_outputs, setting.n_directions, n))
    for i in range(setting.n_outputs):
        blocks = [-point.score_states.signals(unit, 0, i)]
        linear = linear_blocks(point.problem, point.branches, unit, 0, i)
        blocks += [linear["b", j] for j in range(setting.n_inputs)]
        if layout.offset:
            blocks.append(unit.nuisance_signals(i)[:, :1])
        rows = (columns @ np.hstack(blocks)).T
        found[i, : len(rows)] = rows
    return found


def coefficients_of_directions(setting: Setting) -> list[Indices]:
    """For each output the coefficient of each of its directions; -1 for a constant."""
    n, begin = setting.n_poles, setting.n_poles
    found = []
    for row in setting.zeros:
        own = sum(degree + 1 for degree in row)
        one = np.full(setting.n_directions, -1)
        one[:n], one[n : n + own] = np.arange(n), np.arange(begin, begin + own)
        begin += own
        found.append(one)
    return found


def estimate_of(
    setting: Setting,
    blueprint: Blueprint,
    x: Array,
    solution: Finished,
    method: str,
    poles: Complex,
    again: Array | None = None,
) -> Estimate:
    """The estimate with its standard errors.

    Parameters
    ----------
    setting : Setting
    blueprint : Blueprint
    x : array
        Of the estimator.
    solution : Finished
    method : str
        Its name.
    poles : (n,) complex array
        Those that the directions were made at.
    again : (k, n_inputs + n_outputs + 1) array, optional
        All samples that the estimate is of, where they are still kept (`online.second_look`).

    Raises
    ------
    UnsupportedOrderError
        The samples do not tell the coefficients apart.
    """
    point = solution.point
    series = series_model(point)
    step = Step(
        "series",
        series.beta.ravel(),
        float(series.cost.sum() / point.counts.sum()),
        series.condition,
        "W_0 = 1 and the orthonormal functions on the poles of a",
    )
    solution.recorder.add(point, lambda: (step,), series.distance, "check of the end")
    trace = Trace(
        tuple(solution.recorder.passes),
        (),
        (f"nuisance terms: {solution.nuisances.label}",),
        solution.why,
    )
    at = int(blueprint.ints[slots.AT_FIRST_INPUT])
    record = stand_in(setting, x[at : at + setting.n_inputs])
    ending = Ending(point, solution.nuisances, solution.status, solution.criterion, trace)
    # there are no samples any more: the scatter that was gathered along is used below
    found = solved_at(ending, [record], setting.structure, judged=False)
    summary = summarise(blueprint, x)
    share = float(np.mean(summary.shares))
    own = coefficients_of_directions(setting)
    map_ = from_directions(setting, poles)
    white = found.cov * share
    cov = with_scatter(blueprint, x, white, found.noise_variance, own, map_)
    if again is not None and (cov is not white or not tells(blueprint, x)):
        cov = doubted(setting, again, found.theta, cov)
    count = int(x[slots.COUNT])
    asked = Request((record,), setting.structure, method, count, record.dt, fingerprint="")
    told = noise_finding(white, cov)
    if again is not None:
        std = np.sqrt(np.diagonal(white))
        doubt = drain(doubting(setting, again, found.theta, std))
        told = told if doubt is None else (doubt_finding(doubt), *told)
    return assemble(asked, replace(found, cov=cov, findings=told))


def stand_in(setting: Setting, first: Array) -> Record:
    """A record with the channels of an estimator and samples that mean nothing, more than those."""
    row = np.concatenate([[setting.dt], first, np.zeros(setting.n_outputs)])
    return record_of(setting, np.tile(row, (1 + max(setting.n_inputs, setting.n_outputs), 1)))
