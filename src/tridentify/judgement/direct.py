"""Feedback without a reference: the direct route, taken where the input reacts to the output.

The noise gets a model in any case. Innovations are independent of past inputs whether or not a
controller acts, so that the maximum of the likelihood is where it would be without one, as long as
plant and noise are what they are taken for (Ljung 1999, section 13.4). That is what is checked, and
how much hangs on it is said: by how much coefficients differ from those with white weights.

Of a plant that is held, the best model by simulation may be none at all (the controller backwards,
or a stable stand-in), with a residual in which no feedback shows. Then past outputs tell what the
input does next (`causes.past_outputs`), or a short linear law of outputs does
(`causes.attempts.told_apart`), and the direct route is taken for that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.answer import widened_by
from tridentify.estimation.likelihood.question import silently
from tridentify.estimation.methods.base import Method, Progress
from tridentify.estimation.methods.by_reference.not_stable import may_be_unstable, unless_unstable
from tridentify.estimation.methods.explained import explained_records
from tridentify.estimation.methods.in_loop import found_together, made_on_samples, wanders
from tridentify.estimation.methods.output_error import OutputError
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.judgement.causes.attempts.feedback import Inputs, misses
from tridentify.judgement.causes.attempts.first_samples import beginning
from tridentify.judgement.causes.attempts.intersample import moves_between
from tridentify.judgement.causes.attempts.told_apart import answers_at_once, laws, rests
from tridentify.judgement.causes.past_outputs import (
    Told,
    exchanged,
    told_by_past,
)
from tridentify.judgement.validation.assess import (
    LONGEST_LOOK,
    looked_at,
    may_react_at_all,
    own_look,
)
from tridentify.judgement.validation.residuals import Output, View, root_of
from tridentify.numerics.arrays import Array
from tridentify.numerics.lagrange import span
from tridentify.record.record import Record
from tridentify.structure import Structure

CODE = "feedback"

DECIDES = 2.0
"""Difference from white weights [standard errors] from which the model of the noise decides."""

MOST_SHARED = 0.99
"""Of the information on a combination of coefficients: errors grow at most tenfold."""

NOT_EXPLAINED = 1e-4
"""p-value of past inputs and outputs in the innovations, from which the direct route has failed."""


def directly(
    method: Method,
    estimate: Estimate,
    records: Sequence[Record],
    structure: Structure,
    progress: Progress | None = None,
    *,
    stated: bool = True,
) -> tuple[Estimate, list[Record]] | None:
    """Estimate anew by the direct route where the input reacts to the output.

    Parameters
    ----------
    method : Method
        By which the records were identified.
    estimate : Estimate
        Open loop.
    records : sequence of Record
        With the behaviour of their inputs settled.
    structure : Structure
        As asked for.
    progress : callable, optional
    stated : bool
        Whether somebody stated what the inputs do between their samples.

    Returns
    -------
    (Estimate, list of Record) or None
        With the records as they were used: a controller may show that their inputs are held. None
        where nothing calls for it, another route was asked for, or it leads nowhere.
    """
    why = why_directly(method, estimate, records)
    if not (why and isinstance(method, ThreeModel)):
        return None
    seen = records if stated else held_by_a_controller(estimate, records)
    found = _if_it_leads(method, seen, structure, progress, why)
    return None if found is None else (found, list(seen))


def held_by_a_controller(estimate: Estimate, records: Sequence[Record]) -> Sequence[Record]:
    """Records of a loop, with their inputs held where a controller on their samples made them."""
    seen = made_on_samples(estimate, records)
    return [one.between("zoh") for one in records] if seen else records


def why_directly(method: Method, estimate: Estimate, records: Sequence[Record]) -> str:
    """Why the direct route is to be taken; empty where nothing calls for it, or it was not left.

    Parameters
    ----------
    method, estimate, records
        As of `directly`.
    """
    if not (isinstance(method, ThreeModel) and method.route == "auto" and estimate.status.ok):
        return ""
    if method.noise == "white" or method.loss != "squared" or estimate.route != "open-loop":
        return ""
    # what past outputs tell costs little; all tests cost as much as the search itself
    seen = _held(estimate, records)
    if seen and moves_between(estimate, records):
        seen = ""
    seen = seen or _reacts(estimate, records)
    if not seen or exchanged(records):
        return ""
    return f"{seen}, and no reference says what else moved it"


def held_in_loop(
    method: Method, records: Sequence[Record], structure: Structure, progress: Progress | None
) -> Estimate | None:
    """Estimate by the direct route what no stable model told apart, where a controller shows.

    The likeliest stable stand-in of a plant that is held may be one of poles that cancel, which no
    record determines; where past outputs tell the input, plant and noise may be found together.

    Parameters
    ----------
    method : Method
    records : sequence of Record
        With the behaviour of their inputs settled.
    structure : Structure
    progress : callable, optional

    Returns
    -------
    Estimate or None
        None where no controller shows, another route was asked for, or it leads nowhere.
    """
    if not (isinstance(method, ThreeModel) and method.route == "auto"):
        return None
    if (
        method.noise == "white"
        or method.loss != "squared"
        or any(one.dt is None for one in records)
    ):
        return None
    law = any(one.lags is not None and not rests(records, one.input) for one in laws(records))
    if not law and not any(told_by_past(records)):
        return None
    why = "a controller moves the input, and no stable model tells the coefficients apart"
    return _if_it_leads(method, records, structure, progress, why)


def _reacts(estimate: Estimate, records: Sequence[Record]) -> str:
    """What all tests say of an input that reacts; empty for nothing."""
    suspected = may_react_at_all(estimate, records)
    found = looked_at(estimate, records) if suspected else ()
    return "the input reacts to the output" if any(one.code == CODE for one in found) else ""


def _held(estimate: Estimate, records: Sequence[Record]) -> str:
    """What shows that a controller moves an input where no residual does; empty for nothing."""
    names = estimate.input_names
    for told in told_by_outputs(estimate, records):
        if told is not None:
            return f"past outputs tell what {names[told.input]} does next"
    if answers_at_once(estimate) or not all(one.dt and one.behaviour == "zoh" for one in records):
        return ""
    for law in laws(records):
        if law.lags is not None and not rests(records, law.input):
            return f"a short law of outputs tells {names[law.input]}"
    return ""


def told_by_outputs(estimate: Estimate, records: Sequence[Record]) -> list[Told | None]:
    """Which input the past of each output tells, in what every estimate is judged by."""
    if answers_at_once(estimate) or any(
        one.dt is None or one.reference is not None for one in records
    ):
        return []
    return told_by_past([beginning(one, LONGEST_LOOK) for one in records])


def by_direct_route(
    method: ThreeModel,
    records: Sequence[Record],
    structure: Structure,
    progress: Progress | None,
    why: str,
) -> Estimate:
    """Estimate by the direct route, and say in the trace why.

    Parameters
    ----------
    method : ThreeModel
        With any route.
    records, structure, progress
        As of `directly`.
    why : str
        What `why_directly` says.
    """
    (progress or silently)("feedback: the direct route")
    found = replace(method, route="direct").estimate(records, structure, progress)
    return replace(found, trace=found.trace.told(DecisionKind.DIRECT_ROUTE.told(f": {why}")))


def _if_it_leads(
    method: ThreeModel,
    records: Sequence[Record],
    structure: Structure,
    progress: Progress | None,
    why: str,
) -> Estimate | None:
    try:
        found = by_direct_route(method, records, structure, progress, why)
    except TridentifyError:
        return None
    return found if found.status.ok else None


def not_stable(
    method: Method,
    estimate: Estimate,
    records: Sequence[Record],
    structure: Structure,
    progress: Progress | None,
    *,
    stated: bool = True,
) -> Estimate | None:
    """Estimate anew without the limit of stability, where a record in open loop speaks for that.

    An unstable mode in a record of some length means a controller, which a stable model shows by
    its residual; without a reference it is told of there. Where the input was not commanded the
    direct route is taken.

    Parameters
    ----------
    method : Method
        By which the records were identified.
    estimate : Estimate
        By any route.
    records : sequence of Record
        With the behaviour of their inputs settled.
    structure : Structure
        As asked for.
    progress : callable, optional
    stated : bool
        Whether somebody stated what the inputs do between their samples.

    Returns
    -------
    Estimate or None
        None where nothing calls for it.
    """
    if not isinstance(method, ThreeModel) or method.loss != "squared":
        return None
    if estimate.route != "open-loop" or not may_be_unstable(estimate, records, structure):
        return None
    asked = Request.of(records, structure, method.name)
    found = unless_unstable(
        estimate, asked, method.estimate, method.noise != "white", progress or silently
    )
    if found is estimate or any(one.code == CODE for one in looked_at(estimate, records)):
        return None
    if method.route != "auto" or method.noise == "white" or Inputs.of(records).commanded:
        return found
    # what runs away stayed within its record although the input was not commanded: it was held
    why = "the plant runs away by itself, and what moved its input held it"
    held = _if_it_leads(method, records, structure, progress, why)
    return found if held is None else widened(held, records, stated=stated)


def widened(estimate: Estimate, records: Sequence[Record], *, stated: bool = True) -> Estimate:
    """An estimate by the direct route with standard errors that know the noise was estimated too.

    What is found of both together counts (`methods.in_loop`), and what else is nearly as likely.

    Without feedback, coefficients and noise are estimated as if the other were known: derivatives
    of the innovations by the one are made of inputs, by the other of past noise (Pierce 1972). With
    feedback the inputs hold past noise, and the information that both share is taken off.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    stated : bool
        Whether somebody stated what the inputs do between their samples.
    """
    if estimate.method == ThreeModel.name and wanders(estimate, records):
        return found_together(estimate, records)
    if estimate.route != "direct":
        return estimate
    view = None if estimate.draws.size else own_look(estimate, records)
    if view is not None and view.has_errors:
        estimate = _allowing(estimate, view)
    return _doubted(found_together(estimate, records, stated=stated), records)


def _doubted(estimate: Estimate, records: Sequence[Record]) -> Estimate:
    """With errors that reach as far as those of white weights, where no model of the noise holds.

    Where innovations hold past samples, neither answer is that of a likelihood. That of white
    weights has errors from the scatter of its scores, and the other one is as far from the truth as
    it is from that one, and that one from the truth.
    """
    # the output of a plant that is not stable is explained by a predictor, not by a simulation
    shown = explained_records(estimate, records) is not None
    white = (
        with_white_weights(estimate, records)
        if shown and hold_past_samples(estimate, records)
        else None
    )
    if white is None:
        return estimate
    moves = (white.theta - estimate.theta, *root_of(white).T)
    cov, draws = widened_by(estimate.cov, estimate.draws, moves)
    apart = moved_by_weights(estimate, white)
    told = estimate.trace.told(DecisionKind.NOT_INDEPENDENT.told(f": {apart}"))
    return replace(estimate, cov=cov, draws=draws, trace=told)


def _allowing(estimate: Estimate, view: View) -> Estimate:
    """With the information that coefficients and noise share taken off."""
    root = root_of(estimate)
    shared = np.zeros((root.shape[1],) * 2)
    for one in view.outputs:
        shared = shared + _shared(one)
    sizes, turned = np.linalg.eigh(shared)
    larger = turned / np.sqrt(1.0 - np.clip(sizes, 0.0, MOST_SHARED))
    wide = root @ larger
    return replace(estimate, cov=wide @ wide.T)


def _shared(output: Output) -> Array:
    """(r, r) information on the coefficients, in units of all there is, shared with the noise's."""
    p = output.noise.size
    past = [
        np.stack([np.concatenate([np.zeros(k), one[:-k]]) for k in range(1, p + 1)], axis=1)
        for one in (np.nan_to_num(own) for own in output.residual)
    ]
    e = output.white(output.residual, output.noise)
    own = output.white(output.coefficients, output.noise)
    known = span(output.white(output.nuisance, output.noise))
    noise = np.vstack(past)
    basis = span(noise - known @ (known.T @ noise))
    both = basis.T @ (own - known @ (known.T @ own))
    variance = float(e @ e) / max(output.count - own.shape[1] - known.shape[1] - p, 1)
    found: Array = both.T @ both / variance
    return found


def hold_past_samples(estimate: Estimate, records: Sequence[Record]) -> bool:
    """Whether the innovations still hold past inputs or outputs."""
    view = own_look(estimate, records)
    if view is None or view.uneven:
        return False
    for one in view.outputs:
        own = [np.hstack(pair) for pair in zip(one.coefficients, one.nuisance, strict=True)]
        if misses(one.residual, own, one.noise, view.records) < NOT_EXPLAINED:
            return True
    return False


def with_white_weights(estimate: Estimate, records: Sequence[Record]) -> Estimate | None:
    """The estimate with white weights, from the same beginning; None where there is none."""
    try:
        white = OutputError(start=estimate.model).estimate(list(records), estimate.structure)
    except TridentifyError:
        return None
    alike = white.status.ok and white.theta.shape == estimate.theta.shape
    return white if alike and np.isfinite(white.cov).all() else None


def moved_by_weights(estimate: Estimate, white: Estimate) -> str:
    """By how much the coefficients differ from those with white weights."""
    size = np.abs(white.theta - estimate.theta) / np.where(estimate.std > 0, estimate.std, np.inf)
    k = int(np.argmax(size))
    if size[k] < DECIDES:
        return f"White noise moves no coefficient by more than {size[k]:.1f} standard errors"
    return (
        f"The model of the noise decides: white noise moves {estimate.names[k]} from "
        f"{estimate.theta[k]:.4g} to {white.theta[k]:.4g} ({size[k]:.1f} standard errors)"
    )
