"""A record: copied once, checked, read-only; cut, split and thinned without surprise."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tridentify import errors
from tridentify.record.record import Record

U, Y = [0.0, 1.0, 1.0, 0.0], [0.0, 0.5, 0.8, 0.6]


def ramp(n: int = 11, dt: float = 0.1, t0: float = 0.0, **options: object) -> Record:
    k = np.arange(n, dtype=float)
    return Record(np.zeros(n), k, t=t0 + k * dt, **options)


def test_one_dimension_is_one_channel() -> None:
    record = Record(U, Y, dt=0.5)
    assert record.u.shape == record.y.shape == (4, 1)
    assert (record.n_samples, record.n_inputs, record.n_outputs) == (4, 1, 1)
    assert record.dt == 0.5
    np.testing.assert_array_equal(record.t, [0.0, 0.5, 1.0, 1.5])
    assert record.duration == 1.5
    assert (record.input_names, record.output_names) == (("u",), ("y",))
    assert (record.intersample, record.name, dict(record.units)) == ("zoh", "", {})


def test_several_channels_get_numbered_names() -> None:
    record = Record(np.zeros((4, 2)), np.ones((4, 3)), dt=1)
    assert record.input_names == ("u1", "u2")
    assert record.output_names == ("y1", "y2", "y3")


@pytest.mark.parametrize("kind", [int, bool, np.float32, np.float16, np.longdouble, np.uint8])
def test_any_real_numbers_become_float64(kind: type) -> None:
    record = Record(np.array([0, 1, 1, 0], dtype=kind), Y, dt=0.5)
    assert record.u.dtype == np.float64
    np.testing.assert_array_equal(record.u[:, 0], [0, 1, 1, 0])


def test_arrays_are_copied_and_read_only() -> None:
    u, y = np.array(U), np.array(Y)
    record = Record(u, y, t=np.arange(4.0))
    u[:] = 9.0
    y[:] = 9.0
    np.testing.assert_array_equal(record.u[:, 0], U)
    np.testing.assert_array_equal(record.y[:, 0], Y)
    for array in (record.u, record.y, record.t):
        assert array.flags.c_contiguous
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.dt = 1.0  # type: ignore[misc]


def test_a_read_only_view_of_memory_that_can_change_is_copied() -> None:
    owner = np.array(U)
    view = owner[:]
    view.flags.writeable = False
    record = Record(view, Y, dt=0.5)
    owner[:] = 9.0
    np.testing.assert_array_equal(record.u[:, 0], U)


def test_fortran_order_becomes_c_order() -> None:
    u = np.asfortranarray(np.arange(8.0).reshape(4, 2))
    record = Record(u, Y, dt=0.5)
    assert record.u.flags.c_contiguous
    np.testing.assert_array_equal(record.u, u)


def test_a_million_samples_are_copied_once() -> None:
    n = 1_000_000
    u, y = np.zeros(n), np.zeros(n)
    tracemalloc.start()
    record = Record(u, y, dt=0.01)
    kept, peak = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    parts = record.split(5000.0), record.slice(10.0, 9000.0), Record(record.u, record.y, t=record.t)
    later, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 3 * 8 * n * 1.01
    assert peak < 3 * 8 * n * 1.1
    assert later - kept < 1e5
    assert all(np.shares_memory(record.u, p.u) for p in (*parts[0], *parts[1:]))


def test_masked_samples_are_missing_samples() -> None:
    y = np.ma.masked_array(Y, mask=[False, True, False, False])
    assert np.isnan(Record(U, y, dt=0.5).y[1, 0])
    with pytest.raises(errors.NotFiniteError):
        Record(y, Y, dt=0.5)


@pytest.mark.parametrize("again", [lambda r: pickle.loads(pickle.dumps(r)), copy.deepcopy])
def test_a_record_travels_whole_and_stays_read_only(again) -> None:
    record = ramp(input_names=["e"], units={"e": "rad", "t": "s"}, name="one", intersample="foh")
    twin = again(record)
    np.testing.assert_array_equal(twin.y, record.y)
    assert (twin.units, twin.name, twin.dt) == (record.units, "one", record.dt)
    assert not any(array.flags.writeable for array in (twin.u, twin.y, twin.t))
    with pytest.raises(TypeError):
        twin.units["e"] = "deg"


# ------------------------------------------------------------------------------------------ time
def test_uniform_time_gives_the_mean_step() -> None:
    t = np.round(100.0 + 0.04 * np.arange(626), 3)
    assert Record(np.zeros(626), np.ones(626), t=t).dt == pytest.approx(0.04, rel=1e-9)


@pytest.mark.parametrize(("jitter", "uniform"), [(0.9e-3, True), (1.2e-3, False)])
def test_a_thousandth_of_a_step_decides(jitter: float, uniform: bool) -> None:
    t = np.arange(10.0)
    t[4] += jitter
    assert (Record(np.zeros(10), np.ones(10), t=t).dt is not None) is uniform


BAD_ARRAYS = [
    (errors.LengthMismatchError, {"u": U[:3], "y": Y}, "3 samples of u, 4 of y"),
    (errors.LengthMismatchError, {"u": U, "y": Y, "t": [0, 1, 2]}, "3 of t"),
    (errors.LengthMismatchError, {"u": np.zeros((1, 4)), "y": Y}, "transpose"),
    (errors.TooFewSamplesError, {"u": [1.0], "y": [1.0]}, "found 1 samples"),
    (errors.TooFewSamplesError, {"u": [], "y": []}, "found 0 samples"),
    (errors.TooFewSamplesError, {"u": [1.0], "y": [1.0], "t": [0.0]}, "found 1 samples"),
    (errors.ShapeError, {"u": np.zeros((4, 1, 1)), "y": Y}, r"\(4, 1, 1\)"),
    (errors.ShapeError, {"u": 1.0, "y": Y}, "found u of shape"),
    (errors.ShapeError, {"u": np.zeros((4, 0)), "y": Y}, "n_channels"),
    (errors.ShapeError, {"u": U, "y": Y, "t": np.zeros((2, 2))}, "found t of shape"),
    (errors.SampleTypeError, {"u": np.array(U, complex), "y": Y}, "complex"),
    (errors.SampleTypeError, {"u": U, "y": ["a", "b", "c", "d"]}, "found y of type"),
    (errors.SampleTypeError, {"u": U, "y": np.array([1, None, 2, 3], object)}, "object"),
    (errors.SampleTypeError, {"u": [[1.0], [1.0, 2.0]], "y": Y}, "different length"),
    (errors.SampleTypeError, {"u": np.arange(4).astype("M8[s]"), "y": Y}, "found u of type"),
    (errors.NotFiniteError, {"u": [0, 1, np.nan, 0], "y": Y}, "input 'u' = nan at sample 2"),
    (errors.NotFiniteError, {"u": [0, np.inf, 1, 0], "y": Y}, "input 'u' = inf at sample 1"),
    (errors.NotFiniteError, {"u": U, "y": [0, 1, -np.inf, 0]}, "output 'y' = -inf at sample 2"),
    (errors.NotFiniteError, {"u": U, "y": Y, "t": [0, 1, np.nan, 3]}, r"t\[2\] = nan"),
    (errors.EmptyChannelError, {"u": U, "y": [np.nan] * 4}, "nothing but nan in output 'y'"),
    (errors.TimeNotIncreasingError, {"u": U, "y": Y, "t": [0, 1, 1, 2]}, r"t\[2\] = 1 s after"),
    (errors.TimeNotIncreasingError, {"u": U, "y": Y, "t": [3, 2, 1, 0]}, "strictly increasing"),
]


@pytest.mark.parametrize(("error", "arguments", "words"), BAD_ARRAYS)
def test_bad_arrays_are_refused(error: type[Exception], arguments, words: str) -> None:
    options = {} if "t" in arguments else {"dt": 0.5}
    with pytest.raises(error, match=words) as caught:
        Record(**arguments, **options)
    assert type(caught.value) is error
    assert "\n" not in str(caught.value)
    assert "expected" in str(caught.value)


def test_runs_below_each_other_are_told_from_rows_that_are_not_sorted() -> None:
    run, u = np.arange(30.0), np.ones(90)
    with pytest.raises(errors.TimeNotIncreasingError, match=r"t\[30\] = 0 s .* 3 runs below"):
        Record(u, u, t=np.tile(run, 3))
    swapped = np.arange(90.0)
    swapped[[40, 41]] = swapped[[41, 40]]
    with pytest.raises(errors.TimeNotIncreasingError, match="sort the samples"):
        Record(u, u, t=swapped)


BAD_OPTIONS = [
    (errors.SamplingError, {}, "neither dt nor t"),
    (errors.SamplingError, {"dt": 1.0, "t": [0, 1, 2, 3]}, "both dt and t"),
    (errors.SamplingError, {"dt": 0.0}, "positive number of seconds"),
    (errors.SamplingError, {"dt": -1.0}, "positive number of seconds"),
    (errors.SamplingError, {"dt": np.nan}, "positive number of seconds"),
    (errors.SamplingError, {"dt": "0.1"}, "'0.1'"),
    (errors.SamplingError, {"dt": True}, "True"),
    (errors.SamplingError, {"dt": 1e308}, "within range"),
    (errors.ChannelNameError, {"dt": 1, "input_names": ["a", "b"]}, "2 names"),
    (errors.ChannelNameError, {"dt": 1, "input_names": ["y"]}, "more than once"),
    (errors.ChannelNameError, {"dt": 1, "output_names": [" "]}, "not blank"),
    (errors.ChannelNameError, {"dt": 1, "output_names": [1]}, "channel name 1"),
    (errors.UnitError, {"dt": 1, "units": {"q": "rad"}}, "unit for 'q'"),
    (errors.UnitError, {"dt": 1, "units": {"y": 1}}, "unit 1 for 'y'"),
    (errors.OptionError, {"dt": 1, "intersample": "linear"}, "'zoh'"),
]


@pytest.mark.parametrize(("error", "options", "words"), BAD_OPTIONS)
def test_bad_options_are_refused(error: type[Exception], options, words: str) -> None:
    with pytest.raises(error, match=words) as caught:
        Record(U, Y, **options)
    assert type(caught.value) is error
    assert "\n" not in str(caught.value)


def test_repeated_names_of_one_kind_are_refused() -> None:
    with pytest.raises(errors.ChannelNameError, match="'a' more than once"):
        Record(np.zeros((4, 2)), Y, dt=1, input_names=["a", "a"])


def test_a_single_string_is_one_name() -> None:
    assert Record(U, Y, dt=1, input_names="elevator").input_names == ("elevator",)


# ----------------------------------------------------------------------------------- new records
def test_slice_includes_both_ends_within_rounding() -> None:
    part = ramp(101, 0.1).slice(0.3, 0.7)
    np.testing.assert_array_equal(part.y[:, 0], [3, 4, 5, 6, 7])
    assert part.t[0] == pytest.approx(0.3)
    assert part.dt == ramp(101, 0.1).dt


@given(st.integers(2, 60), st.data())
def test_split_loses_and_doubles_no_sample(n: int, data: st.DataObject) -> None:
    record = ramp(n + 2, 0.1, t0=5.0)
    k = data.draw(st.integers(2, n))
    first, second = record.split(float(record.t[k]))
    assert first.n_samples == k
    np.testing.assert_array_equal(np.concatenate([first.y, second.y]), record.y)
    np.testing.assert_array_equal(np.concatenate([first.t, second.t]), record.t)


@pytest.mark.parametrize("bounds", [(2.0, 3.0), (0.5, 0.2), (0.31, 0.39), (np.nan, 1.0)])
def test_an_empty_slice_is_refused(bounds: tuple[float, float]) -> None:
    with pytest.raises(errors.EmptyRangeError, match="expected at least 2") as caught:
        ramp().slice(*bounds)
    assert "between 0 s and 1 s" in str(caught.value)


@pytest.mark.parametrize("at", [0.0, 0.1, 1.0, 7.0, np.nan])
def test_a_split_that_leaves_nothing_is_refused(at: float) -> None:
    with pytest.raises(errors.EmptyRangeError, match="each side"):
        ramp().split(at)


def test_a_slice_without_output_is_refused() -> None:
    y = np.arange(10.0)
    y[5:] = np.nan
    with pytest.raises(errors.EmptyChannelError):
        Record(np.zeros(10), y, dt=1.0).slice(5.0, 9.0)


@given(
    hnp.arrays(float, (20, 2), elements=st.floats(-1e3, 1e3)),
    st.floats(-1e3, 1e3),
    st.floats(-1e3, 1e3),
)
def test_detrend_is_blind_to_a_line(y: np.ndarray, offset: float, slope: float) -> None:
    y[3, 0] = np.nan
    t = 50.0 + 0.1 * np.arange(20)
    plain = Record(np.ones(20), y, t=t).detrend(1)
    moved = Record(np.ones(20), y + offset + slope * t[:, None], t=t).detrend(1)
    np.testing.assert_allclose(moved.y, plain.y, atol=1e-8)
    assert np.isnan(plain.y[3, 0])
    np.testing.assert_array_equal(plain.u, 1.0)


def test_detrend_of_order_zero_takes_the_mean() -> None:
    np.testing.assert_allclose(Record(U, Y, dt=1).detrend().y.mean(), 0.0, atol=1e-15)
    with pytest.raises(errors.OptionError, match="order=2"):
        Record(U, Y, dt=1).detrend(2)  # type: ignore[arg-type]


def test_resample_keeps_every_kth_sample() -> None:
    thin = ramp(11, 0.1, t0=2.0).resample(0.3)
    np.testing.assert_array_equal(thin.y[:, 0], [0, 3, 6, 9])
    np.testing.assert_allclose(thin.t, [2.0, 2.3, 2.6, 2.9])
    assert thin.dt == pytest.approx(0.3)


@pytest.mark.parametrize("dt", [0.15, 0.05, 0.0, -0.1, np.nan, np.inf, 2.0])
def test_other_steps_are_refused(dt: float) -> None:
    with pytest.raises(errors.ResampleError, match=r"whole multiple of 0\.1 s"):
        ramp().resample(dt)


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, 4.0, 1e-9])
def test_a_record_that_is_not_uniform_needs_a_step_that_fits(dt) -> None:
    with pytest.raises(errors.ResampleError, match="expected"):
        Record(U, Y, t=[0.0, 1.0, 3.0, 4.0]).resample(dt)


@pytest.mark.parametrize(
    ("u", "intersample", "warns"),
    [
        ([0, 0, 1, 1, 2, 2, 2], "zoh", False),
        ([0, 1, 1, 1, 2, 2, 2], "zoh", True),
        ([0, 1, 2, 3, 4, 2, 0], "foh", False),
        ([0, 1, 2, 3, 2, 1, 0], "foh", True),
    ],
)
def test_thinning_warns_when_the_input_is_no_longer_described(u, intersample, warns) -> None:
    record = Record(u, np.arange(7.0), dt=0.5, intersample=intersample)
    if warns:
        with pytest.warns(errors.DataWarning, match=r"kept, one in \d+;.*keep the finer step"):
            record.resample(1.0)
    else:
        record.resample(1.0)


def test_select_chooses_channels_by_name_and_in_order() -> None:
    record = Record(
        np.arange(8.0).reshape(4, 2),
        np.arange(12.0).reshape(4, 3),
        dt=1,
        input_names=["e", "r"],
        output_names=["p", "q", "s"],
        units={"e": "rad", "q": "rad/s", "t": "s"},
    )
    part = record.select(inputs=["r"], outputs=["s", "q"])
    np.testing.assert_array_equal(part.u[:, 0], [1, 3, 5, 7])
    np.testing.assert_array_equal(part.y[0], [2, 1])
    assert part.output_names == ("s", "q")
    assert dict(part.units) == {"q": "rad/s", "t": "s"}
    assert part.y.flags.c_contiguous
    with pytest.raises(errors.ChannelNameError, match="no output 'z'; expected one of p, q, s"):
        record.select(outputs=["z"])
    with pytest.raises(errors.ChannelNameError, match="no input chosen"):
        record.select(inputs=[])
    with pytest.raises(errors.ChannelNameError, match="more than once"):
        record.select(inputs=["e", "e"])


def test_html_is_escaped_and_repr_is_short() -> None:
    record = Record(U, [0, np.nan, 1, 2], dt=1, name="<b>", output_names=["a<b"])
    assert "<b>" not in record._repr_html_()
    assert "1 missing" in record._repr_html_()
    assert len(repr(record)) < 120
    assert "time not uniform" in repr(Record(U, Y, t=[0, 1, 3, 4]))
