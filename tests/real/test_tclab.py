"""Two heaters and two sensors on a board: temperatures at about 1 s, ten minutes.

The time stamps jitter by 5 ms and drift by up to 0.2 s from a uniform clock. The time constants are
twenty seconds and more, so the temperatures can be read off on a uniform clock as well, which
changes the coefficients by less than two percent. What a linear model can do: two poles explain 96
to 99 percent and predict the second half of the step record with 93. What it cannot: the record is
shorter than two slow time constants, so slow pole and gain hang together, and the cross-coupling is
not in the record: its estimated gain is negative, which no heater can be.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, identify, read_record

pytestmark = pytest.mark.unjudged

PLAIN = ThreeModel(noise="white", finish="likelihood")


def structure(poles, zeros):
    return Structure(poles, zeros, offset=True, initial_state="free")


def read(folder, name, inputs, outputs):
    return read_record(folder("tclab") / name, time="t", inputs=inputs, outputs=outputs)


def uniform(record):
    """The record on the uniform clock that is nearest to its own."""
    t = record.t
    dt = (t[-1] - t[0]) / (t.size - 1)
    clock = t[0] + dt * np.arange(t.size)
    y = np.column_stack([np.interp(clock, t, column) for column in record.y.T])
    names = {"input_names": record.input_names, "output_names": record.output_names}
    return Record(record.u, y, dt=dt, **names)


def test_time_is_not_uniform(folder):
    record = read(folder, "data_step.csv", ["u"], ["y"])
    assert record.dt is None
    assert np.diff(record.t).mean() == pytest.approx(1.0038, abs=1e-4)
    assert np.diff(record.t).std() == pytest.approx(0.0062, abs=2e-4)


@pytest.mark.parametrize(
    ("poles", "zeros", "own", "other"), [(1, 0, 92.0, 90.2), (2, 0, 98.4, 93.5), (2, 1, 99.1, 94.1)]
)
def test_first_half_of_the_step_predicts_the_second(folder, judged, poles, zeros, own, other):
    record = uniform(read(folder, "data_step.csv", ["u"], ["y"]))
    first, second = record.split(record.t[record.n_samples // 2])
    estimate = identify(first, structure(poles, zeros), PLAIN)
    assert estimate.fit[0] == pytest.approx(own, abs=0.2)
    assert judged(estimate.model, second)[0] == pytest.approx(other, abs=0.3)


def test_poles_of_the_step_are_those_of_a_rough_fit(folder):
    record = uniform(read(folder, "data_step.csv", ["u"], ["y"]))
    first, _ = record.split(record.t[record.n_samples // 2])
    poles = np.sort(identify(first, structure(2, 0), PLAIN).model.poles.real)
    assert np.allclose(poles, [-0.046, -0.0102], rtol=0.01)


def test_two_heaters_and_one_sensor(folder):
    record = uniform(read(folder, "data.csv", ["u_heater1", "u_heater2"], ["y_T1"]))
    estimate = identify(record, structure(2, 0), PLAIN)
    assert estimate.fit[0] == pytest.approx(95.8, abs=0.2)
    poles = np.sort(np.roots(estimate.model.common_denominator).real)
    assert np.allclose(poles, [-0.0948, -0.0061], rtol=0.01)
    own, cross = estimate.model.dc_gain[0]
    assert own == pytest.approx(0.47, abs=0.01)
    # not physical: the record does not determine it
    assert cross == pytest.approx(-0.04, abs=0.01)


def test_two_heaters_and_two_sensors_share_their_poles(folder):
    record = uniform(read(folder, "data.csv", ["u_heater1", "u_heater2"], ["y_T1", "y_T2"]))
    estimate = identify(record, structure(2, 1), PLAIN)
    assert np.all(estimate.fit > 96.0)
    gain = estimate.model.dc_gain
    assert gain[0, 0] > 0.3
    assert gain[1, 1] > 0.1
    assert abs(gain[0, 1]) < 0.3 * gain[0, 0]
    assert estimate.model.is_stable


@pytest.mark.slow
def test_stamps_taken_for_what_they_are_give_the_same(folder):
    record = read(folder, "data_step.csv", ["u"], ["y"])
    uneven, near = (identify(r, structure(2, 0), PLAIN) for r in (record, uniform(record)))
    assert np.allclose(uneven.theta, near.theta, rtol=0.02)
    assert uneven.fit[0] == pytest.approx(near.fit[0], abs=0.1)
