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
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.answer.estimate import Pass, Start, Status
from tridentify.estimation.answer.trace import RESPONSE_AS_NOISE, SLOW_AS_NOISE
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
from tridentify.estimation.likelihood.thresholds import SAME_END
from tridentify.estimation.methods.maximum import Maximum
from tridentify.estimation.search.search import Starts, search
from tridentify.numerics.whiteness import is_white

Array = NDArray[np.float64]

OPEN_ROUNDS = 3
"""Turns in which orders and nuisance terms are decided anew; later they would only alternate."""
LOST = 10.0
"""Residual power over that with white weights from which whitening has led astray."""
NOTABLE, LARGE = 1.5, 4.0
"""Residual power with whitened samples over that with white weights: worth a note, a caution. Right
models in noise that wanders over the whole record reach three, others 1.1."""
PASSED = "noise white: the residual passes the portmanteau test"


def with_noise_model(
    noise: NoiseChoice, question: Question, starts: Starts, found: Maximum
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
    if noise == "auto":
        tinted = tuple(
            coloured and not follows_input(first.point, i, residuals[i])
            for i, coloured in enumerate(tinted)
        )
        if not any(tinted):
            return _told(
                found, "noise taken as white: the residual is not, but most of it follows the input"
            )
    question.say("coloured noise")
    best = _alternate(question, found, tinted, starts.count)
    if noise == "auto" and _is_lost(best.end, first):
        told = "noise taken as white: on whitened samples there was no usable minimum"
        return replace(_told(found, told), tried=best.tried)
    words = (_in_words(best.end.point, tinted, noise), *_apart(first, best.end))
    return replace(best, decisions=(*best.decisions, *words))


def _told(found: Maximum, decision: str) -> Maximum:
    return replace(found, decisions=(*found.decisions, decision))


def _alternate(
    question: Question, found: Maximum, tinted: tuple[bool, ...], n_starts: int
) -> Maximum:
    """Noise model and coefficients in turn, until the coefficients stand still."""
    best, reasons, trail = found.end, found.decisions, Recorder(list(found.end.recorder.passes))
    orders: list[int] | None = None
    tried: tuple[Start, ...] = ()
    for count in range(MOST_ROUNDS):
        model = noise_models(best.point, tinted, orders)
        if count < OPEN_ROUNDS:
            whole = question.whitened(model)
            following = decide(whole, [best.point.poles])
            if not count:
                question.say("another search, on whitened samples")
                anew = search(whole.held, n_starts)
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
