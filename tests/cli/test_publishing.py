"""A set of results is the old one or the new one, whenever the run that writes it is killed."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tridentify import Estimate, Record, Structure, SvfLeastSquares, identify
from tridentify.cli import publishing
from tridentify.cli.results import ResultFolder
from tridentify.writing import files
from tridentify.writing.files import DRAFT_AGE, PENDING, write_atomically

HELPER = Path(__file__).parent / "publish_and_die.py"
DRAFT = ".tridentify-0123abcd"

posix = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork and SIGKILL")


def publish(target: Path, content: str, names: tuple[str, ...] = ("a.png", "model.json")) -> None:
    with ResultFolder(target) as results:
        for name in names:
            (results.draft / name).write_text(content)
        results.publish()


def listing(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}


def age(path: Path, seconds: float) -> None:
    then = time.time() - seconds
    for item in (*path.rglob("*"), path):
        os.utime(item, (then, then))


def swaps(folder: Path) -> bool:
    """Whether the file system can swap two folders."""
    exchange = publishing._exchange_of_system()
    for name in ("one", "other"):
        (folder / name).mkdir(exist_ok=True)
    try:
        if exchange is not None:
            exchange(folder / "one", folder / "other")
    except OSError:
        return False
    return exchange is not None


# -------------------------------------------------------------------------------------- kill -9
@pytest.mark.slow
@posix
@pytest.mark.parametrize("way", ["new", "swap", "folder", "standing", "unlike"])
def test_a_kill_at_any_moment_leaves_the_old_set_or_the_new_one(way, tmp_path):
    done = subprocess.run(
        [sys.executable, HELPER, way], capture_output=True, text=True, timeout=250, check=False
    )
    assert done.returncode == 0, done.stderr
    moments = [line.split() for line in done.stdout.splitlines()]
    assert len(moments) > 15, done.stdout
    before = "absent" if way == "new" else "old"
    # the first kill is before all work, the last run was not killed
    assert moments[0][:2] == [before, before]
    assert moments[-1][:2] == ["new", "new"]
    for raw, read, kept, again in moments:
        assert read in (before, "new"), done.stdout
        assert (kept, again) == ("True", "True"), done.stdout
        # in one step where the system can; elsewhere a reader of models finds the whole set
        at_once = way == "new" or (way == "swap" and swaps(tmp_path))
        assert raw in (before, "new", *(() if at_once else ("mixed",))), done.stdout


@pytest.mark.unjudged
def test_a_model_is_read_from_the_set_that_was_complete(tmp_path):
    u = np.sign(np.sin(0.3 * np.arange(200.0)))
    record = Record(u, np.convolve(u, 0.9 ** np.arange(40.0))[:200], dt=0.1)
    estimate = identify(record, Structure(1, 0), SvfLeastSquares())
    publish(tmp_path, "old")
    (tmp_path / PENDING).mkdir()
    estimate.save(tmp_path / PENDING / "model.json")
    assert Estimate.load(tmp_path / "model.json").names == estimate.names
    # what is written later is newer
    (tmp_path / PENDING / "model.json").write_text("half")
    estimate.save(tmp_path / "model.json")
    assert Estimate.load(tmp_path / "model.json").names == estimate.names


# --------------------------------------------------------------------------- what is not ours
def test_other_files_stay_the_same_files(tmp_path):
    target = tmp_path / "out"
    publish(target, "old")
    (target / "notes.txt").write_text("mine")
    (target / "link").symlink_to("notes.txt")
    (target / ".hidden").write_text("mine too")
    before = {name: (target / name).lstat().st_ino for name in ("notes.txt", "link", ".hidden")}
    with (target / "notes.txt").open("a") as still_open:
        publish(target, "new")
        still_open.write(" as well")
    assert {name: (target / name).lstat().st_ino for name in before} == before
    assert (target / "notes.txt").read_text() == "mine as well"
    assert listing(target)["model.json"] == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@posix
def test_what_is_written_while_the_folders_are_swapped_is_kept(tmp_path, monkeypatch):
    target = tmp_path / "out"
    publish(target, "old")
    (target / "edited.txt").write_text("before")
    found = publishing._exchange_of_system()
    if found is None:
        pytest.skip("this system has no swap")

    def late(one: Path, other: Path) -> None:
        (target / "late.txt").write_text("mine")
        (target / "draft").write_text("after")
        os.replace(target / "draft", target / "edited.txt")
        found(one, other)

    monkeypatch.setattr(publishing, "_exchange_of_system", lambda: late)
    publish(target, "new")
    assert listing(target) == {
        "a.png": "new", "model.json": "new", "late.txt": "mine", "edited.txt": "after"
    }  # fmt: skip


@posix
def test_a_file_system_without_swap_gets_the_files_one_by_one(tmp_path, monkeypatch):
    target = tmp_path / "out"
    publish(target, "old")
    (target / "notes.txt").write_text("mine")
    tried = []

    def refused(one: Path, other: Path) -> None:
        tried.append((one, other))
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr(publishing, "_exchange_of_system", lambda: refused)
    publish(target, "new")
    assert tried
    assert listing(target) == {"a.png": "new", "model.json": "new", "notes.txt": "mine"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert len(list(target.iterdir())) == 3


def test_the_folder_one_stands_in_stays_the_same_folder(tmp_path, monkeypatch):
    publish(tmp_path / "out", "old")
    monkeypatch.chdir(tmp_path / "out")
    publish(Path(), "new")
    assert listing(Path()) == {"a.png": "new", "model.json": "new"}
    assert os.path.samefile(tmp_path / "out", ".")


@posix
def test_a_folder_of_a_link_is_replaced_not_the_link(tmp_path):
    publish(tmp_path / "run-1", "old")
    (tmp_path / "latest").symlink_to("run-1")
    publish(tmp_path / "latest", "new")
    assert (tmp_path / "latest").is_symlink()
    assert listing(tmp_path / "run-1") == {"a.png": "new", "model.json": "new"}


def test_a_file_that_cannot_be_moved_undoes_the_others(tmp_path, monkeypatch):
    publish(tmp_path, "old")
    (tmp_path / "raw").mkdir()
    move = os.replace

    def failing(source: Path, place: Path) -> None:
        if Path(place) == tmp_path / "model.json" and Path(source).read_text() == "new":
            raise PermissionError(1, "Operation not permitted")
        move(source, place)

    monkeypatch.setattr(os, "replace", failing)
    with pytest.raises(files.OutputPathError, match="Operation not permitted"):
        publish(tmp_path, "new", ("a.png", "model.json", "more.txt"))
    assert listing(tmp_path) == {"a.png": "old", "model.json": "old"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "model.json", "raw"]


# --------------------------------------------------------------------------------- old drafts
@pytest.mark.parametrize("where", [".", "out"])
def test_drafts_of_killed_runs_go_after_a_day(tmp_path, where):
    publish(tmp_path / "out", "old")
    for name, seconds in ((DRAFT, 1.1), (".tridentify-00000000", 0.9)):
        draft = tmp_path / where / name
        draft.mkdir()
        (draft / "report.html").write_text("half")
        age(draft, seconds * DRAFT_AGE)
    for name in (".tridentify-mine", ".tridentify-01234567.txt", ".other-0123abcd"):
        (tmp_path / where / name).mkdir()
        age(tmp_path / where / name, 9 * DRAFT_AGE)
    publish(tmp_path / "out", "new")
    left = {path.name for path in (tmp_path / where).iterdir() if path.is_dir()} - {"out"}
    names = {".tridentify-mine", ".tridentify-01234567.txt", ".other-0123abcd"}
    assert left == names | {".tridentify-00000000"}


@posix
def test_the_draft_of_a_run_that_goes_on_for_days_stays(tmp_path):
    with ResultFolder(tmp_path / "out") as results:
        age(results.draft, 3 * DRAFT_AGE)
        publish(tmp_path / "other", "new")
        assert results.draft.is_dir()
        (results.draft / "model.json").write_text("late")
        results.publish()
    assert listing(tmp_path / "out") == {"model.json": "late"}


def test_drafts_of_single_files_go_after_a_day(tmp_path):
    old, young, other = (
        tmp_path / name for name in (".m.json.0a1b2c3d", ".m.json.zzzzzzzz", ".n.json.0a1b2c3d")
    )
    for path in (old, young, other):
        path.write_text("half")
    age(old, 1.1 * DRAFT_AGE)
    age(other, 1.1 * DRAFT_AGE)
    write_atomically(tmp_path / "m.json", "whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ["m.json", young.name, other.name]
    )


# ------------------------------------------------------------------- permissions and durability
PERMISSIONS = """
import os, sys
from pathlib import Path
from tridentify.cli.results import ResultFolder
from tridentify.writing.files import write_atomically

os.umask(0o027)
changed = []
os.umask = lambda mask: changed.append(mask) or 0o027
with ResultFolder(Path("out")) as results:
    write_atomically(results.draft / "a.txt", "1")
    (results.draft / "b.txt").write_text("2")
    results.publish()
write_atomically("deep/c.txt", "3")
modes = [oct(Path(name).stat().st_mode & 0o777) for name in
    ("out", "out/a.txt", "out/b.txt", "deep", "deep/c.txt")]
os.chmod("out", 0o2770)
with ResultFolder(Path("out")) as results:
    write_atomically(results.draft / "a.txt", "4")
    results.publish()
print(*modes, oct(os.stat("out").st_mode & 0o7777), changed)
"""


@posix
def test_permissions_are_those_of_the_umask_which_nobody_changes(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", PERMISSIONS],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["0o750", "0o640", "0o640", "0o750", "0o640", "0o2770", "[]"], (
        done.stderr
    )


@posix
def test_everything_is_on_the_disk_before_it_gets_its_name(tmp_path, monkeypatch):
    log: list[str] = []
    fsync, replace, rename = os.fsync, os.replace, os.rename

    def named(number: int) -> str:
        return Path(os.readlink(f"/proc/self/fd/{number}")).name if sys.platform == "linux" else ""

    monkeypatch.setattr(os, "fsync", lambda n: (log.append(f"sync {named(n)}"), fsync(n))[1])
    monkeypatch.setattr(os, "replace", lambda a, b: (log.append("move"), replace(a, b))[1])
    monkeypatch.setattr(os, "rename", lambda a, b: (log.append("move"), rename(a, b))[1])
    write_atomically(tmp_path / "one.txt", "1")
    assert [line.split()[0] for line in log] == ["sync", "move", "sync"]
    if sys.platform == "linux":
        assert log[0].startswith("sync .one.txt.")
        assert log[2] == f"sync {tmp_path.name}"
    log.clear()
    publish(tmp_path / "out", "new")
    assert log.index("move") == 3  # two files and their folder
    assert log[-1].startswith("sync")


def test_a_device_is_written_to_not_replaced(tmp_path):
    if not Path("/dev/full").is_char_device():
        pytest.skip("needs /dev/full")
    with pytest.raises(files.OutputPathError, match="No space left"):
        write_atomically("/dev/full", "1")
    write_atomically("/dev/null", "1")
    assert Path("/dev/null").is_char_device()
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
        write_atomically(tmp_path / "pipe", "through")
        assert os.read(reader, 100) == b"through"
        os.close(reader)


def test_a_long_file_name_has_a_draft_too(tmp_path):
    name = "m" * 250 + ".json"
    assert write_atomically(tmp_path / name, "1").read_text() == "1"
    assert [path.name for path in tmp_path.iterdir()] == [name]


@posix
def test_an_interruption_while_a_draft_is_made_leaves_none(tmp_path, monkeypatch):
    made = publishing.make_draft

    def interrupted(folder: Path) -> Path:
        draft = made(folder)
        signal.raise_signal(signal.SIGINT)
        return draft

    monkeypatch.setattr(publishing, "make_draft", interrupted)
    with pytest.raises(KeyboardInterrupt), ResultFolder(tmp_path / "out"):
        pytest.fail("the interruption was forgotten")
    assert list(tmp_path.iterdir()) == []


@posix
def test_an_interruption_while_a_draft_is_removed_waits(tmp_path, monkeypatch):
    remove = shutil.rmtree

    def interrupted(*given: object, **options: object) -> None:
        signal.raise_signal(signal.SIGINT)
        remove(*given, **options)

    results = ResultFolder(tmp_path / "out").__enter__()
    (results.draft / "a.txt").write_text("half")
    monkeypatch.setattr(shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt):
        results.__exit__(None, None, None)
    assert list(tmp_path.iterdir()) == []
