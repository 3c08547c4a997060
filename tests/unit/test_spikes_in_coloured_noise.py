"""Single wild samples that slow noise hides by its size."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    OutputError,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.judgement.cautions import judged
from tridentify.judgement.cautions.outliers import spikes
from tridentify.judgement.validation.statistics.distribution import distribution

MODEL = TransferFunction([2.0], [1.0, 2.0, 4.0])
DT, N = 0.05, 800
SLOW = np.array([-1.9, 0.905])


def slow_noise(seed):
    return lfilter([1.0], [1.0, *SLOW], np.random.default_rng(seed).standard_normal(N + 300))[300:]


def places(series, a=SLOW):
    return [k for _, k in spikes([series], a)[0]]


@pytest.mark.parametrize("seed", range(20))
def test_gaussian_noise_has_none(seed):
    assert places(slow_noise(seed)) == []


@pytest.mark.parametrize("size", [8.0, -16.0])
def test_single_samples_are_found(size):
    v = slow_noise(0)
    v[[100, 400, 650]] += size
    found, farthest = spikes([v], SLOW)
    assert found == [(0, 100), (0, 400), (0, 650)]
    assert farthest > 10.0
    assert np.max(np.abs(v - np.median(v))) < 5.0 * np.std(v)


def test_two_beside_each_other_are_a_burst():
    v = slow_noise(1)
    v[300:312] += 12.0 * np.array([1.0, -1.0] * 6)
    assert places(v) == []


def test_missing_samples_are_not_looked_at():
    v = slow_noise(2)
    v[[200, 500]] = np.nan
    v[350] += 12.0
    assert places(v) == [350]


@pytest.mark.slow
def test_the_estimate_says_when():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 10), 10)
    clean = simulate(MODEL, Record(u, u, dt=DT))[:, 0]
    v = 0.3 * clean.std() * slow_noise(3) / slow_noise(3).std()
    innovations = 0.3 * clean.std() / slow_noise(3).std()
    v[[150, 420]] += 9.0 * innovations
    record = Record(u, clean + v, dt=DT)
    estimate = identify(record, Structure(2, 0), ThreeModel(noise="ar", finish="likelihood"))
    found = [f for f in estimate.findings if f.code == "bad-samples"]
    assert len(found) == 1
    assert found[0].times == pytest.approx((150 * DT, 420 * DT))


@pytest.mark.slow
def test_whiteness_of_a_robust_fit_leaves_outliers_out():
    """Pairs of outliers two samples apart: a correlation that the noise does not have."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 10), 10)
    clean = simulate(MODEL, Record(u, u, dt=DT))[:, 0]
    y = clean + 0.05 * clean.std() * rng.standard_normal(N)
    for k in range(20, N - 20, 40):
        y[[k, k + 2, k + 4, k + 6, k + 8]] += 2.0 * clean.std()
    record = Record(u, y, dt=DT)
    estimate = identify(record, Structure(2, 0), OutputError(MODEL, loss="student"))
    assert len(estimate.outliers) >= 90
    assert not [f for f in estimate.findings if f.matters]
    blind = judged(type(estimate)(**{**vars(estimate), "outliers": np.zeros((0, 4))}), [record])
    assert [f for f in blind if f.matters and f.code != "bad-samples"]


def test_what_whitening_makes_of_a_spike_is_no_second_one():
    """Innovations repeat an additive spike with the coefficients of the noise."""
    e = np.random.default_rng(4).standard_normal(600)
    v = lfilter([1.0], [1.0, *SLOW], e)
    v[[200, 450]] += 14.0
    innovations = lfilter([1.0, *SLOW], [1.0], v)
    times = [DT * np.arange(600.0)]
    found = distribution("y", [innovations], times, 0.001, SLOW).outliers[:, 1]
    assert np.rint(found / DT).tolist() == [200, 450]
    plain = distribution("y", [innovations], times, 0.001).outliers[:, 1]
    assert np.rint(plain / DT).tolist() == [200, 201, 202, 450, 451, 452]


def test_an_innovation_that_is_far_off_counts_once_and_its_neighbours_for_themselves():
    e = np.random.default_rng(5).standard_normal(600)
    e[[300, 301]] = 14.0
    found = distribution("y", [e], [np.arange(600.0)], 0.001, SLOW).outliers[:, 1]
    assert found.tolist() == [300.0, 301.0]


def far_off(shape, size=8.0):
    e = np.random.default_rng(5).standard_normal(600)
    e[300 : 300 + len(shape)] += size * np.array(shape)
    return distribution("y", [e], [np.arange(600.0)], 0.001, SLOW)


@pytest.mark.parametrize("shape", [[1.0], [1.0, 0.8]])
def test_what_goes_on_as_the_noise_does_sets_in_and_is_no_wrong_sample(shape):
    assert far_off(shape).shocks[:, 1].tolist() == [300.0 + k for k in range(len(shape))]


@pytest.mark.parametrize("shape", [[1.0, *SLOW], [1.0, -1.0]])
def test_a_wrong_sample_or_what_comes_back_at_once_does_not_set_in(shape):
    found = far_off(shape)
    assert len(found.outliers)
    assert not len(found.shocks)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [300, 304, 308])
def test_wrong_samples_near_one_another_set_nothing_in(seed):
    """Seen: beside the right bad samples, "a disturbance sets in: no sample is wrong"."""
    rng = np.random.default_rng([seed, 61])
    u = np.repeat(rng.choice([-1.0, 1.0], 51), 12)[:600]
    y = simulate(TransferFunction([8.0], [1.0, 1.2, 16.0]), Record(u, u, dt=DT))[:, 0]
    size = 0.15 * np.sqrt(1.0 - 0.81) * np.std(y)
    y = y + size * lfilter([1.0], [1.0, -0.9], np.r_[0.0, rng.standard_normal(800)[1:]])[200:]
    rows = rng.choice(600, 8, replace=False)
    y[rows] += 18.0 * size * rng.choice([-1.0, 1.0], 8)
    found = identify(Record(u, y, dt=DT), Structure(2, 0)).findings
    codes = [one.code for one in found if one.matters]
    assert codes[0] == "bad-samples"
    assert "drift" not in codes
