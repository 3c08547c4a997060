"""Samples taken in blocks leave the same bits as samples taken one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, online, simulate
from tridentify.online import estimator
from tridentify.online.kernels import slots
from tridentify.online.kernels.workspace import LONGEST, Workspace

DT = 0.05
PLANT = TransferFunction([2.0, 3.0], [1.0, 3.0, 9.0])
ALL_BUT_CHANGED = ~online.Flag.CHANGED.value  # which a step raises after it has found one

METHODS = {
    "least squares": online.RecursiveLeastSquares(filter=(1.0, 6.0, 9.0)),
    "complex filter": online.RecursiveLeastSquares(filter=(1.0, 3.0, 9.0)),
    "pair after a real pole": online.RecursiveLeastSquares(filter=(1.0, 5.0, 13.0, 9.0)),
    "searched": online.RecursiveLeastSquares(),
    "forgetting": online.RecursiveLeastSquares(filter=(1.0, 6.0, 9.0), forgetting=0.99),
    "directional": online.RecursiveLeastSquares(
        filter=(1.0, 6.0, 9.0), forgetting=0.99, forget="directional"
    ),
    "resetting": online.RecursiveLeastSquares(
        filter=(1.0, 6.0, 9.0), forgetting=0.99, forget="resetting"
    ),
    "Kalman": online.Kalman(filter=(1.0, 6.0, 9.0)),
    "gradient": online.Gradient(filter=(1.0, 6.0, 9.0)),
    "three models": online.ThreeModel(),
    "three models, started": online.ThreeModel(start=PLANT),
    "three models, forgetting": online.ThreeModel(forgetting=0.995),
}
STRUCTURES = {
    "rest": Structure(2, 1, offset=False, initial_state="rest"),
    "auto": Structure(2, 1),
    "proper": Structure(2, 2, offset=True, drift=False),
    "equilibrium": Structure(2, 1, offset=True, initial_state="equilibrium"),
    "late": Structure(2, 1, delay=0.13),
}


@pytest.fixture(autouse=True)
def every_record_is_long(monkeypatch):
    monkeypatch.setattr(estimator, "LONG_RECORD", 0)


def samples(seed: int, n_inputs: int, kind: str, count: int = 1500) -> tuple[Any, Any]:
    """A record with what may go wrong in it."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], (count // 8 + 1, n_inputs)).repeat(8, 0)[:count]
    y = np.zeros(count)
    for j in range(n_inputs):
        one = Record(u[:, j], u[:, j], dt=DT)
        y += (j + 1) * simulate(PLANT, one)[:, 0]
    y += 0.1 * rng.standard_normal(count)
    if kind == "coarse":
        y = np.round(y / 0.05) * 0.05
    if kind == "damaged":
        y[rng.random(count) < 0.01] += 30.0
        y[rng.random(count) < 0.005] = np.nan
        u[rng.random(count) < 0.003, 0] = np.nan
    if kind == "clipped":
        y = np.clip(y, -0.8, 0.8)
    if kind == "resting":
        u[600:1100] = 0.0
        y[600:1100] = 0.1 * rng.standard_normal(500)
    if kind == "changing":
        y[800:] *= 1.7
    return u, y[:, None]


def folded(method: Any, state: Any, u: Any, y: Any) -> tuple[Any, Any, Any]:
    innovations, flags = np.empty(len(y)), np.empty(len(y), dtype=np.int64)
    for k in range(len(y)):
        state, innovations[k] = method.step(state, u[k], y[k])
        flags[k] = int(state.values[slots.FLAGS])
    return state, innovations, flags


def compare(method: Any, structure: Structure, u: Any, y: Any) -> None:
    names = [f"u{j}" for j in range(u.shape[1])]
    begin = method.init(structure, DT, input_names=names, output_names=["y"])
    one, innovations, flags = folded(method, begin, u, y)
    two, together, seen = method.feed(begin, u, y)
    assert np.array_equal(innovations, together[:, 0], equal_nan=True)
    assert np.array_equal(flags & ALL_BUT_CHANGED, seen & ALL_BUT_CHANGED)
    assert one.changes == two.changes
    assert np.array_equal(one.values, two.values, equal_nan=True)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("kind", ["plain", "damaged"])
@pytest.mark.fast(
    "damaged-searched",
    "damaged-three models",
    "plain-gradient",
    "plain-forgetting",
    "plain-complex filter",
)
def test_blocks_are_steps_for_every_estimator(name, kind):
    compare(METHODS[name], STRUCTURES["auto"], *samples(1, 1, kind, 700))


@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("name", ["least squares", "forgetting", "three models"])
@pytest.mark.fast("three models-equilibrium", "least squares-*", "forgetting-*")
def test_blocks_are_steps_for_every_structure(name, structure):
    compare(METHODS[name], STRUCTURES[structure], *samples(2, 2, "plain", 700))


@pytest.mark.parametrize("kind", ["coarse", "clipped", "resting", "changing"])
@pytest.mark.parametrize("name", ["least squares", "three models"])
@pytest.mark.fast(
    "three models-clipped",
    "least squares-resting",
    "least squares-coarse",
    "least squares-clipped",
    "least squares-changing",
)
def test_blocks_are_steps_whatever_the_samples_are(name, kind):
    compare(METHODS[name], STRUCTURES["rest"], *samples(3, 1, kind))


@pytest.mark.slow
def test_blocks_are_steps_with_several_outputs():
    u, y = samples(4, 1, "damaged")
    y = np.hstack([y, samples(5, 1, "damaged")[1]])
    method = online.ThreeModel(start=PLANT)
    begin = method.init(STRUCTURES["auto"], DT, output_names=["q", "r"])
    state = begin
    found = np.empty(y.shape)
    for k in range(len(y)):
        state, found[k] = method.step(state, u[k], y[k])
    two, together, _ = method.feed(begin, u, y)
    assert np.array_equal(found, together, equal_nan=True)
    assert np.array_equal(state.values, two.values, equal_nan=True)


@pytest.mark.parametrize("name", ["forgetting", "three models"])
@pytest.mark.fast("forgetting")
def test_it_does_not_matter_where_a_record_is_cut(name):
    u, y = samples(6, 1, "damaged")
    method = METHODS[name]
    whole = method.init(STRUCTURES["auto"], DT)
    state = whole
    whole, _, _ = method.feed(whole, u, y)
    cuts = np.sort(np.random.default_rng(7).choice(len(y), 12, replace=False))
    for part in np.split(np.arange(len(y)), cuts):
        state, _, _ = method.feed(state, u[part], y[part])
    assert np.array_equal(whole.values, state.values, equal_nan=True)


@pytest.mark.parametrize("name", ["least squares", "forgetting", "three models, started"])
@pytest.mark.fast("least squares", "forgetting")
def test_quiet_samples_do_go_through_blocks(name):
    """Or the tests above would compare steps with steps."""
    u, y = samples(8, 1, "plain", 12_000)
    method = METHODS[name]
    state = method.init(STRUCTURES["rest"], DT)
    state, _, _ = method.feed(state, u[:3000], y[:3000])
    first = 3000
    # a look goes on sample by sample, and so does what the clock asks for
    while state.values[slots.SUSPECT] or 0 < state.values[slots.TICK] - first <= LONGEST:
        first += 1
        state, _, _ = method.feed(state, u[first - 1 : first], y[first - 1 : first])
    ints, x = state.stage.blueprint.ints, state.values.copy()
    taken = method.kernels().block()(
        ints, state.stage.blueprint.constants, x, u, y, first, 2000, np.empty(y.shape),
        np.empty(len(y), dtype=np.int64), *Workspace.of(ints, x),
    )  # fmt: skip
    assert taken == LONGEST
    assert x[slots.COUNT] == first + LONGEST


def test_a_record_that_cannot_be_written_to_is_taken():
    u, y = samples(9, 1, "plain", 300)
    for one in (u, y):
        one.setflags(write=False)
    method = METHODS["least squares"]
    state, _, _ = method.feed(method.init(STRUCTURES["rest"], DT), u, y)
    assert state.n_samples == 300


@pytest.mark.slow
def test_a_start_is_kept_until_the_samples_tell_the_poles():
    """A bank on poles that are mostly noise misses part of the output: that looks like a change."""
    stiff = TransferFunction([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0])
    method = online.ThreeModel(start=stiff)
    alarms = 0
    for seed in (7, 9, 12):
        rng = np.random.default_rng(seed)
        u = rng.choice([-1.0, 1.0], 500).repeat(8)[:2000]
        y = simulate(stiff, Record(u, u, dt=0.01))[:, 0]
        y += 10**-0.5 * y.std() * rng.standard_normal(y.size)
        run = online.run(
            method, Record(u, y, dt=0.01), Structure(4, 1, offset=False, initial_state="rest"),
            every=1e9,
        )  # fmt: skip
        alarms += run.changes.size
    assert alarms == 0


@pytest.mark.slow
def test_an_initial_state_that_is_long_forgotten_does_no_harm():
    """Its weight vanished, after some five hundred memories, and the estimate with it."""
    u, y = samples(10, 1, "plain", 80_000)
    method = online.ThreeModel(start=PLANT, forgetting=0.99, clock=1e4)
    state = method.init(STRUCTURES["auto"], DT)
    state, _, _ = method.feed(state, u, y)
    estimate = method.estimate(state)
    assert np.all(np.abs(estimate.theta - [3.0, 9.0, 2.0, 3.0]) < 5.0 * estimate.std)
