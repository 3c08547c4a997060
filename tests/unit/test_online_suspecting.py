"""Alarms of least squares, the Kalman filter and the gradient rule, looked into before believed."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, online, simulate
from tridentify.online.estimator import kept_samples
from tridentify.online.kernels import slots
from tridentify.online.layout import watch_of
from tridentify.online.starting import rearranged, with_room
from tridentify.online.suspecting import MOST_KEPT, looking, together
from tridentify.online.suspicion import Old

DT = 0.05
TRUTH = np.array([3.0, 9.0, 2.0, 3.0])
OTHER = np.array([3.0, 14.0, 2.0, 3.0])
ASKED = Structure(2, 1)
METHODS = {
    "least squares": online.RecursiveLeastSquares(on_change="restart"),
    "kalman": online.Kalman(drift=0.001, on_change="restart"),
    "gradient": online.Gradient(),
}
every_method = pytest.mark.parametrize("key", list(METHODS))


def plant(theta):
    return TransferFunction(theta[2:].tolist(), [1.0, *theta[:2].tolist()])


def coloured(seed, count, keep=0.97):
    rng = np.random.default_rng(seed)
    noise = np.zeros(count)
    for k in range(1, count):
        noise[k] = keep * noise[k - 1] + rng.standard_normal()
    return noise / noise.std()


def samples(seed, count=4000, noise=0.05, second=TRUTH, when=0, colour=0.0):
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], -(-count // 8)).repeat(8)[:count]
    record = Record(u, u, dt=DT)
    y = simulate(plant(TRUTH), record)[:, 0]
    size = y.std()
    y[when:] += (simulate(plant(second), record) - simulate(plant(TRUTH), record))[when:, 0]
    y = y + noise * size * rng.standard_normal(count)
    return u, y + colour * size * coloured(seed + 50, count)


def fed(method, u, y, state=None):
    state = method.init(ASKED, DT) if state is None else state
    return method.feed(state, u[:, None].copy(), y[:, None].copy())[0]


def alarm(state):
    return state.method.alarmed(online.State(state.values.copy(), state.stage))


# ------------------------------------------------------------------------------ a false alarm
@pytest.mark.slow
@every_method
def test_a_false_alarm_is_dropped_and_leaves_the_estimate_alone(key):
    """Before, every alarm was believed, and the samples until then were lost."""
    method = METHODS[key]
    u, y = samples(1, 5000)
    before = fed(method, u[:3000], y[:3000])
    after = fed(method, u[3000:], y[3000:], before)
    alarmed = alarm(before)
    assert alarmed.values[slots.SUSPECT] == 3000
    assert alarmed.changes == ()
    told = method.estimate(alarmed)
    assert "varying" in [one.code for one in told.findings if one.matters]
    assert np.array_equal(told.theta, method.estimate(before).theta)
    alarmed = fed(method, u[3000:], y[3000:], alarmed)
    assert alarmed.changes == ()
    assert alarmed.values[slots.SUSPECT] == 0.0
    one, two = method.estimate(after), method.estimate(alarmed)
    assert one.theta == pytest.approx(two.theta, rel=1e-9)
    assert one.std == pytest.approx(two.std, rel=0.2)
    # the next alarm has to be stronger
    for scale in range(slots.SCALES):
        assert _usual(alarmed, scale) >= _usual(after, scale)


@pytest.mark.slow
@every_method
def test_an_alarm_that_a_look_did_not_confirm_is_a_note(key):
    method = METHODS[key]
    u, y = samples(1, 3400)
    alarmed = alarm(fed(method, u[:3000], y[:3000]))
    severities = []
    for more in (10, 390):
        state = fed(method, u[3000 : 3000 + more], y[3000 : 3000 + more], alarmed)
        assert state.values[slots.SUSPECT] == 3000
        (told,) = [f for f in method.estimate(state).findings if f.code == "varying"]
        severities.append(told.severity)
    assert severities == ["warning", "note"]


def _usual(state, scale):
    blueprint = state.stage.blueprint
    k = int(blueprint.ints[slots.DIRECTIONS])
    width = k + k * (k + 1) // 2
    at = watch_of(blueprint, 0) + slots.SCORES + k + scale * (width + slots.SUMS) + width + 1
    return state.values[at]


@pytest.mark.parametrize(
    ("key", "seed"),
    [
        pytest.param(key, seed, marks=[] if (key, seed) == ("kalman", 0) else [pytest.mark.slow])
        for key in METHODS
        for seed in range(3)
    ],
)
@pytest.mark.slow
def test_coloured_noise_that_swells_is_no_change(key, seed):
    """The scores leave what was usual of them; the plant stays."""
    method = METHODS[key]
    u, y = samples(seed, 5000, noise=0.02)
    swell = np.where(np.arange(5000) > 3000, 0.3, 0.03)
    y = y + swell * y.std() * coloured(seed + 90, 5000)
    state = fed(method, u, y)
    assert state.changes == ()
    if key != "gradient":
        # there was something to look into
        assert len(state.stage.extra) > method.own_arrays


# ----------------------------------------------------------------------------- a true change
@pytest.mark.parametrize("key", ["least squares", "kalman"])
@pytest.mark.fast("kalman")
def test_the_old_answer_stays_until_the_new_one_is_better(key):
    method = METHODS[key]
    u, y = samples(4, 4200, second=OTHER, when=2500)
    state, suspected = method.init(ASKED, DT), None
    for k in range(4200):
        state, _ = method.step(state, u[k], y[k])
        if state.values[slots.SUSPECT] and not state.changes:
            suspected = method.estimate(state)
    assert suspected is not None
    assert suspected.n_samples > 2500
    assert len(state.changes) == 1
    assert 2500 <= state.changes[0] < 2900
    end = method.estimate(state)
    assert end.parameters["a0"].value == pytest.approx(14.0, rel=0.05)
    told = [one for one in end.findings if one.code == "varying"]
    assert told[0].times == (state.changes[0] * DT,)


@pytest.mark.parametrize("key", ["least squares", "kalman"])
@pytest.mark.fast("kalman")
def test_a_change_that_is_only_flagged_is_flagged_once(key):
    """The witness goes over to the new plant; what was kept for the look is dropped."""
    method = type(METHODS[key])(on_change="flag")
    u, y = samples(6, 8000, second=OTHER, when=3000)
    state = fed(method, u, y)
    assert len(state.changes) == 1
    theta = state.stage.extra[0]
    assert theta[1] == pytest.approx(14.0, rel=0.1)
    assert len(kept_samples(state)) <= MOST_KEPT + 64


@pytest.mark.slow
def test_a_filter_that_was_given_stays_and_what_comes_after_a_change_is_of_the_samples_since():
    method = online.RecursiveLeastSquares(filter=(1.0, 4.0, 12.0), on_change="restart")
    u, y = samples(7, 6000, noise=0.01, second=OTHER, when=3000)
    state = fed(method, u, y)
    assert len(state.changes) == 1
    assert np.poly(state.stage.blueprint.poles).real == pytest.approx([1.0, 4.0, 12.0])
    assert method.estimate(state).parameters["a0"].value == pytest.approx(14.0, rel=0.03)


# ------------------------------------------------------------------------------- the witness
def setting():
    return online.ThreeModel().init(ASKED, DT).stage.setting


def table(u, y):
    return np.column_stack([np.full(u.size, DT), u, y])


def ended(slices):
    while True:
        try:
            next(slices)
        except StopIteration as end:
            return end.value


@pytest.mark.parametrize("second", [TRUTH, OTHER], ids=["same", "other"])
@pytest.mark.fast("other")
def test_a_biased_answer_is_no_reason_for_a_change(second):
    """The present answer explains the samples badly in both cases; the witness knows why."""
    u, y = samples(8, 1600, noise=0.02, second=second, when=800, colour=0.2)
    every, biased = table(u, y), Old(0.8 * TRUTH, np.diag((0.001 * TRUTH) ** 2))
    verdict = ended(looking(setting(), every[:800], False, every[850:], None, biased))
    assert verdict.found is not None
    assert verdict.witness is not None
    assert verdict.changed == (second is OTHER)
    off = (verdict.witness.theta - TRUTH) / np.sqrt(np.diagonal(verdict.witness.cov))
    assert np.max(np.abs(off)) < 4.0
    nearer = np.trace(verdict.after.cov / verdict.witness.cov) / 4
    assert nearer < 1.0 or verdict.changed


def test_a_drift_that_the_method_has_followed_is_no_change_and_moves_the_witness():
    u, y = samples(9, 800, noise=0.02, second=OTHER, when=0)
    old = Old(TRUTH, np.diag((0.01 * TRUTH) ** 2))
    present = Old(OTHER, np.diag((0.02 * OTHER) ** 2))
    verdict = ended(looking(setting(), table(u, y)[:0], False, table(u, y), old, present))
    assert not verdict.changed
    assert verdict.after.theta[1] == pytest.approx(14.0, rel=0.05)


def test_two_estimates_together_are_the_weighted_mean():
    rng = np.random.default_rng(3)
    roots = rng.standard_normal((2, 3, 3))
    one, other = (Old(rng.standard_normal(3), root @ root.T + np.eye(3)) for root in roots)
    unit = np.array([1.0, 1e6, 1e-6])
    wide = [Old(unit * each.theta, unit[:, None] * each.cov * unit) for each in (one, other)]
    found = together(*wide)
    weights = [np.linalg.inv(each.cov) for each in (one, other)]
    cov = np.linalg.inv(weights[0] + weights[1])
    mean = cov @ (weights[0] @ one.theta + weights[1] @ other.theta)
    assert found.theta == pytest.approx(unit * mean)
    assert found.cov == pytest.approx(unit[:, None] * cov * unit)


# ---------------------------------------------------------------------- states, room and time
@every_method
def test_room_for_samples_is_that_of_a_plan_made_with_it(key):
    method = METHODS[key]
    state = fed(method, *samples(10, 600))
    for keep in (False, True):
        ours = with_room(state.stage.blueprint, keep)
        made = method.rebuilt(state.stage.setting, ours)
        assert np.array_equal(ours.ints, made.ints)
        assert ours.size == made.size
    without = with_room(state.stage.blueprint, False)
    there = rearranged(state.stage.blueprint, state.values, without)
    back = rearranged(without, there, state.stage.blueprint)
    at = int(state.stage.blueprint.ints[slots.AT_WATCH])
    assert np.array_equal(back[at:], state.values[at:], equal_nan=True)


@pytest.mark.slow
@every_method
def test_a_suspicion_goes_on_from_a_file(key, tmp_path):
    method = METHODS[key]
    u, y = samples(11, 3400)
    state = fed(method, u[2600:2800], y[2600:2800], alarm(fed(method, u[:2600], y[:2600])))
    assert state.values[slots.SUSPECT] > 0.0
    assert state.values[slots.WORK_DONE] > 0.0
    read = online.State.load(state.save(tmp_path / "state.json"))
    one = fed(method, u[2800:], y[2800:], state)
    two = fed(read.method, u[2800:], y[2800:], read)
    assert np.array_equal(one.values, two.values, equal_nan=True)
    assert all(map(np.array_equal, one.stage.extra, two.stage.extra))


@pytest.mark.slow
@every_method
def test_samples_and_blocks_are_the_same_stream_through_a_suspicion(key):
    method = METHODS[key]
    u, y = samples(12, 3300)
    state = alarm(fed(method, u[:2500], y[:2500]))
    block = fed(method, u[2500:], y[2500:], state)
    for k in range(2500, 3300):
        state, _ = method.step(state, u[k], y[k])
    assert np.array_equal(state.values, block.values, equal_nan=True)


# ------------------------------------------------------------------------------ coloured noise
@pytest.mark.slow
@pytest.mark.parametrize("key", ["least squares", "kalman"])
def test_the_bias_of_an_equation_error_in_coloured_noise_is_told(key):
    u, y = samples(14, 4000, noise=0.02)
    plain = METHODS[key].estimate(fed(METHODS[key], u, y))
    assert not [one for one in plain.findings if one.matters]
    u, y = samples(14, 4000, noise=0.01, colour=0.2)
    found = METHODS[key].estimate(fed(METHODS[key], u, y))
    assert "noise-model" in [one.code for one in found.findings if one.matters]
    # it is far beyond the errors for white noise
    assert abs(found.parameters["a0"].value - 9.0) > 0.3


@pytest.mark.slow
def test_kalman_errors_are_widened_in_coloured_noise_and_told():
    method = online.Kalman(drift=1e-5)
    u, y = samples(13, 4000, noise=0.05)
    plain = method.estimate(fed(method, u, y))
    assert "noise-model" not in [one.code for one in plain.findings]
    theta, std = [], []
    for seed in range(8):
        u, y = samples(20 + seed, 4000, noise=0.01, colour=0.1)
        found = method.estimate(fed(method, u, y))
        assert "noise-model" in [one.code for one in found.findings]
        theta.append(found.theta)
        std.append(found.std)
    # the scatter, not the bias, is what the errors speak of
    assert np.all(np.std(theta, axis=0) < 2.0 * np.mean(std, axis=0))
