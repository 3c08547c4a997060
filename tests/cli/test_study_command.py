"""`tridentify study NAME`: the table of studies, and what is passed to and taken from one."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tridentify.plots.study as study_pictures
from tridentify import studies
from tridentify.studies.aircraft import noise_free_record
from tridentify.studies.aircraft_numbers import (
    ESTIMATORS,
    FLAGGED,
    TRUTH,
    AircraftNumbers,
    Condition,
    Event,
)
from tridentify.studies.aircraft_text import write_text


class Result:
    def __init__(self, asked: dict[str, Any]) -> None:
        self.asked = asked

    def table(self) -> str:
        return "median [1/s]  bound\n  0.98         0.26"

    def to_dict(self) -> dict[str, Any]:
        return {"asked": self.asked, "bound": math.nan}


def draw(_result: object, folder: Path) -> tuple[Path, ...]:
    (folder / "figure-5.png").write_text("a picture")
    return (folder / "figure-5.png",)


class Study:
    name = "coin"
    description = "heads or tails"

    def run(self, *, progress: Callable[[int, int], None], **asked: Any) -> Result:
        for done in range(1, 21):
            progress(done, 20)
        return Result(asked)


@pytest.fixture(autouse=True)
def _one_quick_study(monkeypatch):
    monkeypatch.setattr(studies, "STUDIES", {"coin": Study()})
    monkeypatch.setattr(study_pictures, "save_study_figures", draw)


def test_a_study_prints_its_table_and_counts_on_stderr(run):
    outcome = run("study", "coin")
    assert outcome.code == 0
    assert outcome.out == Result({}).table() + "\n"
    assert "10 of 20 done" in outcome.err
    assert "20 of 20 done" in outcome.err


def test_options_reach_the_study(run):
    options = ["--draws", 7, "--seed", 3, "--workers", 2]
    document = json.loads(run("study", "coin", *options, "--json").out)
    assert document["asked"] == {"draws": 7, "seed": 3, "workers": 2}
    assert document["bound"] is None
    document = json.loads(run("study", "coin", "--json").out)
    assert document["asked"] == {"draws": 200, "seed": 0, "workers": None}


def test_out_holds_table_numbers_and_pictures(run, tmp_path):
    outcome = run("study", "coin", "--out", tmp_path / "out")
    assert outcome.code == 0
    files = {path.name: path.read_text() for path in (tmp_path / "out").iterdir()}
    assert sorted(files) == ["coin.json", "coin.txt", "figure-5.png"]
    assert files["coin.txt"] == Result({}).table() + "\n"
    assert json.loads(files["coin.json"])["bound"] is None
    assert "figure-5.png" in outcome.out


def test_an_unknown_study_lists_those_that_exist(run):
    outcome = run("study", "dice")
    assert outcome.code == 2
    (line,) = outcome.err.splitlines()
    assert "found no study 'dice'" in line
    assert "coin (heads or tails)" in line


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(run, tmp_path):
    (tmp_path / "file").write_text("")
    outcome = run("study", "coin", "--out", tmp_path / "file" / "out")
    assert outcome.code == 2
    assert "done after" not in outcome.err


def test_the_aircraft_in_words_counts_the_heavy_tails() -> None:
    theta = np.full((3, 5, 3), TRUTH)
    theta[2, 1] = 0.5, 900.0, 150.0  # a ringing that the method calls converged
    theta[2, 2] = 0.5, 900.0, 150.0
    theta[2, 3] = 70.0, 900.0, 150.0
    theta[2, 4] = np.nan
    flagged = (Event(ESTIMATORS[2], 2, FLAGGED, "weakly identifiable"),)
    record = noise_free_record(100, 0.05)
    loud = Condition(record, 2.0, 0.3, 20.0 * np.eye(3), theta, flagged)
    text = " ".join(write_text(AircraftNumbers(0, 5, 1.9, 20, (loud,))).split())
    assert "3 of 5 at noise 2, 100 samples (2 lightly damped, 2 not flagged)" in text
    assert text.index("What is left of tails") < text.index("WHAT THE PAPER'S NUMBERS CAN MEAN")
    quiet = Condition(record, 0.5, 0.1, 20.0 * np.eye(3), theta, ())
    assert "What is left of tails" not in write_text(AircraftNumbers(0, 5, 1.9, 20, (quiet,)))
