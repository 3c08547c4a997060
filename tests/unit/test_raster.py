"""Jittered stamps and lost rows keep the noise model."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.estimation.likelihood.setup.raster import on_raster, places_on_raster

pytestmark = pytest.mark.unjudged

MODEL = TransferFunction([2.0], [1.0, 2.0, 4.0])
DT, N = 0.05, 600
METHOD = ThreeModel(finish="likelihood")
STRUCTURE = Structure(2, 0, offset=False, initial_state="rest")


def recorded(seed, jitter=0.0, intersample="zoh"):
    rng = np.random.default_rng(seed)
    t = DT * (np.arange(N) + jitter * rng.uniform(-1.0, 1.0, N))
    t -= t[0]
    u = np.repeat(rng.choice([-1.0, 1.0], N // 10), 10)
    clean = simulate(MODEL, Record(u, u, t=t, intersample=intersample))[:, 0]
    noise = lfilter([1.0], [1.0, -0.9], rng.standard_normal(N + 200))[200:]
    return t, u, clean + 0.2 * clean.std() * noise / noise.std()


@pytest.fixture(scope="module")
def uniform():
    _t, u, y = recorded(0)
    return identify(Record(u, y, dt=DT), STRUCTURE, METHOD)


@pytest.mark.slow
def test_jitter_keeps_the_noise_model(uniform):
    t, u, y = recorded(0, jitter=0.005)
    record = Record(u, y, t=t)
    assert record.dt is None
    estimate = identify(record, STRUCTURE, METHOD)
    assert estimate.noise_model[0].size == uniform.noise_model[0].size > 0
    assert np.all(np.abs(estimate.theta - uniform.theta) < 0.3 * uniform.std)
    assert estimate.std == pytest.approx(uniform.std, rel=0.1)


@pytest.mark.slow
@pytest.mark.judged
@pytest.mark.judged
@pytest.mark.parametrize("seed", range(4))
def test_what_a_noise_model_stands_for_is_no_objection(seed):
    """Stamps that jitter leave the noise its model, and the residual is judged by it."""
    rng = np.random.default_rng([seed, 63])
    t = 0.05 * (np.arange(600) + 0.005 * rng.uniform(-1.0, 1.0, 600))
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 12)
    y = simulate(TransferFunction([8.0], [1.0, 1.2, 16.0]), Record(u, np.zeros(600), t=t))[:, 0]
    noise = lfilter([1.0], [1.0, -0.9], rng.standard_normal(600))
    found = identify(Record(u, y + 0.15 * y.std() / noise.std() * noise, t=t), Structure(2, 0))
    assert found.noise_model[0].size > 0
    assert not [one.code for one in found.findings if one.matters]


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.fast("zoh")
def test_lost_rows_are_missing_samples(intersample):
    """The same answer as with the rows there and the outputs missing."""
    t, u, y = recorded(1, intersample=intersample)
    if intersample == "foh":
        # what is lost must lie on the line
        u = np.interp(np.arange(N), np.arange(0, N, 10), u[::10])
        y = simulate(MODEL, Record(u, u, dt=DT, intersample="foh"))[:, 0] + (y - y.mean()) * 0.1
    lost = np.array([k for k in range(31, N, 50) if k % 10])
    gap = np.array(y)
    gap[lost] = np.nan
    kept = np.setdiff1d(np.arange(N), lost)
    told = Record(u, gap, dt=DT, intersample=intersample)
    record = Record(u[kept], y[kept], t=t[kept], intersample=intersample)
    whole, estimate = (identify(r, STRUCTURE, METHOD) for r in (told, record))
    assert estimate.noise_model[0].size == whole.noise_model[0].size > 0
    assert estimate.theta == pytest.approx(whole.theta, rel=1e-6)
    assert estimate.std == pytest.approx(whole.std, rel=1e-6)
    assert estimate.n_samples == record.n_samples
    assert estimate.dt is None
    assert any(f"{lost.size} rows missing" in line for line in estimate.trace.decisions)
    assert not [f for f in estimate.findings if f.code == "noise-model"]


def test_uneven_instants_have_no_noise_model():
    rng = np.random.default_rng(2)
    t, u, y = recorded(2)
    kept = np.sort(rng.choice(N, N // 3, replace=False))
    estimate = identify(Record(u[kept], y[kept], t=t[kept]), STRUCTURE, METHOD, throw=False)
    assert not estimate.noise_model[0].size
    assert any("time that is not uniform" in line for line in estimate.trace.decisions)


@pytest.mark.parametrize(
    ("t", "expected"),
    [
        ([0.0, 1.0, 2.0, 3.0], [0, 1, 2, 3]),
        ([0.0, 1.02, 2.0, 3.05], [0, 1, 2, 3]),
        ([0.0, 1.0, 2.0, 5.0, 6.0], [0, 1, 2, 5, 6]),
        ([0.0, 1.0, 1.8, 3.0], None),
        ([0.0, 1.0, 2.0, 30.0, 31.0], None),
    ],
)
def test_places(t, expected):
    found = places_on_raster(np.array(t))
    assert (None if found is None else found.tolist()) == expected


def test_a_uniform_record_is_itself():
    _t, u, y = recorded(3)
    record = Record(u, y, dt=DT)
    assert on_raster(record) is record
