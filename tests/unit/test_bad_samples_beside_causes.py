"""Bad samples beside another cause: one look at that cause does for comparing all of them twice."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.validation import tried, validate


def spiky(seed):
    """A drift that is left out, and four samples that are wrong."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 10)
    y = simulate(TransferFunction([9.0], [1.0, 1.2, 9.0]), Record(u, u, dt=0.05))[:, 0]
    y += 0.3 * np.sin(0.01 * np.arange(u.size)) + 0.03 * rng.standard_normal(u.size)
    y[rng.choice(u.size, 4, replace=False)] += rng.choice([-1.0, 1.0], 4) * 1.2
    return Record(u, y, dt=0.05)


@pytest.mark.parametrize("seed", [2, 3])
def test_one_look_at_the_cause_decides_as_the_whole_comparison_does(seed, monkeypatch):
    record = spiky(seed)
    estimate = identify(record, Structure(2, 0))
    asked, whole = [], tried.explanations

    def counted(*arguments, **options):
        asked.append(options.get("only", ""))
        return whole(*arguments, **options)

    monkeypatch.setattr(tried, "explanations", counted)
    validate(estimate, record)
    asked.clear()
    short = validate(estimate, record)
    assert len(asked) == 2
    assert asked[0] == ""
    assert asked[1] != ""
    monkeypatch.setattr(tried, "_stand_out", lambda *_: False)
    asked.clear()
    full = validate(estimate, record)
    assert asked == ["", ""]
    assert [f.text for f in short.findings] == [f.text for f in full.findings]
    assert [t.p_value for t in short.tests] == [t.p_value for t in full.tests]
