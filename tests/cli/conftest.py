"""A command line in this process, and records whose truth is known, written as CSV files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from tridentify.cli import main

DT = 0.02
DEN = (1.0, 3.0, 9.0)


@dataclass(frozen=True)
class Outcome:
    """What one call of the command line left."""

    code: int
    out: str
    err: str

    @property
    def error_lines(self) -> list[str]:
        return [line for line in self.err.splitlines() if "error:" in line]


Run = Callable[..., Outcome]
Columns = dict[str, np.ndarray]
Held = Callable[[Sequence[float], np.ndarray], np.ndarray]
WriteTable = Callable[[str, Columns], Path]
TableAt = Callable[[Path, Columns], Path]


@pytest.fixture(autouse=True)
def one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn in this process: to start another one takes longer than to draw them."""
    monkeypatch.setattr("tridentify.cli.artist.worth_it", lambda: False)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    """Call the command line with arguments of any type."""

    def call(*arguments: object) -> Outcome:
        capsys.readouterr()
        code = main([str(argument) for argument in arguments])
        return Outcome(code, *capsys.readouterr())

    return call


def pulses(n: int = 600) -> np.ndarray:
    """3-2-1-1, at rest for one second before."""
    u = np.zeros(n)
    for start, stop, sign in ((50, 125, 1), (125, 175, -1), (175, 200, 1), (200, 225, -1)):
        u[start:stop] = 0.05 * sign
    return u


@pytest.fixture(scope="session")
def held() -> Held:
    """Response of num/(s^2 + 3 s + 9) from rest to an input held between samples of 0.02 s."""

    def response(num: Sequence[float], u: np.ndarray) -> np.ndarray:
        b, a, _ = signal.cont2discrete((num, DEN), DT, method="zoh")
        return np.asarray(signal.lfilter(b.ravel(), a, u))

    return response


@pytest.fixture(scope="session")
def table_at() -> TableAt:
    """Write columns as a CSV file without loss of digits."""

    def write(path: Path, columns: Columns) -> Path:
        rows = np.column_stack(list(columns.values())).tolist()
        lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    return write


@pytest.fixture
def write_table(table_at: TableAt, tmp_path: Path) -> WriteTable:
    """The same by name, in the folder of the test."""
    return lambda name, columns: table_at(tmp_path / name, columns)


@pytest.fixture
def clean(held: Held) -> Columns:
    """Columns t, elevator and q of q/elevator = (2 s + 3) / (s^2 + 3 s + 9), without noise."""
    u = pulses()
    return {"t": DT * np.arange(u.size), "elevator": u, "q": held([2.0, 3.0], u)}


@pytest.fixture
def manoeuvre(write_table: WriteTable, clean: Columns) -> Path:
    """The same as a file."""
    return write_table("manoeuvre.csv", clean)


@pytest.fixture
def noisy(write_table: WriteTable, clean: Columns) -> Path:
    """The same with a few percent of noise on q."""
    noise = 1e-3 * np.random.default_rng(3).standard_normal(clean["q"].size)
    return write_table("noisy.csv", clean | {"q": clean["q"] + noise})


@pytest.fixture
def short(write_table: WriteTable, clean: Columns) -> Path:
    """The 200 samples in which the elevator moves, with the same noise: for many models."""
    noise = 1e-3 * np.random.default_rng(3).standard_normal(clean["q"].size)
    columns = clean | {"q": clean["q"] + noise}
    return write_table("short.csv", {name: column[40:240] for name, column in columns.items()})


@pytest.fixture
def question() -> list[str]:
    """The options that ask for the model of these files."""
    return ["--input", "elevator", "--output", "q", "--poles", "2", "--zeros", "1"]
