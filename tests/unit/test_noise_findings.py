"""What is said of noise does not contradict what the estimate says of it."""

from types import SimpleNamespace
from typing import Any

import pytest

from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.trace import Trace
from tridentify.estimation.methods.around_maximum.noise import FOLLOWED, PASSED
from tridentify.judgement.validation import noise_findings


def told(monkeypatch: pytest.MonkeyPatch, decision: str, *, own: bool = True) -> Any:
    monkeypatch.setattr(noise_findings, "_reach", lambda *_: "lag 1 s")
    estimate = SimpleNamespace(trace=Trace((), decisions=(decision,)), errors="curvature")
    said = estimate.trace.about(DecisionKind.NOISE_TAKEN_AS_WHITE)
    declined = said[0].rest if said else ""
    view = SimpleNamespace(own=own, uneven=False, outputs=[])
    beside: Any = SimpleNamespace(estimate=estimate, view=view, robust=False, declined=declined)
    return noise_findings.not_white(SimpleNamespace(), "y", beside)  # type: ignore[arg-type]


def test_noise_that_was_taken_as_white_is_not_white_by_other_tests(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert "by more tests than the one that it passed" in told(monkeypatch, PASSED).message
    # of another record the estimate has said nothing
    assert "passed" not in told(monkeypatch, PASSED, own=False).message


def test_why_a_noise_model_was_not_taken_is_a_sentence_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    remedy = told(monkeypatch, FOLLOWED).remedy
    assert "(the residual is not white, but most of it follows the input)" in remedy
