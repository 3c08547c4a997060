"""The reference route where the controller is given: the loop's own likelihood, if it may be used.

With a known controller the noise goes round the loop in a known way, and the innovations of the
loop have a likelihood (`closed_loop.innovations`). Its maximum is more precise than the reference
route in two ways: what the noise drives tells of the plant too, and of a continuous controller the
input between the samples follows from the loop and need not be fitted. It rests on more: that the
noise is what the model of the noise says, and goes round the loop as the controller says. The
reference route needs neither. Where all of this holds, the difference of the two estimates has the
covariance ``cov_ref - cov_ml``, as the likelihood's is efficient (Hausman 1978); where the
difference is larger, something does not hold, and the reference route's estimate is kept.

References: J. Hausman, Econometrica 46 (1978) 1251-1271.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.parameter import Nuisance
from tridentify.estimation.closed_loop.innovations import (
    ContinuousLoop,
    Innovations,
    SampledLoop,
    Start,
)
from tridentify.estimation.closed_loop.known_controller import KnownLoop
from tridentify.estimation.closed_loop.most_likely import Likeliest, Likelihood
from tridentify.estimation.closed_loop.recorded_input import Worked, sampled_by, worked
from tridentify.estimation.closed_loop.simulated import Simulated
from tridentify.estimation.closed_loop.unstable import autoregressive
from tridentify.estimation.methods.by_reference.passes import Rooted, model_like, without_rest
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

FALSE_ALARMS = 0.01
"""Share of records in which all holds and the reference route's estimate is kept."""
AS_PRECISE = 0.05
"""Share of the variance below which the difference of two estimates is not known to be smaller:
their covariances are estimates too."""


@dataclass(frozen=True, eq=False)
class Given:
    """What a given controller led to.

    Attributes
    ----------
    rooted : Rooted
    told : str
    findings : tuple of Finding
    """

    rooted: Rooted
    told: str
    findings: tuple[Finding, ...] = ()


def rule_of(
    records: Sequence[Record], structure: Structure, controller: TransferFunction
) -> Worked | None:
    """The rule by which a controller may have been sampled; None where nothing can be told.

    One without memory meets its rule at the samples however it works between them: that the input
    was held has then to be stated.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
    controller : TransferFunction
    """
    held = all(record.behaviour == "zoh" for record in records)
    if controller.den[0][0].size == 1 and not held:
        return None
    return sampled_by(records, controller) if _usable(records, structure) else None


def how_it_worked(found: Rooted, rule: Worked | None) -> Worked | None:
    """How the controller worked that was given; None where the records do not allow to tell.

    Parameters
    ----------
    found : Rooted
        On loops with a controller.
    rule : Worked, optional
        As `rule_of` says.
    """
    if rule is None:
        return None
    loops, theta = _continuous(found), np.array(found.estimate.theta)
    return worked(loops, _likelihood(loops, found.estimate), theta, rule)


def by_likelihood(
    found: Rooted,
    how: Worked | None,
    coloured: bool,
    say: Callable[[str], None],
) -> Given:
    """The maximum of the likelihood near the reference route's estimate, or that estimate.

    Parameters
    ----------
    found : Rooted
    how : Worked, optional
    coloured : bool
        Whether the noise may have a model.
    say : callable
        Is told what is going on.
    """
    estimate = found.estimate
    if how is None:
        needs = "complete uniform records, free coefficients, and of a gain alone a held input"
        return Given(found, f"controller as given; its likelihood needs {needs}")
    if not how.explains:
        return Given(found, how.words, _not_this_controller(how))
    if not (estimate.status.ok and found.still):
        return Given(found, how.words)
    say("the likelihood of the loop's noise")
    loops: Sequence[Innovations] = (
        _continuous(found)
        if how.sampling == "continuous"
        else [
            SampledLoop(one.record, _start(estimate, mine))
            for one, mine in zip(found.loops, estimate.nuisance, strict=True)
        ]
    )
    choose = autoregressive if coloured else _white
    best = _likelihood(loops, estimate).maximum(np.array(estimate.theta), choose)
    if best is None or not model_like(estimate, best.theta).is_stable:
        return Given(found, f"{how.words}; no maximum of the likelihood near the root")
    apart = difference(estimate, best)
    if apart < FALSE_ALARMS:
        return Given(found, f"{how.words}; not by its likelihood", _apart(estimate, best, apart))
    share = best.std / np.where(estimate.std > 0, estimate.std, 1.0)
    told = (
        f"{how.words}; likeliest, with {np.min(share[estimate.std > 0]):.2g} to "
        f"{np.max(share):.2g} of the standard errors by the reference alone"
    )
    return Given(replace(found, estimate=_moved(found, best)), told)


def difference(estimate: Estimate, best: Likeliest) -> float:
    """p-value of the difference between the reference route's estimate and the likeliest.

    Parameters
    ----------
    estimate : Estimate
        By the reference route.
    best : Likeliest
    """
    free = np.flatnonzero(estimate.std > 0)
    size = estimate.std[free]
    mine = estimate.cov[np.ix_(free, free)] / np.outer(size, size)
    its = best.cov[np.ix_(free, free)] / np.outer(size, size)
    values, vectors = np.linalg.eigh(mine)
    root = vectors / np.sqrt(np.maximum(values, 1e-12))
    shares, turned = np.linalg.eigh(root.T @ its @ root)
    along = turned.T @ root.T @ ((best.theta - estimate.theta)[free] / size)
    # where the reference's is called the smaller one, the two count as independent
    spread = np.where(shares < 1.0, np.maximum(1.0 - shares, AS_PRECISE), 1.0 + shares)
    return float(chdtrc(float(free.size), float(np.sum(along**2 / spread))))


def _usable(records: Sequence[Record], structure: Structure) -> bool:
    known = (structure.bounds, structure.equalities, structure.priors)
    return (
        not any(known)
        and structure.static_gain is None
        and structure.drift is False
        and all(one.dt is not None and np.isfinite(one.y).all() for one in records)
    )


def _start(estimate: Estimate, mine: Nuisance) -> Start:
    how = mine.initial_state
    return Start(how == "free", how == "equilibrium", bool(estimate.structure.offset))


def _continuous(found: Rooted) -> list[ContinuousLoop]:
    loops = []
    for one, mine in zip(found.loops, found.estimate.nuisance, strict=True):
        assert isinstance(one, KnownLoop)
        assert isinstance(one.driven, Simulated)
        loops.append(ContinuousLoop(one.driven, one.controller, _start(found.estimate, mine)))
    return loops


def _likelihood(loops: Sequence[Innovations], estimate: Estimate) -> Likelihood:
    return Likelihood(
        loops, lambda theta: model_like(estimate, theta), estimate.std > 0, np.array(estimate.std)
    )


def _white(_: Sequence[Array]) -> Array:
    return np.zeros(0)


def _moved(found: Rooted, best: Likeliest) -> Estimate:
    """The estimate at other coefficients, start and offset fitted anew."""
    model = model_like(found.estimate, best.theta)
    moved = replace(found.estimate, theta=best.theta, model=model, cov=best.cov)
    nuisance = []
    for e, (loop, mine) in enumerate(zip(found.loops, moved.nuisance, strict=True)):
        pair = without_rest(loop, model)
        left = moved.residual(pair, experiment=e)[:, 0]
        start = _start(moved, mine)
        columns = start.columns(pair, model)
        norms = np.linalg.norm(columns, axis=0) + 1e-300
        change = np.linalg.lstsq(columns / norms, left, rcond=1e-12)[0] / norms
        free, offset = np.array(mine.free_response), np.array(mine.offset)
        if start.free:
            free[0] += change[: free.shape[1]]
        if start.offset:
            offset += change[-1]
        nuisance.append(replace(mine, offset=offset, free_response=free))
    return replace(moved, nuisance=tuple(nuisance))


def _not_this_controller(how: Worked) -> tuple[Finding, ...]:
    return (
        Finding(
            "contradiction",
            "warning",
            f"The controller given explains {100.0 * (1.0 - how.left):.0f} % of what the reference "
            "does not drive of the input: it has a limit, a delay or other coefficients, or is "
            "continuous and noise moves between the samples. The estimate does without it.",
            "Give the controller that was running, or write controller='sampled' or 'continuous'.",
        ),
    )


def _apart(estimate: Estimate, best: Likeliest, p: float) -> tuple[Finding, ...]:
    size = np.where(estimate.std > 0, estimate.std, np.inf)
    k = int(np.argmax(np.abs(best.theta - estimate.theta) / size))
    return (
        Finding(
            "noise-model",
            "note",
            "The noise does not go round the loop as the controller given says (p = "
            f"{p:.2g}): {estimate.names[k]} would be {best.theta[k]:.4g} in place of "
            f"{estimate.theta[k]:.4g}. The estimate rests on the reference alone.",
            "Nothing needs doing; noise that moves between the samples does this.",
        ),
    )
