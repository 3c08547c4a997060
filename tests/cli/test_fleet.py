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
    outcome = run(
        "fleet", logs / "**" / "*.parquet", *QUESTION, "--out", tmp_path / "results", "--reports", 0
    )
    assert outcome.code == 0, outcome.err
    assert "7 records: 6 with an estimate, 1 without" in outcome.out
    assert "bad input 1" in outcome.out
    assert "7 of 7 done" in outcome.err
    assert "7 of 7" not in outcome.out
    page = (tmp_path / "results" / "report.html").read_text(encoding="utf-8")
    assert "6 of 7 units have an estimate" in page
    assert "report.html" in outcome.out
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


@pytest.mark.slow
@pytest.mark.undrawn
def test_a_population_that_cannot_be_told_does_not_hide_the_common_model(run, tmp_path):
    rng = np.random.default_rng(4)
    records = {f"u{k}": fleets.unit(rng, fleets.TRUTH, n=80, noise=0.2) for k in range(3)}
    fleets.frame_of(records).write_parquet(tmp_path / "all.parquet")
    outcome = run(
        "fleet", tmp_path / "all.parquet", "--key", "unit", *QUESTION, "--together", "--pool",
        "--out", tmp_path / "out",
    )  # fmt: skip
    assert outcome.code == 2
    assert "3 records: 3 with an estimate" in outcome.out
    assert "one model" in outcome.out.lower()
    assert "found 3 units" in outcome.error_lines[-1]


@pytest.mark.undrawn
@pytest.mark.slow
def test_together_and_pool_are_told_and_a_unit_apart_gets_its_report(run, tmp_path):
    rng = np.random.default_rng(2)
    truth = fleets.TRUTH * np.exp(0.05 * rng.standard_normal((32, 3)))
    truth[3, 1] *= 1.6
    records = {f"u{k:02d}": fleets.unit(rng, t, n=80, noise=0.2) for k, t in enumerate(truth)}
    fleets.frame_of(records).write_parquet(tmp_path / "all.parquet")
    outcome = run(
        "fleet", tmp_path / "all.parquet", "--key", "unit", *QUESTION, "--together", "--pool",
        "--reports", 1, "--workers", 2, "--out", tmp_path / "out", "--json",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    document = json.loads(outcome.out)
    assert document["together"]["units"] == 32
    assert document["population"]["deviating"][0] == "u03"
    files = [Path(one).name for one in document["files"]]
    assert files == ["report.html", "together.json", "pool.json", "pool.parquet"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert '<a href="units/u03.html">u03</a>' in page
    assert "u03" in (tmp_path / "out" / "units" / "u03.html").read_text(encoding="utf-8")
    for heading in ("One model for all", "Population", "Distribution of the coefficients"):
        assert heading in page
    delayed = run("fleet", tmp_path / "all.parquet", "--key", "unit", *QUESTION, "--pool",
                  "--delay", "free", "--out", tmp_path / "other")  # fmt: skip
    assert delayed.code == 2
    assert "found delays that are to be estimated" in delayed.error_lines[0]


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


def test_a_fleet_without_an_estimate_says_why_in_its_line(run, logs, tmp_path):
    files = logs / "left" / "*.parquet"
    outcome = run(
        "fleet", files, *QUESTION, "--input", "nix", "--out", tmp_path / "r", "--reports", 0
    )
    assert outcome.code == 1
    assert "found no column 'nix'" in outcome.error_lines[-1]
