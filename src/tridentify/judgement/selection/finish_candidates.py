"""Every candidate finished on the likelihood's maximum, all on the same terms.

1. On white noise each candidate stands where it ended by itself, or at the maximum beside which its
   posterior mean lies. Otherwise it is finished from the best of its starts: that end, balanced
   truncations of the parallel model and a discrete-time model. Single poles or pairs are then tried
   elsewhere (`search.following.Search.move`), as in the search of one structure, where the parallel
   model explains more.
2. A candidate that contains another one cannot explain less. Where it does, its end was a local
   minimum, and it begins again from the poles of the lesser one with one pole more, taken from its
   own starts.
3. The residual of the candidate of lowest AICc is tested for whiteness. If it is noise that is not
   white, *all* candidates get an autoregressive model of the same order, each with coefficients
   from its own residual, and are finished again on whitened samples; once more, as the residuals
   have changed. One set of coefficients for all would favour the candidate that it comes from.
4. Offset, drift and initial state belong to the record, not to the order. Left to each candidate
   they would blur the comparison, so where they are open the candidate of lowest BIC is finished
   with every choice, and the choice of lowest BIC holds for all.

A task is a value and its outcome depends on nothing else, so whoever runs the tasks, in whatever
order, the table is the same to the last bit.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Status, Trace
from tridentify.estimation.likelihood.answer import Ending, estimate_from
from tridentify.estimation.likelihood.choose_nuisance import decide
from tridentify.estimation.likelihood.cost import Point, evaluate_variant
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Patience,
    at_rounding,
    criterion,
    finish,
)
from tridentify.estimation.likelihood.noise.noise_model import MOSTLY
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, candidates
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.likelihood.setup.raster import are_even
from tridentify.estimation.likelihood.thresholds import ALLOWANCE
from tridentify.estimation.methods.around_maximum.maximum import Reached
from tridentify.estimation.methods.base import Method, check
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.estimation.search.following import Search
from tridentify.estimation.search.found import SearchEnd
from tridentify.estimation.search.starts import discrete_poles
from tridentify.judgement.selection.halfway import Halfway
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import deviance, fit_autoregression, most_coefficients
from tridentify.numerics.rational import scaled_roots
from tridentify.numerics.realization import sort_poles
from tridentify.numerics.threads import one_blas_thread
from tridentify.numerics.whiteness import input_share, is_white
from tridentify.record.record import Record
from tridentify.structure import InitialState, Structure

FOLLOWED = 3
"""Seeds of a candidate that are followed, the lowest."""
FEW_STEPS = 12
"""Steps from each: enough to rank them."""
MOST_ROUNDS = 2
"""Turns of the orders of the noise models and of which candidate is best: the one says the
other."""
WORSE = 0.05
"""Deviance [-2 log L] by which a candidate may end above one that it contains: from more its steps
ended elsewhere, and it begins again from there."""


_Done = tuple[Estimate, Complex | None, tuple[Reached, ...]]


@dataclass(frozen=True, eq=False)
class CandidateTask:
    """One candidate and where to begin.

    ``shared`` says that it can be finished from ``seeds``; otherwise ``method`` identifies it.
    Where a candidate comes to ``reach``, the AICc of the parallel model, there is nothing left to
    search for. ``found`` is what ``method`` gave where it was asked already. ``halfway`` says that
    its search may stop at the likelihood's maximum, ``reached`` where one did.
    """

    records: tuple[Record, ...]
    structure: Structure
    method: Method
    seeds: tuple[Complex, ...] = ()
    noise: tuple[Array, ...] = ()
    shared: bool = True
    search: bool = True
    reach: float = -np.inf
    found: Estimate | None = None
    halfway: bool = False
    reached: tuple[Reached, ...] = ()


@dataclass(frozen=True, eq=False)
class Entry:
    """What became of a candidate: an estimate with its residuals, or the reason why not.

    ``longest`` is the duration of the longest experiment [s]. ``left`` is a maximum at which the
    search was left, as the answer may be another one; empty where it is the answer.
    """

    structure: Structure
    estimate: Estimate | None
    reason: str = ""
    residuals: tuple[Array, ...] = ()
    poles: Complex | None = None
    shared: bool = True
    longest: float = 1.0
    left: tuple[Reached, ...] = ()

    @property
    def unfinished(self) -> bool:
        """Whether `identify` may give another estimate: the search went on, or a whole one came."""
        return self.shared or bool(self.left)


def run_task(task: CandidateTask) -> Entry:
    """Finish one candidate; an exception is an entry, too."""
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"), one_blas_thread():
            warnings.simplefilter("ignore")
            estimate, poles, left = _finished(task) if task.shared else _identified(task)
            residuals = tuple(
                np.asarray(estimate.residual(record, experiment=e))
                for e, record in enumerate(task.records)
            )
    except (TridentifyError, np.linalg.LinAlgError, ValueError) as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        return Entry(task.structure, None, reason, shared=task.shared)
    longest = max(record.duration for record in task.records)
    return Entry(task.structure, estimate, "", residuals, poles, task.shared, longest, left)


def _identified(task: CandidateTask) -> _Done:
    """What the method gives, and where its search was left."""
    if task.found is not None:
        return task.found, None, ()
    method = task.method
    if task.halfway and isinstance(method, ThreeModel):
        method = Halfway.of(method, task.reached)
    estimate = method.estimate(task.records, task.structure)
    return estimate, None, tuple(method.left) if isinstance(method, Halfway) else ()


def _finished(task: CandidateTask) -> _Done:
    """The likelihood's maximum from the seeds."""
    records, structure = list(task.records), task.structure
    check(records, structure, task.method.name, ThreeModel().capabilities)
    patience = task.method.patience if isinstance(task.method, ThreeModel) else Patience()
    question = Question.of(records, structure, patience=patience).whitened(task.noise)
    found = decide(question, [_best(question.base, question.variants, task).poles])
    done = found.best
    trace = Trace(tuple(done.recorder.passes), (), found.decisions, done.why)
    ending = Ending(done.point, done.nuisances, done.status, done.criterion, trace)
    estimate = estimate_from(ending, Request.of(records, structure, task.method.name))
    return estimate, done.point.poles, ()


def _best(base: Problem, variants: Sequence[Variant], task: CandidateTask) -> Point:
    """The lowest point reached from the seeds, with all nuisance terms."""
    variant = variants[-1]
    at = partial(evaluate_variant, base, variant)
    seeds = [base.admissible(poles)[0] for poles in task.seeds]
    if task.search or not seeds:
        seeds.append(discrete_poles(base))
    points = sorted((at(poles) for poles in seeds), key=lambda point: point.objective)
    if not task.search:
        return points[0]
    ends = []
    for point in points[:FOLLOWED]:
        ends.append(finish(at, point, None, FEW_STEPS)[0])
        if at_rounding(ends[-1]) or criterion(ends[-1]) < task.reach + ALLOWANCE:
            return ends[-1]
    best = min(ends, key=lambda point: point.objective)
    return Search(1).move(SearchEnd(base, best, variant, np.inf, False))


def begun(task: CandidateTask, alone: Entry) -> CandidateTask | Entry:
    """The candidate, to be finished from where it ended by itself; or the end, if a maximum.

    One that the whole search refuses is refused.
    """
    if alone.estimate is None:
        return alone
    estimate = alone.estimate
    poles = sort_poles(scaled_roots(estimate.model.den[0][0]))
    if task.seeds or not is_on_white(estimate) or estimate.noise_levels:
        return replace(task, seeds=(poles, *task.seeds))
    if alone.left or estimate.status is Status.POSTERIOR_MEAN:
        before = () if alone.left else _before_the_mean(estimate, poles.size)
        return replace(task, seeds=(poles, *before), search=False)
    return replace(alone, poles=poles, shared=True)


def _before_the_mean(estimate: Estimate, n: int) -> list[Complex]:
    """Poles of the maximum beside which a posterior mean was taken."""
    ends = [one.theta[:n] for one in estimate.trace.passes[:-1][-1:] if one.theta.size >= n]
    return [sort_poles(scaled_roots(np.append(1.0, end))) for end in ends]


def is_on_white(estimate: Estimate) -> bool:
    """Whether its samples were not whitened."""
    return not any(a.size for a in estimate.noise_model)


def contained(small: Entry, large: Entry, shape: tuple[int, int]) -> bool:
    """Whether one candidate is a special case of another, nuisance terms included."""
    if small.estimate is None or large.estimate is None:
        return False
    one, other = small.estimate.structure, large.estimate.structure
    if not (one.shared and other.shared) or one.delay != other.delay:
        return False
    more = other.common_poles - one.common_poles
    few, many = one.zeros_matrix(*shape), other.zeros_matrix(*shape)
    wide = all(
        m + more <= k for a, b in zip(few, many, strict=True) for m, k in zip(a, b, strict=True)
    )
    along = (not one.offset or other.offset) and one.drift_degree <= other.drift_degree
    free = one.initial_state == other.initial_state or other.initial_state == "free"
    return more >= 0 and wide and bool(along) and free and one is not other


def noise_orders(entry: Entry, records: Sequence[Record]) -> tuple[int, ...]:
    """Order of an autoregression for each output's residual, by BIC; 0 where it passes for white.

    Also 0 for a residual that mostly follows the input, which is a response that is missed, for
    one that is no more than rounding, and where time is no raster.
    """
    assert entry.estimate is not None
    n_outputs = len(entry.estimate.output_names)
    if not are_even(records):
        return (0,) * n_outputs
    found = []
    for i in range(n_outputs):
        series = [one[:, i] for one in entry.residuals]
        count = sum(int(np.isfinite(one).sum()) for one in series)
        size = float(np.mean([np.nanmean(record.y[:, i] ** 2) for record in records]))
        power = sum(float(np.nansum(one**2)) for one in series) / max(count, 1)
        most = most_coefficients(count - 2 * len(entry.estimate.names))
        if most == 0 or power <= 1e-18 * size or is_white(series):
            found.append(0)
            continue
        a = fit_autoregression(series, most, fewest=1)
        shares = [
            input_share(one, np.asarray(r.u), a)[0] * one.size
            for one, r in zip(series, records, strict=True)
        ]
        follows = sum(shares) > MOSTLY * sum(one.size for one in series)
        found.append(0 if follows else _lean_order(series, a.size, count))
    return tuple(found)


def _lean_order(series: Sequence[Array], most: int, count: int) -> int:
    """The order up to ``most`` of lowest BIC, at least 1."""
    prices = [
        deviance(series, fit_autoregression(series, p, p)) + p * np.log(count)
        for p in range(1, most + 1)
    ]
    return int(np.argmin(prices)) + 1


def nuisance_choices(records: Sequence[Record], structure: Structure) -> tuple[Nuisances, ...]:
    """What a structure leaves open of offset, drift and initial state."""
    return candidates(records, structure)


def with_nuisances(task: CandidateTask, terms: Nuisances) -> CandidateTask:
    """The same candidate with one choice of nuisance terms; a drift that it has stays its own."""
    own = task.structure.drift
    pinned = replace(
        task.structure,
        offset=terms.offset,
        drift=terms.drift if own == "auto" else own,
        initial_state=cast("InitialState", terms.initial_state),
    )
    return replace(task, structure=pinned)


def noise_of_orders(residuals: Sequence[Array], orders: Sequence[int]) -> tuple[Array, ...]:
    """Autoregressions of given orders for the residuals of each output."""
    return tuple(
        fit_autoregression([one[:, i] for one in residuals], p, p) if p else np.zeros(0)
        for i, p in enumerate(orders)
    )


def raised(seeds: Sequence[Complex], poles: Complex) -> list[Complex]:
    """Poles of a lesser candidate, filled up from seeds of a higher order with the farthest."""
    found = []
    for seed in seeds:
        more = seed.size - poles.size
        if more <= 0:
            continue
        distance = np.array(
            [np.min(np.abs(np.log(np.abs(z)) - np.log(np.abs(poles)))) for z in seed]
        )
        order = np.argsort(-distance, kind="stable")
        picked: list[complex] = []
        for k in order:
            z = complex(seed[k])
            need = more - len(picked)
            if z.imag == 0 and need >= 1:
                picked.append(z)
            elif z.imag > 0 and need >= 2:
                picked += [z, z.conjugate()]
        while len(picked) < more:
            picked.append(complex(-np.abs(seed[order[0]])))
        found.append(np.concatenate([poles, np.array(picked, dtype=np.complex128)]))
    return found


def narrowed(task: CandidateTask, poles: Complex | None, noise: tuple[Array, ...]) -> CandidateTask:
    """The same candidate from poles that were found already."""
    seeds = () if poles is None else (poles,)
    return replace(task, seeds=seeds, noise=noise, search=False)
