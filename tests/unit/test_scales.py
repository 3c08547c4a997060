"""Numbers at the edge of a float: refused in one line that says so, or of no consequence."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tridentify import (
    OutputError,
    Record,
    Structure,
    SvfLeastSquares,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify import errors as err
from tridentify.numerics.rational import scaled_roots

U = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 20), 4)
PLANT = TransferFunction([3.0], [1.0, 1.5, 3.0])
Y = simulate(PLANT, Record(U, U, dt=0.1))[:, 0]
Y = Y + 0.02 * np.random.default_rng(2).standard_normal(Y.size)
LAG = Structure(2, 0, offset=False, initial_state="rest")


def refused(kind, call):
    with pytest.raises(kind) as caught:
        call()
    message = str(caught.value)
    assert re.fullmatch(r"found .+; expected .+; .+", message), message
    return message


# --------------------------------------------------------------------------------------- records
@pytest.mark.parametrize("dt", [5e-324, 1e-200, 1e200, 1e300])
def test_a_step_whose_square_is_no_number_is_refused_with_the_record(dt):
    assert "unit of time" in refused(err.ScaleError, lambda: Record(U, Y, dt=dt))


@pytest.mark.parametrize(
    "t",
    [
        np.geomspace(1e-300, 1e300, U.size),
        np.geomspace(1e-12, 1e12, U.size),
        np.append(np.arange(U.size - 1) * 0.1, 1e200),
        np.concatenate([[-1.7e308], np.linspace(0.0, 1.0, U.size - 2), [1.7e308]]),
    ],
    ids=["every magnitude", "of many magnitudes", "a gap", "overflow"],
)
def test_time_in_which_steps_are_lost_is_refused_with_the_record(t):
    refused(err.ScaleError, lambda: Record(U, Y, t=t))


@pytest.mark.parametrize("value", [1.7e308, -1.7e308])
def test_a_sample_that_cannot_be_added_is_refused_with_the_record(value):
    for name in "uy":
        samples = {"u": U.copy(), "y": Y.copy()}
        samples[name][7] = value
        refused(err.ScaleError, lambda samples=samples: Record(**samples, dt=0.1))
    assert Record(U, Y, dt=0.1).with_outputs(np.where(Y > 0, Y, np.nan)[:, None]).n_samples == 80


@pytest.mark.parametrize("dt", [1e-150 * 1.1, 1e-100, 1e100])
@pytest.mark.parametrize("method", [ThreeModel(), OutputError(), SvfLeastSquares()], ids=str)
def test_coefficients_whose_variance_is_no_number_are_refused(dt, method):
    message = refused(err.ScaleError, lambda: identify(Record(U, Y, dt=dt), LAG, method))
    assert "for 2 poles" in message


def test_outputs_out_of_all_proportion_to_inputs_are_refused():
    refused(err.ScaleError, lambda: identify(Record(U * 1e-90, Y * 1e90, dt=0.1), LAG))


# --------------------------------------------------------------------------------------- structures
@pytest.mark.parametrize("value", [1e-310, 1e200, -1e200, 1.7e308])
def test_numbers_whose_squares_are_none_are_refused_with_the_structure(value):
    refused(err.BoundsError, lambda: Structure(2, 0, fixed={"a0": value}))
    refused(err.BoundsError, lambda: Structure(2, 0, bounds={"a0": (value, None)}))
    refused(err.PriorError, lambda: Structure(2, 0, priors={"a0": (value, 1.0)}))
    refused(err.PriorError, lambda: Structure(2, 0, priors={"a0": (1.0, abs(value))}))
    refused(err.StaticGainError, lambda: Structure(2, 0, static_gain=value))


def test_weights_of_one_equality_too_far_apart_are_refused_with_the_structure():
    for row in [({"b0": 1e300, "a0": 1e-300}, 0.0), ({"b0": 1.0, "a0": -1.0}, 1e200)]:
        refused(err.EqualityError, lambda row=row: Structure(2, 0, equalities=[row]))


@pytest.mark.parametrize("scale", [1e-310, 1e-200, 1e200, 1e308])
def test_the_scale_of_an_equality_says_nothing(scale):
    record = Record(U, Y, dt=0.1)

    def answer(weight):
        rows = [({"b0": weight, "a0": -weight}, 0.0)]
        return identify(record, Structure(2, 0, offset=False, equalities=rows)).theta

    assert answer(scale) == pytest.approx(answer(1.0), rel=1e-9)


@pytest.mark.parametrize(
    "known",
    [
        {"fixed": {"a1": 1e100}},
        {"fixed": {"b0": 1e-100}},
        {"bounds": {"b0": (None, 1e-100)}},
        {"priors": {"a0": (1e100, 1.0)}},
        {"priors": {"a0": (3.0, 1e-100)}},
        {"static_gain": 1e100},
        {"equalities": [({"b0": 1e60, "a0": 1.0}, 0.0)]},
        {"equalities": [({"b0": 1.0, "a0": -1.0}, 1e100)]},
    ],
    ids=str,
)
def test_knowledge_out_of_all_proportion_to_the_record_is_refused(known):
    structure = Structure(2, 0, offset=False, initial_state="rest", **known)
    refused(err.ScaleError, lambda: identify(Record(U, Y, dt=0.1), structure))


# ------------------------------------------------------------------------------- filters, responses
@pytest.mark.parametrize("last", [1e-300, 1e200])
def test_a_filter_of_no_rate_that_a_record_shows_is_refused(last):
    refused(err.ScaleError, lambda: SvfLeastSquares(filter=[1.0, 2.0, last]))
    refused(err.ScaleError, lambda: ThreeModel.paper(1.7, filter=(1.0, 5.0, 6.0, last)))
    slow = Record(U, Y, dt=1e60)
    refused(err.ScaleError, lambda: identify(slow, LAG, ThreeModel.paper(1.7)))


def test_a_response_beyond_the_numbers_is_refused():
    record = Record(U, U, dt=0.1)
    grows = TransferFunction([1.0], [1.0, -1e3])
    refused(err.ScaleError, lambda: simulate(grows, record))
    huge = TransferFunction([1e300], [1.0, 1.0])
    refused(err.ScaleError, lambda: simulate(huge, Record(1e99 * U, U, dt=0.1)))


def test_a_delay_beyond_any_record_leaves_the_output_at_rest():
    late = TransferFunction([1.0], [1.0, 1.0], delay=1.7e308)
    assert not simulate(late, Record(U, U, dt=0.1)).any()


def test_roots_of_coefficients_far_apart():
    wide = np.polymul([1.0, 1e-120], [1.0, 1e-100])
    assert np.sort(scaled_roots(wide).real) == pytest.approx([-1e-100, -1e-120], rel=1e-9)
    far = TransferFunction([1e-200, 1.0], [1.0, 1.0, 1.0])
    assert far.zeros.real == pytest.approx([-1e200])
    assert TransferFunction([5e-324, 1e10], [1.0, 1.0]).zeros.size == 0


# --------------------------------------------------------------------------------------- types
@pytest.mark.parametrize("value", ["x", None, [], 10**400])
def test_no_number_of_seconds(value):
    record = Record(U, Y, dt=0.1)
    refused(err.OptionError, lambda: record.split(value))
    refused(err.OptionError, lambda: record.resample(value))
    if value is not None:
        refused(err.OptionError, lambda: record.slice(0.0, value))
        refused(err.SamplingError, lambda: Record(U, Y, dt=value))


@pytest.mark.parametrize("order", [1001, 10**400], ids=["too many", "endless"])
def test_an_order_whose_names_would_not_end(order):
    refused(err.OrderError, lambda: Structure(order, 0))
    refused(err.OrderError, lambda: Structure(order, order, fixed={"a0": 1.0}))


@pytest.mark.parametrize("options", [{"initial_state": np.zeros(2)}, {"initial_state": []}])
def test_an_array_in_place_of_a_word(options):
    refused(err.OptionError, lambda: Structure(2, 0, **options))
    refused(err.OptionError, lambda: Record(U, Y, dt=0.1, intersample=np.zeros(2)))
