"""`--reference`: what drove the loop is read, kept and told by every command that reads records."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

DT = 0.02
ASKED = ("--input", "u", "--output", "q")
DRIVEN = (*ASKED, "--reference", "q_cmd")


@pytest.fixture
def looped(write_table, held) -> Path:
    """A proportional controller with noise in its sensor around a known plant."""
    rng = np.random.default_rng(7)
    n = 400
    r = np.where(np.arange(n) // 100 % 2 == 0, 0.0, 1.0)
    u, x = np.zeros(n), 0.0
    y = np.zeros(n)
    for k in range(n):
        y[k] = x + 0.01 * rng.standard_normal()
        u[k] = 3.0 * (r[k] - y[k])
        x = np.exp(-2.0 * DT) * x + (1.0 - np.exp(-2.0 * DT)) * u[k]
    columns = {"t": DT * np.arange(n), "u": u, "q [deg/s]": y, "q_cmd [deg/s]": r}
    return write_table("loop.csv", columns)


@pytest.mark.slow
@pytest.mark.unjudged
def test_identify_tells_of_the_reference(run, looped: Path) -> None:
    outcome = run("identify", looped, *DRIVEN, "--poles", "1", "--zeros", "0")
    assert outcome.code == 0, outcome.err
    words = " ".join(outcome.out.split())
    assert "reference q_cmd [deg/s], held between samples (zoh)" in words
    asked = ("--poles", "1", "--zeros", "0", "--json")
    document = json.loads(run("identify", looped, *DRIVEN, *asked).out)
    assert document["record"]["references"] == ["q_cmd"]
    assert document["record"]["reference_intersample"] == "zoh"
    without = json.loads(run("identify", looped, *ASKED, *asked).out)
    assert without["record"]["references"] == []
    assert without["record"]["reference_intersample"] is None


@pytest.mark.slow
def test_stated_behaviour_of_the_reference_counts(run, looped: Path) -> None:
    asked = (*DRIVEN, "--reference-intersample", "foh")
    outcome = run("advise", looped, *asked)
    assert outcome.code == 0, outcome.err
    assert "reference q_cmd [deg/s], joined by lines" in " ".join(outcome.out.split())


@pytest.mark.slow
def test_stored_models_are_looked_at_on_records_with_a_reference(
    run, looped: Path, tmp_path: Path
) -> None:
    out = tmp_path / "result"
    made = run("identify", looped, *DRIVEN, "--poles", "1", "--zeros", "0", "--out", out)
    assert made.code == 0, made.err
    page = (out / "report.html").read_text()
    assert "q_cmd" in page
    for command in (("validate", out, looped), ("compare", out, looped)):
        outcome = run(*command, "--reference", "q_cmd")
        assert outcome.code == 0, outcome.err
        assert "reference q_cmd [deg/s]" in " ".join(outcome.out.split())


@pytest.mark.slow
def test_an_input_is_a_reference_too(run, looped: Path) -> None:
    """One column, asked for as both: read, and told as both."""
    outcome = run("advise", looped, *ASKED, "--input", "q_cmd", "--reference", "q_cmd")
    assert outcome.code == 0, outcome.err
    told = " ".join(outcome.out.split())
    assert "reference q_cmd [deg/s]" in told
    assert "u, q_cmd" in told or "q_cmd [deg/s]" in told.partition("reference")[0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--reference", "setpoint"), "found no column 'setpoint'"),
        (("--reference", "q"), "more than once"),
        (("--reference-intersample", "foh"), "without --reference"),
    ],
)
def test_wrong_references_are_refused_in_one_line(
    run, looped: Path, options: tuple[str, ...], words: str
) -> None:
    outcome = run("advise", looped, *ASKED, *options)
    assert outcome.code != 0
    assert len(outcome.error_lines) == 1
    assert words in outcome.error_lines[0]
