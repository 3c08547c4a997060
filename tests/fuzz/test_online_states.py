"""Damaged on-line states: refused in one line, or gone on with; no crash, no endless loop."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Structure, TransferFunction, online

START = TransferFunction([0.3, 0.4], [1.0, 1.5, 2.5])
FILTER = (1.0, 4.0, 4.0)
ESTIMATORS = {
    "three-model": online.ThreeModel(),
    "three-model-start": online.ThreeModel(start=START, forgetting=0.99, forget="directional"),
    "least-squares": online.RecursiveLeastSquares(filter=FILTER, forgetting=0.99),
    "least-squares-resetting": online.RecursiveLeastSquares(start=START, forget="resetting"),
    "kalman": online.Kalman(filter=FILTER),
    "gradient": online.Gradient(gamma=2.0),
    "gradient-start": online.Gradient(start=START, rate=0.5),
}
SHAPES = {"free": ({}, 1), "late": ({"delay": 0.12, "initial_state": "free"}, 1), "two": ({}, 2)}
MOMENTS = (0, 3, 25, 120)
MUTANTS = 120


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """States of every estimator, before, during and after the start; with missing samples."""
    folder = tmp_path_factory.mktemp("fuzz")
    (folder / "states").mkdir()
    rng = np.random.default_rng(1)
    u = np.repeat(rng.standard_normal((60, 1)), 3, axis=0)
    y = np.cumsum(u, axis=0) / 10.0 + 0.1 * rng.standard_normal((180, 1))
    y[::17], u[20::41] = np.nan, np.nan
    for name, method in ESTIMATORS.items():
        for shape, (known, channels) in SHAPES.items():
            names = [f"y{i}" for i in range(channels)]
            if name.endswith("start") and channels > 1:
                continue
            state = method.init(Structure(2, 1, **known), 0.05, output_names=names)
            # a search takes long: that one is seen before it only
            for k in range(121 if name != "three-model" else 26):
                if k in MOMENTS:
                    state.save(folder / "states" / f"{name}-{shape}-{k}.json")
                state, _ = method.step(state, u[k], np.repeat(y[k], channels))
    return folder


def test_a_damaged_state_is_refused_or_runs_on(folder, seeds, mutants):
    told = mutants("states", folder, seeds, MUTANTS)
    assert set(told) == {"refused", "not ready", "ran on"}
