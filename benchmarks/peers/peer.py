"""The packages, their environments, and a batch of records through one of them."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ENVIRONMENTS = HERE / ".environments"
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Peer:
    """A package and the ways of estimating that its ``fit`` script knows.

    Attributes
    ----------
    name : str
        Folder beside this file.
    ways : dict
        Way -> most noise draws.
    """

    name: str
    ways: dict[str, int]


PEERS = (
    Peer("tridentify", {"ThreeModel()": 100, "ThreeModel(), told": 100}),
    Peer(
        "sippy",
        {
            "OE": 100, "OE, tuned": 100, "ARX": 100, "N4SID": 100, "N4SID, tuned": 100,
            "PARSIM-K, tuned": 100,
        },
    ),
    Peer("jax-sysid", {"LinearModel": 30, "LinearModel, tuned": 30, "CTModel, tuned": 30}),
    Peer("pysindy", {"weak form": 100, "weak form, tuned": 30}),
    Peer("octave", {"moen4": 100, "moen4, tuned": 100, "n4sid, tuned": 30}),
)  # fmt: skip


class NotInstalledError(Exception):
    """Why a peer cannot run here, in one line."""


def command(peer: Peer) -> list[str]:
    """What starts a peer's script, its environment made if need be.

    Raises
    ------
    NotInstalledError
    """
    if peer.name == "octave":
        octave = shutil.which("octave-cli")
        if octave is None:
            raise NotInstalledError("no octave-cli on the path")
        return [octave, "--no-history", "--quiet", str(HERE / "octave" / "fit.m")]
    script = str(HERE / peer.name / "fit.py")
    if peer.name == "tridentify":
        return [sys.executable, script]
    return [str(environment(peer.name)), script]


def environment(name: str) -> Path:
    """Interpreter of a peer's own environment, which holds what its requirements say."""
    folder = ENVIRONMENTS / name
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    requirements = HERE / name / "requirements.txt"
    stamp = folder / ".installed"
    if stamp.exists() and stamp.read_text() == requirements.read_text():
        return python
    print(f"installing {name}", file=sys.stderr, flush=True)
    ENVIRONMENTS.mkdir(exist_ok=True)
    (ENVIRONMENTS / ".gitignore").write_text("*\n")
    shutil.rmtree(folder, ignore_errors=True)
    _checked([sys.executable, "-m", "venv", "--without-pip", str(folder)])
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    _checked([*pip, "--python", str(python), "install", "-r", str(requirements)])
    stamp.write_text(requirements.read_text())
    return python


def _checked(arguments: list[str]) -> None:
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    if done.returncode:
        raise NotInstalledError(_one_line(done.stderr))


def _one_line(text: str) -> str:
    """The line of an output that says what went wrong, without addresses and folders."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if line.lower().startswith("error")]
    line = (errors or lines or ["no message"])[-1]
    line = re.sub(r"\S*://\S+", "(address)", line)
    return re.sub(r"(?<!\w)/[\w.\-+/]+/", "", line)[:160]


@dataclass(eq=False)
class Batch:
    """What came back from one way of one peer on the records of one case."""

    answers: list[dict[str, Any]] = field(default_factory=list)
    versions: dict[str, str] = field(default_factory=dict)
    stopped: bool = False


def run(
    start: Sequence[str], way: str, poles: int, zeros: int, files: Sequence[Path], limit: int
) -> Batch:
    """Send record files through one way of one peer, in a process of its own.

    Parameters
    ----------
    start : sequence of str
        From `command`.
    files : sequence of Path
    limit : int
        Processor time for a process [s]. What has not been answered then counts neither for nor
        against the peer, unless nothing has been answered at all.

    Notes
    -----
    A process that dies counts as a failure on the record that it was at; the others go on in a new
    process.
    """
    batch = Batch()
    left = list(files)
    while left and not batch.stopped:
        answered = _process(batch, [*start, way, str(poles), str(zeros), *map(str, left)], limit)
        left = left[answered:]
        if left and not batch.stopped:
            left = left[1:]
    if batch.stopped and not batch.answers:
        message = f"no answer within {limit} s"
        batch.answers.append({"error": "Timeout", "message": message})
    return batch


def _process(batch: Batch, arguments: list[str], limit: int) -> int:
    """Collect the answers of one process; how many there were."""
    environment = os.environ | dict.fromkeys(THREADS, "1")
    answered = 0
    with tempfile.TemporaryFile("w+") as complaints:
        process = subprocess.Popen(
            ["/bin/sh", "-c", f'ulimit -t {limit}; exec "$@"', "peer", *arguments],
            stdout=subprocess.PIPE,
            stderr=complaints,
            text=True,
            env=environment,
        )
        try:
            assert process.stdout is not None
            for line in process.stdout:
                try:
                    facts = json.loads(line)
                except ValueError:
                    continue
                if "versions" in facts:
                    batch.versions = facts["versions"]
                elif "file" in facts:
                    batch.answers.append(facts)
                    answered += 1
            code = process.wait()
        finally:
            process.kill()
            process.wait()
        batch.stopped = code in (-signal.SIGXCPU, -signal.SIGKILL)
        if code and not batch.stopped:
            complaints.seek(0)
            message = _one_line(complaints.read())
            batch.answers.append({"error": "Ended", "message": f"code {code}: {message}"})
    return answered
