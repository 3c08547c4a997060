"""Fleets whose truth is known, units that go wrong, and runs in a process that may be killed.

Imported by the worker processes too, by this name.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tridentify import (
    Estimate,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    fleet,
    simulate,
)

DT = 0.1
TRUTH = np.array([1.0, 3.0, 0.5])
READING: dict[str, Any] = {
    "inputs": ["u"],
    "outputs": ["y"],
    "time": "t",
    "intersample": "zoh",
}


def unit(
    rng: np.random.Generator,
    theta: np.ndarray = TRUTH,
    n: int = 120,
    noise: float = 0.1,
    name: str = "",
) -> Record:
    """One record of b0 / (s^2 + a1 s + a0) from rest, noise as a share of the response."""
    u = np.repeat(np.sign(rng.standard_normal(n // 5 + 1)), 5)[:n]
    model = TransferFunction([theta[2]], [1.0, theta[0], theta[1]])
    y = simulate(model, Record(u, u, dt=DT, intersample="zoh"))[:, 0]
    y = y + noise * y.std() * rng.standard_normal(n)
    return Record(u, y, dt=DT, intersample="zoh", name=name)


def units(count: int, seed: int = 0, **options: Any) -> dict[str, Record]:
    """Some of them, by key."""
    rng = np.random.default_rng(seed)
    return {f"u{k:04d}": unit(rng, name=f"u{k:04d}", **options) for k in range(count)}


def frame_of(records: dict[str, Record]) -> pl.DataFrame:
    """All records in one frame, with a column ``unit``."""
    return pl.concat(
        pl.DataFrame({"unit": [key] * len(r.t), "t": r.t, "u": r.u[:, 0], "y": r.y[:, 0]})
        for key, r in records.items()
    )


def write_files(folder: Path, records: dict[str, Record]) -> None:
    """One Parquet file a record."""
    folder.mkdir(parents=True, exist_ok=True)
    for key, record in records.items():
        frame_of({key: record}).drop("unit").write_parquet(folder / f"{key}.parquet")


@dataclass(frozen=True)
class Moody:
    """`ThreeModel`, but what a record is called decides whether it comes to that."""

    name: str = "moody"

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Any = None
    ) -> Estimate:
        mood = records[0].name
        if mood == "hang":
            time.sleep(60.0)
        if mood == "crash":
            os.kill(os.getpid(), signal.SIGSEGV)
        if mood == "grow":
            np.ones(1 << 40)
        if mood == "raise":
            raise ZeroDivisionError("of the method's own making")
        return ThreeModel().estimate(records, structure, progress)


COMPARED = [name for name in fleet.COLUMNS if name != "seconds"]


def same(one: pl.DataFrame, other: pl.DataFrame) -> bool:
    """Whether two runs have the same rows, but for the time they took."""
    return one.select(COMPARED).equals(other.select(COMPARED))


def fit_files(folder: str, out: str, workers: str, **options: Any) -> fleet.Run:
    """A run over a folder of files."""
    return fleet.fit(
        f"{folder}/*.parquet",
        (2, 0),
        out=out,
        workers=int(workers) if workers.isdigit() else workers,
        judge=False,
        **READING,
        **options,
    )


def start(folder: Path, out: Path, workers: object) -> subprocess.Popen[bytes]:
    """`fit_files` in a process of its own."""
    program = (
        "import sys, fleets\n"
        "fleets.fit_files(*sys.argv[1:4], progress=lambda done, total: "
        "(sys.stdout.write(f'{done}\\n'), sys.stdout.flush()))"
    )
    return subprocess.Popen(
        [sys.executable, "-c", program, folder, out, str(workers)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])},
    )


def children(pid: int) -> list[int]:
    """Processes that a process started."""
    found = subprocess.run(
        ["ps", "-ww", "-o", "pid=,args=", "--ppid", str(pid)],
        capture_output=True,
        text=True,
        check=False,
    )
    return [int(line.split()[0]) for line in found.stdout.splitlines() if "workers.child" in line]


@dataclass(frozen=True)
class Sleepy:
    """A method that takes a minute over anything."""

    name: str = "sleepy"

    def estimate(
        self, records: Sequence[Record], structure: Structure, progress: Any = None
    ) -> Estimate:
        time.sleep(60.0)
        return ThreeModel().estimate(records, structure, progress)
