"""A run that is interrupted and gone on with, on any number of processes, loses nothing."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from declared import STUDY, document, numbers
from fleets import children
from tridentify.errors import OptionError, OutputPathError, UnreadableFileError
from tridentify.studies import DeclaredResult, StudyResult, run_study, study_from
from tridentify.studies.declared import run as running
from tridentify.writing.lock import lock

LINES = 96
"""Of the whole file: four cells, two methods, twelve draws."""
LONGEST = 120.0
"""How long a process may take to write its next line, or to end [s]: a hundred times as usual."""


@pytest.fixture(scope="module")
def undisturbed() -> list[dict[str, Any]]:
    """The numbers of a run on one process that nobody ended."""
    return numbers(run_study(study_from(document(), "small"), workers=1).rows)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(STUDY)
    return path


def lines(out: Path) -> list[bytes]:
    path = out / "draws.jsonl"
    return path.read_bytes().splitlines(keepends=True) if path.exists() else []


def started(file: Path, out: Path, workers: int) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tridentify", "study", str(file), "--out", str(out)]
    return subprocess.Popen(
        [*command, "--workers", str(workers)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def killed_after(process: subprocess.Popen[bytes], out: Path, count: int, pause: float) -> bool:
    """Kill once so many lines are there and a moment has passed; False if it ended before."""
    end = time.monotonic() + LONGEST
    while len(lines(out)) < count and process.poll() is None:
        assert time.monotonic() < end, "no line came"
        time.sleep(0.005)
    time.sleep(pause)
    process.send_signal(signal.SIGKILL)
    return process.wait(timeout=LONGEST) == -signal.SIGKILL


def test_a_result_is_what_studies_give(undisturbed: list[dict[str, Any]]) -> None:
    result = run_study(study_from(document() | {"draws": 1}), workers=1)
    assert isinstance(result, DeclaredResult)
    assert isinstance(result, StudyResult)
    assert len(undisturbed) == LINES
    assert numbers(result.rows) == [row for row in undisturbed if row["draw"] == 0]
    assert list(result.to_frame()["coefficient"][:4]) == ["a0", "b0", "a0", "b0"]


@pytest.mark.slow
def test_two_processes_give_the_numbers_of_one(undisturbed: list[dict[str, Any]]) -> None:
    counts: list[tuple[int, int]] = []
    result = run_study(
        study_from(document()), workers=2, progress=lambda *count: counts.append(count)
    )
    assert numbers(result.rows) == undisturbed
    assert counts[0] == (0, LINES)
    assert counts[-1] == (LINES, LINES)
    assert counts == sorted(counts)


@pytest.mark.parametrize("cut", [1, 40, 10_000])
@pytest.mark.fast("40")
def test_a_line_that_was_cut_short_is_done_again(
    tmp_path: Path, undisturbed: list[dict[str, Any]], cut: int
) -> None:
    study = study_from(document(), "small")
    run_study(study, out=tmp_path, workers=1)
    raw = (tmp_path / "draws.jsonl").read_bytes()
    (tmp_path / "draws.jsonl").write_bytes(raw[:-cut])
    counts: list[int] = []
    result = run_study(study, out=tmp_path, workers=1, progress=lambda done, _: counts.append(done))
    assert 0 < counts[0] < LINES
    assert numbers(result.rows) == undisturbed
    assert numbers([json.loads(line) for line in lines(tmp_path)]) == undisturbed


@pytest.mark.parametrize(
    "damage",
    [b"\0" * 60 + b"\n", b"{}\n", b"[1]\n", b'{"cell": 3}\n', b"\xff\xfe\n", b"\n"],
)
def test_lines_that_are_damaged_are_dropped(
    tmp_path: Path, undisturbed: list[dict[str, Any]], damage: bytes
) -> None:
    study = study_from(document() | {"draws": 1}, "small")
    run_study(study, out=tmp_path, workers=1)
    own = lines(tmp_path)
    (tmp_path / "draws.jsonl").write_bytes(b"".join([own[0], damage, *own[2:]]))
    run_study(study, out=tmp_path, workers=1)
    found = [json.loads(line) for line in lines(tmp_path)]
    assert numbers(found) == [row for row in undisturbed if row["draw"] == 0]


@pytest.mark.slow
def test_an_interrupt_keeps_what_is_done(tmp_path: Path, undisturbed: list[dict[str, Any]]) -> None:
    def interrupt(done: int, _: int) -> None:
        if done >= 20:
            raise KeyboardInterrupt

    study = study_from(document(), "small")
    with pytest.raises(KeyboardInterrupt):
        run_study(study, out=tmp_path, workers=1, progress=interrupt)
    assert 20 <= len(lines(tmp_path)) < LINES
    assert numbers(run_study(study, out=tmp_path, workers=2).rows) == undisturbed


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL there")
@pytest.mark.slow
def test_a_worker_that_dies_costs_nothing(
    tmp_path: Path, undisturbed: list[dict[str, Any]]
) -> None:
    killed: list[int] = []

    def kill(done: int, _: int) -> None:
        if done >= 20 and len(killed) < 4:
            for child in children(os.getpid()):
                os.kill(child, signal.SIGKILL)
                killed.append(child)

    study = study_from(document(), "small")
    assert numbers(run_study(study, out=tmp_path, workers=2, progress=kill).rows) == undisturbed
    assert killed
    assert numbers([json.loads(line) for line in lines(tmp_path)]) == undisturbed


def test_a_run_that_is_complete_does_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = study_from(document() | {"draws": 2}, "small")
    before = run_study(study, out=tmp_path, workers=1)
    monkeypatch.setattr(running, "rows_of", None)
    again = run_study(study, out=tmp_path, workers=1)
    assert again.rows == before.rows
    assert again.table() == before.table()


@pytest.mark.slow
def test_more_draws_go_on_and_fewer_count_the_first(
    tmp_path: Path, undisturbed: list[dict[str, Any]]
) -> None:
    study = study_from(document(), "small")
    run_study(study, out=tmp_path, workers=1, draws=3)
    assert len(lines(tmp_path)) == 24
    first = lines(tmp_path)
    assert numbers(run_study(study, out=tmp_path, workers=1).rows) == undisturbed
    assert lines(tmp_path)[:24] == first
    fewer = run_study(study, out=tmp_path, workers=1, draws=2)
    assert numbers(fewer.rows) == [row for row in undisturbed if row["draw"] < 2]
    assert {row.draws for row in fewer.statistics} == {2}


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        ("seed", 4, "other seed"),
        ("systems", {"first": {"num": [2.5], "den": [1, 4]}}, "other systems"),
        ("noises", {"white": {"ratio": [0.05, 0.3]}}, "other noises, grids"),
        ("methods", {"ours": {"kind": "three-model", "starts": 2}}, "other methods, grids"),
    ],
)
def test_other_settings_are_refused(tmp_path: Path, place: str, value: object, told: str) -> None:
    short = document() | {"draws": 1}
    run_study(study_from(short, "small"), out=tmp_path, workers=1)
    before = lines(tmp_path)
    with pytest.raises(OptionError) as error:
        run_study(study_from(short | {place: value}, "small"), out=tmp_path, workers=1)
    assert told in str(error.value)
    assert "choose another folder" in str(error.value)
    assert lines(tmp_path) == before


def _foreign(folder: Path) -> None:
    (folder / "study.json").write_text("{}")


def _without_settings(folder: Path) -> None:
    (folder / "draws.jsonl").write_text("")


@pytest.mark.parametrize("spoil", [_foreign, _without_settings])
def test_a_folder_of_something_else_is_refused(
    tmp_path: Path, spoil: Callable[[Path], None]
) -> None:
    spoil(tmp_path)
    with pytest.raises(UnreadableFileError, match="choose another folder"):
        run_study(study_from(document()), out=tmp_path, workers=1)


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputPathError, match="choose another folder"):
        run_study(study_from(document()), out=tmp_path / "file" / "out", workers=1)


@pytest.mark.skipif(os.name == "nt", reason="no locks there")
def test_two_runs_in_one_folder_are_refused(tmp_path: Path) -> None:
    with lock(tmp_path), pytest.raises(OutputPathError, match="another run at work"):
        run_study(study_from(document()), out=tmp_path, workers=1)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.slow
def test_a_full_disk_is_told_and_gone_on_with(
    tmp_path: Path, undisturbed: list[dict[str, Any]]
) -> None:
    study = study_from(document(), "small")
    run_study(study, out=tmp_path, workers=1, draws=1)
    kept = (tmp_path / "draws.jsonl").rename(tmp_path / "kept")
    (tmp_path / "draws.jsonl").symlink_to("/dev/full")
    store = running.DrawStore(tmp_path)
    with pytest.raises(OutputPathError, match="with room; draws that are done are kept"):
        store.append([{"cell": "x"}])
    (tmp_path / "draws.jsonl").unlink()
    kept.rename(tmp_path / "draws.jsonl")
    assert numbers(run_study(study, out=tmp_path, workers=1).rows) == undisturbed


@pytest.mark.parametrize(("name", "value"), [("workers", 0), ("draws", 0), ("seed", -1)])
def test_numbers_that_make_no_sense_are_refused(name: str, value: int) -> None:
    with pytest.raises(OptionError, match=f"found {name}={value}; expected a whole number"):
        run_study(study_from(document()), **{name: value})


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL there")
@pytest.mark.parametrize(
    ("workers", "kills"),
    [(1, 2), pytest.param(2, 20, marks=[pytest.mark.slow, pytest.mark.timeout(900)])],
)
@pytest.mark.slow
def test_kills_at_random_moments_lose_and_repeat_nothing(
    file: Path, tmp_path: Path, undisturbed: list[dict[str, Any]], workers: int, kills: int
) -> None:
    chance = random.Random(workers)
    out = tmp_path / "out"
    hits = 0
    for number in range(kills):
        there = len(lines(out))
        wanted = min(there + chance.randrange(1, 2 + LINES // (kills + 1)), LINES)
        process = started(file, out, workers)
        hits += killed_after(process, out, wanted if number else 1, chance.uniform(0.0, 0.1))
        assert len(lines(out)) >= there - 1, "whole lines were lost"
    assert hits > kills // 2
    process = started(file, out, workers)
    assert process.wait(timeout=LONGEST) == 0
    found = [json.loads(line) for line in lines(out)]
    assert len(found) == LINES
    assert numbers(found) == undisturbed
    assert {"table.txt", "statistics.json", "cells.svg"} <= {path.name for path in out.iterdir()}
