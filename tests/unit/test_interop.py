"""Models of python-control and SciPy, both ways."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from tridentify import TransferFunction, errors

OMEGA = np.geomspace(0.01, 100.0, 9)


def same_response(model, system, rtol=1e-9):
    _, response = signal.freqresp(system, OMEGA)
    np.testing.assert_allclose(model.frequency_response(OMEGA)[:, 0, 0], response, rtol=rtol)


poles = st.lists(st.floats(0.1, 30.0), min_size=1, max_size=5)
# neither package holds a zero over a denominator
numerators = st.builds(
    lambda lead, rest: [lead, *rest],
    st.floats(0.1, 5.0),
    st.lists(st.floats(-5.0, 5.0), max_size=4),
)


@given(poles, st.lists(st.floats(-30.0, 30.0), max_size=4), st.floats(0.1, 10.0))
def test_scipy_models_of_every_kind_keep_their_response(rates, zeros, gain):
    zpk = signal.ZerosPolesGain(zeros[: len(rates)], [-rate for rate in rates], gain)
    same_response(TransferFunction.from_scipy(zpk), zpk)
    same_response(TransferFunction.from_scipy((zpk.zeros, zpk.poles, zpk.gain)), zpk)
    tf = zpk.to_tf()
    same_response(TransferFunction.from_scipy(tf), zpk)
    same_response(TransferFunction.from_scipy((tf.num, tf.den)), zpk)


@given(poles, numerators)
def test_to_scipy_and_back_is_the_same_model(rates, num):
    model = TransferFunction(num[: len(rates)], np.poly([-rate for rate in rates]))
    again = TransferFunction.from_scipy(model.to_scipy())
    np.testing.assert_array_equal(again.den[0][0], model.den[0][0])
    np.testing.assert_array_equal(again.num[0][0], model.num[0][0])


@given(poles, st.integers(0, 2**32 - 1))
def test_state_space_models_become_polynomials(rates, seed):
    rng = np.random.default_rng(seed)
    n = len(rates)
    turn = np.linalg.qr(rng.standard_normal((n, n)))[0]
    a = turn @ (np.diag(-np.array(rates)) + np.triu(rng.standard_normal((n, n)), 1)) @ turn.T
    b, c = rng.standard_normal((n, 2)), rng.standard_normal((2, n))
    d = np.array([[0.0, 1.0], [0.0, 0.0]])
    model = TransferFunction.from_scipy((a, b, c, d))
    s = 1j * OMEGA
    expected = np.array([c @ np.linalg.solve(x * np.eye(n) - a, b) + d for x in s])
    size = np.abs(expected).max()
    np.testing.assert_allclose(model.frequency_response(OMEGA), expected, atol=1e-8 * size)
    assert model.common_denominator is not None
    assert len(model.num[0][0]) <= n


def test_a_strictly_proper_state_space_model_has_no_spurious_zeros():
    system = signal.StateSpace(*signal.tf2ss([3.0], [1.0, 2.0, 5.0, 4.0, 1.0]))
    model = TransferFunction.from_scipy(system)
    np.testing.assert_allclose(model.num[0][0], [3.0], rtol=1e-10)
    np.testing.assert_allclose(model.den[0][0], [1.0, 2.0, 5.0, 4.0, 1.0], rtol=1e-10)


def test_poles_many_decades_apart_keep_their_small_coefficients():
    slow, fast = np.poly([-1.0, -2.0]), np.poly([-1e6, -3e6])
    num = np.polymul([1.0, 0.5], [1.0, 2e6])
    a, b, c, d = signal.tf2ss(num, np.polymul(slow, fast))
    model = TransferFunction.from_scipy((a, b, c, d))
    np.testing.assert_allclose(model.num[0][0], num, rtol=1e-6)
    np.testing.assert_allclose(model.den[0][0], np.polymul(slow, fast), rtol=1e-6)


@pytest.mark.parametrize("rate", [1e-6, 1e6])
def test_the_scale_of_time_does_not_matter(rate):
    a = rate * np.array([[-1.0, 2.0], [-3.0, -1.0]])
    model = TransferFunction.from_scipy((a, rate * np.ones((2, 1)), np.ones((1, 2)), [[0.0]]))
    np.testing.assert_allclose(model.den[0][0], [1.0, 2.0 * rate, 7.0 * rate**2], rtol=1e-12)
    np.testing.assert_allclose(model.num[0][0], [2.0 * rate, 1.0 * rate**2], rtol=1e-10)


def test_a_gain_and_an_integrator_are_state_space_models_too():
    gain = TransferFunction.from_scipy((np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), 3.0))
    np.testing.assert_array_equal(gain.num[0][0], [3.0])
    integrator = TransferFunction.from_scipy(([[0.0]], [[2.0]], [[1.0]], [[0.0]]))
    np.testing.assert_allclose(integrator.num[0][0], [2.0])
    np.testing.assert_allclose(integrator.den[0][0], [1.0, 0.0])


def test_one_input_with_several_outputs():
    model = TransferFunction.from_scipy(([[1.0, 2.0], [0.0, 3.0]], [1.0, 4.0]))
    assert (model.n_outputs, model.n_inputs) == (2, 1)
    np.testing.assert_array_equal(model.num[1][0], [3.0])


@pytest.mark.parametrize(
    ("system", "error"),
    [
        (signal.dlti([1.0], [1.0, 0.5], dt=0.1), errors.UnsupportedError),
        (signal.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1), errors.UnsupportedError),
        (3.0, errors.UnsupportedError),
        (([1.0],), errors.UnsupportedError),
        (([1.0 + 2.0j], [-1.0], 1.0), errors.CoefficientError),
        ((["a"], [1.0, 2.0]), errors.CoefficientError),
        (([[1.0]], [[1.0]], [[1.0, 2.0]], [[0.0]]), errors.CoefficientError),
        (([1.0, 2.0, 3.0], [1.0, 2.0]), errors.ImproperModelError),
    ],
)
def test_what_is_no_continuous_time_model_is_refused(system, error):
    with pytest.raises(error, match="expected"):
        TransferFunction.from_scipy(system)


def test_control_state_space_models_are_taken_with_their_names():
    control = pytest.importorskip("control")
    a, b, c, d = [[0.0, 1.0], [-9.0, -1.0]], [[0.0, 1.0], [1.0, 0.0]], [[1.0, 0.0]], [[0.0, 0.5]]
    system = control.ss(a, b, c, d, inputs=["e", "r"], outputs=["q"])
    model = TransferFunction.from_control(system)
    assert model.input_names == ("e", "r")
    expected = np.array([system(1j * w) for w in OMEGA])
    np.testing.assert_allclose(model.frequency_response(OMEGA), expected, rtol=1e-9)


@given(poles, numerators)
def test_to_control_and_back_is_the_same_model(rates, num):
    pytest.importorskip("control")
    model = TransferFunction(num[: len(rates)], np.poly([-rate for rate in rates]))
    again = TransferFunction.from_control(model.to_control())
    np.testing.assert_allclose(again.den[0][0], model.den[0][0], rtol=1e-15)
    np.testing.assert_allclose(
        again.frequency_response(OMEGA), model.frequency_response(OMEGA), rtol=1e-12
    )


def test_what_is_no_model_of_python_control_is_refused_by_its_type():
    pytest.importorskip("control")
    with pytest.raises(errors.UnsupportedError, match=r"^found 'int'; expected a continuous-time"):
        TransferFunction.from_control(3)
