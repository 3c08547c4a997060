"""What `identify` and `select_structure` share: records, method, the input's behaviour."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import ranked
from tridentify.estimation.closed_loop.moving import any_moves, with_still
from tridentify.estimation.likelihood.noise.noise_levels import weighed
from tridentify.estimation.methods.around_maximum.levels import one_level
from tridentify.estimation.methods.base import Method, Progress
from tridentify.estimation.methods.capability import Capability
from tridentify.estimation.methods.closed_loop.projection import Projection
from tridentify.estimation.methods.closed_loop.two_stage import TwoStage
from tridentify.estimation.methods.explained import explained_records
from tridentify.estimation.methods.filtered.bias_compensated_least_squares import (
    BiasCompensatedLeastSquares,
)
from tridentify.estimation.methods.filtered.refined_instrumental_variable import (
    RefinedInstrumentalVariable,
)
from tridentify.estimation.methods.filtered.svf_instrumental_variable import SvfInstrumentalVariable
from tridentify.estimation.methods.filtered.svf_least_squares import SvfLeastSquares
from tridentify.estimation.methods.output_error import OutputError
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.judgement.causes.attempts.intersample import (
    IN_WORDS,
    TIE,
    Behaviours,
    behaviours,
    better_behaviour,
    in_doubt,
    taken_as,
)
from tridentify.judgement.causes.attempts.told_apart import about_loop
from tridentify.judgement.cautions import judged
from tridentify.judgement.cautions.coefficients import coefficient_findings
from tridentify.judgement.cautions.sensors import recorded_findings
from tridentify.judgement.direct_findings import about_direct, predictor_findings
from tridentify.judgement.validation.reacting_reference import reference_findings
from tridentify.record.checks.samples import Behaviour
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.writing.layout import as_call

METHODS: Mapping[str, Callable[[], Method]] = MappingProxyType(
    {
        "three-model": ThreeModel,
        "output-error": OutputError,
        "refined-instrumental-variable": RefinedInstrumentalVariable,
        "svf-instrumental-variable": SvfInstrumentalVariable,
        "svf-least-squares": SvfLeastSquares,
        "bias-compensated-least-squares": BiasCompensatedLeastSquares,
    }
)
"""Name -> method with its default options; the command line and the contract tests read it."""

METHODS_IN_LOOP: Mapping[str, Callable[[], Method]] = MappingProxyType(
    {"two-stage": TwoStage, "projection": Projection}
)
"""The same of methods that need a reference. `ClosedLoopRefinedInstrumentalVariable`, which needs
the controller too, has no default options and hence no row."""


def with_behaviour(
    method: Method, records: list[Record], structure: Structure, progress: Progress | None
) -> tuple[Estimate, list[Record], Behaviours | None, tuple[str, ...]]:
    """The estimate, with what explains the record best where the input's behaviour is left open.

    The search runs with what the samples suggest; at its end every behaviour is fitted from there,
    and another search with the best of them follows where that is another one. So it does where
    the noise has memory and coefficients hang on which it is: AICc says then, with the noise model
    of each search. Where it was stated, nothing is compared: that is for who judges the estimate
    (`beside_stated`).
    """
    stated = all(record.intersample != "auto" for record in records)
    left_open = [record.behaviour for record in records if record.intersample == "auto"]
    suggested: Behaviour = left_open[0] if left_open else "zoh"
    ends: dict[Behaviour, _Searched] = {}
    wanted = suggested
    while True:
        seen = [record.settled(wanted) for record in records]
        estimate = method.estimate(seen, structure, progress)
        if stated:
            return estimate, seen, None, ()
        found = _compared(estimate, seen)
        if found is None:
            told = taken_as(wanted, ", which its samples suggest")
            return estimate, seen, None, (told,)
        ends[wanted] = _Searched(estimate, seen, found)
        asked = [better_behaviour(found, suggested), *in_doubt(found, estimate)]
        others = [one for one in asked if one not in ends and _can_be(one, method)]
        if not others:
            return _best_of(ends, wanted, suggested)
        wanted = others[0]


class _Searched(NamedTuple):
    """Where the search with one behaviour ended, and how others compare from there."""

    estimate: Estimate
    records: list[Record]
    found: Behaviours


def _best_of(
    ends: Mapping[Behaviour, _Searched], last: Behaviour, suggested: Behaviour
) -> tuple[Estimate, list[Record], Behaviours, tuple[str, ...]]:
    """The search to be used: the last, or the best where the noise of one of them has memory."""
    heights = {one: end.estimate.aicc for one, end in ends.items()}
    coloured = any(a.size for end in ends.values() for a in end.estimate.noise_model)
    judged = len(ends) > 1 and coloured and bool(np.isfinite(list(heights.values())).all())
    used = last
    if judged:
        used = min(heights, key=lambda one: heights[one])
        used = suggested if heights[suggested] < heights[used] + TIE else used
    estimate, seen, found = ends[used]
    if judged:
        above = {one: height - heights[used] for one, height in heights.items()}
        searched = {one: np.asarray(end.estimate.theta) for one, end in ends.items()}
        found = replace(found, above=found.above | above, searched=searched)
    return estimate, seen, found, (found.in_words(),)


def beside_stated(estimate: Estimate, records: Sequence[Record]) -> Behaviours | None:
    """How other behaviours of the input compare with one that was stated.

    Parameters
    ----------
    estimate : Estimate
        Where they begin.
    records : sequence of Record
        With the behaviour that was used.
    """
    found = _compared(estimate, records)
    return found and replace(found, stated=True)


def _compared(estimate: Estimate, records: Sequence[Record]) -> Behaviours | None:
    # what lies between the samples of a loop is no matter of the input's samples alone
    return None if estimate.route == "reference" else behaviours(estimate, records)


def still_references(estimate: Estimate, records: Sequence[Record]) -> tuple[str, ...]:
    """That references were given which had no part in the estimate: still ones, or some only."""
    given = [one for one in records if one.reference is not None]
    if not given or estimate.route == "reference":
        return ()
    if len(given) < len(records):
        lost = f"{len(records) - len(given)} of {len(records)} experiments"
        return (f"{lost} without a reference: the others' had no part",)
    return () if any_moves(records) else ("the references never move: taken as none",)


def own_behaviour(estimate: Estimate, records: Sequence[Record]) -> tuple[str, ...]:
    """What references were taken to do between their samples, where inputs do something else."""
    if estimate.route != "reference":
        return ()
    apart = {one.reference_behaviour for one in records if one.reference_behaviour != one.behaviour}
    return tuple(f"reference taken as {IN_WORDS[one]}" for one in sorted(filter(None, apart)))


ANSWERED = ("feedback", "loop-not-excited")
"""What a reference answers: that there was a controller is known."""


def _can_be(behaviour: Behaviour, method: Method) -> bool:
    """Whether a method takes an input of that behaviour."""
    can = getattr(method, "capabilities", Capability.NONE)
    return behaviour != "band-limited" or Capability.BAND_LIMITED in can


def with_judgement(
    estimate: Estimate,
    records: Sequence[Record],
    method: Method,
    between: Behaviours | None,
    told: Sequence[str] = (),
) -> Estimate:
    """The estimate with what is to be said of it, and how it was asked for.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        With the behaviour of the input that was used.
    method : Method
    between : Behaviours or None
        How other behaviours of the input compare.
    told : sequence of str
        Further decisions for its trace.
    """
    driving = (*still_references(estimate, records), *own_behaviour(estimate, records))
    said = (*told, *driving, *one_level(estimate, records))
    records = weighed(records, estimate.noise_levels)
    trace = replace(estimate.trace, decisions=(*estimate.trace.decisions, *said))
    estimate = estimate.saying(trace=trace)
    seen = explained_records(estimate, records)
    if seen is None:
        of_the_plant = coefficient_findings(estimate, list(records))
        known = [*estimate.findings, *of_the_plant, *predictor_findings(estimate, records)]
        known += recorded_findings(estimate, records)
        found = ranked([*known, *about_loop(estimate, records, known)])
    else:
        found = about_direct(judged(estimate, seen, between, records), estimate, records)
        if estimate.route == "reference":
            kept = estimate.findings
            found = tuple(one for one in found if one.code not in ANSWERED or one in kept)
            found = ranked([*found, *reference_findings(estimate, seen, records)])
    found = with_still(found, records, estimate.route)
    return estimate.saying(findings=found, call=as_call(method))


def checked_method(method: object) -> Method:
    """Give the method that was chosen, or the default one.

    Raises
    ------
    OptionError
        It is a name of `METHODS`, a class, or no method at all.
    """
    if method is None:
        return ThreeModel()
    if isinstance(method, Method) and not isinstance(method, type):
        return method
    found, write = shown(method), "ThreeModel()"
    if isinstance(method, str) and method in METHODS:
        made = METHODS[method]
        write = f"{getattr(made, '__name__', write)}(), or METHODS[{method!r}]()"
    elif isinstance(method, str) and method in METHODS_IN_LOOP:
        write = f"{getattr(METHODS_IN_LOOP[method], '__name__', write)}()"
    elif isinstance(method, type):
        found = f"the class {method.__name__}"
        known = [*METHODS.values(), *METHODS_IN_LOOP.values()]
        if issubclass(method, tuple(m for m in known if isinstance(m, type))):
            write = f"{method.__name__}()"
    raise OptionError(
        f"found method={found}; expected a method with its options; write method={write}"
    )
