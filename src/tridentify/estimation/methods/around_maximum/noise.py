"""Coloured measurement noise: whether it gets a model, and which end then counts.

White weights remain consistent where the noise is coloured, but are not efficient, their standard
errors are wrong, and AICc takes slow noise for offsets, drifts and free responses. So the noise
gets a model where the residual is not white, and coefficients and noise are fitted in turn
(`methods.around_maximum.turns`).

Where more than half of the whitened residual follows the input, the samples are left as they are:
with whitening the coefficients would move to where the missing response is smallest for its size,
which can be far from anything wanted. An autoregression forecasts a slow response nearly as well as
noise of the same colour, and hides most of it; but then the predictor, which knows the input,
foretells most of the innovations that it leaves. What white weights explain and the whitened
samples leave to the noise is told. In open loop an end that does not follow the output is not
taken, but told.

A mode that decays little within the record may stand for a disturbance that wanders over it, and
what the plant then misses follows the input. Where white weights end at such a mode, or at a limit,
the end on whitened samples counts although their residual follows the input, and although the mode
follows more of the output, if it explains the record: what it leaves does not follow the input, and
is as little as the predictor leaves, which needs no model of the plant.

What a plant integrates of the forces on it says nothing of how well a simulation may follow. Where
no end is within the limits, and that from the predictor integrates, the likelihood decides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tridentify.estimation.answer.decision import DecisionKind, KnownDecision
from tridentify.estimation.answer.estimate import Status
from tridentify.estimation.likelihood.choose_nuisance import Finished
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.curvature import Curvature, output_rss
from tridentify.estimation.likelihood.fitted_point import TESTED
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import at_rounding, coefficients
from tridentify.estimation.likelihood.noise.noise_model import (
    NoiseChoice,
    follows_input,
    noise_models,
    refusal,
    residual_series,
)
from tridentify.estimation.likelihood.noise.two_weights import moved_by_weights
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.thresholds import CLEARLY, NEAR, RIVAL
from tridentify.estimation.methods.around_maximum.maximum import Maximum
from tridentify.estimation.methods.around_maximum.turns import Turns, criterion_with_noise
from tridentify.estimation.search.found import Starts
from tridentify.numerics.arrays import Array

LOST = 10.0
"""Residual power over that with white weights from which whitening has led astray."""
NOTABLE, LARGE = 1.5, 4.0
"""Residual power with whitened samples over that with white weights: worth a note, a caution. Right
models in noise that wanders over the whole record reach three, others 1.1."""
ELSEWHERE = 3.0
"""Standard errors between two ends from which they are told apart."""
SLOW_MODE = 10.0
"""Decay of a mode within the record from below which it may stand for a disturbance that wanders
over the record."""
PASSED = DecisionKind.NOISE_WHITE.told(": the residual passes the portmanteau test")
FOLLOWED = DecisionKind.NOISE_TAKEN_AS_WHITE.told(
    ": the residual is not white, but most of it follows the input"
)
NO_MINIMUM = DecisionKind.NOISE_TAKEN_AS_WHITE.told(
    ": on whitened samples there was no usable minimum"
)


@dataclass(frozen=True)
class Coloured:
    """Outputs whose noise may get a model.

    Attributes
    ----------
    tinted : tuple of bool
        Which they are.
    asked : bool
        Somebody asked for the model, so that its end counts whatever it is.
    slow : bool
        White weights end at a mode that a slow disturbance may have been taken for.
    doubtful : bool
        Their residual follows the input all the same: an end on whitened samples counts only if it
        explains the record.
    """

    tinted: tuple[bool, ...]
    asked: bool
    slow: bool = False
    doubtful: bool = False


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
        if at_rounding(first.point):
            return found
        return _told(found, DecisionKind.NOISE_TAKEN_AS_WHITE.told(f": {note}"))
    if starts.saw_white(first.point) and noise == "auto":
        return _told(found, PASSED)
    case = _coloured(first, asked=noise == "ar")
    if isinstance(case, str):
        return _told(found, case)
    turns = Turns(question, starts, found, case.tinted)
    if not (in_loop or case.asked or case.slow) and turns.foretold(first.point):
        return _told(found, FOLLOWED)
    best, likelier = _ends(turns, case, in_loop=in_loop)
    integrates = _integrates(best.end, likelier.end)
    best = likelier if integrates else best
    lost = not (case.asked or integrates) and _is_lost(best.end, first)
    if case.doubtful or (case.slow and lost):
        explaining = next((one for one in (best, likelier) if _explains(one.end, turns)), None)
        if explaining is not None:
            best, likelier, lost = explaining, explaining, False
        elif case.doubtful:
            return _told(found, FOLLOWED)
    if lost:
        words = (NO_MINIMUM, *_likelier(first, likelier.end, turns))
        return replace(found, decisions=(*found.decisions, *words), tried=best.tried)
    words = (_in_words(best.end.point, case), *_apart(first, best.end))
    if likelier is not best:
        words = (*words, *_likelier(best.end, likelier.end, turns))
    moved = None if in_loop else _moved(first, best.end)
    return replace(best, decisions=(*best.decisions, *words), moved=moved)


def _coloured(first: Finished, *, asked: bool) -> Coloured | str:
    """Outputs whose noise may get a model; in words why none does."""
    tinted = tuple(asked or not passes for passes in first.point.white)
    if not any(tinted):
        return PASSED
    if asked:
        return Coloured(tinted, asked=True)
    slow, left = _may_be_a_disturbance(first), _left_to_noise(first.point, tinted)
    if slow and left != tinted:
        return Coloured(tinted, asked=False, slow=True, doubtful=True)
    return Coloured(left, asked=False, slow=slow) if any(left) else FOLLOWED


def _ends(turns: Turns, case: Coloured, *, in_loop: bool) -> tuple[Maximum, Maximum]:
    """The end on whitened samples, and the likeliest one, which need not follow the output."""
    first = turns.found.end
    if case.doubtful:
        # a residual that follows the input is no noise to begin with
        end = turns.from_predictor()
        return end, end
    best = turns.taken()
    if turns.are_near(best.end.point) and not in_loop:
        return best, best
    if in_loop:
        best = turns.from_predictor(best)
    if turns.misses(best.end.point) or (not case.asked and _is_lost(best.end, first)):
        best = turns.from_every_start(best)
    if in_loop or turns.behind(best.end.point) <= CLEARLY:
        return best, best
    likelier = turns.from_predictor(best)
    return (likelier if case.asked or _follows(likelier.end, first) else best), likelier


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
    sound = end.status in (Status.CONVERGED, Status.AT_SAMPLING_LIMIT)
    return not sound or slowest * longest < SLOW_MODE


def _told(found: Maximum, decision: str) -> Maximum:
    return found.told(decision)


def _explains(end: Finished, turns: Turns) -> bool:
    """Whether an end follows the output, and leaves noise alone, as little as the predictors do."""
    problem = end.point.problem
    if not problem.noise or np.any(output_rss(end.point) > problem.power * end.point.counts):
        return False
    if (
        end.status is not Status.CONVERGED
        or _left_to_noise(end.point, turns.tinted) != turns.tinted
    ):
        return False
    return turns.behind(end.point) < RIVAL


def _is_lost(best: Finished, first: Finished) -> bool:
    """Whether whitening led astray: to a limit, or to a model that explains far less."""
    if first.status is Status.CONVERGED and best.status is not Status.CONVERGED:
        return True
    return bool(np.any(output_rss(best.point) > LOST * output_rss(first.point)))


def _follows(best: Finished, first: Finished) -> bool:
    """Whether an end follows the output hardly worse than that with white weights."""
    far = np.any(output_rss(best.point) > LARGE * output_rss(first.point))
    return not far and not _is_lost(best, first)


def _integrates(kept: Finished, other: Finished) -> bool:
    """Whether neither end is within the limits, and the other integrates and is far likelier."""
    if kept.status is Status.CONVERGED or other.status is not Status.AT_STABILITY_LIMIT:
        return False
    return criterion_with_noise(kept.point) - criterion_with_noise(other.point) > RIVAL


def _moved(first: Finished, best: Finished) -> Array | None:
    """Half of how far white weights lead from the end; in a loop they are biased by themselves."""
    if not first.status is best.status is Status.CONVERGED:
        return None
    return moved_by_weights(first.point, best.point)


def _likelier(kept: Finished, other: Finished, turns: Turns) -> tuple[str, ...]:
    """A word where an end that is not kept is as likely as the predictor, and the kept one not."""
    white = not any(a.size for a in kept.point.problem.noise)
    noise = noise_models(kept.point, turns.tinted, None) if white else None
    behind, left = turns.behind(kept.point, noise), turns.behind(other.point)
    if behind - left < RIVAL or left > NEAR:
        return ()
    errors = np.maximum(Curvature.at(kept.point).std, 1e-300)
    moved = np.max(np.abs(coefficients(other.point) - coefficients(kept.point)) / errors)
    if moved < ELSEWHERE:
        return ()
    fall = f"AICc lower by {behind - left:.0f}"
    return (DecisionKind.FAR_LIKELIER.told(f" by up to {moved:.0f} standard errors ({fall})"),)


def _apart(first: Finished, best: Finished) -> tuple[str, ...]:
    """A word where white weights explain far more of the output than whitened samples do.

    Slow noise looks like a slow response, and the other way round: the record cannot say which,
    only by how much the two ends differ.
    """
    counts = first.point.counts
    size = np.maximum(first.point.problem.power * counts, 1e-300)
    plain, own = (output_rss(end.point) / size for end in (first, best))
    told: list[str] = []
    limits = {DecisionKind.RESPONSE_AS_NOISE: LARGE, DecisionKind.SLOW_AS_NOISE: NOTABLE}
    for known, much in limits.items():
        where = np.flatnonzero(own > much * plain)
        if where.size and not told:
            fits = [
                f"{100.0 * (1.0 - math.sqrt(own[i])):.1f} % where white weights reach "
                f"{100.0 * (1.0 - math.sqrt(plain[i])):.1f} %"
                for i in where
            ]
            told.append(known.told(f": fit {', '.join(fits)}"))
    return tuple(told)


def _in_words(point: Point, case: Coloured) -> KnownDecision:
    why = "as asked for" if case.asked else "the residual with white weights is not white"
    orders = [
        f"order {a.size}" if coloured else "white"
        for a, coloured in zip(point.problem.noise, case.tinted, strict=True)
    ]
    how = f"samples whitened by autoregressions, {', '.join(orders)}"
    return DecisionKind.NOISE_COLOURED.told(f" ({why}): {how}")
