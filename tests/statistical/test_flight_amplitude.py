"""Three aircraft of the JSBSim engine, the amplitude of the manoeuvre swept under the same gyro."""

from __future__ import annotations

import sys

import numpy as np
import pytest

pytestmark = pytest.mark.slow

AMPLITUDES = (0.1, 1.0, 8.0)
"""[deg]: the noise prevails, neither, the aircraft is not linear any more."""
DRAWS = 16


@pytest.fixture(scope="module")
def flights(repository):
    """The script that flies them; skips without the engine."""
    pytest.importorskip("jsbsim", reason="needs jsbsim, of the extra tridentify[jsbsim]")
    sys.path.insert(0, str(repository / "examples"))
    try:
        import jsbsim_amplitude
    finally:
        sys.path.pop(0)
    return jsbsim_amplitude


@pytest.fixture(scope="module")
def swept(flights):
    return {case.aircraft: flights.study(case, AMPLITUDES, DRAWS) for case in flights.CASES[:2]}


def column(rows, key):
    return np.array([row[key] for row in rows])


def test_small_manoeuvres_without_noise_give_the_linearised_engine(flights):
    for case in flights.CASES:
        manoeuvre = flights.Manoeuvre(case)
        record = manoeuvre.fly(0.2)
        estimate = manoeuvre.ways()["output error"]
        # speed and attitude, which two poles leave out, move the slower two by up to 4 %
        assert flights.rms(flights.relative(estimate, record, manoeuvre.truth)) < 0.04


def test_what_noise_makes_falls_with_the_amplitude(swept):
    for found in swept.values():
        for way, rows in found["errors"].items():
            spread = column(rows, "spread")
            assert spread[0] > spread[1]
            # its noise model takes what is not linear for noise, of another order in every draw
            if way != "the strategy":
                assert spread[1] > 2.0 * spread[2]


def test_what_the_linear_model_leaves_out_grows_with_the_amplitude(swept):
    for found in swept.values():
        for rows in found["errors"].values():
            clean = column(rows, "without_noise")
            assert clean[2] > 0.04
            assert clean[2] > 3.0 * clean[1]


def test_the_least_error_lies_in_between_for_every_estimator(flights, swept):
    rows = swept["A4"]["errors"]
    assert set(rows) == {"Step 2 alone", "output error", "the strategy"}
    for own in rows.values():
        amplitude, error = flights.best(own, list(AMPLITUDES))
        assert amplitude == 1.0
        assert error < 0.04


def test_spread_is_inverse_to_the_amplitude_where_the_aircraft_is_linear(flights):
    found = flights.study(flights.CASES[0], (0.25, 1.0), DRAWS)
    for rows in (found["errors"]["output error"], found["errors"]["the strategy"]):
        spread = column(rows, "spread")
        # the same draws of the noise at both amplitudes
        assert spread[0] / spread[1] == pytest.approx(4.0, rel=0.25)
