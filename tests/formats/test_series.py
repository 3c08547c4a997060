"""All channels of a file over time, and a picture of limited width that loses nothing seen."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from tridentify import read_series
from tridentify.errors import OptionError, SamplingError, TimeNotIncreasingError

pytestmark = pytest.mark.unisolated


def table(tmp_path, text, name="log.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_numbers_are_read_and_words_are_not(tmp_path):
    path = table(tmp_path, "t,u [V],note,y\n0,1,a,2\n0.5,1,b,\n1,3,c,4\n")
    u, y = read_series(path)
    assert (u.channel.name, u.channel.unit, u.dt) == ("u", "V", 0.5)
    np.testing.assert_array_equal(u.values, [1.0, 1.0, 3.0])
    np.testing.assert_array_equal(y.values, [2.0, np.nan, 4.0])
    assert (u.missing, y.missing) == (0, 1)


def test_without_time_a_step_is_asked_for(tmp_path):
    path = table(tmp_path, "u,y\n1,2\n1,3\n3,4\n")
    with pytest.raises(SamplingError, match="dt"):
        read_series(path)
    assert read_series(path, dt=0.1)[1].t.tolist() == pytest.approx([0.0, 0.1, 0.2])


def test_time_in_milliseconds_is_seconds(tmp_path):
    path = table(tmp_path, "time [ms],u\n0,1\n20,1\n40,3\n")
    assert read_series(path)[0].t.tolist() == pytest.approx([0.0, 0.02, 0.04])


def test_time_that_goes_back_is_refused(tmp_path):
    with pytest.raises(TimeNotIncreasingError, match="increas"):
        read_series(table(tmp_path, "t,u\n0,1\n2,1\n1,3\n"))


def test_a_million_samples_keep_every_peak(tmp_path):
    rng = np.random.default_rng(1)
    y = rng.standard_normal(1_000_000)
    y[777_777] = 99.0
    y[100_000:200_000] = np.nan
    path = tmp_path / "long.parquet"
    pl.DataFrame({"t": np.arange(y.size) * 0.001, "y": y}).write_parquet(path)
    (one,) = read_series(path)
    thin = one.thinned(0.0, 999.999, 800)
    assert thin.thinned
    assert thin.t.size == 800
    column = int(777.777 / 999.999 * 800)
    assert thin.maximum[column] == 99.0
    assert np.nanmin(thin.minimum) == np.nanmin(y)
    assert np.isnan(thin.maximum[100])
    direct = [
        (np.nanmin(part), np.nanmax(part)) for part in np.array_split(y[200_000:1_000_000], 640)
    ]
    low, high = thin.minimum[160:], thin.maximum[160:]
    assert np.mean(low == [a for a, _ in direct]) > 0.95
    assert np.mean(high == [b for _, b in direct]) > 0.95


def test_few_samples_are_given_as_they_are(tmp_path):
    (one,) = read_series(table(tmp_path, "t,y\n" + "\n".join(f"{k},{k**2}" for k in range(9))))
    part = one.thinned(2.0, 5.0, 100)
    assert not part.thinned
    assert part.t.tolist() == [2.0, 3.0, 4.0, 5.0]
    assert part.minimum.tolist() == part.maximum.tolist() == [4.0, 9.0, 16.0, 25.0]
    assert one.thinned(100.0, 200.0, 10).t.size == 0
    with pytest.raises(OptionError, match="at least 1"):
        one.thinned(0.0, 1.0, 0)


def test_samples_far_apart_leave_columns_empty(tmp_path):
    t = np.concatenate([np.linspace(0.0, 1.0, 300), np.linspace(9.0, 10.0, 300)])
    (one,) = read_series(table(tmp_path, "t,y\n" + "\n".join(f"{x!r},{x!r}" for x in t.tolist())))
    thin = one.thinned(0.0, 10.0, 100)
    assert np.isnan(thin.minimum[20:80]).all()
    assert np.isfinite(thin.minimum[[0, 5, 95, 99]]).all()
