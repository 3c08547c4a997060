"""A transfer function: monic, proper, evaluated and converted without loss."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tridentify import errors
from tridentify.transfer_function import TransferFunction

PAPER = TransferFunction([0.5], [1.0, 1.0, 3.0])
coefficient = st.floats(-1e3, 1e3, allow_subnormal=False).filter(lambda x: x == 0 or abs(x) > 1e-3)


def two_by_two(**options: object) -> TransferFunction:
    return TransferFunction([[[1.0], [2.0, 1.0]], [[3.0], [0.0]]], [1.0, 2.0, 5.0], **options)


def test_the_denominator_is_made_monic() -> None:
    model = TransferFunction([1, 4], [2, 6, 8])
    np.testing.assert_array_equal(model.num[0][0], [0.5, 2.0])
    np.testing.assert_array_equal(model.den[0][0], [1.0, 3.0, 4.0])
    assert (model.n_inputs, model.n_outputs) == (1, 1)
    assert (model.input_names, model.output_names) == (("u",), ("y",))


def test_leading_zeros_are_no_degree() -> None:
    model = TransferFunction([0, 0, 0, 1], [0, 1, 2])
    np.testing.assert_array_equal(model.num[0][0], [1.0])
    np.testing.assert_array_equal(model.den[0][0], [1.0, 2.0])


def test_coefficients_are_copied_and_read_only() -> None:
    den = np.array([1.0, 2.0])
    model = TransferFunction([1.0], den)
    den[1] = 9.0
    assert model.den[0][0][1] == 2.0
    for array in (model.num[0][0], model.den[0][0], model.delay):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


def test_a_common_denominator_serves_all_channels() -> None:
    model = two_by_two(input_names=["e", "r"], output_names=["q", "p"])
    assert (model.n_outputs, model.n_inputs) == (2, 2)
    np.testing.assert_array_equal(model.common_denominator, [1.0, 2.0, 5.0])
    assert model.poles[1][0].shape == (2,)
    assert model.zeros[0][1] == pytest.approx([-0.5])
    np.testing.assert_allclose(model.dc_gain, [[0.2, 0.2], [0.6, 0.0]])
    np.testing.assert_allclose(model.natural_frequency, np.sqrt([5.0, 5.0]))
    channel = model.channel(0, 1)
    assert (channel.input_names, channel.output_names) == (("r",), ("q",))
    np.testing.assert_array_equal(channel.num[0][0], [2.0, 1.0])


def test_different_denominators_have_no_common_modes() -> None:
    model = TransferFunction([[[1.0], [1.0]]], [[[1.0, 1.0], [1.0, 2.0]]])
    assert model.common_denominator is None
    with pytest.raises(errors.UnsupportedError, match="channel"):
        _ = model.damping


def test_modes_of_a_second_order_system() -> None:
    assert PAPER.natural_frequency == pytest.approx(np.sqrt([3.0, 3.0]))
    assert PAPER.damping == pytest.approx(np.full(2, 0.5 / np.sqrt(3.0)))
    assert PAPER.zeros.shape == (0,)
    assert PAPER.is_stable


@pytest.mark.parametrize("den", [[1.0, 0.0], [1.0, -1.0], [1.0, 0.0, 4.0]])
def test_a_pole_on_or_right_of_the_axis_is_not_stable(den: list[float]) -> None:
    assert not TransferFunction([1.0], den).is_stable


def test_stiff_poles_keep_their_digits() -> None:
    poles = np.array([-1e4, -1.0])
    model = TransferFunction([1.0], np.poly(poles))
    np.testing.assert_allclose(model.poles, poles, rtol=1e-10)


# --------------------------------------------------------------------------------- the response
@given(
    st.lists(coefficient, min_size=1, max_size=5),
    st.floats(-3, 3),
)
def test_response_agrees_with_the_plain_polynomials(den: list[float], exponent: float) -> None:
    num, den = [1.0, -2.0], [1.0, *den]
    omega = 10.0**exponent
    s = 1j * omega
    bottom = np.polyval(den, s)
    if abs(bottom) < 1e-6 * np.polyval(np.abs(den), omega):
        return
    response = TransferFunction(num, den, delay=0.1).frequency_response([omega])[0, 0, 0]
    expected = np.polyval(num, s) / bottom * np.exp(-0.1 * s)
    assert abs(response - expected) <= 1e-8 * abs(expected)


@given(st.lists(coefficient, min_size=6, max_size=6), st.floats(-300, 300))
def test_response_never_overflows(den: list[float], exponent: float) -> None:
    response = TransferFunction([1.0, 1.0], [1.0, *den]).frequency_response([10.0**exponent])
    assert not np.isnan(response).any()


def test_response_at_the_ends_of_the_axis() -> None:
    direct = TransferFunction([2.0, 1.0], [1.0, 4.0]).frequency_response([0.0, 1e200])
    np.testing.assert_allclose(direct.ravel(), [0.25, 2.0])
    integrator = TransferFunction([1.0], [1.0, 0.0])
    assert np.isinf(integrator.frequency_response([0.0])).all()
    assert np.isinf(integrator.dc_gain).all()


def test_response_has_one_matrix_for_each_frequency() -> None:
    model = two_by_two()
    omega = np.array([0.1, 1.0, 10.0])
    response = model.frequency_response(omega)
    assert response.shape == (3, 2, 2)
    single = model.channel(0, 1).frequency_response(omega)
    np.testing.assert_array_equal(response[:, 0, 1], single[:, 0, 0])


@pytest.mark.parametrize("omega", [[np.nan], [[1.0]], ["a"], [1j], [np.inf]])
def test_senseless_frequencies_are_refused(omega: list) -> None:
    with pytest.raises(errors.OptionError, match="finite real frequencies"):
        PAPER.frequency_response(omega)


# ----------------------------------------------------------------------------------- conversions
def test_control_and_back() -> None:
    control = pytest.importorskip("control")
    model = two_by_two(input_names=["e", "r"], output_names=["q", "p"])
    twin = TransferFunction.from_control(model.to_control())
    assert (twin.input_names, twin.output_names) == (("e", "r"), ("q", "p"))
    omega = np.array([0.3, 3.0])
    np.testing.assert_allclose(twin.frequency_response(omega), model.frequency_response(omega))
    np.testing.assert_allclose(
        model.to_control()(3j), model.frequency_response([3.0])[0], rtol=1e-12
    )
    unnamed = TransferFunction.from_control(control.tf([1.0], [1.0, 2.0]))
    assert (unnamed.input_names, unnamed.output_names) == (("u",), ("y",))


def test_control_models_of_another_kind_are_refused() -> None:
    control = pytest.importorskip("control")
    sampled = (control.tf([1.0], [1.0, 0.5], 0.1), control.ss(-0.5, 1, 1, 0, 0.1))
    measured = control.frd([1.0, 0.5], [1.0, 2.0])
    for system in (*sampled, measured, "1 / s"):
        with pytest.raises(errors.UnsupportedError, match="continuous-time"):
            TransferFunction.from_control(system)


def test_missing_control_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "control", None)
    with pytest.raises(errors.MissingDependencyError, match="pip install control"):
        PAPER.to_control()


def test_scipy_has_the_same_response() -> None:
    omega = np.array([0.3, 1.0, 3.0])
    _, response = PAPER.to_scipy().freqresp(omega)
    np.testing.assert_allclose(response, PAPER.frequency_response(omega)[:, 0, 0])


def test_scipy_takes_neither_channels_nor_delay() -> None:
    with pytest.raises(errors.UnsupportedError, match="2 outputs and 2 inputs"):
        two_by_two().to_scipy()
    with pytest.raises(errors.UnsupportedError, match="Pade"):
        TransferFunction([1.0], [1.0, 1.0], delay=0.1).to_scipy()
    pytest.importorskip("control")
    with pytest.raises(errors.UnsupportedError, match="Pade"):
        TransferFunction([1.0], [1.0, 1.0], delay=0.1).to_control()


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=3),
    st.lists(coefficient, min_size=2, max_size=4),
    st.floats(0.0, 10.0),
)
def test_nothing_is_lost_in_json_or_pickle(num: list, den: list, delay: float) -> None:
    model = TransferFunction(num, [1.0, *den], delay=delay, input_names=["e"])
    for twin in (
        TransferFunction.from_dict(json.loads(json.dumps(model.to_dict()))),
        pickle.loads(pickle.dumps(model)),
    ):
        assert twin.to_dict() == model.to_dict()


# -------------------------------------------------------------------------------------- refusals
BAD = [
    (errors.ImproperModelError, ([1, 0, 0], [1, 1]), {}, "numerator of degree 2"),
    (errors.CoefficientError, ([1], [0, 0]), {}, "denominator of zeros"),
    (errors.CoefficientError, ([], [1, 1]), {}, "at least one number"),
    (errors.CoefficientError, ([1], [1, np.nan]), {}, "finite coefficients"),
    (errors.CoefficientError, ([1j], [1, 1]), {}, "real coefficients"),
    (errors.CoefficientError, (["a"], [1, 1]), {}, "real coefficients"),
    (errors.CoefficientError, ([1], [1e-320, 1.0]), {}, "leading coefficient"),
    (errors.ChannelCountError, ([[[1], [1]]], [[[1, 1]]]), {}, "den for 1 outputs x 1 inputs"),
    (errors.ChannelCountError, ([[[1], [1]], [[1]]], [1, 1]), {}, "equally long rows"),
    (errors.ChannelCountError, ([[1.0], [2.0]], [1, 1]), {}, "nest it as"),
    (errors.ChannelCountError, ([1], [1, 1]), {"delay": [[0.1, 0.2]]}, "delay of shape"),
    (errors.OptionError, ([1], [1, 1]), {"delay": -1.0}, "zero or more"),
    (errors.OptionError, ([1], [1, 1]), {"delay": "free"}, "delay='free'"),
    (errors.ChannelNameError, ([1], [1, 1]), {"input_names": ["a", "b"]}, "2 names"),
]


@pytest.mark.parametrize(("error", "coefficients", "options", "words"), BAD)
def test_senseless_models_are_refused(error: type, coefficients, options, words: str) -> None:
    with pytest.raises(error, match=words) as caught:
        TransferFunction(*coefficients, **options)
    assert type(caught.value) is error
    assert "\n" not in str(caught.value)


def test_a_damaged_dictionary_is_refused() -> None:
    with pytest.raises(errors.StructureError, match="restore the file"):
        TransferFunction.from_dict({"num": [1.0]})


def test_text_of_one_channel_and_of_several() -> None:
    assert str(PAPER).splitlines()[1] == "-------------"
    assert "exp(-0.1 s) ---" in str(TransferFunction([1.0], [1.0, 1.0], delay=0.1))
    text = str(two_by_two(input_names=["e", "r"], output_names=["q", "p"]))
    assert "q <- r:" in text
    assert "2 s + 1" in text
    assert repr(PAPER) == "TransferFunction([0.5], [1.0, 1.0, 3.0])"


def test_python_control_takes_names_with_dots():
    pytest.importorskip("control")
    model = TransferFunction([[[1.0], [2.0]]], [1.0, 3.0], input_names=["q.x", "q_x"])
    assert model.to_control().input_labels == ["q_x_2", "q_x"]


def test_a_notebook_shows_every_channel_as_a_fraction() -> None:
    shown = TransferFunction([2.0], [1.0, 3.0], delay=0.5)._repr_html_()
    assert shown.count("<mfrac>") == 1
    assert "exp(-0.5 s)" in shown
    assert TransferFunction([[[1.0]], [[2.0]]], [1.0, 3.0])._repr_html_().count("<mfrac>") == 2
