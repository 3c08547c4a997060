"""`tridentify fleet`: rows of many files, exit codes, and what is said where."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import fleets

pytestmark = pytest.mark.unjudged


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("fleet") / "logs"
    fleets.write_files(made / "left", fleets.units(4, n=80))
    fleets.write_files(made / "right", fleets.units(2, seed=1, n=80))
    (made / "right" / "bad.parquet").write_bytes(b"PAR1")
    return made


QUESTION = ("--poles", 2, "--zeros", 0, "--intersample", "zoh", "--no-judge")


def test_a_fleet_prints_its_summary_and_leaves_rows(run, logs, tmp_path):
    outcome = run("fleet", logs / "**" / "*.parquet", *QUESTION, "--out", tmp_path / "results")
    assert outcome.code == 0, outcome.err
    assert "7 records: 6 with an estimate, 1 without" in outcome.out
    assert "bad input 1" in outcome.out
    assert "7 of 7 done" in outcome.err
    assert "7 of 7" not in outcome.out
    rows = pl.concat(pl.read_parquet(p) for p in (tmp_path / "results/parts").glob("*.parquet"))
    assert sorted(rows["key"])[:2] == ["left/u0000.parquet", "left/u0001.parquet"]

    again = run("fleet", logs / "**/*.parquet", *QUESTION, "--out", tmp_path / "results", "--json")
    document = json.loads(again.out)
    assert (document["records"], document["estimates"], document["failed"]) == (7, 6, 1)
    assert document["coefficients"]["a0"][2] == pytest.approx(3.0, rel=0.1)
    assert "done" not in again.err, "nothing was left to do"

    other = run(
        "fleet", logs / "**/*.parquet", *QUESTION, "--delay", 0.1, "--out", tmp_path / "results"
    )
    assert other.code == 2
    assert "other settings" in other.error_lines[0]
    assert "--no-resume" in other.error_lines[0]


def test_units_of_one_file_by_a_column_on_two_processes(run, tmp_path):
    fleets.frame_of(fleets.units(3, n=80)).write_parquet(tmp_path / "all.parquet")
    outcome = run(
        "fleet", tmp_path / "all.parquet", "--key", "unit", *QUESTION,
        "--workers", 2, "--time", "t", "--out", tmp_path / "out", "--json",
    )  # fmt: skip
    assert json.loads(outcome.out)["status"] == {"converged": 3}


def test_a_fleet_without_an_estimate_is_no_answer(run, tmp_path):
    t = 0.1 * np.arange(50)
    frame = pl.DataFrame({"t": t, "u": np.ones(50), "y": np.sin(t)})
    frame.write_csv(tmp_path / "one.csv")
    frame.write_csv(tmp_path / "two.csv")
    outcome = run(
        "fleet", tmp_path / "one.csv", tmp_path / "two.csv", *QUESTION,
        "--initial-state", "free", "--out", tmp_path / "out",
    )  # fmt: skip
    assert outcome.code == 1
    assert "2 records: 0 with an estimate" in outcome.out
    assert "found no usable estimate among 2 records (no answer)" in outcome.error_lines[0]


def test_bad_usage_is_one_line(run, logs, tmp_path):
    out = ("--out", tmp_path / "out")
    none = run("fleet", tmp_path / "*.csv", *QUESTION, *out)
    assert (none.code, len(none.error_lines)) == (2, 1)
    assert "found no file for" in none.error_lines[0]
    both = run("fleet", "x*", *QUESTION, *out, "--workers", 2, "--scheduler", "tcp://a:1")
    assert both.code == 2
    assert "found --workers beside --scheduler" in both.error_lines[0]
    several = run("fleet", "a", "b", *QUESTION, *out, "--key", "unit")
    assert "found 2 files with --key" in several.error_lines[0]
