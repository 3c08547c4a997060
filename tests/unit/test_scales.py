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
    select_structure,
    simulate,
    validate,
)
from tridentify import errors as err
from tridentify.estimation.likelihood.scores import judged_scatter
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.judgement.causes.attempts.attempt import attempt
from tridentify.judgement.cautions.sensors import seen_in
from tridentify.numerics.discretize import discretize
from tridentify.numerics.rational import scaled_roots
from tridentify.numerics.realization import cascade
from tridentify.numerics.sampled import Sampled, States

pytestmark = pytest.mark.unjudged

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


FIRST = Structure(1, 0, offset=False, initial_state="rest")


@pytest.mark.parametrize("dt", [1e-42, 1e42, 1e98])
@pytest.mark.parametrize("method", [ThreeModel(), OutputError(), SvfLeastSquares()], ids=str)
def test_time_that_leaves_an_integral_no_variance_is_not_identified_from(dt, method):
    message = refused(err.ScaleError, lambda: identify(Record(U, Y, dt=dt), FIRST, method))
    assert "unit of time" in message
    uneven = np.cumsum(np.random.default_rng(3).uniform(0.5, 1.5, U.size)) * dt
    if method != SvfLeastSquares():
        refused(err.ScaleError, lambda: identify(Record(U, Y, t=uneven), FIRST, method))


@pytest.mark.parametrize("size", [1e-42, 1e42])
def test_signals_whose_products_of_variances_are_no_numbers_are_not_identified_from(size):
    for u, y in [(U * size, Y), (U, Y * size)]:
        record = Record(u, y, dt=0.1)
        assert "other units" in refused(err.ScaleError, lambda r=record: identify(r, FIRST))
        refused(err.ScaleError, lambda r=record: select_structure(r, [FIRST]))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("into", "out", "time"),
    [
        (-39, 39, 0),
        (0, 0, 37),
        *(
            pytest.param(*powers, marks=pytest.mark.slow)
            for powers in ((39, -39, 0), (0, 0, -37), (39, 39, 37), (-39, -39, -37))
        ),
    ],
)
@pytest.mark.judged
@pytest.mark.slow
def test_what_just_enters_is_identified_and_judged_as_in_any_unit(into, out, time):
    plain = identify(Record(U, Y, dt=0.1), FIRST, OutputError(), throw=False)
    record = Record(U * 10.0**into, Y * 10.0**out, dt=0.1 * 10.0**time)
    found = identify(record, FIRST, OutputError(), throw=False)
    factor = 10.0**-time * np.array([1.0, 10.0 ** (out - into)])
    assert found.theta / factor == pytest.approx(plain.theta, rel=1e-6)
    assert found.std / factor == pytest.approx(plain.std, rel=1e-4)
    codes = [f.code for f in validate(found, record).findings]
    assert codes == [f.code for f in validate(plain, Record(U, Y, dt=0.1)).findings]


@pytest.mark.filterwarnings("error")
def test_scales_of_powers_of_two_change_rounding_alone():
    plain = identify(Record(U, Y, dt=0.1), FIRST, SvfLeastSquares(), throw=False)
    record = Record(U * 2.0**-90, Y * 2.0**100, dt=0.1 * 2.0**80)
    found = identify(record, FIRST, SvfLeastSquares(), throw=False)
    assert found.theta / plain.theta == pytest.approx([2.0**-80, 2.0**110], rel=1e-12)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("between", ["zoh", "foh"])
@pytest.mark.parametrize("unit", [2.0**-100, 2.0**40, 2.0**120])
def test_the_unit_of_time_costs_a_filter_no_digit(between, unit):
    poles = np.array([-0.3 + 2j, -0.3 - 2j, *[-1.0] * 5])
    plain, scaled = cascade(poles), cascade(poles / unit)
    one = discretize(plain.a, plain.b[:, None], 0.25, between)
    other = discretize(scaled.a, scaled.b[:, None], 0.25 * unit, between)
    assert other.transition == pytest.approx(one.transition, abs=1e-15)
    # the states of an orthonormal filter are per root of time
    for a, b in zip(one[1:], other[1:], strict=True):
        assert b / np.sqrt(unit) == pytest.approx(a, abs=1e-15)


@pytest.mark.filterwarnings("error")
def test_steps_of_very_different_lengths_in_a_slow_unit_are_crossed():
    # seen: squared so often that the exponential of a stable filter overflowed
    lengths = 1e30 * np.geomspace(0.1, 1e9, 12)
    bank = cascade(np.full(7, -2e-33 + 0j))
    record = Record(np.ones(13), np.arange(13.0), t=np.append(0.0, np.cumsum(lengths)))
    signal = Sampled(np.ones((13, 1)), 1e29, "zoh", t=np.array(record.t))
    out = np.empty((7, 13))
    States(signal, bank.a, bank.b, upper=0).advance(0, 13, out)
    settled = -np.linalg.solve(bank.a, bank.b)
    assert out[:, -1] == pytest.approx(settled, rel=1e-9)


# ------------------------------------------------------------------------------------------ nothing
@pytest.mark.filterwarnings("error")
def test_a_part_of_a_record_that_is_zero_throughout_explains_nothing():
    still = build([Record(U, 0.0 * U, dt=0.1)], FIRST, Nuisances("rest", False, False))
    assert attempt(still, [np.array([-1.0 + 0j])], [0]) is None


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("pole", [0.0, 1e-310, -1e-300])
def test_a_pole_of_no_rate_is_held_at_the_slowest(pole):
    problem = build([Record(U, Y, dt=1e-12)], FIRST, Nuisances("rest", False, False))
    poles, note = problem.admissible(np.array([pole + 0j]))
    assert poles == pytest.approx([-problem.slowest])
    assert note


@pytest.mark.filterwarnings("error")
def test_scores_of_which_the_last_sample_has_all_are_blocks_too():
    g = np.append(np.full(799, 1e-10), 1.0)[:, None]
    e = np.random.default_rng(5).standard_normal((800, 1))
    found = judged_scatter([g[:, None]], [e - g @ (g.T @ e)])
    assert found is None or np.isfinite(found.covariance).all()


@pytest.mark.filterwarnings("error")
def test_a_limit_that_is_only_entered_after_missing_samples_is_judged():
    y = np.array([np.nan, *np.zeros(9), 0.68, 0.22, np.nan])
    record = Record(np.eye(13)[9], y, dt=0.1)
    told = seen_in(record, np.full((13, 1), 0.01), np.array([1e-3]), None)
    assert "saturation" not in [finding.code for finding in told]


# --------------------------------------------------------------------------------------- structures
@pytest.mark.parametrize("value", [1e-310, 1e200, -1e200, 1.7e308])
def test_numbers_whose_squares_are_none_are_refused_with_the_structure(value):
    refused(err.BoundsError, lambda: Structure(2, 0, fixed={"a0": value}))
    refused(err.BoundsError, lambda: Structure(2, 0, bounds={"a0": (value, None)}))
    refused(err.PriorError, lambda: Structure(2, 0, priors={"a0": (value, 1.0)}))
    refused(err.PriorError, lambda: Structure(2, 0, priors={"a0": (1.0, abs(value))}))
    refused(err.StaticGainError, lambda: Structure(2, 0, static_gain=value))


def test_weights_of_one_equality_too_far_apart_are_refused_with_the_structure():
    for row in [
        ({"b0": 1e300, "a0": 1e-300}, 0.0),
        ({"b0": 1.0, "a0": -1.0}, 1e200),
        ({"b0": 1e308}, 1e-100),
    ]:
        refused(err.EqualityError, lambda row=row: Structure(2, 0, equalities=[row]))


@pytest.mark.parametrize("scale", [1e-310, 1e-200, 1e200, 1e308])
@pytest.mark.fast("1e-310", "1e+308")
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


@pytest.mark.parametrize("unit", [1e-38, 1e20, 1e38])
def test_a_band_limited_response_is_the_same_in_any_unit_of_time(unit):
    u = np.cumsum(np.random.default_rng(1).standard_normal(60))
    found = []
    for dt in (1.0, unit):
        plant = TransferFunction([0.01 / dt**2], [1.0, 0.15 / dt, 0.01 / dt**2])
        found.append(simulate(plant, Record(u, u, dt=dt, intersample="band-limited")))
    assert np.allclose(found[1], found[0], rtol=0.0, atol=1e-12 * np.abs(found[0]).max())


def test_an_output_that_is_one_sample_among_nothing_is_identified_or_refused():
    u, y = np.full(30, 0.6778), np.full(30, 1.7e-300)
    y[3] = 1.0
    records = [Record(u, y, dt=1.7e-9)] * 2
    structure = Structure(1, 0, offset=False, initial_state="rest")
    estimate = identify(records, structure, SvfLeastSquares(), throw=False)
    assert np.isfinite(estimate.theta).all()
