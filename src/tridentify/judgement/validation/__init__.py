"""Whether an estimate can be trusted: tests of its residual, and a verdict in words."""

from __future__ import annotations

from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.validation.assess import validate
from tridentify.judgement.validation.result import Validation

__all__ = ["Finding", "Validation", "validate"]
