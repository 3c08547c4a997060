"""Streams that are closed, full or no longer read, and Ctrl-C at any moment: one line, one code."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tridentify.cli import entry

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs a POSIX shell")

FULL = "found no way to go on ([Errno 28] No space left on device)"
CLOSED = "found standard output closed"


def shell(command: str, *, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a line of bash in which $T is the program."""
    environment = os.environ | {"T": f"{sys.executable} -m tridentify", "NO_COLOR": "1"}
    return subprocess.run(
        ["bash", "-c", command],
        env=environment,
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
    )


@pytest.mark.parametrize(
    ("command", "code", "says"),
    [
        ("$T --version >&-", 2, CLOSED),
        pytest.param("$T identify --help >&-", 2, CLOSED, marks=pytest.mark.slow),
        ("$T --version >/dev/full", 2, FULL),
        pytest.param("$T identify --help >/dev/full", 2, FULL, marks=pytest.mark.slow),
        ("$T identify --help | head -1; exit ${PIPESTATUS[0]}", 0, ""),
        ("$T stream --input u --output y --poles 1 --zeros 0 <&-", 2, "standard input closed"),
        pytest.param("$T channels none.csv 2>/dev/full", 2, "", marks=pytest.mark.slow),
        pytest.param("$T channels none.csv 2>&-", 2, "", marks=pytest.mark.slow),
        ("$T channels none.csv <&- >&- 2>&-", 2, ""),
        pytest.param("$T --version 2>&-", 0, "", marks=pytest.mark.slow),
        pytest.param("$T --version <&-", 0, "", marks=pytest.mark.slow),
    ],
)
@pytest.mark.fast("$T --version >/dev/full*")
def test_a_stream_that_cannot_be_used_ends_in_one_line(command, code, says, tmp_path):
    done = shell(command, cwd=tmp_path)
    assert done.returncode == code, done.stderr
    lines = done.stderr.splitlines()
    assert len(lines) == (1 if says else 0), done.stderr
    assert says in done.stderr
    assert "error" not in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    "messages",
    [
        "2>&-",
        pytest.param("2>/dev/full", marks=pytest.mark.slow),
        pytest.param("2> >(exec <&-; sleep 9)", marks=pytest.mark.slow),
    ],
)
def test_results_come_although_nobody_reads_the_messages(messages, noisy, question):
    done = shell(f"$T identify {noisy} {' '.join(question)} --json {messages}")
    assert done.returncode == 0
    assert done.stdout.startswith("{")
    assert done.stdout.endswith("}\n")
    assert "tridentify: " not in done.stdout


@pytest.mark.slow
def test_no_file_takes_the_place_of_a_closed_stream(noisy, question, tmp_path):
    words = " ".join(question)
    done = shell(f"$T identify {noisy} {words} --out {tmp_path}/out <&- 2>&-")
    assert done.returncode == 0
    for path in (tmp_path / "out").iterdir():
        assert b"tridentify: " not in path.read_bytes(), path.name


# ---------------------------------------------------------------------------------------- Ctrl-C
WAITING = """
import os, signal, sys
class Pressed:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Pressed())
from tridentify.cli import main
sys.argv = ["tridentify", *{words!r}]
sys.exit(main())
"""


@pytest.mark.parametrize(
    "name",
    [
        "tridentify.cli.app",
        "numpy",
        "numba",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("typer", "scipy.linalg")),
    ],
)
@pytest.mark.fast("numpy")
def test_ctrl_c_while_the_program_is_loaded(name, noisy, question):
    code = WAITING.format(name=name, words=["identify", str(noisy), *question])
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=250, check=False
    )
    assert done.returncode == 130, done.stderr
    assert done.stderr.splitlines()[-1] == "tridentify: interrupted"
    assert "Traceback" not in done.stderr
    assert "ignored" not in done.stderr
    assert done.stdout == ""


CLEARING_UP = """
import os, signal, sys, time, weakref
from tridentify.cli import app, main
class Thing:
    pass
def pressed(_):
    os.kill(os.getpid(), signal.SIGINT)
def run(arguments):
    thing = Thing()
    reference = weakref.ref(thing, pressed)
    del thing
    time.sleep(60)
app.run = run
sys.argv = ["tridentify", "--version"]
sys.exit(main())
"""


def test_ctrl_c_while_something_is_cleared_up_is_not_lost():
    done = subprocess.run(
        [sys.executable, "-c", CLEARING_UP],
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert done.returncode == 130, done.stderr
    assert done.stderr == "tridentify: interrupted\n"


BEGINNING = """
import sys
class Begun:
    def find_spec(self, name, path=None, target=None):
        if name == "tridentify.cli.app":
            print("begun", flush=True)
sys.meta_path.insert(0, Begun())
from tridentify.cli import main
sys.argv = ["tridentify", *{words!r}]
sys.exit(main())
"""
"""The program, which tells when Python's own beginning is over: none of ours can answer there."""


@pytest.mark.slow
def test_ctrl_c_at_any_moment(noisy, question, tmp_path):
    command = ["identify", str(noisy), *question, "--out", str(tmp_path / "out")]
    code = BEGINNING.format(words=command)

    def interrupted_after(seconds):
        with subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdout.readline() == "begun\n"
            time.sleep(seconds)
            process.send_signal(signal.SIGINT)
            _, messages = process.communicate(timeout=60)
        return process.returncode, messages

    began = time.monotonic()
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    whole = time.monotonic() - began
    for part in range(30):
        ended, messages = interrupted_after(part * whole / 30)
        assert ended in (0, 130), messages
        assert "Traceback" not in messages, messages
        assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_the_way_in_is_light():
    code = "import sys, tridentify.cli; print(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    assert not loaded & {
        "numpy",
        "scipy",
        "numba",
        "rich",
        "typer",
        "click",
        "matplotlib",
        "jinja2",
    }


def test_called_from_python_ctrl_c_is_left_to_the_caller():
    before = signal.getsignal(signal.SIGINT)
    assert entry.main(["--version"]) == 0
    assert signal.getsignal(signal.SIGINT) is before
