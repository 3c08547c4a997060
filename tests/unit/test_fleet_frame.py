"""`fit_frame`: what Spark and Ray are given, tried with the frames that they hand over."""

from __future__ import annotations

import pickle
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pyarrow as pa
import pytest

import fleets
from tridentify import Record, fleet, identify
from tridentify.errors import OptionError, SampleTypeError

pytestmark = pytest.mark.unjudged

FIT = partial(fleet.fit_frame, structure=(2, 0), key="unit", judge=False, time="t")
HELD = partial(FIT, intersample="zoh")


@pytest.fixture(scope="module")
def records() -> dict[str, Record]:
    return fleets.units(3, n=80)


@pytest.fixture(scope="module")
def frame(records: dict[str, Record]) -> pl.DataFrame:
    made = fleets.frame_of(records)
    bad = made.filter(pl.col("unit") == "u0000").with_columns(
        pl.lit("bad").alias("unit"), pl.lit(0.0).alias("y")
    )
    return pl.concat([made, bad])


@pytest.mark.parametrize("kind", ["pandas", "pyarrow", "batch", "polars"])
@pytest.mark.fast("batch", "polars")
def test_a_frame_of_each_kind_gives_one_of_the_same(
    kind: str, frame: pl.DataFrame, records: dict[str, Record]
) -> None:
    given: Any = {
        "pandas": frame.to_pandas(),
        "pyarrow": frame.to_arrow(),
        "batch": frame.to_arrow().combine_chunks().to_batches()[0],
        "polars": frame,
    }[kind]
    found = HELD(given)
    assert type(found) is type(given)
    table = found.to_pandas() if kind != "pandas" else found
    assert list(table.columns) == list(fleet.COLUMNS)
    assert table["key"].tolist() == [*records, "bad"]
    assert table["ok"].tolist() == [True, True, True, False]
    assert table["exception"].tolist() == ["", "", "", "ZeroOutputError"]
    alone = identify(records["u0001"], (2, 0))
    np.testing.assert_array_equal(np.asarray(table["coefficients"][1]), alone.theta)


def test_the_schema_is_fixed_whatever_comes_of_a_unit(frame: pl.DataFrame) -> None:
    whole = HELD(frame.to_arrow())
    bad = HELD(frame.filter(pl.col("unit") == "bad").to_arrow())
    none = HELD(frame[:0].to_arrow())
    assert whole.schema == bad.schema == none.schema == fleet.arrow_schema()
    assert none.num_rows == 0
    pairs = [pair.split() for pair in fleet.ddl().split(", ")]
    assert [name for name, _ in pairs] == fleet.arrow_schema().names


def test_groups_as_spark_and_ray_hand_them_over(frame: pl.DataFrame) -> None:
    """One pandas frame a group, in any order, by a function that went through a pickle."""
    function = pickle.loads(pickle.dumps(HELD))
    groups = [group for _, group in frame.to_pandas().groupby("unit", sort=False)]
    found = pd.concat([function(group) for group in reversed(groups)])
    whole = HELD(frame.to_pandas()).set_index("key")
    for name in ("coefficients", "covariance", "status", "fingerprint"):
        assert found.set_index("key")[name].to_dict() == whole[name].to_dict(), name
    as_arrow = pa.Table.from_pandas(found, schema=fleet.arrow_schema(), preserve_index=False)
    assert as_arrow.num_rows == 4


def test_a_frame_without_key_is_one_unit(frame: pl.DataFrame) -> None:
    one = frame.filter(pl.col("unit") == "u0002").drop("unit")
    row = fleet.fit_frame(one, (2, 0), intersample="zoh", judge=False)
    assert row["key"].to_list() == [""]
    other = HELD(frame).filter(key="u0002")
    assert row["coefficients"].to_list() == other["coefficients"].to_list()


@pytest.mark.slow
def test_a_limit_is_kept_by_a_process_beside(records: dict[str, Record]) -> None:
    frame = fleets.frame_of(records)
    slow = fleet.fit_frame(
        frame.head(80), (2, 0), fleets.Sleepy(), key="unit", judge=False, time_limit=0.3
    )
    assert slow["status"].to_list() == ["over time"]


def test_what_is_no_frame_is_refused(frame: pl.DataFrame) -> None:
    with pytest.raises(SampleTypeError, match="found list"):
        HELD([1, 2])
    with pytest.raises(SampleTypeError, match="found LazyFrame"):
        HELD(frame.lazy())
    with pytest.raises(OptionError, match="found key='tail'"):
        fleet.fit_frame(frame, (2, 0), key="tail")
