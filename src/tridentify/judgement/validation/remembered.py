"""The judgement that came with an estimate, kept for whoever asks for it next.

`identify` judges what it found by all tests where a first look calls for them, and a report, or the
user, validates the same estimate on the same records right after that. One judgement is kept, until
it is asked for or the next one is made; so is one quick look.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import Any, cast

import numpy as np

from tridentify.errors import SampleTypeError
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.signals.wild_beginning import without_wild_beginning
from tridentify.judgement.causes.timing.timed import as_timed, is_timed
from tridentify.judgement.validation.residuals import View
from tridentify.judgement.validation.result import Validation
from tridentify.numerics.kept import Beside
from tridentify.record.record import Record

SAID = ("findings", "trace", "call")
"""What `identify` adds to an estimate after it was judged: no test looks at it."""

_ALL_BUT_SAID: attrgetter[tuple[Any, ...]] = attrgetter(
    *(one.name for one in fields(Estimate) if one.name not in (*SAID, "model"))
)


@dataclass(frozen=True, eq=False)
class _Judgement:
    """What was judged, and what came of it."""

    judged: tuple[Any, ...]
    records: tuple[str, ...]
    validation: Validation

    @classmethod
    def of(
        cls, estimate: Estimate, records: Sequence[Record], validation: Validation
    ) -> _Judgement:
        return cls(_judged(estimate), _signature(records), validation)

    def fits(self, estimate: Estimate, records: Sequence[Record]) -> bool:
        """Whether these are the ones."""
        pairs = zip(self.judged, _judged(estimate), strict=True)
        return all(_same(one, other) for one, other in pairs) and (
            self.records == _signature(records)
        )


_JUDGEMENTS = Beside[_Judgement]("judgement")
"""Of a model; its estimates may differ in what was said since, and in nothing else."""


def remember(estimate: Estimate, records: Sequence[Record], validation: Validation) -> None:
    """Keep a judgement in place of the one before.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        All of them, whole.
    validation : Validation
        By the default options of `validate`.
    """
    _JUDGEMENTS.keep(_Judgement.of(estimate, records, validation), estimate.model, ())


def remembered(estimate: Estimate, records: Sequence[Record]) -> Validation | None:
    """The judgement of these, if it is the one that is kept.

    Parameters
    ----------
    estimate : Estimate
        What is said of it, its trace and its call may have been added since.
    records : sequence of Record
    """
    last = _JUDGEMENTS.find(estimate.model, ())
    return last.validation if last is not None and last.fits(estimate, records) else None


def given_away(estimate: Estimate, records: Sequence[Record]) -> Validation | None:
    """The same, once: nothing is kept of it.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
    """
    found = remembered(estimate, records)
    if found is not None:
        _JUDGEMENTS.drop()
    return found


_LOOKS = Beside[tuple[View | None]]("look")


def kept_look(
    estimate: Estimate, records: Sequence[Record], made: Callable[[], View | None]
) -> View | None:
    """The quick look at an estimate and its records, a new one where it was not the last.

    Two questions that follow one another are asked of it: whether an input reacts, and whether the
    residual calls for tests.

    Parameters
    ----------
    estimate : Estimate
        What is said of it, its trace and its call may have been added since.
    records : sequence of Record
    made : callable
        Takes a look.
    """
    parts = (*_judged(estimate), *records)
    known = _LOOKS.find(estimate.model, parts)
    return (known or _LOOKS.keep((made(),), estimate.model, parts))[0]


def as_identified(
    estimate: Estimate, given: Record | Sequence[Record]
) -> tuple[Estimate, list[Record], tuple[Finding, ...]]:
    """A list of the records as identified, the estimate of them, and what is left out.

    Samples that were identified by their interval alone come with a clock from elsewhere; wild
    first samples are none. Where an estimate was found beside the times at which inputs moved, so
    is what a record tells of these. Of an estimate by the reference route, experiments without a
    reference are left out beside others.

    Parameters
    ----------
    estimate : Estimate
    given : Record or sequence of Record

    Raises
    ------
    SampleTypeError
        Something else is among them.
    """
    asked = _on_its_clock(estimate, _listed(given))
    records, wild = without_wild_beginning(asked)
    timed = is_timed(estimate)
    changed = [as_timed(estimate, one) for one in records] if timed else records
    if (wild or timed) and fingerprint(asked) == estimate.record_fingerprint:
        estimate = replace(estimate, record_fingerprint=fingerprint(changed))
    return estimate, changed, tuple(wild)


def _on_its_clock(estimate: Estimate, given: Sequence[Record]) -> list[Record]:
    """The records on the times of the estimate where they are those identified."""
    records = [one.settled(estimate.intersample) for one in given]
    if estimate.route == "reference":
        records = [one for one in records if one.reference is not None] or records
    if estimate.dt is None or fingerprint(records) == estimate.record_fingerprint:
        return records
    counted = [
        one._derive(t=estimate.dt * np.arange(one.n_samples), dt=estimate.dt) for one in records
    ]
    own = fingerprint(counted) == estimate.record_fingerprint
    return counted if own else records


def _listed(record: object) -> list[Record]:
    alone = isinstance(record, Record) or not isinstance(record, Iterable)
    found: list[Any] = [record] if alone else list(cast("Iterable[Any]", record))
    if not found or not all(isinstance(one, Record) for one in found):
        what = type(found[0]).__name__ if found else "nothing"
        raise SampleTypeError(
            f"found {what} in place of a record; expected a Record or a list of them; write "
            "Record(u, y, dt=...)"
        )
    return found


def _judged(estimate: Estimate) -> tuple[Any, ...]:
    """All that is judged, beside the model."""
    return _ALL_BUT_SAID(estimate)


def _signature(records: Sequence[Record]) -> tuple[str, ...]:
    return (fingerprint(records), *(record.behaviour for record in records))


def _same(one: Any, other: Any) -> bool:
    """Whether two attributes are one object, or plain values or arrays that are equal."""
    if one is other:
        return True
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    plain = (str, int, float, dict)
    if isinstance(one, tuple) and isinstance(other, tuple) and len(one) == len(other):
        return all(_same(a, b) for a, b in zip(one, other, strict=True))
    return isinstance(one, plain) and type(one) is type(other) and bool(one == other)
