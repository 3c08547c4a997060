"""A record longer than memory, from its front door to its findings.

The ordinary way, with its search and all of its judgement, is gone on a stretch that fits in
memory; the numbers are then those of all samples (`estimation.methods.long_record`). What is said
of single samples, of the residual and of other causes is said of the stretch, and says so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError, UnsupportedError
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding, ranked
from tridentify.estimation.methods.base import Method, Progress
from tridentify.estimation.methods.long_record import Readings, long_estimate, poles_of_seed
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.judgement.cautions.coefficients import coefficient_findings
from tridentify.record.long_record import LongRecord
from tridentify.record.long_survey import Survey, survey
from tridentify.record.record import Record
from tridentify.structure import AutoStructure, Structure
from tridentify.writing.layout import as_call

Whole = Callable[[Record, Structure | AutoStructure, Method], Estimate]
"""`identify` of a record in memory, with its findings."""

OF_ALL = frozenset(
    {
        "no-response",
        "not-excited",
        "constant-input",
        "missing-samples",
        "order-high",
        "not-determined",
        "outside-the-record",
        "at-bound",
        "samples-left-out",
    }
)
"""Findings that all samples answer, so that a stretch has no say in them."""


def identified(
    record: LongRecord,
    wanted: Structure | AutoStructure,
    method: Method,
    whole: Whole,
    progress: Progress | None = None,
) -> Estimate:
    """The estimate of all samples of a long record.

    Parameters
    ----------
    record : LongRecord
    wanted : Structure or AutoStructure
        Of the latter a stretch chooses.
    method : Method
        `ThreeModel` without robust losses, posterior or closed loop.
    whole : callable
        The ordinary way, for records in memory.
    progress : callable, optional
        Told in words what is going on, and what time remains.

    Raises
    ------
    UnsupportedError
        What is asked for needs a record in memory.
    DataError, IdentifiabilityError
        As `identify`.
    """
    chosen = supported(wanted, method)
    say = progress or (lambda _: None)
    if record.n_samples <= record.stretch:
        return whole(record.part(0, record.n_samples), wanted, chosen)
    readings = Readings(record, say)
    seen = survey(record, readings.told)
    readings.done = 2
    start = 0 if seen.begins_lively else seen.liveliest
    stretch = record.part(start, start + record.stretch)
    say(f"the ordinary search, on samples {start} to {start + stretch.n_samples - 1}")
    began = whole(stretch, _on_stretch(wanted, known=start == 0), chosen)
    _refuse_band_limited(began, record)
    structure = _asked(wanted, began)
    seeds = [poles_of_seed(began), *_slow_seed(seen, structure)]
    found = long_estimate(
        record, seen, replace(began, structure=structure), seeds, chosen.patience, readings
    )
    return _judged(found, began, record, seen, stretch, (start, readings.done), chosen)


def supported(wanted: Structure | AutoStructure, method: Method) -> ThreeModel:
    """The method, where what is asked for can be had from triangles alone.

    Parameters
    ----------
    wanted : Structure or AutoStructure
    method : Method

    Raises
    ------
    UnsupportedError
        It cannot.
    """
    template = wanted.template if isinstance(wanted, AutoStructure) else wanted
    why = ""
    if not isinstance(method, ThreeModel):
        why = f"{as_call(method)}; expected ThreeModel()"
    elif method.loss != "squared":
        why = f"loss={method.loss!r}; expected loss='squared'"
    elif method.finish == "posterior":
        why = "finish='posterior'; expected the likelihood's maximum"
    elif method.route in ("reference", "direct"):
        why = f"route={method.route!r}; expected a record in open loop"
    elif template.delay == "free":
        why = "delay='free'; expected a delay in seconds"
    elif template.constrained:
        why = "knowledge of coefficients; expected coefficients that are free"
    if why:
        raise UnsupportedError(
            f"found {why} for a record that is read in parts; leave it out, or identify a stretch: "
            "record.part(0, 100000)"
        )
    assert isinstance(method, ThreeModel)
    return method


def _on_stretch(wanted: Structure | AutoStructure, *, known: bool) -> Structure | AutoStructure:
    """What to ask of a stretch: its initial state is free unless it is the beginning."""
    if known:
        return wanted
    if isinstance(wanted, AutoStructure):
        return replace(wanted, template=replace(wanted.template, initial_state="free"))
    return replace(wanted, initial_state="free")


def _asked(wanted: Structure | AutoStructure, began: Estimate) -> Structure:
    """The structure for all samples: the nuisance terms as they were left open."""
    if isinstance(wanted, Structure):
        return wanted
    return replace(wanted.template, poles=began.structure.poles, zeros=began.structure.zeros)


def _refuse_band_limited(began: Estimate, record: LongRecord) -> None:
    if began.intersample == "band-limited" and record.intersample == "auto":
        raise UnsupportedError(
            "found an input that is explained best as band-limited; expected one that is held or "
            "joined by straight lines in a record that is read in parts; state intersample='foh', "
            "or identify a stretch: record.part(0, 100000)"
        )


def _slow_seed(seen: Survey, structure: Structure) -> list[np.ndarray]:
    """Poles from the record averaged over blocks, where that has a model."""
    if seen.coarse is None:
        return []
    try:
        plain = ThreeModel(noise="white", finish="likelihood", route="open-loop", starts=1)
        return [poles_of_seed(plain.estimate([seen.coarse], structure))]
    except TridentifyError:  # nothing so slow is in it
        return []


def _judged(
    found: Estimate,
    began: Estimate,
    record: LongRecord,
    seen: Survey,
    stretch: Record,
    counted: tuple[int, int],
    method: ThreeModel,
) -> Estimate:
    """The estimate with what is to be said of it."""
    start, readings = counted
    small = seen.coarse if seen.coarse is not None else stretch
    known = [
        one for one in coefficient_findings(found, [small]) if one.code != "outside-the-record"
    ]
    first, last = start, start + stretch.n_samples - 1
    where = f"On samples {first} to {last}: "
    carried = [
        replace(one, message=where + one.message) for one in began.findings
        if one.code not in OF_ALL
    ]  # fmt: skip
    said = Finding(
        "judged-on-stretch",
        "note",
        f"The {record.n_samples} samples were read in parts. Coefficients and standard errors are "
        f"of all of them; residual, sensors and other causes were looked at on samples {first} to "
        f"{last} alone ({100.0 * stretch.n_samples / record.n_samples:.2g} %).",
        "Where that matters, validate other stretches: validate(estimate, record.part(a, b)).",
        times=(float(stretch.t[0]), float(stretch.t[-1])),
    )
    findings = ranked([*found.findings, *known, *_missing(seen, record), *carried, said])
    told = f"{readings} readings of {record.n_samples} samples; begun on samples {first} to {last}"
    trace = replace(found.trace, decisions=(told, *_order_told(began), *found.trace.decisions))
    return replace(found, findings=findings, trace=trace, call=as_call(method))


def _order_told(began: Estimate) -> tuple[str, ...]:
    """What the stretch decided of orders and of the input between its samples."""
    return began.trace.about(DecisionKind.ORDERS_CHOSEN, DecisionKind.INPUT_TAKEN)


def _missing(seen: Survey, record: LongRecord) -> Sequence[Finding]:
    missing = int(seen.missing.sum())
    if not missing:
        return []
    which = tuple(name for name, n in zip(record.output_names, seen.missing, strict=True) if n)
    return [
        Finding(
            "missing-samples",
            "note",
            f"{missing} output samples are missing; they do not count.",
            outputs=which,
        )
    ]
