"""A selection says what stands in the way of the order that it recommends."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, select_structure, simulate
from tridentify.cli.select_command import _blocks

CANDIDATES = (Structure(1, 0), Structure(2, 0))


def spiked():
    """A lag with three samples that no noise explains."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    y = simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=0.05))[:, 0]
    y = y + 0.03 * rng.standard_normal(u.size)
    y[[90, 200, 310]] += 1.5
    return Record(u, y, dt=0.05)


def in_a_loop():
    """A lag held at rest by a fast controller against a disturbance with memory; no set point."""
    rng = np.random.default_rng(6)
    n, step = 500, 0.05
    decay = np.exp(-2.0 * step)
    u, y, state, noise = np.zeros(n), np.zeros(n), 0.0, 0.0
    for k in range(n):
        noise = 0.9 * noise + 0.2 * rng.standard_normal()
        y[k] = state + noise
        u[k] = -2.0 * y[k] + 0.2 * rng.standard_normal()
        state = decay * state + (1.0 - decay) * u[k]
    return Record(u, y, dt=step)


@pytest.mark.parametrize(
    ("record", "code"),
    [(spiked(), "bad-samples"), pytest.param(in_a_loop(), "feedback", marks=pytest.mark.slow)],
)
def test_what_identify_would_say_of_it_is_said(record, code):
    found = select_structure(record, CANDIDATES)
    assert found.recommended is not None
    assert code in [finding.code for finding in found.findings if finding.matters]
    foremost = found.cautions[0]
    assert foremost == next(finding.text for finding in found.findings if finding.matters)
    flat = " ".join(found.summary().split())
    assert f"caution: {foremost}" in flat
    assert foremost in " ".join("".join(map(str, _blocks(found, [record]))).split())
    assert json.loads(json.dumps(found.to_dict()))["findings"][0]["code"] == found.findings[0].code


def test_of_a_right_model_nothing_is_said():
    rng = np.random.default_rng(7)
    u = np.repeat(rng.choice([-1.0, 1.0], 30), 10)
    y = simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=0.05))[:, 0]
    found = select_structure(Record(u, y + 0.05 * rng.standard_normal(300), dt=0.05), CANDIDATES)
    assert found.cautions == ()
    assert "caution" not in found.summary()
