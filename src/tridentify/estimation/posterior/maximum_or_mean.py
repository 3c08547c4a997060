"""Which of the two finishes a record gets: the likelihood's maximum, or the posterior mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from tridentify.errors import OptionError, UnsupportedError, UnsupportedOrderError
from tridentify.estimation.answer.estimate import Estimate, Status, Step, Trace
from tridentify.estimation.likelihood.answer import (
    covariance,
    estimate_from,
    output_rss,
    scatter_at,
)
from tridentify.estimation.likelihood.choose_nuisance import Finished
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.levenberg_marquardt import Recorder, at_rounding
from tridentify.estimation.likelihood.problem import Variant
from tridentify.estimation.posterior.mean import (
    VAGUE,
    Posterior,
    Vague,
    is_short,
    posterior,
    vaguest,
)
from tridentify.estimation.search.one_mode_moved import moved_poles
from tridentify.estimation.search.search import Scan
from tridentify.numerics.realization import Complex, denominator
from tridentify.record.record import Record
from tridentify.structure import Structure

FinishChoice = Literal["auto", "likelihood", "posterior"]
CHOICES = ("auto", "likelihood", "posterior")
RIVAL = 30.0
APART = float(np.log(2.0))
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


def told_of_posterior(robust: Estimate) -> Estimate:
    """A robust estimate with a word on why it is no posterior mean."""
    told = "the maximum of the robust likelihood: the posterior mean is for squared loss"
    return _told(robust, told)


def weigh(
    finish: FinishChoice,
    best: Finished,
    records: Sequence[Record],
    structure: Structure,
    trace: Trace,
    method: str,
    say: Callable[[str], None],
    scan: Scan | None = None,
) -> Estimate:
    """The estimate at the likelihood's maximum or, where that is not to be trusted, beyond it.

    Parameters
    ----------
    finish : {"auto", "likelihood", "posterior"}
    best : Finished
        The maximum.
    records : sequence of Record
    structure : Structure
    trace : Trace
        Of the way to the maximum.
    method : str
        Its name.
    say : callable
        Is told what is going on.
    scan : Scan, optional
        The search's last look at other places.

    Raises
    ------
    UnsupportedOrderError
        If the data cannot tell the coefficients apart.
    """
    maximum = _maximum(best, records, structure, trace, method)
    possible = is_short(best.point.problem) and not at_rounding(best.point)
    if finish == "likelihood" or not possible:
        return _given(maximum)
    if len(best.point.problem.groups) > 1 or best.point.problem.n_delays:
        return _told(_given(maximum), SEPARATE)
    n = best.point.problem.n_poles
    # that of the likelihood, whatever the scatter of the scores makes of it
    cov = None if isinstance(maximum, UnsupportedOrderError) else covariance(best.point)[:n, :n]
    longest = max(e.duration for e in best.point.problem.experiments)
    vague = None if cov is None else vaguest(best.point.poles, cov, longest)
    sound = best.status in SOUND
    sharp = vague is not None and vague.share < VAGUE
    if finish == "auto" and sound and sharp and not has_rivals(best.point, scan):
        return _given(maximum)
    scatter = None if cov is None else scatter_at(best.point)
    known = vague is not None and vague.share < LOST
    if finish == "auto" and sound and known and scatter is not None:
        return _told(_given(maximum), CONTRADICTED)
    say("the posterior, as the record leaves coefficients open")
    found = posterior(best.point.problem, [(best.point.poles, cov)])
    if not found.usable:
        return _told(
            _given(maximum), "the posterior could not be sampled; the likelihood's maximum is kept"
        )
    point = evaluate(best.point.problem, found.poles)
    if finish == "auto" and sound and point.objective > best.point.objective + RIVAL:
        return _told(_given(maximum), BETWEEN)
    told = _in_words(finish, vague, sound, best)
    if scatter is not None:
        trace = replace(trace, decisions=(*trace.decisions, scatter.in_words()))
    trace = _continued(trace, point, found, told)
    estimate = estimate_from(
        point,
        records,
        structure,
        best.nuisances,
        Status.POSTERIOR_MEAN,
        trace,
        method,
        best.criterion,
        judged=False,
    )
    if scatter is None:
        return replace(estimate, cov=found.covariance, draws=found.draws)
    ratio = max(scatter.ratio, 1.0)
    draws = estimate.theta + math.sqrt(ratio) * (found.draws - estimate.theta)
    return replace(estimate, cov=ratio * found.covariance, draws=draws, errors="scores")


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
    near = np.allclose(scan.poles, point.poles, rtol=1e-3, atol=0.0)
    return bool(same and sizes[0] == sizes[1] and not whitened and near)


def _middle(poles: Complex) -> float:
    return float(np.exp(np.log(np.abs(poles)).mean()))


def _maximum(
    best: Finished,
    records: Sequence[Record],
    structure: Structure,
    trace: Trace,
    method: str,
) -> Estimate | UnsupportedOrderError:
    try:
        return estimate_from(
            best.point,
            records,
            structure,
            best.nuisances,
            best.status,
            trace,
            method,
            best.criterion,
        )
    except UnsupportedOrderError as refusal:
        return refusal


def _given(maximum: Estimate | UnsupportedOrderError) -> Estimate:
    if isinstance(maximum, UnsupportedOrderError):
        raise maximum
    return maximum


def _told(estimate: Estimate, decision: str) -> Estimate:
    trace = estimate.trace
    return replace(estimate, trace=replace(trace, decisions=(*trace.decisions, decision)))


def _in_words(finish: str, vague: Vague | None, sound: bool, best: Finished) -> str:
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
        max(fit.solution.condition for fit in point.fits),
        f"{found.evaluated} denominators, worth {found.effective:.0f}",
    )
    recorder.add(point, (step,), np.nan, "")
    stopped = (
        f"{found.evaluated} denominators weighed, worth {found.effective:.0f} independent ones"
    )
    return Trace(tuple(recorder.passes), trace.starts, (*trace.decisions, told), stopped)
