"""``tridentify advise``: findings and facts as text, JSON and files."""

from __future__ import annotations

import json

import numpy as np
import pytest


@pytest.fixture
def flight(write_table, held):
    rng = np.random.default_rng(4)
    u = 0.05 * np.repeat(rng.choice([-1.0, 1.0], 40), 15)
    q = held([2.0, 3.0], u) + 1e-3 * rng.standard_normal(u.size)
    q[200] += 0.1
    return write_table("flight.csv", {"t": 0.02 * np.arange(u.size), "elevator": u, "q": q})


def test_findings_come_with_what_to_do(run, flight):
    outcome = run("advise", flight, "--input", "elevator", "--output", "q")
    assert outcome.code == 0
    text = " ".join(outcome.out.split())
    assert "! A sample of q stands alone" in text
    assert "(at 4 s)" in text
    assert not outcome.out.endswith("\n\n")
    assert "what to do: Mark them as missing" in text
    assert "elevator excites: from" in text
    assert "poles it may support: about" in text
    assert "tridentify select compares orders" in " ".join(text.split())


@pytest.mark.slow
def test_json_and_files(run, flight, tmp_path):
    options = ("--input", "elevator", "--output", "q", "--json", "--out", tmp_path / "a")
    outcome = run("advise", flight, *options)
    document = json.loads(outcome.out)
    assert [finding["code"] for finding in document["findings"]] == ["bad-samples"]
    assert document["ok"] is False
    stored = json.loads((tmp_path / "a" / "advice.json").read_text())
    assert stored["frequency"]["omega"] == document["frequency"]["omega"]
    assert (tmp_path / "a" / "frequency-response.svg").stat().st_size > 1000
    assert len(document["files"]) == 2


@pytest.mark.slow
def test_what_is_missing_is_left_out(run, flight):
    columns = ("--input", "elevator", "--output", "q")
    outcome = run("advise", flight, *columns, "--missing", "q>=0.1", "--json")
    assert outcome.code == 0
    document = json.loads(outcome.out)
    assert "bad-samples" not in [finding["code"] for finding in document["findings"]]


def test_a_short_record_is_refused_in_one_line(run, flight):
    outcome = run("advise", flight, "--input", "elevator", "--output", "q", "--to", "0.3")
    assert outcome.code == 2
    (line,) = outcome.error_lines
    assert "expected at least 40" in line
