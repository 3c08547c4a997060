"""Whether an estimate can be trusted: tests of its residual, and a verdict in words."""

from __future__ import annotations

from tridentify.finding import Finding
from tridentify.validation.assess import validate
from tridentify.validation.result import Validation

__all__ = ["Finding", "Validation", "validate"]
