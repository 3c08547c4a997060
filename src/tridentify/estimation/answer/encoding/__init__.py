"""Estimates as JSON documents and back. A file may be damaged or come from a stranger."""

from __future__ import annotations

from tridentify.estimation.answer.encoding.consistency import (
    check_covariance,
    check_draws,
    check_model,
    check_noise,
    check_nuisance,
    check_outliers,
    check_route,
    check_sampling,
)
from tridentify.estimation.answer.encoding.document import (
    document_text,
    load_document,
    one_line,
    read_json,
    save_document,
)
from tridentify.estimation.answer.encoding.values import LEFT_OUT, decode, encode, plain_model

__all__ = [
    "LEFT_OUT",
    "check_covariance",
    "check_draws",
    "check_model",
    "check_noise",
    "check_nuisance",
    "check_outliers",
    "check_route",
    "check_sampling",
    "decode",
    "document_text",
    "encode",
    "load_document",
    "one_line",
    "plain_model",
    "read_json",
    "save_document",
]
