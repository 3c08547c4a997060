"""Damaged checkpoints of a stream: refused in one line, or gone on with; never a crash."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tridentify.cli import main

MUTANTS = 60


@pytest.fixture(scope="module", params=[pytest.param(0.0, marks=pytest.mark.slow), 0.1])
def folder(request, tmp_path_factory):
    """A stream with gaps and bad lines that was stopped at three places."""
    folder = tmp_path_factory.mktemp("fuzz")
    (folder / "checkpoints").mkdir()
    rng = np.random.default_rng(2)
    u = np.repeat(rng.standard_normal(80), 4)
    y = np.cumsum(u) / 20.0 + 0.1 * rng.standard_normal(320)
    lines = [f"{k * 0.05:.3f},{u[k]:.5f},{y[k]:.5f}\n" for k in range(320) if not 100 < k < 104]
    lines[50], lines[120] = "2.5,x,1\n", "6.1,0.5,\n"
    (folder / "asked.json").write_text(json.dumps({"delay": request.param, "every": 2.0}))
    question = [
        "stream", str(folder / "data.csv"), "--input", "u", "--output", "y", "--poles", "2",
        "--zeros", "1", "--delay", str(request.param), "--every", "2",
        "--method", "recursive-least-squares", "--filter", "1,4,4", "--forgetting", "0.999",
    ]  # fmt: skip
    for count in (40, 110, 200):
        (folder / "data.csv").write_text("t,u,y\n" + "".join(lines[:count]))
        kept = folder / "checkpoints" / f"{count}.json"
        assert main([*question, "--checkpoint", str(kept)]) == 0
    (folder / "data.csv").write_text("t,u,y\n" + "".join(lines))
    return folder


def test_a_damaged_checkpoint_is_refused_or_goes_on(folder, seeds, mutants):
    told = mutants("checkpoints", folder, seeds, MUTANTS)
    assert set(told) == {"refused", "ran on"}
