"""Coefficients and a model of the noise, in turn, from the starts that may lead to the best end.

With the noise modelled as in `likelihood.noise.noise_model` the two are fitted in turn,

    coefficients -> residual -> A (its order by AICc) -> coefficients on whitened samples -> ...

each step on the same likelihood, until the coefficients stand still. Nuisance terms are decided
anew on whitened samples, and these are searched once as well, as what the search saw was coloured.

Under strong slow noise white weights may end far from the truth, and a long model of what they left
takes the response that they missed for noise as well: later turns then stay where they are. Where
the whitened residual still follows the input, every start of both searches is therefore given a
model of the noise of its own, and the turns are taken once more from the likeliest. And where the
predictor, which needs no model of the plant, forecasts the output clearly better than the end does,
the turns are taken once more from its noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.special import chdtri

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Pass, Start, Status
from tridentify.estimation.likelihood.choose_nuisance import Finished, decide
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.curvature import Curvature, output_rss
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Patience,
    Recorder,
    coefficients,
    criterion,
    finish,
)
from tridentify.estimation.likelihood.noise.noise_model import (
    LONGEST_MODELLED,
    MOST_ROUNDS,
    MOSTLY,
    STILL,
    noise_models,
    residual_series,
)
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.thresholds import CLEARLY, SAME_END
from tridentify.estimation.methods.around_maximum.maximum import Maximum
from tridentify.estimation.methods.around_maximum.predictor import Forecast, forecasts
from tridentify.estimation.search.following import CERTAIN
from tridentify.estimation.search.found import Starts
from tridentify.estimation.search.search import search
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import deviance, whiten
from tridentify.numerics.information import aicc_price
from tridentify.numerics.realization import sort_poles
from tridentify.numerics.whiteness import input_share

OPEN_ROUNDS = 3
"""Turns in which orders and nuisance terms are decided anew; later they would only alternate."""
FEW = 2
"""Coefficients of a model that follows the slope of the noise's spectrum and no resonance."""
STEPS = 10
"""On the coefficients between two models of the noise, where starts are compared."""
ALIKE = 0.2
"""Distance of two starts' poles over their size, below which one of the two is tried."""
MISSED = 1e-3
"""Probability of taking noise for a response that is missing."""
FORETOLD = -math.log(1.0 - MOSTLY)
"""AICc above the predictor's for each sample where most of the innovations' power is foretold."""
MUCH = 0.02
"""Share of an output's power (a fit of 86 %) in a residual that noise models may do harm with: of
less, the response that they take for noise is no loss, and their weights foretell better."""
MOST_LEFT = 0.5
"""Share of an output's power that such an end may leave to the noise: where an input acts late, the
likeliest end of all may be that the output is noise, and nothing would be learnt of the
response."""


@dataclass(frozen=True, eq=False)
class Turns:
    """Where turns begin, and on what they are taken.

    Attributes
    ----------
    question : Question
        That of the maximum.
    starts : Starts
        Its search.
    found : Maximum
        The end with white weights.
    tinted : tuple of bool
        Outputs whose noise gets a model.
    """

    question: Question
    starts: Starts
    found: Maximum
    tinted: tuple[bool, ...]

    @cached_property
    def known(self) -> Sequence[Forecast]:
        """The predictors, which need no model of the plant."""
        experiments = self.found.end.point.problem.experiments
        return forecasts([(np.asarray(e.u), np.asarray(e.y)) for e in experiments])

    def are_near(self, point: Point) -> bool:
        """Whether the search began at poles that the record may well have, and they are known."""
        return self.starts.near is not None and point.looseness <= CERTAIN

    def taken(self) -> Maximum:
        """The end of the turns from that with white weights."""
        self.question.say("coloured noise")
        return _alternate(self.question, self.found, self.tinted, self.starts)

    def from_predictor(self, best: Maximum | None = None) -> Maximum:
        """The likelier of an end, if there is one, and of that to which the predictor leads."""
        self.question.say("coloured noise, from the predictor")
        first = tuple(one.noise for one in self.known)
        try:
            other = _alternate(self.question, self.found, self.tinted, self.starts, first)
        except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
            return best or self.found
        if best is None:
            return other
        fall = criterion_with_noise(best.end.point) - criterion_with_noise(other.end.point)
        whole, other_whole = (one.end.status is Status.CONVERGED for one in (best, other))
        if whole == other_whole:
            return other if fall > 0.0 else best
        # an integrator ends at a limit, and so does many a search that went astray
        return other if fall > (CLEARLY if whole else -CLEARLY) else best

    def from_every_start(self, best: Maximum) -> Maximum:
        """The end of the turns from the likeliest start, where that is clearly better.

        Where the turns ended at a limit, any other end that lies near it will do.
        """
        self.question.say("coloured noise, a model for every start")
        point = best.end.point
        seeds = [_poles_of(point, one.theta) for one in best.tried]
        near = [point.poles]
        for poles in seeds:
            if not any(_is_near(poles, other) for other in near):
                near.append(poles)
        ends = [_profiled(point, poles, self.tinted) for poles in near[1:]]
        known = [one for one in ends if one is not None]
        if not known:
            return best
        start = min(known, key=criterion_with_noise)
        begun = replace(best, end=replace(best.end, point=start), tried=())
        other = _alternate(self.question, begun, self.tinted, None)
        end = other.end.point
        left = output_rss(end) > MOST_LEFT * end.problem.power * end.counts
        if other.end.status is not Status.CONVERGED or np.any(left):
            return best
        fall = criterion_with_noise(point) - criterion_with_noise(end)
        least = CLEARLY if best.end.status is Status.CONVERGED else -CLEARLY
        return replace(other, tried=best.tried) if fall > least else best

    def misses(self, point: Point) -> bool:
        """Whether part of a whitened residual follows the input."""
        series = residual_series(point, LONGEST_MODELLED)
        for i in np.flatnonzero(self.tinted):
            statistic, dimension = 0.0, 0
            for one, e in zip(series[i], point.problem.experiments, strict=True):
                a = point.problem.noise[i]
                _, own, freedom = input_share(one, e.u[: one.size], a)
                statistic, dimension = statistic + own, dimension + freedom
            if dimension and statistic > chdtri(float(dimension), MISSED):
                return True
        return False

    def behind(self, point: Point, noise: tuple[Array, ...] | None = None) -> float:
        """AICc of an end above that of the predictors, which need no model of the plant.

        Where it is large, the end is no likely one: part of the response has been taken for noise.
        """
        models = point.problem.noise if noise is None else noise
        return max(0.0, *(excess for excess, _ in self._excesses(point, models)))

    def foretold(self, point: Point) -> bool:
        """Whether predictors foretell most of what noise models leave of a large residual."""
        problem = point.problem
        much = output_rss(point) > MUCH * problem.power * point.counts
        if not np.all(much[np.array(self.tinted)]):
            return False
        excesses = self._excesses(point, noise_models(point, self.tinted, None))
        return all(
            excess > FORETOLD * count
            for (excess, count), tinted in zip(excesses, self.tinted, strict=True)
            if tinted
        )

    def _excesses(self, point: Point, noise: tuple[Array, ...]) -> list[tuple[float, int]]:
        """For every output the AICc above that of its predictor, and of how many samples."""
        problem = point.problem
        own = (problem.n_coefficients + problem.n_nuisance) / problem.n_outputs
        found = []
        for series, a, one in zip(residual_series(point), noise, self.known, strict=True):
            white = [whiten(left, a)[0] for left in series]
            count = sum(int(np.isfinite(each[one.first :]).sum()) for each in white)
            found.append((one.excess(white, own + a.size), count))
        return found


def _alternate(
    question: Question,
    found: Maximum,
    tinted: tuple[bool, ...],
    starts: Starts | None,
    first: tuple[Array, ...] | None = None,
) -> Maximum:
    """Noise model and coefficients in turn, until the coefficients stand still.

    Parameters
    ----------
    question : Question
    found : Maximum
        Where to begin.
    tinted : tuple of bool
        Outputs whose noise gets a model.
    starts : Starts or None
        The search before; None where whitened samples are not to be searched.
    first : tuple of (p,) arrays, optional
        The noise to begin with; by default that of the residual.
    """
    best, reasons, trail = found.end, found.decisions, Recorder(list(found.end.recorder.passes))
    orders: list[int] | None = None
    tried: tuple[Start, ...] = ()
    for count in range(MOST_ROUNDS):
        model = first if first and not count else noise_models(best.point, tinted, orders)
        if count < OPEN_ROUNDS:
            whole = question.whitened(model)
            following = decide(whole, [best.point.poles])
            certain = starts is not None and starts.near is not None
            certain = certain and following.best.point.looseness <= CERTAIN
            if starts is not None and not count and not certain:
                question.say("another search, on whitened samples")
                anew = search(whole.held, starts.count, starts.far, near=starts.near)
                tried = tuple(replace(one, name=f"whitened: {one.name}") for one in anew.tried)
                other = decide(whole, anew.seeds)
                if other.best.criterion < following.best.criterion - SAME_END:
                    following = other
            after, reasons = following.best, following.decisions or reasons
        else:
            orders = [a.size for a in model]
            after = _finished(best, model, question.patience)
        trail.passes.extend(_relabelled(after, model, len(trail.passes)))
        still = after.nuisances == best.nuisances and _stands(after.point, best.point)
        best = after
        if still:
            break
    end = replace(best, recorder=trail)
    return replace(found, end=end, decisions=reasons, tried=(*found.tried, *tried))


def _finished(best: Finished, model: tuple[Array, ...], patience: Patience) -> Finished:
    """The minimum for another model of the noise, from where the last one ended."""
    problem = best.point.problem.whitened(model)
    at, recorder = partial(evaluate, problem), Recorder()
    start = at(best.point.poles)
    settled = patience.settled(start.counts.sum())
    point, status, why = finish(at, start, recorder, patience.most, settled)
    return Finished(best.nuisances, point, status, why, criterion(point), recorder)


def _stands(point: Point, before: Point) -> bool:
    """Whether the coefficients moved by less than a hundredth of their standard errors."""
    moved = np.abs(coefficients(point) - coefficients(before))
    return bool(np.all(moved <= STILL * Curvature.at(point).std))


def _relabelled(end: Finished, model: Sequence[Array], before: int) -> list[Pass]:
    """Its passes, numbered from those before, with a word on the noise model."""
    label = ", ".join(str(a.size) for a in model)
    return [
        replace(
            one,
            number=before + k,
            note=f"samples whitened, order {label}" + (f"; {one.note}" if one.note else ""),
        )
        for k, one in enumerate(end.recorder.passes, start=1)
    ]


def _profiled(point: Point, poles: Complex, tinted: tuple[bool, ...]) -> Point | None:
    """Where a start leads under a model of the noise of its own; None where it leads nowhere."""
    few = [FEW] * len(tinted)
    try:
        end = evaluate(point.problem.whitened(noise_models(point, tinted, few)), poles)
        for orders in (few, None, None):
            at = partial(evaluate, point.problem.whitened(noise_models(end, tinted, orders)))
            end = finish(at, at(end.poles), None, STEPS)[0]
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return None
    return end


def _poles_of(point: Point, theta: Array) -> Complex:
    """Of every denominator among the coefficients of a start."""
    found = []
    for place in point.problem.places()[0]:
        found.append(sort_poles(np.roots(np.append(1.0, theta[place])).astype(np.complex128)))
    return point.problem.admissible(np.concatenate(found))[0]


def _is_near(poles: Complex, other: Complex) -> bool:
    return bool(np.all(np.abs(poles - other) <= ALIKE * np.abs(other)))


def criterion_with_noise(point: Point) -> float:
    """AICc with the model of the noise, so that ends under different ones compare."""
    series = residual_series(point)
    noise = point.problem.noise or (np.zeros(0),) * len(series)
    k = float(sum(a.size for a in noise) + point.problem.n_outputs)
    k += point.problem.n_coefficients + point.problem.n_nuisance
    found = sum(deviance(own, a) for own, a in zip(series, noise, strict=True))
    return found + aicc_price(k, float(point.counts.sum()))
