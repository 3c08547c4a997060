"""A fleet that is killed, cut short or asked twice: a clear outcome each, and every key once."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest

import fleets
from tridentify import Structure, fleet
from tridentify.errors import OptionError, OutputPathError, UnreadableFileError
from tridentify.fleet.store import Store
from tridentify.writing.lock import alone_in

pytestmark = pytest.mark.unjudged

COUNT = 28


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files of some units."""
    made = tmp_path_factory.mktemp("fleet") / "logs"
    fleets.write_files(made, fleets.units(COUNT, n=60))
    (made / "u0007.parquet").write_bytes(b"PAR1 and no more")
    return made


@pytest.fixture(scope="module")
def undisturbed(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    """What a serial run makes of them."""
    out = tmp_path_factory.mktemp("serial") / "out"
    return fleets.fit_files(str(folder), str(out), "1", progress=False).rows()


def killed_after(folder: Path, out: Path, workers: object, records: int) -> None:
    """Run until some records are done, kill a worker's child, then the run itself."""
    process = fleets.start(folder, out, workers)
    assert process.stdout is not None
    for line in process.stdout:
        if int(line) >= records:
            break
    process.send_signal(signal.SIGSTOP)  # so that it does not end meanwhile
    for child in fleets.children(process.pid)[:1]:
        os.kill(child, signal.SIGKILL)
    process.send_signal(signal.SIGKILL)
    process.communicate()


def test_a_killed_run_goes_on_where_it_was(
    folder: Path, undisturbed: pl.DataFrame, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    killed_after(folder, out, 1, 8)
    before = Store(out).keys()
    assert 8 <= len(before) < COUNT
    run = fleets.fit_files(str(folder), str(out), "2", progress=False)
    stored = pl.concat(pl.read_parquet(path) for path in run.store.files())
    assert stored.height == COUNT
    assert fleets.same(run.rows(), undisturbed)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(20))
def test_twenty_kills_at_random_moments(
    number: int, folder: Path, undisturbed: pl.DataFrame, tmp_path: Path
) -> None:
    """Children and parents killed at any moment, the start included; then one run to the end."""
    draw = random.Random(number)
    out = tmp_path / "out"
    for _ in range(2):
        process = fleets.start(folder, out, draw.choice([1, 2]))
        end = time.monotonic() + draw.uniform(0.2, 6.0)
        while time.monotonic() < end and process.poll() is None:
            time.sleep(draw.uniform(0.05, 1.0))
            found = fleets.children(process.pid)
            if found and draw.random() < 0.4:
                os.kill(draw.choice(found), signal.SIGKILL)
        process.kill()
        process.communicate()
    run = fleets.fit_files(str(folder), str(out), "2", progress=False)
    assert run.rows()["key"].is_unique().all()
    assert fleets.same(run.rows(), undisturbed)


@pytest.mark.slow
def test_a_worker_killed_meanwhile_costs_nothing(
    folder: Path, undisturbed: pl.DataFrame, tmp_path: Path
) -> None:
    told = []

    def kill(done: int, total: int | None) -> None:
        told.append((done, total))
        # once: a record that is under way when its child dies a second time ends as "crashed"
        if len(told) == 1:
            for child in fleets.children(os.getpid()):
                os.kill(child, signal.SIGKILL)

    run = fleets.fit_files(str(folder), str(tmp_path / "out"), "1", progress=kill)
    assert told[-1] == (COUNT, COUNT)
    assert fleets.same(run.rows(), undisturbed)


@pytest.fixture
def stored(undisturbed: pl.DataFrame, folder: Path, tmp_path: Path) -> Path:
    """A complete folder of results, in two parts."""
    out = tmp_path / "out"
    store = Store(out)
    # the settings of `fleets.fit_files`
    with alone_in(out):
        fleets_run = fleet.fit(
            {}, (2, 0), out=tmp_path / "other", judge=False, progress=False, **fleets.READING
        )
        store.begin(fleets_run.question.job.in_words(), resume=True)
    undisturbed[:15].write_parquet(store.parts / "part-a.parquet")
    undisturbed[15:].write_parquet(store.parts / "part-b.parquet")
    return out


def test_rows_of_a_part_cut_short_meanwhile_are_told_in_one_line(
    tmp_path: Path, undisturbed: pl.DataFrame
) -> None:
    store = Store(tmp_path / "out")
    store.parts.mkdir(parents=True)
    undisturbed.write_parquet(store.parts / "part-a.parquet")
    assert store.rows().height == COUNT
    part = store.parts / "part-a.parquet"
    part.write_bytes(part.read_bytes()[:-100])
    for columns in (None, ["status"]):
        with pytest.raises(UnreadableFileError, match=r"damaged part .*call fleet\.fit again"):
            store.rows(columns)


def test_a_truncated_part_is_set_aside_and_its_records_done_again(
    stored: Path, folder: Path, undisturbed: pl.DataFrame
) -> None:
    part = stored / "parts" / "part-b.parquet"
    part.write_bytes(part.read_bytes()[:-100])
    told: list[int] = []
    run = fleets.fit_files(
        str(folder), str(stored), "1", progress=lambda done, total: told.append(done)
    )
    assert told[0] > 15
    assert told[-1] == COUNT
    assert len(run.notes) == 1
    assert "part-b.parquet damaged" in run.notes[0]
    assert (stored / "parts" / "part-b.parquet.damaged").exists()
    assert fleets.same(run.rows(), undisturbed)


def test_a_complete_run_does_nothing_more(stored: Path, folder: Path) -> None:
    told: list[int] = []
    before = sorted((stored / "parts").iterdir())
    fleets.fit_files(str(folder), str(stored), "1", progress=lambda done, total: told.append(done))
    assert told == []
    assert sorted((stored / "parts").iterdir()) == before


def test_other_settings_are_refused_and_named(stored: Path, folder: Path) -> None:
    again = {"out": stored, "progress": False, "judge": False, **fleets.READING}
    with pytest.raises(OptionError, match=r"results of other settings.*structure.*Structure"):
        fleet.fit(f"{folder}/*.parquet", Structure(2, 1), **again)
    assert len(list((stored / "parts").glob("*.parquet"))) == 2
    run = fleet.fit(f"{folder}/u000*.parquet", Structure(2, 1), resume=False, **again)
    assert run.rows()["names"].to_list()[0] == ["a1", "a0", "b1", "b0"]
    assert run.rows().height == 10


def test_two_runs_in_one_folder(stored: Path, folder: Path) -> None:
    with (
        alone_in(stored),
        pytest.raises(OutputPathError, match="found another run at work in"),
    ):
        fleets.fit_files(str(folder), str(stored), "1", progress=False)


def test_a_folder_of_something_else(tmp_path: Path, folder: Path) -> None:
    (tmp_path / "manifest.json").write_text('{"mine": 1}')
    with pytest.raises(UnreadableFileError, match="no manifest of a fleet"):
        fleets.fit_files(str(folder), str(tmp_path), "1", progress=False)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputPathError, match="no way to make the folder"):
        fleets.fit_files(str(folder), str(tmp_path / "file"), "1", progress=False)


@pytest.mark.skipif(sys.platform == "win32", reason="limits of file sizes are of POSIX")
@pytest.mark.slow
def test_a_full_disk_ends_the_run_in_one_line_and_the_next_goes_on(
    folder: Path, undisturbed: pl.DataFrame, tmp_path: Path
) -> None:
    """A limit of the file size is what a full disk is to a part: a write that fails half way."""
    program = (
        "import resource, sys, fleets\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000))\n"
        "fleets.fit_files(*sys.argv[1:4], progress=False)"
    )
    out = tmp_path / "out"
    done = subprocess.run(
        [sys.executable, "-c", program, folder, out, "1"],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(Path(fleets.__file__).parent), *sys.path]),
        },
    )
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert "OutputPathError: found no way to write" in last
    assert "File too large" in last
    assert list((out / "parts").iterdir()) == []
    run = fleets.fit_files(str(folder), str(out), "1", progress=False)
    assert fleets.same(run.rows(), undisturbed)
