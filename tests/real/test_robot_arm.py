"""A flexible robot arm: torque to acceleration, 1024 samples, the sampling interval is not known.

All frequencies are in radians per sample. What a linear model can do: four poles, four zeros and
the direct term explain 97 percent and predict the rest of the record as well, with two resonances
of half a percent damping; the record is a steady periodic response, and one of the hardest tests
for a search, because a start in the wrong place ends on one resonance. What it cannot tell: the
physical frequencies, without the interval.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, identify

pytestmark = pytest.mark.unjudged

PLAIN = ThreeModel(noise="white", finish="likelihood")
FOUR = Structure(4, 4, offset=True, initial_state="free")


@pytest.fixture(scope="module")
def record(folder):
    table = np.loadtxt(folder("robot-arm") / "data.csv", delimiter=",", skiprows=1)
    return Record(table[:, 0], table[:, 1], dt=1.0)


def test_first_part_predicts_the_rest(record, judged):
    first, second = record.split(800.0)
    estimate = identify(first, FOUR, PLAIN)
    assert estimate.fit[0] == pytest.approx(97.0, abs=0.2)
    assert judged(estimate.model, second)[0] == pytest.approx(95.2, abs=0.3)


@pytest.mark.slow
def test_resonances_are_those_of_a_rough_fit(record):
    first, _ = record.split(800.0)
    poles = identify(first, FOUR, PLAIN).model.poles
    upper = poles[np.argsort(poles.imag)][-2:]
    assert np.allclose(upper.imag, [0.366, 0.796], rtol=0.002)
    assert np.allclose(upper.real, [-0.0019, -0.0037], rtol=0.05)


@pytest.mark.slow
def test_the_interval_only_scales_the_answer(record):
    first, _ = record.split(800.0)
    fast = Record(first.u, first.y, dt=1e-3)
    slow_poles, fast_poles = (identify(r, FOUR, PLAIN).model.poles for r in (first, fast))
    assert np.allclose(np.sort(fast_poles), 1e3 * np.sort(slow_poles), rtol=1e-4)
