"""Measured frequency responses: right, with the scatter they state, from records as they are."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tridentify import DataError, Record, TransferFunction, simulate
from tridentify.errors import DataWarning
from tridentify.judgement.advice import frequency_response

LIGHT = TransferFunction([2.0, 3.0], [1.0, 0.3, 9.0])
NOISE = 0.05


def pulses(rng, n, hold=5, channels=1):
    return np.repeat(rng.choice([-1.0, 1.0], (n // hold + 1, channels)), hold, axis=0)[:n]


def recorded(seed, n=800, noise=NOISE, intersample="zoh", model=LIGHT):
    rng = np.random.default_rng(seed)
    u = pulses(rng, n, channels=len(model.num[0]))
    clean = Record(u, np.zeros(n), dt=0.05, intersample=intersample)
    y = simulate(model, clean)
    return Record(u, y + noise * rng.standard_normal(y.shape), dt=0.05, intersample=intersample)


def errors(measured, model):
    """Squares of errors over those that are stated, where points are good."""
    true = model.frequency_response(measured.omega)
    ratio = np.abs(measured.response - true) ** 2 / measured.std**2
    return ratio[measured.good]


@pytest.mark.slow
def test_the_scatter_is_the_one_stated():
    ratios = np.concatenate([errors(frequency_response(recorded(k)), LIGHT) for k in range(15)])
    assert ratios.size > 500
    assert 0.6 < np.median(ratios) / np.log(2.0) < 1.5
    assert np.mean(ratios > 9.0) < 0.03


def test_a_short_manoeuvre_does_not_leak():
    u = np.zeros(400)
    u[20:40], u[40:60] = 1.0, -1.0
    model = TransferFunction([2.0, 3.0], [1.0, 1.5, 9.0])
    # cut while it still moves: a window over the whole record would see the step at its end
    whole = Record(u, simulate(model, Record(u, u, dt=0.02)), dt=0.02).slice(0.5, 4.0)
    measured = frequency_response(whole)
    near = (measured.omega > 1.0) & (measured.omega < 15.0)
    true = model.frequency_response(measured.omega)[near, 0, 0]
    off = np.abs(measured.response[near, 0, 0] / true - 1.0)
    assert off.max() < 0.08  # the lowest line is one period of the record
    assert np.median(off) < 0.01


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.fast("foh")
def test_the_input_between_the_samples_is_allowed_for(intersample):
    rng = np.random.default_rng(3)
    u = rng.standard_normal(2000)
    model = TransferFunction([3.0], [1.0, 4.0, 9.0])
    clean = Record(u, u, dt=0.1, intersample=intersample)
    measured = frequency_response(
        Record(u, simulate(model, clean), dt=0.1, intersample=intersample)
    )
    low = measured.omega < 0.25 * np.pi / 0.1
    true = model.frequency_response(measured.omega)[low, 0, 0]
    assert np.max(np.abs(measured.response[low, 0, 0] / true - 1.0)) < 0.01


@pytest.mark.slow
def test_inputs_that_are_alike_have_responses_of_their_own():
    rng = np.random.default_rng(5)
    n = 3000
    first = pulses(rng, n)[:, 0]
    u = np.column_stack([first, 0.7 * first + 0.5 * pulses(rng, n)[:, 0]])
    model = TransferFunction([[[2.0], [1.0, 0.0]]], [[[1.0, 2.0], [1.0, 1.0, 4.0]]])
    y = simulate(model, Record(u, np.zeros(n), dt=0.05))
    y = y + 0.05 * rng.standard_normal(y.shape)
    measured = frequency_response(Record(u, y, dt=0.05))
    ratios = errors(measured, model)
    assert ratios.size > 60
    assert np.median(ratios) / np.log(2.0) < 2.0
    # an input that does nothing has no partial coherence, however much it is like the other
    only = simulate(LIGHT, Record(u[:, :1], np.zeros(n), dt=0.05))
    single = frequency_response(Record(u, only + 0.3 * rng.standard_normal((n, 1)), dt=0.05))
    assert np.median(single.coherence[:, 0, 1]) < 0.2 < 0.6 < np.max(single.coherence[:, 0, 0])


def test_missing_samples_are_bridged_or_cut_out_and_told():
    record = recorded(8, n=2000)
    y = record.y[:, 0].copy()
    y[100:102] = np.nan
    y[900:1000] = np.nan
    measured = frequency_response(Record(record.u, y, dt=0.05))
    assert measured.notes == (
        "2 missing samples bridged by straight lines",
        "100 samples left out, in gaps or in stretches of fewer than 32 samples",
    )
    assert np.median(errors(measured, LIGHT)) / np.log(2.0) < 2.0


def test_experiments_of_other_lengths_share_the_response():
    parts = [recorded(k, n) for k, n in ((1, 400), (2, 500), (3, 333))]
    together, alone = frequency_response(parts), frequency_response(parts[0])
    assert np.median(errors(together, LIGHT)) / np.log(2.0) < 2.0
    k, one = (int(np.argmin(abs(m.omega - 6.0))) for m in (together, alone))
    assert together.std[k, 0, 0] < alone.std[one, 0, 0]


def test_uneven_time_stamps():
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.045, 0.055, 2000))
    u = pulses(rng, 2000, hold=10)
    y = simulate(LIGHT, Record(u, np.zeros(2000), t=t)) + NOISE * rng.standard_normal((2000, 1))
    measured = frequency_response(Record(u, y, t=t))
    near = (measured.omega > 0.5) & (measured.omega < 6.0)
    true = LIGHT.frequency_response(measured.omega)[near, 0, 0]
    assert np.median(np.abs(measured.response[near, 0, 0] / true - 1.0)) < 0.05


def test_only_frequencies_with_power_are_excited():
    t = 0.05 * np.arange(4000)
    lines = 2.0 * np.pi / 200.0 * np.arange(100, 200, 7)
    u = np.cos(np.outer(t, lines) + np.arange(lines.size) ** 2).sum(axis=1)
    rng = np.random.default_rng(2)
    y = simulate(LIGHT, Record(u, u, dt=0.05)) + 0.1 * rng.standard_normal((4000, 1))
    measured = frequency_response(Record(u, y, dt=0.05))
    low, high = measured.band()
    assert 2.0 < low < 3.3
    assert 5.9 < high < 8.5
    assert measured.seen()[0] > 2.0


def test_noise_alone_has_no_coherence():
    rng = np.random.default_rng(6)
    noise = frequency_response(Record(pulses(rng, 2000), rng.standard_normal(2000), dt=0.05))
    assert np.mean(noise.good) < 0.05
    assert np.mean(noise.coherence) < 0.25


def test_plain_numbers_go_through_json():
    measured = frequency_response(recorded(1, n=200))
    again = json.loads(json.dumps(measured.to_dict(), allow_nan=False))
    assert len(again["omega"]) == measured.omega.size
    assert again["outputs"] == ["y"]


def test_too_little_is_refused_in_one_line():
    with pytest.raises(DataError, match="record longer"):
        frequency_response(Record(np.ones(20), np.arange(20.0), dt=1.0))
    with pytest.raises(DataError, match="found no record"):
        frequency_response([])


def test_uneven_time_is_to_be_resampled():
    rng = np.random.default_rng(7)
    t = np.sort(rng.uniform(0.0, 30.0, 600))
    record = Record(pulses(rng, 600), rng.standard_normal(600), t=t)
    with pytest.raises(DataError, match=r"record\.resample"):
        frequency_response(record)
    with pytest.warns(DataWarning, match="interpolation"):
        even = record.resample(0.05)
    assert frequency_response(even).omega.size
