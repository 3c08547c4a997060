"""`tridentify study NAME`: the table of studies, and what is passed to and taken from one."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import tridentify.plots.study as study_pictures
from tridentify import studies


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
