"""Bad samples beside another cause: one look at that cause does for comparing all of them twice."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.judgement.validation import tried, validate


def spiky(seed):
    """A drift that is left out, and four samples that are wrong."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 10)
    y = simulate(TransferFunction([9.0], [1.0, 1.2, 9.0]), Record(u, u, dt=0.05))[:, 0]
    y += 0.3 * np.sin(0.01 * np.arange(u.size)) + 0.03 * rng.standard_normal(u.size)
    y[rng.choice(u.size, 4, replace=False)] += rng.choice([-1.0, 1.0], 4) * 1.2
    return Record(u, y, dt=0.05)


@pytest.mark.parametrize("seed", [pytest.param(2, marks=pytest.mark.slow), 3])
@pytest.mark.slow
def test_one_look_at_the_cause_decides_as_the_whole_comparison_does(seed, monkeypatch):
    record = spiky(seed)
    estimate = identify(record, Structure(2, 0), ThreeModel(noise="ar"))
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


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.fast("1")
def test_wild_samples_at_the_start_of_another_record_are_not_taken_for_two_poles_more(seed):
    """A larger model with a free start fits whatever stands there."""
    rng = np.random.default_rng(seed)
    plant = TransferFunction([-7.0, -6.5], [1.0, 2.5, 6.4])
    records = []
    for _ in range(2):
        u = np.interp(np.arange(600), np.arange(0, 601, 25), rng.standard_normal(25)) * 2.0
        y = simulate(plant, Record(u, u, dt=0.04, intersample="foh"))[:, 0]
        y += lfilter([1.0], [1.0, -0.7], 0.03 * rng.standard_normal(600))
        records.append(Record(u, y, dt=0.04, intersample="foh"))
    wild = records[1].y[:, 0].copy()
    wild[:3] += np.array([-1.1, 0.8, -0.4])
    other = records[1].with_outputs(wild)
    checked = validate(identify(records[0], Structure(2, 1)), other)
    assert checked.findings[0].code == "bad-samples"
    assert set(checked.findings[0].times) >= {0.0, 0.04}
    assert "order-low" not in [f.code for f in checked.findings]


@pytest.mark.slow
def test_a_sample_at_the_start_that_only_too_few_poles_leave_far_is_not_bad():
    """A larger model that was fitted without it foretells it."""
    rng = np.random.default_rng(21)
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 8)
    y = simulate(TransferFunction([9.0], [1.0, 2.0, 9.0]), Record(u, u, dt=0.05))[:, 0]
    y += 0.02 * rng.standard_normal(400)
    estimate = identify(Record(u, y, dt=0.05), Structure(1, 0), throw=False)
    assert estimate.findings[0].code == "order-low", [f.text for f in estimate.findings]
    assert "bad-samples" not in [f.code for f in estimate.findings]


@pytest.mark.parametrize("seed", [3, 4])
@pytest.mark.slow
def test_identify_itself_names_wild_samples_at_the_start(seed):
    """They stand together, so that none stands alone, and the noise model takes what it can."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 8)
    plant = TransferFunction([-4.5, -90.0], [1.0, 13.0, 57.0])
    y = simulate(plant, Record(u, u, dt=0.0224))[:, 0] + 0.08 * rng.standard_normal(400)
    y[:3] += np.array([-1.6, 1.28, -0.64])
    first = identify(Record(u, y, dt=0.0224), Structure(2, 1), throw=False).findings[0]
    assert first.code == "bad-samples"
    assert set(first.times) <= {0.0, 0.0224, 0.0448}
