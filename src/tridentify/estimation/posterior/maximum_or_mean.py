"""Which of the two finishes a record gets: the likelihood's maximum, or the posterior mean."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from tridentify.errors import OptionError, UnsupportedError, UnsupportedOrderError
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.trace import (
    Status,
    Step,
    Trace,
)
from tridentify.estimation.likelihood.answer import Ending, Spread
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.curvature import output_rss
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import (
    Recorder,
    at_rounding,
    coefficients,
)
from tridentify.estimation.likelihood.scores import ScoreScatter
from tridentify.estimation.likelihood.setup.problem import Variant
from tridentify.estimation.likelihood.thresholds import RIVAL
from tridentify.estimation.posterior.mean import (
    VAGUE,
    Posterior,
    Vague,
    is_short,
    is_slower_than_assumed,
    posterior,
    vaguest,
)
from tridentify.estimation.search.found import Scan
from tridentify.estimation.search.one_mode_moved import moved_poles
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import denominator

FinishChoice = Literal["auto", "likelihood", "posterior"]
CHOICES = ("auto", "likelihood", "posterior")
APART = float(np.log(2.0))
"""Difference in the log of a rate from which a place is another one: a factor of two, the
resolution of a damped pole."""
SEPARATE = (
    "the likelihood's maximum: the posterior is weighed for a shared denominator and known delays"
)
# with little noise and needless poles the models lie on a curve, and their mean beside it
BETWEEN = (
    "the likelihood's maximum: the mean of the models that explain the record does not explain it"
)
CONTRADICTED = (
    "the likelihood's maximum: the posterior weighs models by the likelihood, which the scatter "
    "of the scores contradicts"
)
SLOW = (
    "the likelihood's maximum: the record sees a pole that is slower than one over its length, "
    "which the posterior's prior leaves out"
)
ELSEWHERE = "models far likelier than the end of the search lie elsewhere, and the mean with them"
NOT_ROBUST = "the maximum of the robust likelihood: the posterior mean is for squared loss"
LOST = 0.5
"""Standard error over natural size above which a maximum is not kept for that reason."""
SOUND = (Status.CONVERGED, Status.AT_STABILITY_LIMIT, Status.WEAKLY_IDENTIFIABLE)


def check_finish(finish: str) -> None:
    """Refuse an unknown option.

    Raises
    ------
    OptionError
    """
    if finish not in CHOICES:
        raise OptionError(
            f"found finish={finish!r}; expected 'auto', 'likelihood' or 'posterior'; choose one"
        )


def refuse_posterior(finish: str) -> None:
    """Refuse the posterior mean where coefficients are known.

    Raises
    ------
    UnsupportedError
    """
    if finish == "posterior":
        raise UnsupportedError(
            "found finish='posterior' together with knowledge of the coefficients; expected "
            "finish='auto' or 'likelihood', as the posterior mean keeps no constraints; choose "
            "one of them"
        )


def weigh(
    finish: FinishChoice, best: Ending, say: Callable[[str], None], scan: Scan | None = None
) -> Ending:
    """The likelihood's maximum or, where that is not to be trusted, the posterior mean.

    Parameters
    ----------
    finish : {"auto", "likelihood", "posterior"}
    best : Ending
        The maximum.
    say : callable
        Is told what is going on.
    scan : Scan, optional
        The search's last look at other places.
    """
    kept = kept_maximum(finish, best, scan)
    return kept if kept is not None else mean(finish, best, say)


def kept_maximum(finish: FinishChoice, best: Ending, scan: Scan | None = None) -> Ending | None:
    """The likelihood's maximum where it is to be trusted; None where the posterior is weighed.

    Parameters
    ----------
    finish, best, scan
        As of `weigh`.
    """
    problem = best.point.problem
    if finish == "likelihood" or not is_short(problem) or at_rounding(best.point):
        return best
    if len(problem.groups) > 1 or problem.n_delays:
        return best.told(SEPARATE)
    cov, vague = _vagueness(best)
    sound = best.status in SOUND
    sharp = vague is not None and vague.share < VAGUE
    if finish == "auto" and sound and sharp and not has_rivals(best.point, scan):
        return best
    scatter = None if cov is None else best.curvature.scatter
    known = vague is not None and vague.share < LOST
    contradicted = scatter is not None and scatter.contradicts
    if finish == "auto" and sound and known and contradicted:
        return best.told(CONTRADICTED)
    longest = max(e.duration for e in problem.experiments)
    slow = cov is not None and is_slower_than_assumed(best.point.poles, cov, longest)
    return best.told(SLOW) if finish == "auto" and sound and known and slow else None


def mean(finish: FinishChoice, best: Ending, say: Callable[[str], None]) -> Ending:
    """The posterior mean, or the maximum where the mean does not explain the record.

    Parameters
    ----------
    finish, best, say
        As of `weigh`.
    """
    problem, sound = best.point.problem, best.status in SOUND
    cov, vague = _vagueness(best)
    scatter = None if cov is None else best.curvature.scatter
    say("the posterior, as the record leaves coefficients open")
    found = posterior(problem, [(best.point.poles, cov)])
    if not found.usable:
        return best.told("the posterior could not be sampled; the likelihood's maximum is kept")
    point = evaluate(problem, found.poles)
    if point.objective > best.point.objective + RIVAL:
        if finish == "auto" and sound:
            return best.told(BETWEEN)
        likely = evaluate(problem, found.nearest(problem))
        point = likely if likely.objective < point.objective - RIVAL else point
    if point.objective < best.point.objective - RIVAL:
        fall = best.point.objective - point.objective
        best = replace(best, trace=left_behind(best.trace, fall))
    scattered = best if scatter is None else best.told(scatter.in_words())
    return replace(
        scattered,
        point=point,
        status=Status.POSTERIOR_MEAN,
        trace=_continued(scattered.trace, point, found, _in_words(finish, vague, sound, best)),
        spread=_spread(point, found, scatter),
    )


def _vagueness(best: Ending) -> tuple[Array | None, Vague | None]:
    """`_told_apart`, and the vaguest coefficient of a section."""
    cov = _told_apart(best)
    longest = max(e.duration for e in best.point.problem.experiments)
    return cov, None if cov is None else vaguest(best.point.poles, cov, longest)


def left_behind(trace: Trace, fall: float) -> Trace:
    """The way to a maximum from which the mean lies far, where the models are likelier.

    Words that compare that end with others, or that tell its fit, would be read as of the mean.

    Parameters
    ----------
    trace : Trace
    fall : float
        Of ``-2 log L``, from the maximum to the mean.
    """
    gone = trace.about(
        DecisionKind.FAR_LIKELIER, DecisionKind.RESPONSE_AS_NOISE, DecisionKind.SLOW_AS_NOISE
    )
    kept = tuple(told for told in trace.decisions if told not in gone)
    way = replace(trace, decisions=kept)
    return way.told(f"{ELSEWHERE} (-2 log L lower by {fall:.0f})")


def _told_apart(best: Ending) -> Array | None:
    """(n, n) covariance of the denominator; None where the samples do not tell it.

    It is that of the likelihood, whatever the scatter of the scores makes of it.
    """
    n = best.point.problem.n_poles
    try:
        best.curvature.refuse_undetermined()
    except UnsupportedOrderError:
        return None
    return best.curvature.covariance[:n, :n]


def _spread(point: Point, found: Posterior, scatter: ScoreScatter | None) -> Spread:
    """That of the draws, wider where the scores scatter more than the likelihood says."""
    middle = coefficients(point)
    if scatter is None:
        return Spread(found.covariance_about(middle), found.draws)
    ratio = max(scatter.ratio, 1.0)
    draws = middle + math.sqrt(ratio) * (found.draws - middle)
    return Spread(ratio * found.covariance_about(middle), draws, "scores")


def has_rivals(point: Point, scan: Scan | None = None) -> bool:
    """Whether one pole or pair could as well be somewhere else, the others held.

    A sharp minimum has small standard errors even where it only fits the noise. Then other places,
    farther off than a factor of two, come near its cost.
    """
    problem = point.problem
    e = problem.experiments[0]
    variant = Variant(e.free, e.offset, e.drift, (None,) * len(problem.experiments))
    if scan is not None and _is_of(scan, point):
        moves = scan.moves
    else:
        moves = moved_poles(problem, variant, point.poles)
    for move in moves:
        if move.objective > point.objective + RIVAL:
            return False
        if abs(np.log(_middle(move.place) / _middle(move.before))) > APART:
            return True
    return False


def _is_of(scan: Scan, point: Point) -> bool:
    """Whether the search's last scan was of the same samples, nuisance terms and poles."""
    e, chosen = point.problem.experiments[0], scan.variant
    same = (chosen.free, chosen.offset, chosen.drift) == (e.free, e.offset, e.drift)
    sizes = [[x.n_samples for x in p.experiments] for p in (scan.base, point.problem)]
    whitened = any(a.size for p in (scan.base, point.problem) for a in p.noise)
    near = np.all(np.abs(scan.poles - point.poles) <= 1e-3 * np.abs(point.poles))
    return bool(same and sizes[0] == sizes[1] and not whitened and near)


def _middle(poles: Complex) -> float:
    return float(np.exp(np.log(np.abs(poles)).mean()))


def _in_words(finish: str, vague: Vague | None, sound: bool, best: Ending) -> str:
    """Why the maximum is not the answer: what the record leaves open, and what the record is."""
    point = best.point
    power = np.where(point.problem.power > 0, point.problem.power, np.inf)
    noise = float(np.sqrt(np.max(output_rss(point) / point.counts / power)))
    record = f"{int(point.counts.max())} samples, residual {_percent(noise)} of the output"
    if finish == "posterior":
        why = "as asked for"
    elif not sound:
        why = f"the likelihood's maximum is no usable end ({best.status.message})"
    elif vague is None:
        why = f"the record ({record}) does not tell the coefficients apart"
    elif vague.share < VAGUE:
        why = f"poles elsewhere explain the record ({record}) almost as well"
    else:
        which = "the pole" if vague.quantity == "rate" else f"the {vague.quantity} of the poles"
        why = (
            f"the record ({record}) hardly sees {which} near {vague.frequency:.3g} rad/s, which "
            f"has a standard error of {_percent(vague.share)} of its natural size"
        )
    return f"posterior mean, not the likelihood's maximum: {why}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 1.0 else f"{100.0 * share:.3g} %"


def _continued(trace: Trace, point: Point, found: Posterior, told: str) -> Trace:
    recorder = Recorder(list(trace.passes))
    step = Step(
        "posterior",
        denominator(point.poles)[1:],
        float(point.rss.sum() / point.counts.sum()),
        point.condition,
        f"{found.evaluated} denominators, worth {found.effective:.0f}",
    )
    recorder.add(point, lambda: (step,), np.nan, "")
    stopped = (
        f"{found.evaluated} denominators weighed, worth {found.effective:.0f} independent ones"
    )
    return Trace(tuple(recorder.passes), trace.starts, (*trace.decisions, told), stopped)
