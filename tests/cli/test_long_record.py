"""``tridentify identify`` takes a file that is too long for memory without being told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tridentify import Record, TransferFunction, simulate


@pytest.fixture
def long_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tridentify.cli.long_record.LONGEST_HELD", 60_000)
    rng = np.random.default_rng(1)
    u = np.repeat(rng.standard_normal(1_400), 50)
    y = simulate(TransferFunction([5.0], [1, 1.2, 9.0]), Record(u, u, dt=0.01))[:, 0]
    np.save(tmp_path / "run.npy", np.column_stack([u, y + 0.1 * rng.standard_normal(u.size)]))
    return tmp_path / "run.npy"


def test_a_long_file_is_read_in_parts(run, long_file: Path) -> None:
    out = run(
        "identify", long_file, "--input", "x[0]", "--output", "x[1]", "--dt", 0.01, "--poles", 2,
        "--zeros", 0, "--intersample", "zoh", "--json",
    )  # fmt: skip
    assert out.code == 0, out.err
    assert "read in parts" in out.err
    found = json.loads(out.out)
    assert found["record"]["n_samples"] == 70_000
    assert "judged-on-stretch" in [one["code"] for one in found["findings"]]
    values = {one["name"]: one for one in found["parameters"]}
    assert abs(values["a0"]["value"] - 9.0) < 4 * values["a0"]["std"]


@pytest.mark.slow
def test_what_needs_memory_is_read_whole_and_said(run, long_file: Path) -> None:
    out = run(
        "identify", long_file, "--input", "x[0]", "--output", "x[1]", "--dt", 0.01, "--poles", 2,
        "--zeros", 0, "--intersample", "zoh", "--fix", "a0=9",
    )  # fmt: skip
    assert out.code == 0, out.err
    assert "whole file is read into memory" in out.err
    assert "judged" not in out.out
