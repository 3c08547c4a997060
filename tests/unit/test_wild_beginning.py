"""First samples of an output that are no measurements yet."""

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, advise, identify, simulate, validate
from tridentify.judgement.causes.signals.wild_beginning import APART, _far, without_wild_beginning

TRUTH = np.array([3.0, 9.0, 9.0])


def woken(seed: int, n_samples: int = 500) -> tuple[Record, tuple[float, ...]]:
    """A record whose first samples are off by 10 to 10,000, and their times."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n_samples // 10), 10)
    y = simulate(TransferFunction([9.0], [1.0, 3.0, 9.0]), Record(u, u, dt=0.05))[:, 0]
    y = y + 0.05 * rng.standard_normal(n_samples)
    n = int(rng.integers(1, 6))
    y[:n] += 10.0 ** rng.uniform(1, 4) * rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.0, n)
    record = Record(u, y, dt=0.05)
    return record, tuple(record.t[:n].tolist())


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.slow
def test_they_are_left_out_and_named_first(seed):
    record, times = woken(seed)
    estimate = identify(record, Structure(2, 0))
    assert (estimate.findings[0].code, estimate.findings[0].times) == ("bad-samples", times)
    assert np.all(np.abs(estimate.theta - TRUTH) < 4 * estimate.std)
    for found in (validate(estimate, record), advise(record)):
        assert [(one.code, one.times) for one in found.findings if one.matters] == [
            ("bad-samples", times)
        ]


def test_of_another_record_they_are_no_objection_to_the_model():
    estimate = identify(woken(7)[0], Structure(2, 0))
    record, times = woken(8)
    assert [one.times for one in validate(estimate, record).findings] == [times]


def test_a_response_that_decays_is_none():
    t = 0.1 * np.arange(200)
    for rate in (0.5, 2.0, 9.0):
        y = 50.0 * np.exp(-rate * t) + 0.01 * np.random.default_rng(0).standard_normal(200)
        assert not without_wild_beginning([Record(np.sin(t), y, dt=0.1)])[1]


def test_an_output_that_follows_a_hammer_at_once_is_none():
    u = np.zeros(200)
    u[0] = 100.0
    y = simulate(TransferFunction([2.0, 0.0, 0.0], [1.0, 3.0, 9.0]), Record(u, u, dt=0.05))[:, 0]
    assert abs(y[0]) > 3.0 * np.abs(y[1:]).max()
    assert not without_wild_beginning([Record(u, y, dt=0.05)])[1]


@pytest.mark.slow
def test_what_is_not_looked_at_is_not_far():
    def plainly(y: np.ndarray) -> int:
        for n in range(min(10, int(0.05 * y.size)), 0, -1):
            later = y[n:][np.isfinite(y[n:])]
            low, high = (later.min(), later.max()) if later.size else (0.0, 0.0)
            far = np.fmax(low - y[:n], y[:n] - high)
            if later.size and np.isfinite(far[-1]) and np.nanmin(far) > APART * (high - low):
                return n
        return 0

    rng, found = np.random.default_rng(0), []
    for _ in range(2000):
        y = rng.standard_normal(int(rng.integers(2, 300)))
        y[: int(rng.integers(0, 12))] += rng.choice([0.0, 5.0, 15.0, 40.0, -40.0])
        y[rng.random(y.size) < rng.choice([0.0, 0.2, 0.7])] = np.nan
        found.append(plainly(y))
        assert _far(y) == found[-1]
    assert 200 < np.count_nonzero(found) < 1900
