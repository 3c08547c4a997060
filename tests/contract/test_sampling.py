"""What every method owes that takes delays or instants that are not uniform.

The cases run on each row of `METHODS` that raises the flag; the others must refuse.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tridentify import METHODS, Record, Structure, TransferFunction, identify, simulate
from tridentify import errors as err
from tridentify.estimation.methods.capability import Capability

pytestmark = [pytest.mark.unjudged, pytest.mark.parametrize("key", list(METHODS), ids=str)]
DT, DELAY = 0.05, 0.137
MODEL = TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0], delay=DELAY)
PLAIN = TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0])
TRUTH = [1.0, 3.0, 0.2, 0.5]


def instants(n, jitter, seed=1):
    steps = DT * (1.0 + jitter * np.random.default_rng(seed).uniform(-1.0, 1.0, n - 1))
    return np.concatenate([[0.0], np.cumsum(steps)])


def recorded(model, jitter=0.0, noise=0.0, n=400, seed=1, scale=1.0):
    """Binary input of held lengths, output of the model, noise as a part of its size."""
    rng = np.random.default_rng(seed)
    u = np.repeat(np.sign(rng.standard_normal(-(-n // 5))), 5)[:n]
    kind = {"t": scale * instants(n, jitter, seed)} if jitter else {"dt": scale * DT}
    y = simulate(model, Record(u, u, **kind))[:, 0]
    y = y + noise * y.std() * rng.standard_normal(n)
    return Record(u, y, **kind)


CASES = {
    "delay": (MODEL, 0.0, Capability.DELAY),
    "jitter": (PLAIN, 0.6, Capability.NON_UNIFORM_TIME),
    "delay and jitter": (MODEL, 0.6, Capability.DELAY | Capability.NON_UNIFORM_TIME),
}


@pytest.fixture(params=list(CASES))
def case(request, key):
    """Model, jitter and structure; skipped where the method does not claim it."""
    model, jitter, needed = CASES[request.param]
    if needed not in METHODS[key]().capabilities:
        pytest.skip(f"{key} does not claim it")
    return model, jitter, Structure(2, 1, delay=float(model.delay[0, 0]))


@cache
def noisy(model, jitter, key):
    """A record with noise, and its estimate: several tests hold theirs against it."""
    record = recorded(model, jitter, noise=0.1)
    structure = Structure(2, 1, delay=float(model.delay[0, 0]))
    return record, identify(record, structure, METHODS[key]())


def test_what_is_not_claimed_is_refused(key):
    can = METHODS[key]().capabilities
    if Capability.DELAY not in can:
        with pytest.raises(err.UnsupportedError, match="delay"):
            identify(recorded(MODEL), Structure(2, 1, delay=DELAY), METHODS[key]())
    if Capability.NON_UNIFORM_TIME not in can:
        with pytest.raises(err.NonUniformTimeError):
            identify(recorded(PLAIN, 0.5), Structure(2, 1), METHODS[key]())
    if Capability.BAND_LIMITED not in can:
        record = recorded(PLAIN)
        smooth = Record(record.u, record.y, dt=DT, intersample="band-limited")
        with pytest.raises(err.UnsupportedError, match="band-limited"):
            identify(smooth, Structure(2, 1), METHODS[key]())


def test_without_noise_the_truth(key, case):
    model, jitter, structure = case
    estimate = identify(recorded(model, jitter), structure, METHODS[key]())
    assert estimate.theta == pytest.approx(TRUTH, rel=1e-9)
    assert np.array_equal(estimate.model.delay, model.delay)


@pytest.mark.fast("delay and jitter-*", "jitter-three-model")
def test_with_noise_the_truth_within_the_standard_errors(key, case):
    model, jitter, structure = case
    off = []
    for seed in range(4):
        record = recorded(model, jitter, noise=0.1, seed=seed)
        estimate = identify(record, structure, METHODS[key]())
        off.append((estimate.theta - TRUTH) / estimate.std)
    assert np.sqrt(np.mean(np.square(off))) < 1.8
    assert np.abs(off).max() < 4.5


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.fast("delay and jitter-1e-06-*", "jitter-1000000.0-*")
def test_the_unit_of_time_does_not_matter(key, case, scale):
    model, jitter, _ = case
    _, plain = noisy(model, jitter, key)
    n = 2
    num = np.array([0.2, 0.5]) / scale ** np.array([n - 1, n])
    den = np.array([1.0, 1.0, 3.0]) / scale ** np.arange(n + 1)
    late = TransferFunction(num, den, delay=scale * model.delay)
    record = recorded(late, jitter, noise=0.1, scale=scale)
    delay = float(late.delay[0, 0])
    other = identify(record, Structure(2, 1, delay=delay), METHODS[key]())
    powers = scale ** np.array([1.0, 2.0, 1.0, 2.0])
    assert other.theta * powers == pytest.approx(plain.theta, rel=1e-5)


def test_a_moved_origin_of_time_does_not_matter(key, case):
    model, jitter, structure = case
    record, plain = noisy(model, jitter, key)
    moved = Record(record.u, record.y, t=record.t + 4096.0)
    found = identify(moved, structure, METHODS[key]())
    assert found.theta == pytest.approx(plain.theta, rel=1e-6)


def test_missing_samples_are_samples_not_there(key, case):
    """A row without output, and the estimate from the rows that have one."""
    model, jitter, structure = case
    record, plain = noisy(model, jitter, key)
    y = np.array(record.y)
    y[[3, 77, 78, 200]] = np.nan
    kind = {"t": record.t} if jitter else {"dt": record.dt}
    estimate = identify(Record(record.u, y, **kind), structure, METHODS[key]())
    assert np.all(np.abs(estimate.theta - plain.theta) < 1.0 * plain.std)
    assert np.isnan(estimate.residual(Record(record.u, y, **kind))[77:79]).all()


def test_experiments_with_clocks_of_their_own(key, case):
    model, jitter, structure = case
    records = [recorded(model, jitter, seed=1), recorded(model, jitter * 0.5, seed=2, n=250)]
    estimate = identify(records, structure, METHODS[key]())
    assert estimate.theta == pytest.approx(TRUTH, rel=1e-9)


def test_an_estimate_is_a_pure_function(key, case):
    model, jitter, structure = case
    record, before = noisy(model, jitter, key)
    assert np.array_equal(identify(record, structure, METHODS[key]()).theta, before.theta)


def test_a_delay_beyond_the_record_is_refused(key, case):
    model, jitter, _ = case
    if Capability.DELAY not in METHODS[key]().capabilities:
        pytest.skip(f"{key} takes no delay")
    with pytest.raises(err.DelayError):
        identify(recorded(model, jitter), Structure(2, 1, delay=1e3), METHODS[key]())
