"""Ready-made physical models against their state equations, and refusals of declared maps."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from hypothesis import given
from hypothesis import strategies as st

from tridentify import Structure
from tridentify.errors import CoefficientMapError, OptionError, PhysicalParameterError
from tridentify.physical import (
    PhysicalModel,
    PhysicalParameter,
    dc_motor,
    dutch_roll,
    mass_spring_damper,
    rc_circuit,
    rcrc_circuit,
    short_period,
)


def short_period_states(p):
    a = [[p["Z_alpha"], p.get("Z_q", 1.0)], [p["M_alpha"], p["M_q"]]]
    return a, [[p["Z_delta"]], [p["M_delta"]]], np.eye(2)


def lateral_states(p):
    """Side force and yawing moment in level flight, roll left out."""
    a = [[p["Y_beta"], p.get("Y_r", 0.0) - 1.0], [p["N_beta"], p["N_r"]]]
    return a, [[p["Y_delta"]], [p["N_delta"]]], np.eye(2)


def motor_states(p, rows):
    a = [[-p["R"] / p["L"], -p["K"] / p["L"]], [p["K"] / p["J"], -p["B"] / p["J"]]]
    return a, [[1.0 / p["L"]], [0.0]], rows


def ladder_states(p):
    """Two RC stages from Kirchhoff's laws."""
    one, two = 1.0 / (p["R1"] * p["C1"]), 1.0 / (p["R2"] * p["C1"])
    last = 1.0 / (p["R2"] * p["C2"])
    return [[-one - two, two], [last, -last]], [[one], [0.0]], [[0.0, 1.0]]


def buffered_states(p):
    one, two = 1.0 / (p["R1"] * p["C1"]), 1.0 / (p["R2"] * p["C2"])
    return [[-one, 0.0], [two, -two]], [[one], [0.0]], [[0.0, 1.0]]


def oscillator_states(p):
    a = [[0.0, 1.0], [-p["k"] / p["m"], -p["c"] / p["m"]]]
    return a, [[0.0], [1.0 / p["m"]]], [[1.0, 0.0]]


def rc_states(p):
    rate = 1.0 / (p["R"] * p["C"])
    return [[-rate]], [[rate]], [[1.0]]


MODELS = {
    "short period": (short_period(), short_period_states),
    "short period, Z_q": (short_period(pitch_rate_effect=None), short_period_states),
    "Dutch roll": (dutch_roll(), lateral_states),
    "Dutch roll, aileron, Y_r": (
        dutch_roll(control="aileron", yaw_rate_effect=None),
        lateral_states,
    ),
    "motor speed": (dc_motor(), lambda p: motor_states(p, [[0.0, 1.0]])),
    "motor current": (dc_motor("current"), lambda p: motor_states(p, [[1.0, 0.0]])),
    "motor both": (dc_motor("both"), lambda p: motor_states(p, [[0.0, 1.0], [1.0, 0.0]])),
    "ladder": (rcrc_circuit(), ladder_states),
    "buffered": (rcrc_circuit(buffered=True), buffered_states),
    "oscillator": (mass_spring_damper(), oscillator_states),
    "rc": (rc_circuit(), rc_states),
}


def drawn(model, seed):
    factors = np.exp(np.random.default_rng(seed).normal(size=len(model.names)))
    return dict(zip(model.names, (model.guess * factors).tolist(), strict=True))


@pytest.mark.parametrize("name", MODELS)
@given(seed=st.integers(0, 10_000))
@pytest.mark.fast("Dutch roll", "motor current")
def test_the_map_is_the_transfer_function_of_the_state_equation(name, seed):
    model, states = MODELS[name]
    values = drawn(model, seed)
    a, b, c = (np.array(part) for part in states(values))
    num, den = scipy.signal.ss2tf(a, b, c, np.zeros((len(c), 1)))
    found = model.transfer_function(values)
    assert np.allclose(found.den[0][0], den, rtol=1e-9)
    for i, row in enumerate(num):
        expected = np.trim_zeros(np.where(np.abs(row) < 1e-12 * np.abs(row).max(), 0, row), "f")
        ours = found.num[i][0]
        assert np.allclose(ours[-expected.size :], expected, rtol=1e-8)
        assert not np.any(ours[: -expected.size])


@pytest.mark.parametrize("name", MODELS)
@given(seed=st.integers(0, 10_000))
@pytest.mark.fast("oscillator", "rc", "buffered")
def test_differences_are_the_derivatives(name, seed):
    """Against complex steps, which have no truncation error to speak of."""
    model, _ = MODELS[name]
    values = drawn(model, seed)
    z = model.coordinates(np.array(list(values.values())))
    table = model.jacobian(z) / model.slope(z)
    for j, parameter in enumerate(model.names):
        moved = dict(values)
        moved[parameter] = values[parameter] * (1.0 + 1e-30j)
        there = model.coefficients(moved)
        step = values[parameter] * 1e-30
        exact = np.array([np.imag(there[c]) / step for c in model.coefficient_names])
        size = np.abs(model.theta(values)) / abs(values[parameter])
        assert np.all(np.abs(table[:, j] - exact) <= 1e-9 * (np.abs(exact) + size))


def test_analytic_derivatives_are_used():
    calls = []

    def derivatives(p):
        calls.append(p)
        return {"a0": {"tau": -1 / p["tau"] ** 2}, "b0": {"tau": -1 / p["tau"] ** 2}}

    model = low_pass(derivatives=derivatives)
    before = len(calls)
    z = model.coordinates(np.array([0.5]))
    assert model.jacobian(z)[:, 0] == pytest.approx([-2.0, -2.0])
    assert len(calls) == before + 1


def low_pass(coefficients=None, **options):
    parameters = [PhysicalParameter("tau", "s", guess=0.1, positive=True)]
    given = coefficients or (lambda p: {"a0": 1 / p["tau"], "b0": 1 / p["tau"]})
    return PhysicalModel("low pass", parameters, Structure(1, 0), given, **options)


@pytest.mark.parametrize(
    ("coefficients", "told"),
    [
        (lambda p: {"a0": 1.0}, "expected a0, b0"),
        (lambda p: {"a0": 1.0, "b0": 1.0, "b1": 1.0}, "found the coefficients a0, b0, b1"),
        (lambda p: {"a0": 1.0, "b0": np.nan}, "expected finite numbers"),
        (lambda p: {"a0": 1.0, "b0": "much"}, "expected real numbers"),
        (lambda p: {"a0": 1.0, "b0": np.ones(2)}, "expected"),
        (lambda p: p["mass"], "KeyError"),
        (lambda p: None, "TypeError"),
        (lambda p: {"a0": 1 / 0, "b0": 1.0}, "ZeroDivisionError"),
    ],
)
def test_a_map_that_gives_no_coefficients_is_refused(coefficients, told):
    with pytest.raises(CoefficientMapError, match=told) as caught:
        low_pass(coefficients)
    assert "\n" not in str(caught.value)


def test_wrong_derivatives_are_refused():
    with pytest.raises(CoefficientMapError, match="d b0 / d tau"):
        low_pass(derivatives=lambda p: {"a0": {"tau": -1 / p["tau"] ** 2}})


@pytest.mark.parametrize(
    "options",
    [
        {"name": " "},
        {"name": "m", "guess": 0.0},
        {"name": "m", "guess": np.nan},
        {"name": "m", "guess": "heavy"},
        {"name": "m", "guess": -1.0, "positive": True},
    ],
)
def test_a_parameter_of_no_use_is_refused(options):
    with pytest.raises(PhysicalParameterError):
        PhysicalParameter(**options)


def test_parameters_twice_or_none_are_refused():
    twice = [PhysicalParameter("tau"), PhysicalParameter("tau")]
    for parameters, told in ((twice, "tau twice"), ([], "none")):
        with pytest.raises(PhysicalParameterError, match=told):
            PhysicalModel("low pass", parameters, Structure(1, 0), lambda p: {})


def test_a_motor_without_such_an_output_is_refused():
    with pytest.raises(OptionError, match="torque"):
        dc_motor("torque")
