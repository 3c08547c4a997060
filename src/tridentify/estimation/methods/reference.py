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
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tridentify.errors import OptionError, TridentifyError, shown
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.closed_loop.between_samples import IN_WORDS, Loop, Sampling
from tridentify.estimation.closed_loop.driven import Driven, beside_noise, driven
from tridentify.estimation.closed_loop.known_controller import known_loop, refuse_unknown_loop
from tridentify.estimation.closed_loop.unstable import (
    BY_PREDICTOR,
    autoregressive,
    estimate_of,
    orders_of,
    slowest,
    starting_plants,
)
from tridentify.estimation.closed_loop.unstable import root as unstable_root
from tridentify.estimation.methods.base import Method
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

Controller = Literal["unknown", "sampled", "continuous"] | TransferFunction

TAKEN_AS_CONTINUOUS = f"controller taken as {IN_WORDS['continuous']}"
"""How the trace begins to say it."""
MORE_ROUNDS = 4
"""The same for a plant that is not stable, whose input is more noise than response."""
NOT_TOLD = "the record does not tell"
"""Which of two kinds of controller it was."""
WORSE = 50.0
"""Rise of ``-2 log L`` that a better known driven input may cost by chance."""
PLAINLY = 0.3
"""Difference of ``-2 log L`` a sample from which the record speaks for one kind of controller:
noise of the driven input between the samples, or its colour, may make a tenth by itself, a wrong
kind makes 4."""
COARSE = 0.3
"""Rate of the loop times sampling interval from which what a continuous controller does between the
samples counts: standard errors are then a fifth too small and more."""
ROUNDS = 2
"""Fits of the driven input beside the noise that the model leaves; a third changes nothing."""
MOST_PASSES = 40
"""Passes; nearly all loops need four to ten."""
STILL = 1e-3
"""Standard errors that the coefficients move by in the last pass."""
MEMORY = 4
"""Passes that the extrapolation uses: as many as coefficients of a second-order model."""


def check_controller(controller: object) -> None:
    """Refuse an unknown kind of controller.

    Raises
    ------
    OptionError
    """
    if isinstance(controller, TransferFunction):
        return
    if controller not in ("unknown", "sampled", "continuous"):
        raise OptionError(
            f"found controller={shown(controller)}; expected 'sampled' (its output is held between "
            "samples), 'continuous', 'unknown' or a TransferFunction; choose one of them"
        )


def reference_estimate(
    asked: Request,
    controller: Controller,
    plain: Method,
    near: Callable[[TransferFunction], Method],
    coloured: Method | None,
    say: Callable[[str], None],
    *,
    robust: bool = False,
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

    Returns
    -------
    Estimate
    """
    known = controller if isinstance(controller, TransferFunction) else None
    if known is not None:
        refuse_unknown_loop(asked.records, asked.structure, known)
    say("what the reference drives")
    kind = _kind(controller, asked.records)
    parts = [driven(record, between=kind == "continuous") for record in asked.records]
    if coloured is not None or not robust:
        unstable = _unstable(parts, kind, asked, coloured is not None, say)
        if unstable is not None:
            return unstable
    found = _white(parts, kind, asked.structure, plain, near, say)
    told = f"controller taken as {IN_WORDS[kind]}"
    if known is not None:
        found, told = _with_controller(*found, known, asked.structure, near, say)
    elif controller == "unknown":
        try:
            other = _other(*found, asked.structure, near, say)
        except TridentifyError as refused:
            told += f"; as {IN_WORDS[_opposite(kind)]}, no estimate: {refused}"
        else:
            turned, told = _compared(found, other)
            found = other if turned else found
    loops, best = found
    if coloured is not None:
        best = _with_noise_model(loops, asked.structure, best, coloured, say)
    return completed(asked, loops, best, told)


def _white(
    parts: Sequence[Driven],
    sampling: Sampling,
    structure: Structure,
    plain: Method,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
) -> tuple[list[Loop], Rooted]:
    """The root for one kind of controller and white noise."""
    loops = [Loop(part, sampling) for part in parts]
    first = plain.estimate([one.instrument for one in loops], structure)
    best = root(loops, structure, first, near, say)
    if sampling == "sampled":
        return loops, best
    # between the samples the driven input itself counts, and not its shape alone
    for _ in range(ROUNDS):
        noise = residuals(loops, best.estimate)
        parts = [beside_noise(part, left) for part, left in zip(parts, noise, strict=True)]
        beside = [Loop(part, sampling) for part in parts]
        try:
            end = root(beside, structure, best.estimate, near, say)
        except TridentifyError:
            break
        # where hardly any noise is left, what is follows the reference and takes its part
        worse = _deviance(beside, end.estimate) - _deviance(loops, best.estimate)
        if best.still and not (end.still and worse < WORSE):
            break
        loops, best = beside, end
    return loops, best


def _unstable(
    parts: Sequence[Driven],
    kind: Sampling,
    asked: Request,
    coloured: bool,
    say: Callable[[str], None],
) -> Estimate | None:
    """The estimate of a plant with a pole at zero or to the right of it; None for any other."""
    orders = orders_of(asked.records, asked.structure)
    if orders is None:
        return None
    loops = [Loop(part, kind) for part in parts]
    edge = slowest(loops)
    plants = starting_plants(loops, *orders)
    # fast operators follow the samples and swing between them, where Step 2 looks; slow ones miss
    others = [Loop(driven(one, between=kind == "sampled"), kind) for one in asked.records]
    plants += starting_plants(others, *orders)
    if not any(plant.poles.real.max() > -edge for plant in plants):
        return None
    say("a plant that is not stable")
    choose = autoregressive if coloured else None
    best = unstable_root(loops, plants, None, say)
    for _ in range(MORE_ROUNDS if kind == "continuous" else 0):
        if best is None or not best.still:
            break
        renewed = [
            beside_noise(part, left[:, None]) for part, left in zip(parts, best.errors, strict=True)
        ]
        loops = [Loop(part, kind) for part in renewed]
        best = unstable_root(loops, [best.plant], None, say)
    if best is not None and best.still and choose is not None:
        best = unstable_root(loops, [best.plant], choose, say)
    if best is None or not best.still or not best.plant.poles.real.max() > -edge:
        return None
    return estimate_of(asked, loops, best, (f"controller taken as {IN_WORDS[kind]}",))


def _with_controller(
    loops: Sequence[Loop],
    best: Rooted,
    controller: TransferFunction,
    structure: Structure,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
) -> tuple[tuple[list[Loop], Rooted], str]:
    """The root where the loop is simulated with its controller, and what is told."""
    say("the loop with the controller given")
    parts = [one.driven for one in loops if isinstance(one.driven, Driven)]
    first, kind = best.estimate.model, loops[0].sampling
    known: list[Loop] = [known_loop(part, first, controller, kind) for part in parts]
    found = root(known, structure, best.estimate, near, say)
    return (known, replace(found, passes=found.passes + best.passes)), "controller as given"


def _kind(controller: Controller, records: Sequence[Record]) -> Sampling:
    """How the controller worked: as stated, or as the input is stated to behave."""
    if isinstance(controller, TransferFunction):
        return "continuous"
    if controller != "unknown":
        return controller
    return "sampled" if all(record.behaviour == "zoh" for record in records) else "continuous"


def _other(
    loops: Sequence[Loop],
    best: Rooted,
    structure: Structure,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
) -> tuple[list[Loop], Rooted]:
    """The root for the other kind of controller, from the one that is there."""
    kind = _opposite(loops[0].sampling)
    others = [Loop(driven(one.record, between=kind == "continuous"), kind) for one in loops]
    return others, root(others, structure, best.estimate, near, say)


def _opposite(kind: Sampling) -> Sampling:
    return "continuous" if kind == "sampled" else "sampled"


def _compared(
    mine: tuple[list[Loop], Rooted], other: tuple[list[Loop], Rooted]
) -> tuple[bool, str]:
    """Whether the other kind of controller is clearly likelier, and what is told."""
    (loops, best), (others, end) = mine, other
    words, rival = IN_WORDS[loops[0].sampling], IN_WORDS[others[0].sampling]
    gain = _deviance(loops, best.estimate) - _deviance(others, end.estimate)
    plainly = PLAINLY * sum(int(np.isfinite(one.record.y).sum()) for one in loops)
    if end.still and (gain > plainly or not best.still):
        return True, f"controller taken as {rival}: -2 log L is lower by {gain:.1f} than as {words}"
    size = np.maximum(best.estimate.std, 1e-12 * np.abs(best.estimate.theta) + 1e-300)
    moved = np.abs(end.estimate.theta - best.estimate.theta) / size
    k = int(np.argmax(moved))
    if not end.still or gain < -plainly:
        against = f"the record speaks against a {others[0].sampling} one"
    else:
        against = (
            f"{NOT_TOLD}; as {rival}, {best.estimate.names[k]} would be "
            f"{end.estimate.theta[k]:.4g} in place of {best.estimate.theta[k]:.4g}"
        )
    return False, f"controller taken as {words}; {against}"


def _deviance(loops: Sequence[Loop], estimate: Estimate) -> float:
    """Minus two log likelihood of the residuals, as if they were white."""
    left = np.vstack(residuals(loops, estimate))
    counts = np.isfinite(left).sum(axis=0)
    return float(counts @ np.log(np.nanmean(left**2, axis=0)))


def residuals(loops: Sequence[Loop], estimate: Estimate) -> list[Array]:
    """(n_samples, n_outputs) per experiment, ``y - G u`` less the nuisance terms."""
    return [
        estimate.residual(without_rest(loop, estimate.model), experiment=e)
        for e, loop in enumerate(loops)
    ]


def _with_noise_model(
    loops: Sequence[Loop],
    structure: Structure,
    white: Rooted,
    method: Method,
    say: Callable[[str], None],
) -> Rooted:
    """The same on whitened samples, where the residual calls for a model of the noise."""
    say("coloured noise")
    at = white.estimate.model
    first = method.estimate([without_rest(one, at) for one in loops], structure)
    if not any(a.size for a in first.noise_model):
        return replace(white, estimate=first)
    found = root(loops, structure, first, lambda _: method, say)
    return replace(found, passes=found.passes + white.passes)


def completed(asked: Request, loops: Sequence[Loop], best: Rooted, *told: str) -> Estimate:
    """The last pass as an estimate of the records as they were given."""
    estimate = best.estimate
    left = np.vstack(residuals(loops, estimate))
    y = np.vstack([record.y - np.nanmean(record.y, axis=0) for record in asked.records])
    fit = 100.0 * (1.0 - np.sqrt(np.nansum(left**2, axis=0) / np.nansum(y**2, axis=0)))
    driven_by = ", ".join(one.driven.words for one in loops)
    findings = (*estimate.findings, *_between(loops, "; ".join(told)))
    words = [f"reference route: {driven_by}, {best.passes} passes", *told]
    status = estimate.status
    if not best.still:
        words.append(f"not at rest: the last pass moved a coefficient by {best.moved:.2g} errors")
        status = Status.WEAKLY_IDENTIFIABLE if status.ok else status
    return replace(
        estimate,
        fit=fit,
        status=status,
        findings=findings,
        method=asked.method,
        n_samples=asked.n_samples,
        dt=asked.dt,
        intersample=asked.records[0].behaviour,
        record_fingerprint=asked.fingerprint,
        route="reference",
        trace=estimate.trace.told(*words, *asked.told),
    )


def _between(loops: Sequence[Loop], told: str) -> list[Finding]:
    """What is to be said of the input between the samples of a loop."""
    found = []
    steps = [float(np.median(np.diff(one.record.t))) for one in loops]
    fastest = max(one.driven.rate * step for one, step in zip(loops, steps, strict=True))
    if loops[0].sampling == "continuous" and fastest > COARSE:
        found.append(
            Finding(
                "intersample",
                "warning",
                f"The controller is continuous and the loop fast for the sampling ({fastest:.2g} "
                "rad a step): what noise makes of the input between the samples is not recorded, "
                "and the standard errors do not allow for all of it.",
                "Sample faster, by five times if possible.",
            )
        )
    if NOT_TOLD in told:
        found.append(
            Finding(
                "intersample",
                "note",
                f"Controller: {NOT_TOLD + told.partition(NOT_TOLD)[2]}.",
                "State how the controller works: controller='sampled' or 'continuous' "
                "(--controller).",
            )
        )
    return found


@dataclass(frozen=True, eq=False)
class Rooted:
    """Where the passes ended.

    Attributes
    ----------
    estimate : Estimate
        Of the last pass.
    passes : int
    moved : float
        By which the last pass moved the coefficients [standard errors].
    """

    estimate: Estimate
    passes: int
    moved: float

    @property
    def still(self) -> bool:
        """Whether it is a root."""
        return self.moved <= STILL


def root(
    loops: Sequence[Loop],
    structure: Structure,
    first: Estimate,
    near: Callable[[TransferFunction], Method],
    say: Callable[[str], None],
) -> Rooted:
    """Passes of (3) until the coefficients stand still.

    Parameters
    ----------
    loops : sequence of Loop
    structure : Structure
    first : Estimate
        Where to begin.
    near : callable
        The method of the passes, which begins at a model.
    say : callable
        Is told what is going on.
    """
    given, images, estimate, moved = [first.theta], [], first, np.inf
    for count in range(1, MOST_PASSES + 1):
        say(f"what the reference does not drive, pass {count}")
        at = _model_like(estimate, given[-1])
        estimate = near(at).estimate([without_rest(one, at) for one in loops], structure)
        images.append(estimate.theta)
        scale = np.maximum(estimate.std, 1e-12 * np.abs(estimate.theta) + 1e-300)
        moved = float(np.max(np.abs(images[-1] - given[-1]) / scale))
        if moved <= STILL:
            break
        following = _extrapolated(given, images, scale)
        if not _model_like(estimate, following).is_stable:
            following = 0.5 * (given[-1] + images[-1])
        given.append(following)
    return Rooted(estimate, count, moved)


def without_rest(loop: Loop, model: TransferFunction) -> Record:
    """The pair ``(u_M, y')`` of (3)."""
    now = loop.at(model)
    return now.instrument.with_outputs(np.asarray(loop.record.y) - now.beside(model))


def _extrapolated(given: Sequence[Array], images: Sequence[Array], scale: Array) -> Array:
    """Anderson's extrapolation of the last passes, in units of standard errors."""
    depth = min(MEMORY, len(images), scale.size + 1)
    x = np.array([one / scale for one in given[-depth:]])
    g = np.array([one / scale for one in images[-depth:]])
    rest = g - x
    if depth == 1:
        return images[-1]
    steps = rest[1:] - rest[:-1]
    weights = np.linalg.lstsq(steps.T, rest[-1], rcond=1e-8)[0]
    return np.asarray((g[-1] - weights @ (g[1:] - g[:-1])) * scale)


def _model_like(estimate: Estimate, theta: Array) -> TransferFunction:
    """The model of other coefficients of the same structure."""
    channels = [
        [estimate.channel_draws(theta[None], i, j) for j in range(len(estimate.input_names))]
        for i in range(len(estimate.output_names))
    ]
    return TransferFunction(
        [[num[0] for num, _, _ in row] for row in channels],
        [[den[0] for _, den, _ in row] for row in channels],
        delay=np.array([[float(late[0]) for _, _, late in row] for row in channels]),
        input_names=estimate.input_names,
        output_names=estimate.output_names,
    )


def explained_records(estimate: Estimate, records: Sequence[Record]) -> list[Record] | None:
    """What an estimate of the reference route is a fit to: the pairs ``(u_M, y')`` at its end.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record

    Returns
    -------
    list of Record or None
        The records themselves where the route is another one; None where there is no such pair, as
        for a plant that is not stable, or a record without a reference.
    """
    if estimate.route != "reference":
        return list(records)
    mirrored = any(told.startswith(BY_PREDICTOR) for told in estimate.trace.decisions)
    if mirrored or any(record.reference is None for record in records):
        return None
    kind: Sampling = "sampled"
    if any(told.startswith(TAKEN_AS_CONTINUOUS) for told in estimate.trace.decisions):
        kind = "continuous"
    between = kind == "continuous"
    loops = [Loop(driven(record, between=between), kind) for record in records]
    return [without_rest(loop, estimate.model) for loop in loops]
