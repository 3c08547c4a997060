"""The scatter of the scores: gathered rightly, and what the standard errors make of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.signal
import scipy.stats

from tridentify import Record, Structure, TransferFunction, online, simulate
from tridentify.estimation.likelihood.cost import evaluate_variant
from tridentify.estimation.likelihood.curvature import physical_map
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.estimation.likelihood.setup.problem import Variant
from tridentify.numerics.realization import sort_poles
from tridentify.online import scatter as room
from tridentify.online import steps
from tridentify.online.equation_plan import from_directions
from tridentify.online.kernels import slots
from tridentify.online.kernels.intake import scatter
from tridentify.online.steps import coefficients_of_directions

DT = 0.05
PLANT = TransferFunction([3.0], [1.0, 4.0, 3.0])
REST = Structure(2, 0, offset=False, initial_state="rest")


def noisy(seed: int, *, coloured: bool, count: int = 1500) -> Record:
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], count // 8 + 1).repeat(8)[:count]
    clean = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
    noise = rng.standard_normal(count + 100)
    if coloured:
        noise = scipy.signal.lfilter([1.0, 0.9], [1.0, -1.0, 0.2], noise)
    noise = noise[100:] / noise.std()
    return Record(u, clean + 0.3 * clean.std() * noise, dt=DT)


@pytest.mark.parametrize("forgetting", [1.0, 0.99])
def test_the_sums_are_those_of_a_dense_computation(forgetting):
    method = online.RecursiveLeastSquares(filter=(1.0, 4.0, 4.0), forgetting=forgetting)
    state = method.init(REST, DT)
    blueprint, x = state.stage.blueprint, state.values.copy()
    ints, c = blueprint.ints, blueprint.constants
    k, w = int(ints[slots.DIRECTIONS]), int(ints[slots.AT_WATCH])
    at = w + slots.SCORES + k
    lower = np.tril_indices(k)
    rng = np.random.default_rng(1)
    scores, blocks = rng.standard_normal((70, k)), []
    for s in scores:
        g = rng.standard_normal((5, k))
        blocks.append(g.T @ g)
        x[at : at + k] = s
        x[at + k : at + k + lower[0].size] = blocks[-1][lower]
        scatter(ints, c, x, w)
    found = room.scatter_of(blueprint, x, 0)
    keep = forgetting ** float(ints[slots.BLOCK])
    ages = np.arange(70)[::-1]
    assert np.allclose(
        found.information, sum(keep**a * m for a, m in zip(ages, blocks, strict=True))
    )
    for level in range(4):
        size = 4**level
        joined = scores[: 70 // size * size].reshape(-1, size, k).sum(axis=1)
        old = keep ** (size * np.arange(len(joined))[::-1])
        assert found.blocks[level] == pytest.approx(old.sum())
        assert np.allclose(found.products[level], (old[:, None] * joined).T @ joined)


@pytest.mark.parametrize(
    "poles", [[-1.0, -3.0], [-0.5 + 4j, -0.5 - 4j], [-1.0, -0.3 + 2j, -0.3 - 2j]]
)
def test_coefficients_follow_from_the_directions_as_off_line(poles):
    poles = sort_poles(np.array(poles, dtype=np.complex128))
    n = poles.size
    rng = np.random.default_rng(2)
    u = rng.choice([-1.0, 1.0], (300, 2))
    y = rng.standard_normal((300, 2))
    structure = Structure(n, [[n - 1, 0], [1, n]], offset=False, initial_state="rest")
    record = Record(u, y, dt=DT)
    problem = build([record], structure, Nuisances("rest", False, False))
    point = evaluate_variant(problem, Variant(False, False, False, (None,)), poles)
    expected, keys = physical_map(point)
    state = online.ThreeModel().init(
        structure, DT, input_names=["u1", "u2"], output_names=["y1", "y2"]
    )
    setting = state.stage.setting
    found = from_directions(setting, poles)
    order = [keys["a"], *[keys[i, ("b", j)] for i in range(2) for j in range(2)]]
    columns = np.concatenate([np.arange(place.start, place.stop) for place in order])
    assert np.allclose(found, expected[:, columns])
    own = coefficients_of_directions(setting)
    assert sorted(set(np.concatenate(own).tolist()) - {-1}) == list(range(len(setting.names)))


def ended(record: Record) -> tuple[Any, Any]:
    run = online.run(online.ThreeModel(), record, REST, every=1e9)
    return run.state, run.estimate


def without_scatter(monkeypatch: pytest.MonkeyPatch, state: Any) -> Any:
    with monkeypatch.context() as patch:
        patch.setattr(steps, "with_scatter", lambda blueprint, x, cov, *rest: cov)
        return state.method.estimate(state)


def test_the_bread_is_the_covariance_under_white_noise(monkeypatch):
    state, _ = ended(noisy(3, coloured=False))
    plain = without_scatter(monkeypatch, state)
    seen = room.scatter_of(state.stage.blueprint, state.values, 0)
    live = np.diagonal(seen.information) > 0
    assert live.sum() == 3
    move = from_directions(state.stage.setting, state.stage.poles)
    inverse = np.linalg.inv(seen.information[np.ix_(live, live)])
    bread = move @ inverse @ move.T * plain.noise_variance[0]
    assert np.allclose(bread, plain.cov, rtol=0.25, atol=0.05 * np.abs(plain.cov).max())


@pytest.mark.slow
def test_turning_the_directions_changes_no_standard_error():
    state, estimate = ended(noisy(4, coloured=True))
    stage, x = state.stage, state.values.copy()
    setting, blueprint = stage.setting, stage.blueprint
    own = coefficients_of_directions(setting)
    map_ = from_directions(setting, stage.poles)
    white = np.linalg.inv(np.diag([3.0, 2.0, 1.0]) + 0.5)
    variance = estimate.noise_variance
    before = room.with_scatter(blueprint, x, white, variance, own, map_)
    turn = np.random.default_rng(5).standard_normal((3, 3))
    room.turn_scatter(blueprint, x, own, turn)
    after = room.with_scatter(blueprint, x, white, variance, own, map_ @ turn)
    assert not np.allclose(before, white)
    assert np.allclose(before, after)


@pytest.mark.slow
def test_white_noise_keeps_its_standard_errors_and_coloured_noise_gets_its_own(monkeypatch):
    kept, wider, changes = 0, [], 0
    for seed in range(3):
        state, estimate = ended(noisy(10 + seed, coloured=False))
        plain = without_scatter(monkeypatch, state)
        kept += bool(np.array_equal(plain.cov, estimate.cov))
    for seed in range(2):
        state, estimate = ended(noisy(20 + seed, coloured=True))
        plain = without_scatter(monkeypatch, state)
        changes += len(state.changes)
        wider.append(estimate.std / plain.std)
    assert kept >= 2
    assert changes <= 1
    assert np.all(np.median(wider, axis=0) > 1.5)


def test_longer_blocks_count_where_their_scores_scatter_more(monkeypatch):
    """A response that the model misses: each direction by what the longest blocks say of it."""
    sums = np.array([np.diag([8.0, 8.0, 4.0]), np.diag([20.0, 9.0, 4.0]), np.diag([1e9] * 3)])
    blocks = np.array([66.0, 16.0, 4.0])
    eye = np.eye(3)
    seen = room._Scores(np.ones(3, dtype=bool), np.ones(3), eye, sums, blocks)
    monkeypatch.setattr(room, "_scores_of", lambda *_: seen)
    found = room.with_scatter(None, None, eye, np.ones(1), [np.arange(3)], eye)
    tails = (scipy.stats.t.ppf(0.975, 16) / scipy.stats.norm.ppf(0.975)) ** 2
    # sixteen blocks and three directions; the ratio of traces goes on by a third of its last step
    told, ratios = 16.0 / 19.0, np.array([20.0, 33.0]) / 3.0
    expected = told * sums[1] + (1.0 - told) * ratios[1] * eye
    beyond = 1.0 + (ratios[1] - ratios[0]) / 3.0 / ratios[1]
    assert np.allclose(found, tails * beyond * expected)
    # sixteen blocks do not tell twelve directions apart
    many = np.array([np.kron(np.eye(4), one) for one in sums])
    seen = room._Scores(np.ones(12, dtype=bool), np.ones(12), np.eye(12), many, blocks)
    found = room.with_scatter(None, None, np.eye(12), np.ones(1), [np.arange(12)], np.eye(12))
    told = 66.0 / 78.0
    small, large = (told * one + (1.0 - told) * 20.0 / 3.0 for one in (4.0, 8.0))
    assert found[2, 2] / found[0, 0] == pytest.approx(small / large)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_bands_hold_with_coloured_noise():
    theta, std, changes = [], [], 0
    for seed in range(100):
        state, estimate = ended(noisy(1000 + seed, coloured=True, count=3000))
        changes += len(state.changes)
        theta.append(estimate.theta)
        std.append(estimate.std)
    error = np.array(theta) - np.array([4.0, 3.0, 3.0])
    inside = np.mean(np.abs(error) < 1.96 * np.array(std), axis=0)
    assert np.all(inside > 0.85)
    assert changes <= 30


@pytest.mark.slow
def test_a_change_among_the_kept_samples_is_not_taken_for_usual():
    record = noisy(30, coloured=False, count=1800)
    other = simulate(TransferFunction([3.0], [1.0, 4.0, 6.0]), record)
    y = record.y.copy()
    y[1000:] += (other - simulate(PLANT, record))[1000:]
    run = online.run(online.ThreeModel(), Record(record.u, y, dt=DT), REST, every=1e9)
    assert run.state.changes
    assert 1000 <= run.state.changes[0] < 1600


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_scores_of_white_noise_would_give_its_errors_whatever_is_forgotten(monkeypatch, share):
    """Twice the scatter is twice the covariance, also where weights make that smaller."""
    rng = np.random.default_rng(6)
    map_, root = rng.standard_normal((2, 3, 3))
    information = root @ root.T + np.eye(3)
    white = share * map_ @ np.linalg.inv(information) @ map_.T
    blocks = np.full(slots.LEVELS, 1e6)
    sums = np.tile(2.0 * information, (slots.LEVELS, 1, 1))
    inverse = np.linalg.inv(information)
    seen = room._Scores(np.ones(3, dtype=bool), np.ones(3), inverse, sums, blocks)
    monkeypatch.setattr(room, "_scores_of", lambda *_: seen)
    found = room.with_scatter(None, None, white, np.ones(1), [np.arange(3)], map_)
    assert np.allclose(found, 2.0 * white, rtol=1e-4)


def shaken(seed: int, count: int, forgetting: float) -> tuple[Any, Any]:
    """A resonant plant, gusts of half a second on its output."""
    rng, dt = np.random.default_rng([seed, 77]), 0.02
    u = rng.choice([-1.0, 1.0], count // 20 + 1).repeat(20)[:count]
    y = simulate(TransferFunction([2.0, 3.0], [1.0, 3.0, 9.0]), Record(u, u, dt=dt))[:, 0]
    keep = np.exp(-dt / 0.5)
    gust = scipy.signal.lfilter(
        [np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(count + 500)
    )
    y = y + y.std() * (0.3 * gust[500:] + 0.05 * rng.standard_normal(count))
    method = online.ThreeModel(forgetting=forgetting)
    return method, online.run(method, Record(u, y, dt=dt), Structure(2, 1), every=20.0)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_bands_hold_with_coloured_noise_where_samples_are_forgotten():
    """Half of the variance was lost there, and few blocks were taken for many."""
    found = []
    for seed in range(8):
        method, run = shaken(seed, 7000, 1.0 - 1.0 / 500.0)
        for state in run.states[1:]:
            estimate = method.estimate(state)
            found.append((estimate.theta - [3.0, 9.0, 2.0, 3.0]) / estimate.std)
    off = np.abs(found)
    print("rms", np.sqrt(np.mean(off**2)), "inside", np.mean(off < 1.96))
    assert np.sqrt(np.mean(off**2)) < 1.4
    assert np.mean(off < 1.96) > 0.85
