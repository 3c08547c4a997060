"""The reference route: the three models in closed loop, driven by the reference.

In a loop the input carries the noise, so that no fit to the recorded input alone is free of bias.
What a recorded reference drives is (`closed_loop.driven`): Step 1 gives ``u_M``, a function of
continuous time, whatever the controller. The estimate is the root of

    sum_k Z(t_k, theta) (y - G(theta) u)(t_k) = 0,      Z = d/dtheta G(theta) u_M,       (1)

the derivatives of the driven output as instruments. The residual at the true coefficients is the
noise itself, which is independent of the reference and hence of ``Z``: (1) is consistent whatever
the controller and whatever the colour of the noise, and nothing depends on how complete ``u_M`` is.
For white noise its covariance is

    sigma^2 (sum_k Z Z')^{-1},                                                            (2)

as ``sum Z (d/dtheta G u)'`` is ``sum Z Z'`` on the mean (Soderstrom & Stoica 1983; Gilson, Garnier,
Young & Van den Hof 2011, optimal instruments in closed loop). On whitened samples the same holds
for coloured noise.

Equation (1) is solved by the open-loop estimators as they are. With a model ``G_0`` at hand, the
part of the output that the rest of the input makes is taken away,

    y' = y - G_0 (u - u_M),                                                               (3)

and ``G`` is fitted to ``(u_M, y')`` by output error, whose stationary point is ``sum Z (y' - G
u_M) = 0``: where ``G = G_0`` this is (1). The fit's covariance, noise model, nuisance terms and
constraints are then those of (1), (2). Repeating (3) converges fast, since its derivative is
``(sum Z Z')^{-1} sum Z (d/dtheta G (u - u_M))'``, a correlation of instruments with noise, of the
order of one over the root of the number of samples; the iterates are extrapolated (Anderson 1965).
The first ``G_0`` is the fit to ``(u_M, y)``, the two-stage estimate of Van den Hof & Schrama
(1993).

References
----------
T. Soderstrom & P. Stoica, *Instrumental Variable Methods for System Identification* (1983).
M. Gilson, H. Garnier, P. Young & P. Van den Hof, IET Control Theory & Applications 5 (2011)
1147-1154. P. Van den Hof & R. Schrama, Automatica 29 (1993) 1523-1527. D. Anderson, J. ACM 12
(1965) 547-560.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tridentify.errors import DataError, TridentifyError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.closed_loop.begun import with_start
from tridentify.estimation.closed_loop.between_samples import IN_WORDS, Loop, Sampling
from tridentify.estimation.closed_loop.driven import Driven, driven
from tridentify.estimation.closed_loop.known_controller import (
    KnownLoop,
    known_loop,
    refuse_unknown_loop,
)
from tridentify.estimation.closed_loop.moving import together_findings
from tridentify.estimation.closed_loop.not_supported import refuse_not_stable
from tridentify.estimation.closed_loop.recorded_input import Worked
from tridentify.estimation.closed_loop.unstable_answer import (
    NotStable,
    unstable_estimate,
    worse_by,
)
from tridentify.estimation.likelihood.answer import widened_by
from tridentify.estimation.likelihood.thresholds import CLEARLY
from tridentify.estimation.methods.base import Method
from tridentify.estimation.methods.by_reference.along_axis import with_fall
from tridentify.estimation.methods.by_reference.controller_kind import (
    Assumed,
    Compared,
    Controller,
    LeftOpen,
    assumed,
    compared,
    of_integrator,
    opposite,
)
from tridentify.estimation.methods.by_reference.either_kind import beside_stable, of_either_kind
from tridentify.estimation.methods.by_reference.followed import (
    coarse_findings,
    driving_findings,
    following_findings,
)
from tridentify.estimation.methods.by_reference.given_controller import (
    by_likelihood,
    how_it_worked,
    rule_of,
)
from tridentify.estimation.methods.by_reference.passes import (
    Rooted,
    residuals,
    root,
)
from tridentify.estimation.methods.by_reference.returned_errors import (
    moves_between,
    sees_nothing,
    with_returned_errors,
)
from tridentify.estimation.methods.by_reference.roots import (
    other_root,
    rise,
    white_root,
    with_noise_model,
)
from tridentify.estimation.methods.by_reference.stated_kind import (
    findings_as_stated,
    not_stable_as_stated,
)
from tridentify.numerics.arrays import Array
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

BETWEEN = "the loop is fast for its samples: what lies between them makes errors up to"
NOTABLE, HANGS = 1.2, 3.0
"""Times that errors grow for that, from which it is told, and from which the answer hangs on it."""


def reference_estimate(
    asked: Request,
    controller: Controller,
    plain: Method,
    near: Callable[[TransferFunction], Method],
    coloured: Method | None,
    say: Callable[[str], None],
    *,
    robust: bool = False,
    only_stable: bool = False,
) -> Estimate:
    """The estimate by the reference route.

    Parameters
    ----------
    asked : Request
        Records with references, the structure, and how the estimate is to be called.
    controller : {"unknown", "sampled", "continuous"} or TransferFunction
        The latter as what acts on the measured output, in continuous time.
    plain : Method
        The whole method for open loop and white noise, its search included.
    near : callable
        The method of the passes, which begins at a model.
    coloured : Method, optional
        The whole method with a noise model, if the noise may have one.
    say : callable
        Is told what is going on.
    robust : bool
        Whether ``near`` minimises another loss than squares.
    only_stable : bool
        Whether the plant counts as stable.

    Returns
    -------
    Estimate
    """
    known = controller if isinstance(controller, TransferFunction) else None
    if known is not None:
        refuse_unknown_loop(asked.records, asked.structure, known)
    say("what the reference drives")
    rule = None if known is None else rule_of(asked.records, asked.structure, known)
    exactly = rule is not None and rule.exact
    taken = assumed(controller, asked.records, asked.structure)
    kind = "sampled" if exactly else taken.sampling
    together = together_findings(asked.records)
    parts = [driven(record, between=kind == "continuous") for record in asked.records]
    loop = (*together, *driving_findings(parts))
    if known is None and (begun := with_start(list(asked.records))) != list(asked.records):
        asked = replace(asked, records=tuple(begun))
        parts = [driven(record, between=kind == "continuous") for record in begun]
    again = partial(reference_estimate, asked, controller, plain, near, coloured, say)
    among = partial(again, robust=robust, only_stable=True)
    if not loop and not only_stable:
        ended = _not_stable(parts, taken, asked, coloured is not None, robust, among, kind, say)
        if ended is not None:
            return ended
    found = white_root(parts, kind, asked.structure, plain, near, say, again=known is None)
    if known is None and not (loop or only_stable):
        ended = _beyond_limit(found, taken, asked, coloured is not None, robust, among, say)
        if ended is not None:
            return ended
    taken = of_integrator(taken, found.estimate, asked.records)
    told, how = f"controller taken as {IN_WORDS[kind]}{taken.why}", rule
    left: LeftOpen | None = None
    if known is not None and not exactly:
        say("the loop with the controller given")
        found, how = _with_controller(found, known, rule, asked.structure, plain, near, say)
        if how is not None and not how.explains:
            taken = assumed("unknown", asked.records, asked.structure)
            told = f"controller taken as {IN_WORDS[taken.sampling]}{taken.why}"
    beside: NotStable | Compared | None = None
    if taken.even and not loop and not only_stable and (coloured is not None or not robust):
        beside = beside_stable(found, taken, asked, coloured is not None, say)
    if isinstance(beside, NotStable):
        return beside.estimate
    if beside is not None:
        told, left = beside.told, beside.left
    elif not taken.certain:
        found, told, left = _either(found, taken, asked.structure, near, say)
    findings, white = following_findings(found), found
    moved: Array | None = None
    if coloured is not None:
        found = with_noise_model(found, asked.structure, coloured, say)
    if left is not None:
        moved, (open_, said) = left.moved(found.estimate), left.said(found.estimate)
        told, findings = f"{told}; {open_}", (*findings, *said)
    found, wider, hanging = _with_all_errors(found, moved)
    rival = partial(other_root, white, asked.structure, near, say)
    findings += findings_as_stated(white, found.estimate, taken, rival)
    told, findings = "; ".join((told, *wider)), (*findings, *hanging)
    if known is not None:
        given = by_likelihood(found, how, coloured is not None, say)
        told = told if how is not None and not how.explains else given.told
        found, findings = given.rooted, (*findings, *given.findings)
    return completed(asked, found, told, findings=(*loop, *findings))


def _not_stable(
    parts: Sequence[Driven],
    taken: Assumed,
    asked: Request,
    coloured: bool,
    robust: bool,
    stable: Callable[[], Estimate],
    kind: Sampling,
    say: Callable[[str], None],
) -> Estimate | None:
    """What ends the question where the plant may not be stable; None where it is stable."""
    if coloured or not robust:
        found = unstable_estimate(parts, kind, asked, coloured, say)
        if found is not None:
            return _ended(found, parts, taken, asked, coloured, stable, say)
    return refuse_not_stable(asked, kind, robust, stable, say)


def _beyond_limit(
    found: Rooted,
    taken: Assumed,
    asked: Request,
    coloured: bool,
    robust: bool,
    stable: Callable[[], Estimate],
    say: Callable[[str], None],
) -> Estimate | None:
    """What ends the question where passes among stable plants do not; None where nothing does.

    Fits to stable plants have no way to a root that integrates, nor to one whose errors reach that
    far: they end nowhere, or where instruments see next to nothing of what the output changes by,
    or where clearly more of it is left than by the open-loop fit. Where references drive little of
    what is recorded, Step 2 does not show such a root either; the open-loop fit, of all of the
    record, may.
    """
    if robust and not coloured:
        return None
    ends, kind = found.still and not sees_nothing(found), found.loops[0].sampling
    # of a controller that works between the samples the open-loop fit leaves less of any record
    if ends and not (kind == "sampled" and rise(found) > CLEARLY):
        return None
    parts = [one.driven for one in found.loops if isinstance(one.driven, Driven)]
    begun = [one.model for one in (found.whole, found.estimate) if one is not None]
    beyond = unstable_estimate(parts, kind, asked, coloured, say, begun)
    if beyond is None or (ends and not worse_by(found.estimate, beyond.estimate) > CLEARLY):
        return None
    return _ended(beyond, parts, taken, asked, coloured, stable, say)


def _ended(
    found: NotStable,
    parts: Sequence[Driven],
    taken: Assumed,
    asked: Request,
    coloured: bool,
    stable: Callable[[], Estimate],
    say: Callable[[str], None],
) -> Estimate:
    """The estimate of a plant that is not stable, with what is said of the controller's kind."""
    taken = of_integrator(taken, found.estimate, asked.records)
    if taken.certain:
        found = not_stable_as_stated(found, parts, taken, asked, coloured, say)
    else:
        found = of_either_kind(found, taken, asked, coloured, say)
    return _or_stable(found, stable)


def _with_all_errors(
    found: Rooted, moved: Array | None
) -> tuple[Rooted, Sequence[str], tuple[Finding, ...]]:
    """With errors that allow for what comes back and what is not known; what is told, and said.

    ``moved`` is how far the kind of the controller may have moved the coefficients.
    """
    found, wider = with_returned_errors(found)
    found = with_fall(found)
    found, far = _reaching(found, moves_between(found))
    words = [wider] if wider else []
    words += [f"{BETWEEN} {far:.1f} times as large"] if far > NOTABLE else []
    found = found if moved is None else _reaching(found, (moved,))[0]
    return found, words, _hanging(far)


def _hanging(far: float) -> tuple[Finding, ...]:
    """What is to be said where most of the errors is what is not known between the samples."""
    if far < HANGS:
        return ()
    return (
        Finding(
            "intersample",
            "warning",
            f"The controller is continuous; {BETWEEN} {far:.1f} times as large. A response that is "
            "over within a sample is not in the record, and the truth may be farther off.",
            "Sample faster, by five times if possible, or give the controller.",
        ),
    )


def _or_stable(found: NotStable, stable: Callable[[], Estimate]) -> Estimate:
    """A plant that is not stable; or a stable one, where the first may be none and it is better."""
    try:
        other = stable() if found.follows or found.unseen else None
    except TridentifyError:
        other = None
    return found.estimate if other is None else found.or_stable(other)


def _reaching(found: Rooted, moves: Sequence[Array]) -> tuple[Rooted, float]:
    """With errors that reach as far as the coefficients may have moved, and by how much larger."""
    estimate = found.estimate
    cov, draws = widened_by(estimate.cov, estimate.draws, moves)
    wider = replace(estimate, cov=cov, draws=draws)
    free = estimate.std > 0.0
    far = float(np.max(wider.std[free] / estimate.std[free], initial=1.0))
    return replace(found, estimate=wider), far


def _either(
    found: Rooted,
    taken_for: Assumed,
    structure: Structure,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
) -> tuple[Rooted, str, LeftOpen | None]:
    """The root for one kind of controller or the other, as the record says."""
    try:
        other = other_root(found, structure, near, say)
    except TridentifyError as refused:
        kind = found.loops[0].sampling
        without = f"as {IN_WORDS[opposite(kind)]}, no estimate: {refused}"
        return found, f"controller taken as {IN_WORDS[kind]}{taken_for.why}; {without}", None
    seen = compared(found, other, taken_for)
    return other if seen.turned else found, seen.told, seen.left


def _with_controller(
    best: Rooted,
    controller: TransferFunction,
    rule: Worked | None,
    structure: Structure,
    plain: Method,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
) -> tuple[Rooted, Worked | None]:
    """The root where the loop is simulated with its controller, and how that worked.

    If it worked on samples there is nothing to simulate: the input is known between them. If the
    input was made by something else, that is taken for a controller that is not known.
    """
    parts = [one.driven for one in best.loops if isinstance(one.driven, Driven)]
    first, kind = best.estimate.model, best.loops[0].sampling
    try:
        known: list[Loop] = [known_loop(part, first, controller, kind) for part in parts]
        how = how_it_worked(replace(best, loops=known), rule)
    except DataError:
        if rule is None or not rule.seen:
            raise
        how = rule
    taken: Sampling = "sampled"
    if how is not None and not how.explains:
        taken = assumed("unknown", [part.record for part in parts], structure).sampling
    elif how is None or how.sampling == "continuous":
        found = root(known, structure, best.estimate, near, say)
        return replace(found, passes=found.passes + best.passes), how
    held = [driven(part.record, between=taken == "continuous") for part in parts]
    return white_root(held, taken, structure, plain, near, say), how


def completed(
    asked: Request,
    best: Rooted,
    *told: str,
    findings: Sequence[Finding] = (),
) -> Estimate:
    """The last pass as an estimate of the records as they were given."""
    estimate, loops = best.estimate, best.loops
    left = np.vstack(residuals(loops, estimate))
    y = np.vstack([record.y - np.nanmean(record.y, axis=0) for record in asked.records])
    fit = 100.0 * (1.0 - np.sqrt(np.nansum(left**2, axis=0) / np.nansum(y**2, axis=0)))
    driven_by = ", ".join(one.driven.words for one in loops)
    given = {one.controller for one in loops if isinstance(one, KnownLoop)}
    words = [f"reference route: {driven_by}, {best.passes} passes", *told]
    status = estimate.status
    if not best.still:
        words.append(f"not at rest: the last pass moved a coefficient by {best.moved:.2g} errors")
        status = Status.WEAKLY_IDENTIFIABLE if status.ok else status
    return replace(
        estimate,
        fit=fit,
        status=status,
        findings=(*estimate.findings, *coarse_findings(best), *findings),
        method=asked.method,
        n_samples=asked.n_samples,
        dt=asked.dt,
        intersample=asked.records[0].behaviour,
        record_fingerprint=asked.fingerprint,
        route="reference",
        loop=LoopTaken(loops[0].sampling, next(iter(given), None)),
        trace=estimate.trace.told(*words, *asked.told),
    )
