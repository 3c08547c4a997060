"""Series, columns, dates and frames: names, units and time are taken as they are labelled."""

from __future__ import annotations

import datetime

import numpy as np
import polars as pl
import pytest

from tridentify import Record, Structure, errors, identify, record_from_frame

pd = pytest.importorskip("pandas", reason="needs pandas")
pa = pytest.importorskip("pyarrow", reason="needs pyarrow")

T = [0.0, 0.5, 1.0, 1.5]
COLUMNS = {"u": [1.0, 4.0, 7.0, 2.0], "q [deg/s]": [2.0, 5.0, 8.0, 1.0], "alpha": [0.0, 1.0, 0, 1]}
ASKED = {"inputs": ["u"], "outputs": ["q"]}


# ------------------------------------------------------------------------------------------ Record
@pytest.mark.parametrize("library", [pd, pl], ids=["pandas", "polars"])
def test_series_and_columns_keep_their_names_and_units(library) -> None:
    frame = library.DataFrame({"t": T, **COLUMNS})
    record = Record(frame["u"], frame[["q [deg/s]", "alpha"]], t=frame["t"])
    assert (record.input_names, record.output_names) == (("u",), ("q", "alpha"))
    assert dict(record.units) == {"q": "deg/s"}
    np.testing.assert_array_equal(record.t, T)
    np.testing.assert_array_equal(record.y[:, 1], COLUMNS["alpha"])


def test_names_and_units_given_come_first() -> None:
    frame = pd.DataFrame(COLUMNS)
    record = Record(
        frame["u"], frame["q [deg/s]"], dt=0.5, output_names=["rate"], units={"u": "deg"}
    )
    assert (record.input_names, record.output_names) == (("u",), ("rate",))
    assert dict(record.units) == {"u": "deg"}
    stated = Record(frame["u"], frame["q [deg/s]"], dt=0.5, units={"q": "rad/s"})
    assert dict(stated.units) == {"q": "rad/s"}


@pytest.mark.parametrize(
    ("u", "y", "names"),
    [
        (pd.Series(T, name="x"), pd.Series(T, name="x"), ("u", "y")),
        (pd.Series(T), pd.Series(T, name=3), ("u", "y")),
        (pd.Series(T, name=" "), pd.Series(T, name="a\nb"), ("u", "y")),
        (pd.DataFrame(np.eye(4)[:, :1]), np.array(T), ("u", "y")),
        (pl.Series(T), pl.Series("y [" + "m" * 200 + "]", T), ("u", "y")),
        (pa.table({"de": T}), pd.Index(T, name="q"), ("de", "q")),
    ],
)
def test_what_is_no_name_gives_the_default_one(u, y, names) -> None:
    record = Record(u, y, dt=0.5)
    assert (*record.input_names, *record.output_names) == names


START = datetime.datetime(2026, 11, 22, 10, 0, 0, 1)
STEPS = [datetime.timedelta(seconds=s) for s in T]
ZONED = [START.replace(tzinfo=datetime.UTC) + step for step in STEPS]
CLOCKS = {
    "numpy dates": np.array([START + s for s in STEPS], "M8[us]"),
    "pandas index": pd.DatetimeIndex([START + s for s in STEPS]),
    "pandas index with a zone": pd.DatetimeIndex(ZONED),
    "pandas series with a zone": pd.Series(ZONED),
    "polars": pl.Series([START + s for s in STEPS]),
    "datetime": [START + s for s in STEPS],
    "durations": pd.TimedeltaIndex(STEPS),
    "numpy durations": np.array(STEPS, "m8[ms]"),
}


@pytest.mark.parametrize("kind", CLOCKS)
def test_time_may_be_dates_or_durations(kind: str) -> None:
    record = Record(COLUMNS["u"], COLUMNS["alpha"], t=CLOCKS[kind])
    np.testing.assert_allclose(record.t, T, rtol=0, atol=1e-12)
    assert record.dt == 0.5


def test_a_date_that_is_missing_is_refused() -> None:
    dates = pd.Series([START, None, START + STEPS[1], START + STEPS[2]])
    for t in (dates, dates.dt.tz_localize("UTC")):
        with pytest.raises(errors.NotFiniteError, match=r"t\[1\] = nan"):
            Record(COLUMNS["u"], COLUMNS["alpha"], t=t)
    mixed = [START, *ZONED[1:]]
    with pytest.raises(errors.SampleTypeError, match="found t of type object"):
        Record(COLUMNS["u"], COLUMNS["alpha"], t=mixed)


# ------------------------------------------------------------------------------------------ frames
FRAME = pd.DataFrame(COLUMNS)
TIMED = {
    "a column t": FRAME.assign(t=T),
    "a column Time [ms]": FRAME.assign(**{"Time [ms]": [1000 * t for t in T]}),
    "a column of dates": FRAME.assign(time=[START + s for s in STEPS]),
    "a column of dates as text": FRAME.assign(t=[f"2026-11-22 10:00:0{t}" for t in T]),
    "polars, times of day as text": pl.DataFrame({**COLUMNS, "t": [f"10:00:0{t}" for t in T]}),
    "an index t": FRAME.set_index(pd.Index(T, name="t")),
    "an index time [min]": FRAME.set_index(pd.Index([t / 60 for t in T], name="time [min]")),
    "an index of dates": FRAME.set_index(CLOCKS["pandas index"]),
    "an index of dates with a zone": FRAME.set_index(CLOCKS["pandas index with a zone"]),
    "an index of durations": FRAME.set_index(CLOCKS["durations"]),
    "polars": pl.DataFrame({**COLUMNS, "t": T}),
    "pyarrow": pa.table({**COLUMNS, "T": T}),
}


@pytest.mark.parametrize("kind", TIMED)
def test_time_of_a_frame_is_found_by_its_name_or_kind(kind: str) -> None:
    record = record_from_frame(TIMED[kind], **ASKED)
    np.testing.assert_allclose(record.t, T, rtol=0, atol=1e-12)
    assert record.units["q"] == "deg/s"


def test_two_columns_of_time_are_refused_and_one_may_be_named() -> None:
    both = FRAME.assign(t=T, time=T)
    with pytest.raises(errors.SamplingError, match=r"'t' and 'time'.*name the column of time"):
        record_from_frame(both, **ASKED)
    assert record_from_frame(both, time="t", **ASKED).dt == 0.5


def test_a_date_as_text_that_is_none_is_refused_with_its_row() -> None:
    mixed = FRAME.assign(t=["10:00:00", "10:00:01", "later", "10:00:03"])
    with pytest.raises(errors.TextInColumnError, match="'later' in column 't', row 2"):
        record_from_frame(mixed, **ASKED)
    with pytest.raises(errors.TextInColumnError, match="found String in column 't'"):
        record_from_frame(FRAME.assign(t=["a", "b", "c", "d"]), **ASKED)


def test_columns_that_may_hold_nothing_are_read() -> None:
    frame = pd.DataFrame({"t": T, "u": [1, 2, 3, 4], "q": [1.0, None, 2.0, 3.0]}).convert_dtypes()
    for record in (record_from_frame(frame, **ASKED), Record(frame["u"], frame["q"], t=frame["t"])):
        np.testing.assert_array_equal(record.y[:, 0], [1.0, np.nan, 2.0, 3.0])


def test_a_plain_index_is_no_time() -> None:
    with pytest.raises(errors.SamplingError, match="neither a time column"):
        record_from_frame(FRAME, **ASKED)
    with pytest.raises(errors.SamplingError, match="neither a time column"):
        record_from_frame(FRAME.set_index(pd.Index(T, name="x")), **ASKED)


# ---------------------------------------------------------------------------------------- identify
@pytest.mark.parametrize(
    "asked", [((Structure(1, 0),), {}), ((), {"poles": 1, "zeros": 0}), (((1, 0),), {})]
)
@pytest.mark.unjudged
def test_orders_may_be_given_in_every_way(asked) -> None:
    rng = np.random.default_rng(4)
    u = np.repeat(rng.choice([-1.0, 1.0], 20), 5)
    y = np.zeros(100)
    for k in range(99):
        y[k + 1] = 0.9 * y[k] + 0.1 * u[k]
    record = Record(u, y + 0.01 * rng.standard_normal(100), dt=0.1)
    found = identify(record, *asked[0], **asked[1])
    assert found.names == ("a0", "b0")
    assert abs(found.theta[0] + np.log(0.9) / 0.1) < 5 * found.std[0]
