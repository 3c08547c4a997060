"""Noise that changes its size: no samples are wrong, and nothing sets in."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.cautions.outliers import _far_samples
from tridentify.numerics.local_size import changes_size, over_local_size

PLANT = TransferFunction([8.0], [1.0, 1.2, 16.0])
WRONG = {"bad-samples", "drift", "lost-rows", "channel-changes"}
N, DT = 600, 0.05


def record(seed: int, sizes: np.ndarray, spikes: int = 0) -> Record:
    rng = np.random.default_rng([seed, 41])
    u = np.repeat(rng.choice([-1.0, 1.0], N // 12), 12)
    y = simulate(PLANT, Record(u, np.zeros(N), dt=DT))[:, 0]
    noise = 0.06 * y.std() * sizes * rng.standard_normal(N)
    quiet = np.flatnonzero(sizes == sizes.min())
    noise[rng.choice(quiet, spikes, replace=False)] += 2.0 * y.std()
    return Record(u, y + noise, dt=DT)


def burst(seed: int) -> np.ndarray:
    """Eight times as large over an eighth of the record."""
    first = int(np.random.default_rng([seed, 42]).integers(N // 8, 3 * N // 4))
    return np.where((np.arange(N) >= first) & (np.arange(N) < first + N // 8), 8.0, 1.0)


@pytest.mark.fast("5", "6")
@pytest.mark.parametrize("seed", range(5, 15))
def test_a_burst_of_noise_is_told_as_that(seed: int) -> None:
    found = identify(record(seed, burst(seed)), Structure(2, 0)).findings
    told = [one.code for one in found if one.matters]
    assert not WRONG.intersection(told)
    assert "noise-changes" in told


@pytest.mark.fast("5")
@pytest.mark.parametrize("seed", range(5, 11))
def test_spikes_beside_a_burst_are_found(seed: int) -> None:
    """What is not one of the spikes is not called one."""
    spiked, clean = record(seed, burst(seed), spikes=3), record(seed, burst(seed))
    (first, *_) = identify(spiked, Structure(2, 0)).findings
    assert first.code == "bad-samples"
    at = np.round(np.array(first.times) / DT).astype(int)
    assert np.all(np.abs(spiked.y - clean.y)[at] > 0.0)


def test_the_distance_said_is_over_the_size_of_the_noise_there() -> None:
    """Quiet for most of the time: a wild sample there is less than one usual deviation of all."""
    rng = np.random.default_rng(21)
    noise = rng.standard_normal(N) * np.where(np.arange(N) % 300 < 200, 1.0, 60.0)
    noise[100] = 20.0
    places, farthest = _far_samples([noise], np.zeros(0))
    assert (0, 100) in places
    assert 8.0 < farthest < 40.0


def test_what_is_far_off_together_is_no_bad_sample() -> None:
    rng = np.random.default_rng(22)
    noise = rng.standard_normal(N) * burst(6)
    quiet = int(np.flatnonzero(burst(6) == 1.0)[40])
    noise[quiet : quiet + 6] += 25.0
    assert _far_samples([noise], np.zeros(0)) == ([], 0.0)


def test_little_change_is_a_note() -> None:
    sizes = np.where(np.arange(N) < N // 2, 1.0, 1.3)
    found = [one for seed in range(3) for one in identify(record(seed, sizes), (2, 0)).findings]
    assert not [one for one in found if one.code == "noise-changes" and one.matters]


def test_over_its_local_size_noise_is_no_farther_than_a_normal_deviate() -> None:
    rng = np.random.default_rng(8)
    even = np.concatenate([over_local_size(rng.standard_normal(600)) for _ in range(200)])
    assert np.mean(np.abs(even) > 3.0) < 0.0027
    assert np.mean(np.abs(even) > 2.0) > 0.25 * 0.0455


def test_missing_samples_and_short_records_pass() -> None:
    noise = np.random.default_rng(9).standard_normal(100)
    noise[[3, 50]] = np.nan
    assert np.array_equal(np.isnan(over_local_size(noise)), np.isnan(noise))
    assert np.array_equal(over_local_size(noise[4:14]), noise[4:14])
    assert not changes_size(noise)
    assert not changes_size(noise[4:14])


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_an_experiment_too_short_for_a_size_of_its_own_has_no_unit(unit: float) -> None:
    rng = np.random.default_rng(10)
    long = rng.standard_normal(600) * burst(5)
    long[100 if burst(5)[100] == 1.0 else 590] = 40.0
    found, _ = _far_samples([unit * long, unit * rng.standard_normal(12)], np.zeros(0))
    assert len(found) == 1
    assert found[0][0] == 0
