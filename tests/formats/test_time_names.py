"""Columns of time by their name, and the unit that their name or their size tells."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tridentify import open_record, read_record, record_from_frame
from tridentify.errors import SamplingError, UnitError

STEP = 0.02


def frame(name, scale=1.0, first=0.0, output="y"):
    rng = np.random.default_rng(5)
    t = first + STEP * scale * np.arange(50)
    return pd.DataFrame({name: t, "u": rng.standard_normal(50), output: rng.standard_normal(50)})


@pytest.mark.parametrize(
    ("name", "scale"),
    [
        ("t_ms", 1e3),
        ("timestamp_ms", 1e3),
        ("Time_us", 1e6),
        ("time-ns", 1e9),
        ("t (ms)", 1e3),
        ("time [ms]", 1e3),
        ("time_min", 1.0 / 60.0),
        ("time_h", 1.0 / 3600.0),
        ("time_s", 1.0),
        ("Elapsed Time", 1.0),
        ("elapsed_ms", 1e3),
        ("seconds", 1.0),
        ("milliseconds", 1e3),
    ],
)
def test_a_name_with_a_unit_is_time_where_nothing_is_named(name, scale, tmp_path):
    columns = frame(name, scale)
    assert record_from_frame(columns, inputs=["u"], outputs=["y"]).dt == pytest.approx(STEP)
    columns.to_csv(tmp_path / "run.csv", index=False)
    for time in (None, name):
        read = read_record(tmp_path / "run.csv", inputs=["u"], outputs=["y"], time=time)
        assert read.dt == pytest.approx(STEP)


def test_any_column_that_is_named_as_time_may_end_on_a_unit():
    columns = frame("logged_ms", 1e3)
    named = record_from_frame(columns, time="logged_ms", inputs=["u"], outputs=["y"])
    assert named.dt == pytest.approx(STEP)
    with pytest.raises(SamplingError):
        record_from_frame(columns, inputs=["u"], outputs=["y"])
    stated = record_from_frame(
        columns, time="logged_ms", inputs=["u"], outputs=["y"], units={"logged_ms": "us"}
    )
    assert stated.dt == pytest.approx(STEP / 1e3)


@pytest.mark.parametrize("scale", [1.0, 1e3, 1e6])
def test_stamps_since_1970_tell_their_unit_by_their_size(scale):
    columns = frame("stamp", scale, 1.76e9 * scale)
    read = record_from_frame(columns, time="stamp", inputs=["u"], outputs=["y"])
    assert read.dt == pytest.approx(STEP, rel=1e-3)
    assert read.t[0] == pytest.approx(1.76e9)


def test_stamps_that_cannot_be_seconds_are_refused_as_seconds():
    columns = frame("time_s", 1e3, 1.76e12)
    with pytest.raises(UnitError, match="1e11"):
        record_from_frame(columns, inputs=["u"], outputs=["y"])


def test_an_output_called_as_time_is_none_where_another_column_is(tmp_path):
    columns = frame("t", output="T")
    columns.to_csv(tmp_path / "run.csv", index=False)
    read = read_record(tmp_path / "run.csv", inputs=["u"], outputs=["T"])
    assert read.dt == pytest.approx(STEP)
    columns.to_parquet(tmp_path / "run.parquet")
    parts = open_record(tmp_path / "run.parquet", inputs=["u"], outputs=["T"])
    assert parts.dt == pytest.approx(STEP)


def test_a_capital_t_before_a_letter_is_a_temperature():
    columns = frame("T_h")
    with pytest.raises(SamplingError):
        record_from_frame(columns, inputs=["u"], outputs=["y"])


def test_the_shortest_name_comes_first():
    columns = frame("t").assign(time_ms=7.0)
    assert record_from_frame(columns, inputs=["u"], outputs=["y"]).dt == pytest.approx(STEP)
