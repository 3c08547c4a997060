"""What the reference route says of the controller's kind, where the tests see feedback as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tridentify import Finding, Record, Structure, identify
from tridentify.judgement import cautions


def test_the_kind_of_the_controller_stays_to_be_told(monkeypatch):
    """Feedback drops what other behaviours of the input would explain, and nothing else."""
    rng = np.random.default_rng(0)
    record = Record(np.repeat(rng.standard_normal(20), 5), rng.standard_normal(100), dt=0.1)
    kind = Finding("intersample", "warning", "The record does not tell the kind.", "State it.")
    estimate = identify(record, Structure(1, 0), throw=False)
    estimate = replace(estimate, findings=(kind,), route="reference")
    seen = Finding("feedback", "warning", "The input reacts.", "Give the reference.")
    monkeypatch.setattr(cautions, "looked_at", lambda *_: [seen])
    said = cautions.judged(estimate, [record])
    assert any(one.message == kind.message for one in said)
