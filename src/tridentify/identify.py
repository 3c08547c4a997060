"""The front door: records and a structure in, an estimate out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from tridentify.errors import (
    ConvergenceError,
    IdentifiabilityError,
    OptionError,
    OrderError,
    SampleTypeError,
    UnsupportedOrderError,
)
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.machine_code import ready
from tridentify.estimation.methods.base import Method, Progress
from tridentify.estimation.methods.route import having_left_out, referenced
from tridentify.judgement.causes.signals.wild_beginning import without_wild_beginning
from tridentify.judgement.causes.timing.timed import beside_stated_moves, is_timed, with_times
from tridentify.judgement.choice import (
    METHODS,
    beside_stated,
    checked_method,
    with_behaviour,
    with_judgement,
)
from tridentify.judgement.direct import directly, held_in_loop, not_stable, widened
from tridentify.judgement.long_record import identified
from tridentify.judgement.selection.orders import default_candidates
from tridentify.judgement.selection.select import select_structure
from tridentify.numerics.executor import check_told
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.checks.orders import is_pair
from tridentify.record.listed import listed
from tridentify.record.long_record import LongRecord
from tridentify.record.record import Record
from tridentify.structure import AutoStructure, Structure

__all__ = ["METHODS", "identify"]


def identify(
    records: Record | LongRecord | Sequence[Record],
    structure: Structure | AutoStructure | Sequence[int] | None = None,
    method: Method | None = None,
    *,
    poles: int | Sequence[Sequence[int]] | None = None,
    zeros: int | Sequence[Sequence[int]] | None = None,
    throw: bool = True,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate the physical coefficients of a continuous-time model.

    Parameters
    ----------
    records : Record, LongRecord or sequence of Record
        One or several experiments on the same system; or one that is longer than memory
        (`open_record`).
    structure : Structure, AutoStructure or pair of int, optional
        Numbers of poles and zeros, and which nuisance terms are estimated along; ``(2, 1)`` or
        ``[2, 1]`` for ``Structure(2, 1)``. Left out, or `Structure.auto`, it is the one that
        `select_structure` recommends, and the decisions in ``trace`` say why.
    method : Method, optional
        Default ``ThreeModel()``.
    poles, zeros : int or nested sequence of int, optional
        In place of ``structure``: ``poles=2, zeros=1`` for ``Structure(2, 1)``.
    throw : bool
        Whether an estimate that is not usable raises; otherwise it is returned and its
        ``status`` says so.
    progress : callable, optional
        Called with a few words at the start of each stage.

    Returns
    -------
    Estimate

    Raises
    ------
    DataError, StructureError
        If records and structure are not usable, or swapped.
    OrderError
        If one of ``poles`` and ``zeros`` is missing, or they stand beside a structure.
    OptionError
        If ``structure`` or ``method`` is something else, such as a name or a class.
    IdentifiabilityError
        If the data cannot determine the coefficients.
    ConvergenceError
        If no stationary point was reached and ``throw`` is true.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate
    >>> u = np.sign(np.sin(np.arange(200) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))
    >>> identify(Record(u, y, dt=0.02), Structure(1, 0)).parameters["a0"].value
    4.0
    >>> identify(Record(u, y, dt=0.02), poles=1, zeros=0).names
    ('a0', 'b0')
    """
    _check_order(records, structure)
    check_told(progress)
    wanted = _wanted(structure, poles, zeros)
    estimate = (
        identify_long(records, wanted, method, progress)
        if isinstance(records, LongRecord)
        else search(records, wanted, method, progress).judged()
    )
    if throw and estimate.status is Status.AT_SAMPLING_LIMIT:
        raise UnsupportedOrderError(
            f"found a pole that runs away from the record with {estimate.structure.poles} poles: "
            f"{estimate.status.message}; expected poles that leave a trace between the samples; "
            f"{estimate.status.remedy} (throw=False returns the estimate all the same)"
        )
    if throw and not estimate.status.ok:
        name = checked_method(method).name
        raise ConvergenceError(
            f"{name} ended without a usable estimate: {estimate.status.message}; "
            f"{estimate.status.remedy} (throw=False returns the estimate all the same)"
        )
    return estimate


def identify_long(
    record: LongRecord,
    wanted: Structure | AutoStructure,
    method: Method | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """`identify` of a record that is read in parts; a status that is not usable does not raise.

    Parameters
    ----------
    record : LongRecord
    wanted : Structure or AutoStructure
    method : Method, optional
    progress : callable, optional

    Raises
    ------
    UnsupportedError
        What is asked for needs a record in memory.
    DataError, IdentifiabilityError
        As `identify`.
    """

    def whole(part: Record, asked: Structure | AutoStructure, by: Method) -> Estimate:
        return search(part, asked, by, progress).judged()

    with one_blas_thread():
        return identified(record, wanted, checked_method(method), whole, progress)


@dataclass(frozen=True, eq=False)
class Searched:
    """What a search ended with, before it is judged.

    Attributes
    ----------
    estimate : Estimate
        Without findings.
    records : tuple of Record
        As they were used: with the behaviour of their inputs.
    judged : callable
        Gives the estimate with all that is to be said of it; it takes longer than the search.
    """

    estimate: Estimate
    records: tuple[Record, ...]
    judged: Callable[[], Estimate]


def search(
    records: Record | Sequence[Record],
    wanted: Structure | AutoStructure,
    method: Method | None = None,
    progress: Progress | None = None,
) -> Searched:
    """The first half of `identify`, for who has something to do while the second lasts.

    Parameters
    ----------
    records : Record or sequence of Record
    wanted : Structure or AutoStructure
    method : Method, optional
    progress : callable, optional

    Returns
    -------
    Searched

    Raises
    ------
    DataError, StructureError, IdentifiabilityError, OptionError
        As `identify`.
    """
    chosen = checked_method(method)
    asked, left_out = referenced(getattr(chosen, "route", None), listed(records))
    given, wild = without_wild_beginning(asked)
    ready()
    with one_blas_thread():
        if isinstance(wanted, AutoStructure):
            estimate = _of_chosen_order(given, wanted, chosen, progress)
            estimate = having_left_out(estimate, left_out)
            used = tuple(record.settled(estimate.intersample) for record in given)
            stated = all(record.intersample != "auto" for record in given)
            again = directly(chosen, estimate, used, estimate.structure, progress, stated=stated)
            if again is not None:
                told, used = estimate.trace.decisions[:1], tuple(again[1])
                wide = widened(again[0], used, stated=stated)
                estimate = with_judgement(wide, used, chosen, None, told)
            if not (stated or again or estimate.route == "direct"):
                estimate, used = _beside_times(estimate, used, chosen, progress)
            ended = _told(estimate, asked, wild)
            return Searched(ended, used, lambda: ended)
        try:
            found, seen, between, told = with_behaviour(chosen, given, wanted, progress)
        except UnsupportedOrderError:
            seen = [record.settled("zoh") for record in given]
            held = held_in_loop(chosen, seen, wanted, progress)
            if held is None:
                raise
            found, between, told = held, None, ()
        found = having_left_out(found, left_out)
        first, stated = found, all(record.intersample != "auto" for record in given)
        again = directly(chosen, found, seen, wanted, progress, stated=stated)
        if again is not None:
            taken = seen[0].behaviour
            found, seen = again
            between = between if taken == seen[0].behaviour else None
        elif not (stated or found.route == "direct"):
            found, seen = with_times(chosen, found, seen, wanted, progress)
            between = None if is_timed(found) else between
        found = widened(found, seen, stated=stated)
        found = not_stable(chosen, found, seen, wanted, progress, stated=stated) or found

    def judged() -> Estimate:
        if progress is not None:
            progress("testing the residual")
        with one_blas_thread():
            compared = beside_stated(first, seen) if stated else between
            said = beside_stated_moves(found, seen) if stated and again is None else found
            return _told(with_judgement(said, seen, chosen, compared, told), asked, wild)

    return Searched(found, tuple(seen), judged)


def _beside_times(
    estimate: Estimate, records: tuple[Record, ...], method: Method, progress: Progress | None
) -> tuple[Estimate, tuple[Record, ...]]:
    """The estimate of an order beside the times that this order tells.

    The candidates were compared with those that one of them told.
    """
    known, structure = estimate.trace.decisions[:1], estimate.structure
    was_timed = estimate.record_fingerprint != fingerprint(records)
    timed, seen = with_times(method, estimate, records, structure, progress)
    if seen[0] is not records[0]:
        return with_judgement(timed, seen, method, None, known), tuple(seen)
    if was_timed:
        plain = method.estimate(records, structure, progress)
        return with_judgement(plain, records, method, None, known), records
    return timed, records


def _told(estimate: Estimate, asked: Sequence[Record], wild: Sequence[Finding]) -> Estimate:
    """An estimate of the records as they were asked for, and which samples it left out."""
    if not (wild or is_timed(estimate)):
        return estimate
    seen = fingerprint([record.settled(estimate.intersample) for record in asked])
    return replace(estimate, findings=(*wild, *estimate.findings), record_fingerprint=seen)


def _check_order(records: object, structure: object) -> None:
    """Refuse a structure where the records belong."""
    if isinstance(records, Structure | AutoStructure) or (
        is_pair(records) and isinstance(structure, Record)
    ):
        raise SampleTypeError(
            "found the structure before the record: swapped; expected the record first; write "
            "identify(record, structure)"
        )


def _wanted(structure: object, poles: object, zeros: object) -> Structure | AutoStructure:
    """What is asked for, in whichever way it was said."""
    if poles is not None or zeros is not None:
        if structure is not None or poles is None or zeros is None:
            found = "zeros" if poles is None else "poles" if zeros is None else "poles and zeros"
            beside = " beside a structure" if structure is not None else ""
            raise OrderError(
                f"found {found}{beside}; expected poles and zeros together, or a structure, or "
                "neither for orders that the record chooses; write for example poles=2, zeros=1"
            )
        return Structure(poles, zeros)  # type: ignore[arg-type]
    return checked_structure(structure)


def checked_structure(structure: object) -> Structure | AutoStructure:
    """What was given in place of a structure, as one.

    Raises
    ------
    OptionError
        It is neither a structure nor a pair of numbers.
    """
    if structure is None:
        return AutoStructure()
    if isinstance(structure, Structure | AutoStructure):
        return structure
    if is_pair(structure):
        return Structure(*structure)  # type: ignore[misc]
    raise OptionError(
        f"found structure={type(structure).__name__}; expected a Structure or a pair (poles, "
        "zeros); write for example identify(record, (2, 1)), and select_structure for several"
    )


def _of_chosen_order(
    records: list[Record], wanted: AutoStructure, method: Method, progress: Progress | None
) -> Estimate:
    """The estimate of the row that `select_structure` recommends, with the reason."""
    most = wanted.max_poles
    selection = select_structure(
        records,
        None if most is None else default_candidates(records, wanted.template, most),
        method=method,
        template=wanted.template,
        integrators=True,
        delays=True,
        finish=False,
        progress=progress,
    )
    row = selection.recommended
    if row is None or row.estimate is None:
        raise IdentifiabilityError(
            f"found no usable candidate among {len(selection.rows)} orders: {selection.reason}; "
            "expected one that the record determines; state poles and zeros, or record longer"
        )
    # rows with a delay or an integrator have joined where the record called for them
    plain = (one.structure for one in selection.rows if not one.structure.constrained)
    tried = sum(one.delay == wanted.template.delay for one in plain)
    told = DecisionKind.ORDERS_CHOSEN.told(
        f" {row.label} chosen of {tried} candidates: {selection.reason}"
    )
    estimate, left_open = row.estimate, any(record.intersample == "auto" for record in records)
    if left_open and row.structure.delay == "free":
        # held for half an interval is late by as much: what was said without a delay is no matter
        again, seen, found, words = with_behaviour(method, records, row.structure, progress)
        estimate = with_judgement(again, seen, method, found, words)
    trace = replace(estimate.trace, decisions=(told, *estimate.trace.decisions))
    return replace(estimate, trace=trace)
