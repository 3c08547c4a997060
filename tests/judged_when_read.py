"""Findings of `identify` that are made when a test reads them.

Half of the time of an identification that is not all right goes into what is to be said of it, and
most tests look at other things. So `make test` judges an estimate as soon as its findings are asked
for; `make test-all` does it at once, as users have it, and so do tests marked `judged_at_once`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import pytest

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.methods.base import Method
from tridentify.judgement import choice
from tridentify.judgement.causes.intersample import Behaviours, behaviours
from tridentify.judgement.selection import select
from tridentify.record.record import Record
from tridentify.writing.layout import as_call

IDENTIFY = importlib.import_module("tridentify.identify")
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class _Later(Generic[T]):
    """What is made when it is needed."""

    made: Callable[[], T]

    def __reduce__(self) -> tuple[Any, ...]:
        return tuple, (self.made(),)


class _WhenRead:
    """The attribute `findings` of an estimate."""

    def __get__(self, estimate: Any, _: object) -> tuple[Finding, ...]:
        if estimate is None:
            raise AttributeError("findings")
        own = vars(estimate)
        if isinstance(own["findings"], _Later):
            own["findings"] = own["findings"].made()
        return own["findings"]

    def __set__(self, estimate: Any, found: object) -> None:
        vars(estimate)["findings"] = found


def _compared_later(
    compare: Callable[..., Behaviours | None],
) -> Callable[..., _Later[Behaviours | None]]:
    return lambda *of: _Later(lambda: compare(*of))


def _judged_later(
    estimate: Estimate,
    records: Sequence[Record],
    method: Method,
    between: _Later[Behaviours | None] | Behaviours | None,
    told: Sequence[str] = (),
) -> Estimate:
    def made() -> tuple[Finding, ...]:
        compared = between.made() if isinstance(between, _Later) else between
        return choice.with_judgement(estimate, records, method, compared, told).findings

    said = (*told, *choice.still_references(estimate, records))
    trace = replace(estimate.trace, decisions=(*estimate.trace.decisions, *said))
    found: Any = _Later(made)
    return replace(estimate, findings=found, trace=trace, call=as_call(method))


def judge_when_read(patch: pytest.MonkeyPatch) -> None:
    """As long as the patch holds, estimates are judged when their findings are read."""
    patch.setattr(Estimate, "findings", _WhenRead(), raising=False)
    patch.setattr(IDENTIFY, "with_judgement", _judged_later)
    patch.setattr(IDENTIFY, "beside_stated", _compared_later(choice.beside_stated))
    patch.setattr(select, "with_judgement", _judged_later)
    patch.setattr(select, "behaviours", _compared_later(behaviours))


def judge_at_once(patch: pytest.MonkeyPatch) -> None:
    """The same as users have it."""
    patch.setattr(IDENTIFY, "with_judgement", choice.with_judgement)
    patch.setattr(IDENTIFY, "beside_stated", choice.beside_stated)
    patch.setattr(select, "with_judgement", choice.with_judgement)
    patch.setattr(select, "behaviours", behaviours)
