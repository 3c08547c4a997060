"""Coloured measurement noise: its model and the coefficients, in turn.

With the noise modelled as in `likelihood.noise_model` the two are fitted in turn,

    coefficients -> residual -> A (its order by AICc) -> coefficients on whitened samples -> ...

each step on the same likelihood, until the coefficients stand still. White weights remain
consistent where the noise is coloured, but are not efficient, their standard errors are wrong, and
AICc takes slow noise for offsets, drifts and free responses. So the nuisance terms are decided anew
on whitened samples, and these are searched once as well, as what the search saw was coloured.

Where more than half of the whitened residual follows the input, the samples are left as they are:
with whitening the coefficients would move to where the missing response is smallest for its size,
which can be far from anything wanted. What white weights explain and the whitened samples leave to
the noise is told.

A mode that decays little within the record may stand for a disturbance that wanders over it, and
what the plant then misses follows the input. Where white weights end at such a mode, or at a limit,
the end on whitened samples counts although their residual follows the input, and although the mode
follows more of the output, if it explains the record: what it leaves does not follow the input, and
is as little as the predictor leaves, which needs no model of the plant.

Under strong slow noise white weights may end far from the truth, and a long model of what they left
takes the response that they missed for noise as well: later turns then stay where they are. Where
the whitened residual still follows the input, every start of both searches is therefore given a
model of the noise of its own, and the turns are taken once more from the likeliest. And where the
predictor, which needs no model of the plant, forecasts the output clearly better than the end does,
the turns are taken once more from its noise. In open loop an end that does not follow the output is
not taken for that, but told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.special import chdtri

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Pass, Start, Status
from tridentify.estimation.answer.trace import FAR_LIKELIER, RESPONSE_AS_NOISE, SLOW_AS_NOISE
from tridentify.estimation.likelihood.choose_nuisance import Finished, decide
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.curvature import Curvature, output_rss
from tridentify.estimation.likelihood.levenberg_marquardt import (
    Patience,
    Recorder,
    at_rounding,
    coefficients,
    criterion,
    finish,
)
from tridentify.estimation.likelihood.noise_model import (
    LONGEST_MODELLED,
    MOST_ROUNDS,
    STILL,
    TESTED,
    NoiseChoice,
    follows_input,
    noise_models,
    refusal,
    residual_series,
)
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.thresholds import CLEARLY, NEAR, RIVAL, SAME_END
from tridentify.estimation.likelihood.two_weights import moved_by_weights
from tridentify.estimation.methods.maximum import Maximum
from tridentify.estimation.methods.predictor import Forecast, forecasts
from tridentify.estimation.search.found import Starts
from tridentify.estimation.search.search import search
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import deviance, whiten
from tridentify.numerics.information import aicc_price
from tridentify.numerics.realization import sort_poles
from tridentify.numerics.whiteness import input_share, is_white

OPEN_ROUNDS = 3
"""Turns in which orders and nuisance terms are decided anew; later they would only alternate."""
LOST = 10.0
"""Residual power over that with white weights from which whitening has led astray."""
NOTABLE, LARGE = 1.5, 4.0
"""Residual power with whitened samples over that with white weights: worth a note, a caution. Right
models in noise that wanders over the whole record reach three, others 1.1."""
FEW = 2
"""Coefficients of a model that follows the slope of the noise's spectrum and no resonance."""
STEPS = 10
"""On the coefficients between two models of the noise, where starts are compared."""
ALIKE = 0.2
"""Distance of two starts' poles over their size, below which one of the two is tried."""
MISSED = 1e-3
"""Probability of taking noise for a response that is missing."""
MOST_LEFT = 0.5
"""Share of an output's power that such an end may leave to the noise: where an input acts late, the
likeliest end of all may be that the output is noise, and nothing would be learnt of the
response."""
ELSEWHERE = 3.0
"""Standard errors between two ends from which they are told apart."""
SLOW_MODE = 10.0
"""Decay of a mode within the record from below which it may stand for a disturbance that wanders
over the record."""
PASSED = "noise white: the residual passes the portmanteau test"
FOLLOWED = "noise taken as white: the residual is not, but most of it follows the input"


def with_noise_model(
    noise: NoiseChoice,
    question: Question,
    starts: Starts,
    found: Maximum,
    *,
    in_loop: bool = False,
) -> Maximum:
    """Model the noise if that is asked for, or if the residual is not white.

    Parameters
    ----------
    noise : {"white", "ar", "auto"}
    question : Question
        That of the maximum.
    starts : Starts
        Its search.
    found : Maximum
        The end with white weights.
    in_loop : bool
        Whether the inputs react to the outputs: the turns then also begin with the noise of the
        predictor, which no such end has bent, and the likelier end counts.

    Returns
    -------
    Maximum
        On whitened samples, or as it was where the noise passes for white.

    Raises
    ------
    UnsupportedError, TooFewSamplesError
        If a model of the noise is asked for and cannot be made.
    """
    if noise == "white":
        return found
    first = found.end
    refused = refusal(first.point)
    if refused is not None:
        if noise == "ar" and not at_rounding(first.point):
            raise refused
        note = str(refused).partition(";")[0].removeprefix("found ")
        return found if at_rounding(first.point) else _told(found, f"noise taken as white: {note}")
    if starts.saw_white(first.point) and noise == "auto":
        return _told(found, PASSED)
    residuals = residual_series(first.point, TESTED)
    tinted = tuple(noise == "ar" or not is_white(series) for series in residuals)
    if not any(tinted):
        return _told(found, PASSED)
    slow = noise == "auto" and _may_be_a_disturbance(first)
    doubtful = False
    if noise == "auto":
        left = _left_to_noise(first.point, tinted)
        doubtful = slow and left != tinted
        if not doubtful and not any(left):
            return _told(found, FOLLOWED)
        tinted = tinted if doubtful else left
    question.say("coloured noise")
    best = _alternate(question, found, tinted, starts)
    known = forecasts(_pairs(first.point))
    if in_loop:
        question.say("coloured noise, from the predictor")
        best = _from_predictor(question, found, tinted, starts, best, known)
    if _misses(best.end.point, tinted) or (noise == "auto" and _is_lost(best.end, first)):
        question.say("coloured noise, a model for every start")
        best = _elsewhere(question, best, tinted)
    likelier = best
    if not in_loop and _behind(best.end.point, known) > CLEARLY:
        question.say("coloured noise, from the predictor")
        likelier = _from_predictor(question, found, tinted, starts, best, known)
        if noise == "ar" or _follows(likelier.end, first):
            best = likelier
    lost = noise == "auto" and _is_lost(best.end, first)
    if doubtful or (slow and lost):
        ends = (one for one in (best, likelier) if _explains(one.end, tinted, known))
        explaining = next(ends, None)
        if explaining is not None:
            best, likelier, lost = explaining, explaining, False
        elif doubtful:
            return _told(found, FOLLOWED)
    if lost:
        told = "noise taken as white: on whitened samples there was no usable minimum"
        words = (told, *_likelier(first, likelier.end, tinted, known))
        return replace(found, decisions=(*found.decisions, *words), tried=best.tried)
    words = (_in_words(best.end.point, tinted, noise), *_apart(first, best.end))
    if likelier is not best:
        words = (*words, *_likelier(best.end, likelier.end, tinted, known))
    moved = None if in_loop else _moved(first, best.end)
    return replace(best, decisions=(*best.decisions, *words), moved=moved)


def _left_to_noise(point: Point, tinted: tuple[bool, ...]) -> tuple[bool, ...]:
    """Outputs whose residual is coloured, and does not mostly follow the input."""
    residuals = residual_series(point, TESTED)
    return tuple(
        coloured and not follows_input(point, i, residuals[i]) for i, coloured in enumerate(tinted)
    )


def _may_be_a_disturbance(end: Finished) -> bool:
    """Whether an end has a mode that a slow disturbance may have been taken for."""
    problem = end.point.problem
    longest = max(e.duration for e in problem.experiments)
    slowest = float(np.min(np.abs(end.point.poles.real)))
    return end.status is not Status.CONVERGED or slowest * longest < SLOW_MODE


def _explains(end: Finished, tinted: tuple[bool, ...], known: Sequence[Forecast]) -> bool:
    """Whether an end follows the output, and leaves noise alone, as little as the predictors do."""
    if np.any(output_rss(end.point) > end.point.problem.power * end.point.counts):
        return False
    if end.status is not Status.CONVERGED or _left_to_noise(end.point, tinted) != tinted:
        return False
    return _behind(end.point, known) < RIVAL


def _moved(first: Finished, best: Finished) -> Array | None:
    """Half of how far white weights lead from the end; in a loop they are biased by themselves."""
    if not first.status is best.status is Status.CONVERGED:
        return None
    return moved_by_weights(first.point, best.point)


def _pairs(point: Point) -> list[tuple[Array, Array]]:
    """Recorded inputs and outputs."""
    return [(np.asarray(e.u), np.asarray(e.y)) for e in point.problem.experiments]


def _behind(
    point: Point, known: Sequence[Forecast], noise: tuple[Array, ...] | None = None
) -> float:
    """AICc of an end above that of the predictors, which need no model of the plant.

    Where it is large, the end is no likely one: part of the response has been taken for noise.
    """
    problem = point.problem
    own = (problem.n_coefficients + problem.n_nuisance) / problem.n_outputs
    models = problem.noise if noise is None else noise
    found = 0.0
    for series, a, one in zip(residual_series(point), models, known, strict=True):
        white = [whiten(left, a)[0] for left in series]
        found = max(found, one.excess(white, own + a.size))
    return found


def _likelier(
    kept: Finished, other: Finished, tinted: tuple[bool, ...], known: Sequence[Forecast]
) -> tuple[str, ...]:
    """A word where an end that is not kept is as likely as the predictor, and the kept one not."""
    white = not any(a.size for a in kept.point.problem.noise)
    noise = noise_models(kept.point, tinted, None) if white else None
    behind, left = _behind(kept.point, known, noise), _behind(other.point, known)
    if behind - left < RIVAL or left > NEAR:
        return ()
    errors = np.maximum(Curvature.at(kept.point).std, 1e-300)
    moved = np.max(np.abs(coefficients(other.point) - coefficients(kept.point)) / errors)
    if moved < ELSEWHERE:
        return ()
    fall = f"AICc lower by {behind - left:.0f}"
    return (f"{FAR_LIKELIER} by up to {moved:.0f} standard errors ({fall})",)


def _from_predictor(
    question: Question,
    found: Maximum,
    tinted: tuple[bool, ...],
    starts: Starts,
    best: Maximum,
    known: Sequence[Forecast],
) -> Maximum:
    """The likelier of an end and of that to which the noise of the predictor leads."""
    first = tuple(one.noise for one in known)
    try:
        other = _alternate(question, found, tinted, starts, first)
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return best
    fall = _criterion(best.end.point) - _criterion(other.end.point)
    whole, other_whole = (one.end.status is Status.CONVERGED for one in (best, other))
    if whole == other_whole:
        return other if fall > 0.0 else best
    # an integrator ends at a limit, and so does many a search that went astray
    return other if fall > (CLEARLY if whole else -CLEARLY) else best


def _told(found: Maximum, decision: str) -> Maximum:
    return replace(found, decisions=(*found.decisions, decision))


def _misses(point: Point, tinted: Sequence[bool]) -> bool:
    """Whether part of a whitened residual follows the input."""
    series = residual_series(point, LONGEST_MODELLED)
    for i in np.flatnonzero(tinted):
        statistic, dimension = 0.0, 0
        for one, e in zip(series[i], point.problem.experiments, strict=True):
            a = point.problem.noise[i]
            _, own, freedom = input_share(one, e.u[: one.size], a)
            statistic, dimension = statistic + own, dimension + freedom
        if dimension and statistic > chdtri(float(dimension), MISSED):
            return True
    return False


def _criterion(point: Point) -> float:
    """AICc with the model of the noise, so that ends under different ones compare."""
    noise = point.problem.noise
    series = residual_series(point)
    k = float(sum(a.size for a in noise) + point.problem.n_outputs)
    k += point.problem.n_coefficients + point.problem.n_nuisance
    found = sum(deviance(own, a) for own, a in zip(series, noise, strict=True))
    return found + aicc_price(k, float(point.counts.sum()))


def _elsewhere(question: Question, found: Maximum, tinted: tuple[bool, ...]) -> Maximum:
    """The end of the turns from the likeliest start, where that is clearly better.

    Where the turns ended at a limit, any other end that lies near it will do.
    """
    point = found.end.point
    seeds = [_poles_of(point, one.theta) for one in found.tried]
    near = [point.poles]
    for poles in seeds:
        if not any(_is_near(poles, other) for other in near):
            near.append(poles)
    ends = [_profiled(point, poles, tinted) for poles in near[1:]]
    known = [one for one in ends if one is not None]
    if not known:
        return found
    start = min(known, key=_criterion)
    begun = replace(found, end=replace(found.end, point=start), tried=())
    other = _alternate(question, begun, tinted, None)
    end = other.end.point
    left = output_rss(end) > MOST_LEFT * end.problem.power * end.counts
    if other.end.status is not Status.CONVERGED or np.any(left):
        return found
    fall = _criterion(point) - _criterion(end)
    least = CLEARLY if found.end.status is Status.CONVERGED else -CLEARLY
    return replace(other, tried=found.tried) if fall > least else found


def _poles_of(point: Point, theta: Array) -> Complex:
    """Of every denominator among the coefficients of a start."""
    found = []
    for place in point.problem.places()[0]:
        found.append(sort_poles(np.roots(np.append(1.0, theta[place])).astype(np.complex128)))
    return point.problem.admissible(np.concatenate(found))[0]


def _is_near(poles: Complex, other: Complex) -> bool:
    return bool(np.all(np.abs(poles - other) <= ALIKE * np.abs(other)))


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
            if starts is not None and not count:
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


def _finished(best: Finished, model: tuple[Array, ...], patience: Patience) -> Finished:
    """The minimum for another model of the noise, from where the last one ended."""
    problem = best.point.problem.whitened(model)
    at, recorder = partial(evaluate, problem), Recorder()
    start = at(best.point.poles)
    settled = patience.settled(start.counts.sum())
    point, status, why = finish(at, start, recorder, patience.most, settled)
    return Finished(best.nuisances, point, status, why, criterion(point), recorder)


def _is_lost(best: Finished, first: Finished) -> bool:
    """Whether whitening led astray: to a limit, or to a model that explains far less."""
    if first.status is Status.CONVERGED and best.status is not Status.CONVERGED:
        return True
    return bool(np.any(output_rss(best.point) > LOST * output_rss(first.point)))


def _follows(best: Finished, first: Finished) -> bool:
    """Whether an end follows the output hardly worse than that with white weights."""
    far = np.any(output_rss(best.point) > LARGE * output_rss(first.point))
    return not far and not _is_lost(best, first)


def _stands(point: Point, before: Point) -> bool:
    """Whether the coefficients moved by less than a hundredth of their standard errors."""
    moved = np.abs(coefficients(point) - coefficients(before))
    return bool(np.all(moved <= STILL * Curvature.at(point).std))


def _apart(first: Finished, best: Finished) -> tuple[str, ...]:
    """A word where white weights explain far more of the output than whitened samples do.

    Slow noise looks like a slow response, and the other way round: the record cannot say which,
    only by how much the two ends differ.
    """
    counts = first.point.counts
    size = np.maximum(first.point.problem.power * counts, 1e-300)
    plain, own = (output_rss(end.point) / size for end in (first, best))
    told: list[str] = []
    for known, much in ((RESPONSE_AS_NOISE, LARGE), (SLOW_AS_NOISE, NOTABLE)):
        where = np.flatnonzero(own > much * plain)
        if where.size and not told:
            fits = [
                f"{100.0 * (1.0 - math.sqrt(own[i])):.1f} % where white weights reach "
                f"{100.0 * (1.0 - math.sqrt(plain[i])):.1f} %"
                for i in where
            ]
            told.append(f"{known}: fit {', '.join(fits)}")
    return tuple(told)


def _in_words(point: Point, tinted: Sequence[bool], noise: str) -> str:
    why = "as asked for" if noise == "ar" else "the residual with white weights is not white"
    orders = [
        f"order {a.size}" if coloured else "white"
        for a, coloured in zip(point.problem.noise, tinted, strict=True)
    ]
    return f"noise coloured ({why}): samples whitened by autoregressions, {', '.join(orders)}"
