"""`tridentify study FILE.toml`: a study that a file declares."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from declared import STUDY
from tridentify.cli.terminal import Pace


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(STUDY)
    return path


@pytest.mark.slow
def test_a_file_is_run_and_leaves_its_folder(run, file, tmp_path):
    out = tmp_path / "out"
    outcome = run("study", file, "--draws", 2, "--workers", 1, "--out", out)
    assert outcome.code == 0
    names = {path.name for path in out.iterdir()}
    assert names == {"study.json", "draws.jsonl", "table.txt", "statistics.json", "cells.svg"}
    table = (out / "table.txt").read_text()
    assert outcome.out.startswith(table)
    assert "first / pulses / white ratio 0.05" in table
    assert "RMSE/bound" in table
    assert "16 of 16 done" in outcome.err
    stored = json.loads((out / "statistics.json").read_text())
    assert len(stored["statistics"]) == 20
    assert {row["draws"] for row in stored["statistics"]} == {2}
    assert (out / "cells.svg").read_text().lstrip().startswith("<?xml")


@pytest.mark.slow
def test_a_run_goes_on_and_says_so(run, file, tmp_path):
    asked = ["study", file, "--workers", 1, "--out", tmp_path / "out", "--json"]
    first = json.loads(run(*asked, "--draws", 1).out)
    outcome = run(*asked, "--draws", 2)
    document = json.loads(outcome.out)
    assert document["draws"] == 2
    assert len(document["statistics"]) == len(first["statistics"]) == 20
    assert sorted(Path(path).name for path in document["files"]) == [
        "cells.svg",
        "statistics.json",
        "table.txt",
    ]
    assert len((tmp_path / "out" / "draws.jsonl").read_text().splitlines()) == 16
    assert "8 of 16 done" in outcome.err


@pytest.mark.slow
def test_other_settings_in_the_folder_are_one_line(run, file, tmp_path):
    out = tmp_path / "out"
    asked = ["study", file, "--draws", 1, "--workers", 1, "--out", out]
    assert run(*asked).code == 0
    before = (out / "draws.jsonl").read_bytes()
    outcome = run(*asked, "--seed", 9)
    assert outcome.code == 2
    (line,) = outcome.error_lines
    assert "found draws of other settings" in line
    assert "(other seed)" in line
    assert (out / "draws.jsonl").read_bytes() == before


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (STUDY.replace("three-model", "best-model"), "[methods.ours]: found kind = 'best-model'"),
        (STUDY.replace("draws", "drawz"), "found the unknown key 'drawz'"),
        ("a = [", "found no study in"),
    ],
)
def test_a_wrong_file_is_one_line_and_leaves_no_folder(run, tmp_path, text, told):
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    outcome = run("study", path, "--out", tmp_path / "out")
    assert outcome.code == 2
    (line,) = outcome.error_lines
    assert told in line
    assert not (tmp_path / "out").exists()


def test_what_is_neither_study_nor_file_lists_what_there_is(run):
    outcome = run("study", "airship")
    assert outcome.code == 2
    (line,) = outcome.error_lines
    assert "aircraft (the paper's aircraft" in line
    assert "efficiency.toml" in line
    outcome = run("study", "airship.toml")
    assert outcome.code == 2
    assert "found no study in 'airship.toml' (No such file" in outcome.err


@pytest.mark.parametrize("name", ["aircraft.toml", "efficiency"])
def test_files_of_the_package_are_found_by_name(run, name, monkeypatch, tmp_path):
    asked = []

    def declared(path, *options):
        asked.append(path)
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tridentify.cli.study_command._declared", declared)
    run("study", name)
    assert asked[0].is_file()
    Path(name).write_text(STUDY)
    run("study", name)
    assert asked[1] == Path(name)


def test_the_pace_counts_what_this_run_has_done():
    pace = Pace(since=100.0, first=40)
    assert pace.left(now=100.0, done=40, total=100) is None
    assert pace.left(now=110.0, done=60, total=100) == pytest.approx(20.0)
    assert pace.left(now=130.0, done=100, total=100) is None


def test_workers_beside_a_scheduler_are_one_line(run, file):
    outcome = run("study", file, "--workers", 1, "--scheduler", "tcp://127.0.0.1:9")
    assert outcome.code == 2
    (line,) = outcome.error_lines
    assert "found --workers beside --scheduler" in line


def test_what_is_no_scheduler_is_one_line(run, file):
    outcome = run("study", file, "--scheduler", "host")
    assert outcome.code == 2
    assert "expected an address such as 'tcp://host:8786'" in outcome.error_lines[-1]
