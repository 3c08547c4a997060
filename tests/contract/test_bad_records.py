"""Bad input to every method: one clear line, "found ...; expected ...; do ...", never a crash.

A refusal is an error of the package whose message says what was found and what to do. Nothing
passes a bad record on to linear algebra: no warning of numpy, no nan in an estimate that says it
converged.
"""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from tridentify import METHODS, Record, Structure, TridentifyError, identify
from tridentify import errors as err

pytestmark = pytest.mark.unjudged

DT = 0.05
every_method = pytest.mark.parametrize("key", list(METHODS), ids=str)


def sound(n_samples=200, seed=0, dt=DT, gain=1.0, **options):
    """First-order lag with a little noise; truth a0 = 4, b0 = 2."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n_samples // 8 + 1), 8)[:n_samples]
    y = np.zeros(n_samples)
    decay = math.exp(-4.0 * DT)
    for k in range(n_samples - 1):
        y[k + 1] = decay * y[k] + 0.5 * (1.0 - decay) * u[k]
    y += 0.01 * rng.standard_normal(n_samples)
    return Record(u, gain * y, dt=dt, **options)


FIRST = Structure(1, 0, offset=False, initial_state="rest")


def refused(call, *kinds):
    """The message of a refusal, which must be one line in the house's form."""
    with pytest.raises(TridentifyError) as caught:
        call()
    message = str(caught.value)
    assert isinstance(caught.value, kinds or TridentifyError), (type(caught.value), message)
    assert "\n" not in message
    assert message.startswith("found "), message
    assert message.count(";") >= 1, message
    return message


# ------------------------------------------------------------------------------ several records
@every_method
def test_no_record(key):
    refused(lambda: identify([], FIRST, METHODS[key]()), err.DataError)


@every_method
def test_something_else_in_place_of_a_record(key):
    for wrong in ([sound(), None], "flight.csv", [np.ones(5)], [[sound()]]):
        refused(lambda wrong=wrong: identify(wrong, FIRST, METHODS[key]()), err.SampleTypeError)


@every_method
@pytest.mark.parametrize(
    "other",
    [
        {"input_names": ["rudder"]},
        {"output_names": ["beta"]},
        {"input_names": ["y"], "output_names": ["u"]},
    ],
    ids=["other input", "other output", "swapped"],
)
def test_records_with_different_channels(key, other):
    records = [sound(), sound(seed=1, **other)]
    message = refused(lambda: identify(records, FIRST, METHODS[key]()))
    named = [*other.get("input_names", []), *other.get("output_names", [])]
    assert all(name in message for name in named)


@every_method
def test_records_with_different_numbers_of_channels(key):
    two = Record(np.ones((50, 1)), np.random.default_rng(0).standard_normal((50, 2)), dt=DT)
    refused(lambda: identify([sound(), two], FIRST, METHODS[key]()))


# -------------------------------------------------------------------------------------- samples
def test_output_without_a_sample():
    for y in (np.full(50, np.nan), np.column_stack([np.ones(50), np.full(50, np.nan)])):
        refused(lambda y=y: Record(np.ones(50), y, dt=DT), err.EmptyChannelError)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_input_that_is_not_finite(bad):
    u = np.ones(50)
    u[7] = bad
    assert "7" in refused(lambda: Record(u, np.ones(50), dt=DT), err.NotFiniteError)


@every_method
def test_one_sample_of_an_output_is_not_enough(key):
    record = sound()
    y = np.full(record.n_samples, np.nan)
    y[20] = 1.0
    refused(lambda: identify(Record(record.u, y, dt=DT), FIRST, METHODS[key]()))


@every_method
@pytest.mark.parametrize("value", [0.0, 3.5])
def test_output_that_never_moves(key, value):
    record = Record(sound().u, np.full(200, value), dt=DT)
    refused(lambda: identify(record, FIRST, METHODS[key]()), err.DataError)


@every_method
@pytest.mark.parametrize("parts", [1, 2])
def test_inputs_that_are_proportional(key, parts):
    record = sound()
    both = [
        Record(piece.u @ [[1.0, -3.0]], piece.y, dt=DT, input_names=["left", "right"])
        for piece in (record, record.slice(1.0))[:parts]
    ]
    message = refused(lambda: identify(both, FIRST, METHODS[key]()), err.DependentInputsError)
    assert "left and right proportional" in message


def test_an_input_that_is_the_sum_of_others():
    u = np.random.default_rng(3).standard_normal((200, 4)) * [1.0, 1e-6, 1e6, 1.0]
    u[:, 3] = u[:, 0] - 1e6 * u[:, 1]
    record = Record(u, sound().y, dt=DT)
    message = refused(lambda: identify(record, FIRST), err.DependentInputsError)
    assert "u1, u2 and u4 linearly dependent" in message


@pytest.mark.slow
def test_inputs_that_move_apart_in_one_record_are_told_apart():
    record = sound()
    still = np.zeros_like(record.u)
    both = [
        Record(np.hstack([record.u, other]), record.y, dt=DT) for other in (2.0 * record.u, still)
    ]
    assert identify(both, FIRST, throw=False).theta.size == 3


def test_proportional_inputs_with_other_delays_are_told_apart():
    record = sound()
    both = Record(record.u @ [[1.0, 2.0]], record.y, dt=DT)
    late = Structure(1, 0, delay=[[0.0, 0.3]], offset=False, initial_state="rest")
    estimate = identify(both, late)
    assert estimate.parameters["b0[y,u1]"].value == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("which", ["u", "y"])
def test_time_along_a_row(which):
    arrays = {"u": np.ones((3, 3)), "y": np.ones((3, 3))} | {which: np.ones((3, 150))}
    message = refused(lambda: Record(**arrays, dt=DT), err.ShapeError)
    assert "first axis; transpose it" in message


def test_constant_input_of_an_integrator():
    record = sound()
    still = Record(np.hstack([record.u, np.ones_like(record.u)]), record.y, dt=DT)
    structure = Structure(2, 0, fixed={"a0": 0.0}, initial_state="free", offset=True)
    message = refused(lambda: identify(still, structure), err.ConstantInputError)
    assert "input 'u2'" in message
    assert "drift=True" in message


@pytest.mark.parametrize(
    ("method", "words"),
    [
        ("output-error", r"write method=OutputError\(\)"),
        ("nothing", r"found method='nothing'.*write method=ThreeModel\(\)"),
        (METHODS["svf-least-squares"], r"write method=SvfLeastSquares\(\)"),
        (dict, r"the class dict.*write method=ThreeModel\(\)"),
        (3, "found method=3"),
    ],
)
def test_something_else_in_place_of_a_method(method, words):
    message = refused(lambda: identify(sound(), FIRST, method), err.OptionError)
    assert re.search(words, message)


@every_method
def test_input_that_never_acts(key):
    record = Record(np.zeros(200), sound().y, dt=DT)
    refused(lambda: identify(record, FIRST, METHODS[key]()), err.ZeroInputError)


@every_method
@pytest.mark.parametrize("size", [1e150, 1e300, 1e-150, 1e-300])
@pytest.mark.parametrize("where", ["output", "input", "both"])
def test_values_that_no_unit_makes_sense_of(key, size, where):
    record = sound()
    u = record.u * (size if where != "output" else 1.0)
    y = record.y * (size if where != "input" else 1.0)
    refused(lambda: identify(Record(u, y, dt=DT), FIRST, METHODS[key]()), err.DataError)


@every_method
@pytest.mark.parametrize("gain", [1e-12, 1e12])
def test_large_and_small_units_are_no_reason_to_refuse(key, gain):
    found = identify(sound(gain=gain), FIRST, METHODS[key](), throw=False)
    assert np.all(np.isfinite(found.theta))
    assert found.theta[1] / gain == pytest.approx(2.0, rel=0.2)


@every_method
@pytest.mark.parametrize("n_samples", [2, 3, 4])
def test_records_of_a_few_samples(key, n_samples):
    record = sound(20)
    few = Record(record.u[:n_samples], record.y[:n_samples], dt=DT)
    refused(lambda: identify(few, Structure(2, 1), METHODS[key]()))


@every_method
@pytest.mark.fast("output-error", "svf-*", "refined-*", "bias-*")
def test_one_wild_sample_gives_an_answer_or_a_refusal(key):
    record = sound()
    y = np.array(record.y)
    y[90] = 1e30
    try:
        found = identify(record.with_outputs(y), FIRST, METHODS[key](), throw=False)
    except TridentifyError:
        return
    assert np.all(np.isfinite(found.theta))


# ----------------------------------------------------------------------------------------- time
@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf])
def test_step_that_is_no_step(dt):
    refused(lambda: Record(np.ones(9), np.ones(9), dt=dt), err.SamplingError)


@pytest.mark.parametrize(
    "t",
    [
        [0.0, 1.0, 1.0, 2.0],
        [0.0, 1.0, 0.5, 2.0],
        [0.0, 1.0, 2.0, 0.0],
        [3.0, 2.0, 1.0, 0.0],
    ],
    ids=["repeated", "back", "clock set back", "reversed"],
)
def test_time_that_does_not_increase(t):
    refused(lambda: Record(np.ones(4), np.arange(4.0), t=t), err.TimeNotIncreasingError)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_time_that_is_not_finite(bad):
    refused(lambda: Record(np.ones(4), np.arange(4.0), t=[0.0, bad, 2.0, 3.0]), err.DataError)


# ---------------------------------------------------------------------------------- delay, orders
@pytest.mark.parametrize("delay", [-0.1, -1e-9, np.nan, np.inf, "soon", True])
def test_delay_that_is_none(delay):
    refused(lambda: Structure(1, 0, delay=delay), err.StructureError)


@every_method
def test_delay_longer_than_the_record(key):
    structure = Structure(1, 0, delay=1e6, offset=False, initial_state="rest")
    refused(lambda: identify(sound(), structure, METHODS[key]()))


@every_method
def test_more_unknowns_than_samples(key):
    refused(lambda: identify(sound(24), Structure(12, 11), METHODS[key]()))


# ------------------------------------------------------------------------------------ constraints
def contradictions():
    return {
        "bounds the wrong way round": {"bounds": {"a0": (2.0, 1.0)}},
        "fixed outside its bounds": {"fixed": {"a0": 5.0}, "bounds": {"a0": (0.0, 1.0)}},
        "fixed to nan": {"fixed": {"a0": math.nan}},
        "fixed to infinity": {"fixed": {"a0": math.inf}},
        "bound of nan": {"bounds": {"a0": (math.nan, 1.0)}},
        "no such coefficient": {"fixed": {"a7": 1.0}},
        "no such name": {"bounds": {"gain": (0.0, 1.0)}},
    }


@pytest.mark.parametrize("kind", contradictions())
def test_contradictory_constraints(kind):
    def use():
        structure = Structure(1, 0, **contradictions()[kind])
        identify(sound(), structure)

    refused(use, err.StructureError)


# ------------------------------------------------------------------------------------------ units
@pytest.mark.parametrize(
    "units", [{"z": "m"}, {"u": 3}, {"u": None}, "m", ["m", "s"], {1: "m"}], ids=repr
)
def test_units_that_name_no_channel_or_are_no_words(units):
    refused(lambda: sound(units=units), err.DataError)


@every_method
@pytest.mark.parametrize("channel", ["u", "y"])
def test_units_that_do_not_match(key, channel):
    records = [sound(units={channel: "rad"}), sound(seed=1, units={channel: "deg"})]
    message = refused(lambda: identify(records, FIRST, METHODS[key]()), err.UnitError)
    assert "rad" in message
    assert "deg" in message


@every_method
def test_units_that_one_record_leaves_out_match(key):
    records = [sound(units={"u": "rad"}), sound(seed=1)]
    assert np.all(np.isfinite(identify(records, FIRST, METHODS[key]()).theta))
