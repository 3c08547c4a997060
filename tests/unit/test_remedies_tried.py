"""A remedy is tried before it is advised, and the finding says what it brings."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.judgement.causes.attempts.first_samples import Predictions
from tridentify.judgement.cautions.sensors import stuck_samples

DT, N = 0.05, 600
PLANT = TransferFunction([9.0], [1.0, 1.5, 9.0])
THETA = [1.5, 9.0, 9.0]


def held(seed):
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], N // 8), 8)


def clean(seed):
    u = held(seed)
    return u, simulate(PLANT, Record(u, u, dt=DT))[:, 0]


def fits(text):
    """Fit from, fit to [percent]."""
    found = re.search(r"fit of y from (-?[\d.]+) to (-?[\d.]+) %", text)
    assert found, text
    return float(found[1]), float(found[2])


@pytest.mark.slow
@pytest.mark.parametrize(("first", "length"), [(200, 120), (40, 300)])
def test_a_sensor_that_hung_is_tried_without_its_samples(first, length):
    u, y = clean(1)
    y = y + 0.03 * np.random.default_rng(2).standard_normal(N)
    y[first : first + length] = y[first - 1]
    record = Record(u, y, dt=DT)
    estimate = identify(record, Structure(2, 0), throw=False)
    (found,) = [one for one in estimate.findings if one.code == "stuck-sensor"]
    before, after = fits(found.effect)
    stuck = stuck_samples(estimate, record, 0, Predictions(estimate))
    assert set(range(first, first + length)) <= set(np.flatnonzero(stuck[:, 0]))
    assert stuck.sum() <= length + 1
    again = identify(record.with_outputs(np.where(stuck, np.nan, record.y)), Structure(2, 0))
    assert np.all(np.abs(again.theta - THETA) < 5.0 * again.std)
    assert after == pytest.approx(again.fit[0], abs=0.2)
    assert after > before + 5.0
    name, to = re.search(r", (\w+) from [-\d.e+]+ to ([-\d.e+]+) \(", found.effect).groups()
    assert float(to) == pytest.approx(again.parameters[name].value, rel=0.02)


@pytest.mark.slow
def test_a_hang_that_leads_the_estimate_astray_is_tried_from_elsewhere():
    """Levenberg-Marquardt from where such an estimate ended does not find the way back."""
    rng = np.random.default_rng(5)
    u = np.resize(np.repeat([0.0, 1, 1, -1, -1, 1, -1, 0, 0, 0, 0, 0], 6), N)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0] + 0.03 * rng.standard_normal(N)
    y[100:400] = 0.9
    estimate = identify(Record(u, y, dt=DT), Structure(2, 0), throw=False)
    (found,) = [one for one in estimate.findings if one.code == "stuck-sensor"]
    assert fits(found.effect)[1] > 85.0


def wandering(seed, size):
    white = np.random.default_rng(seed).standard_normal(N + 300)
    return size * lfilter([1.0], [1.0, -0.95], white)[300:]


def slow(findings):
    return [one for one in findings if one.code == "drift"]


@pytest.mark.slow
def test_a_drift_is_advised_where_it_explains_the_record():
    u, y = clean(3)
    y = y + 4.0 * np.linspace(0.0, 1.0, N) + wandering(4, 0.02)
    structure = Structure(2, 0, offset=False, drift=False)
    estimate = identify(Record(u, y, dt=DT), structure, ThreeModel(noise="ar"), throw=False)
    (found,) = slow(estimate.findings)
    assert "drift=True" in found.remedy
    before, after = fits(found.effect)
    assert after > before + 10.0


def test_a_drift_is_not_advised_where_it_was_tried_in_vain():
    u, y = clean(3)
    y = y + np.sin(4.0 * np.pi * np.linspace(0.0, 1.0, N)) + wandering(4, 0.02)
    estimate = identify(Record(u, y, dt=DT), Structure(2, 0), ThreeModel(noise="ar"), throw=False)
    told = slow(estimate.findings)
    assert told
    assert not any("drift=True" in one.remedy or "ut the record" in one.remedy for one in told)
    assert all("does not stand for it" in one.effect for one in told)
