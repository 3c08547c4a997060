"""Work beside the stream: bounded slices, whatever is done in between, and what it is for."""

from __future__ import annotations

import pickle
import time

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, online, simulate
from tridentify.estimation.search.gross_outliers import gross_outliers
from tridentify.numerics.slices import drain
from tridentify.online.estimator import kept_samples
from tridentify.online.kernels import slots
from tridentify.online.residual import gain_of, is_driven, left_by, refined
from tridentify.online.task import Task

DT = 0.05
PLANT = TransferFunction([2.0, 3.0], [1.0, 3.0, 9.0])
ASKED = Structure(2, 1)
SLOWEST = 5e-3  # s of processor time that a step may take on order 2, on a machine at rest
LONGEST = 15.0  # times the mean slice


def samples(seed, count=2600, noise=0.1):
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], -(-count // 8)).repeat(8)[:count]
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
    return u, y + noise * y.std() * rng.standard_normal(count)


def counting(limit):
    for _ in range(limit):
        yield
    return limit


# ----------------------------------------------------------------------------------------- tasks
def test_a_task_is_over_after_the_same_number_of_slices_however_it_was_asked():
    task = Task(counting, 3)
    assert [task.over_after(k) for k in (1, 3)] == [False, False]
    assert task.result() == 3
    # done by someone else already: it is over when it would have been
    assert [task.over_after(k) for k in (1, 4, 5, 9)] == [False, False, True, True]


def test_a_task_that_is_pickled_begins_again():
    task = Task(counting, 3)
    task.over_after(2)
    again = pickle.loads(pickle.dumps(task))
    assert not again.over_after(3)
    assert again.result() == 3


# ------------------------------------------------------------------------------------- the steps
def stepped(method, u, y):
    """Processor time of every step, and which steps had work under way."""
    state, times, working = method.init(ASKED, DT), [], []
    for one, other in zip(u.tolist(), y.tolist(), strict=True):
        begin = time.thread_time()
        state, _ = method.step(state, one, other)
        times.append(time.thread_time() - begin)
        working.append(state.stage.task is not None)
    assert not state.stage.searching
    return np.array(times), np.array(working)


def test_no_step_is_held_up_by_a_search():
    """No step takes much longer than the others that do a slice, however busy the machine is."""
    u, y = samples(1, 1600)
    stepped(online.ThreeModel(), u, y)  # compiled
    found = [stepped(online.ThreeModel(), u, y) for _ in range(3)]
    assert min(times.max() / times[working].mean() for times, working in found) < LONGEST
    assert found[0][1].sum() > 20


@pytest.mark.slow
def test_no_step_takes_five_milliseconds():
    u, y = samples(1)
    stepped(online.ThreeModel(), u, y)
    assert min(stepped(online.ThreeModel(), u, y)[0].max() for _ in range(5)) < SLOWEST


@pytest.mark.slow
def test_what_another_future_did_to_a_search_changes_nothing():
    u, y = samples(2, 400)
    method = online.ThreeModel()
    state = method.init(ASKED, DT)
    for k in range(60):
        state, _ = method.step(state, u[k], y[k])
    assert state.stage.task is not None
    other = state
    for k in range(60, 160):
        other, _ = method.step(other, -u[k], 0.0)
    plain = method.init(ASKED, DT)
    plain, _, _ = method.feed(plain, u[:, None], y[:, None])
    state, _, _ = method.feed(state, u[60:, None], y[60:, None])
    assert np.array_equal(plain.values, state.values, equal_nan=True)


def test_an_estimate_asked_for_during_the_search_is_there_and_changes_nothing():
    u, y = samples(3, 400, noise=0.02)
    method = online.ThreeModel()
    one = two = method.init(ASKED, DT)
    early = None
    for k in range(400):
        one, _ = method.step(one, u[k], y[k])
        two, _ = method.step(two, u[k], y[k])
        if one.stage.searching and one.values[slots.WORK_DONE] and early is None:
            early = method.estimate(one)
    assert early is not None
    assert np.all(np.abs(early.theta - [3.0, 9.0, 2.0, 3.0]) < 6.0 * early.std)
    assert np.array_equal(one.values, two.values, equal_nan=True)


# --------------------------------------------------------------------------- a change is suspected
@pytest.mark.slow
def test_the_old_answer_stays_until_the_new_one_is_better():
    u, y = samples(4, 4000)
    other = TransferFunction([2.0, 3.0], [1.0, 3.0, 14.0])
    record = Record(u, u, dt=DT)
    y[2500:] += (simulate(other, record) - simulate(PLANT, record))[2500:, 0]
    method = online.ThreeModel()
    state = method.init(ASKED, DT)
    suspected = None
    for k in range(4000):
        state, _ = method.step(state, u[k], y[k])
        if k % 25 == 0 and state.values[slots.SUSPECT] and not state.changes:
            suspected = method.estimate(state)
    assert suspected is not None
    # still the estimate of all samples, and it says so
    assert suspected.n_samples > 2500
    assert "varying" in [f.code for f in suspected.findings if f.matters]
    assert len(state.changes) == 1
    assert 2500 <= state.changes[0] < 2900
    end = method.estimate(state)
    assert abs(end.parameters["a0"].value - 14.0) < 5.0 * end.parameters["a0"].std
    told = [f for f in end.findings if f.code == "varying"]
    assert told[0].times == (state.changes[0] * DT,)


@pytest.mark.slow
def test_an_alarm_without_a_change_is_dropped_and_leaves_the_estimate_alone():
    u, y = samples(5, 3400)
    method = online.ThreeModel()
    state = method.init(ASKED, DT)
    state, _, _ = method.feed(state, u[:2600, None], y[:2600, None])
    x = state.values.copy()
    alarmed = method.alarmed(online.State(x, state.stage))
    assert alarmed.values[slots.SUSPECT] == 2600
    state, _, _ = method.feed(state, u[2600:, None], y[2600:, None])
    alarmed, _, _ = method.feed(alarmed, u[2600:, None], y[2600:, None])
    assert alarmed.values[slots.SUSPECT] == 0.0
    assert alarmed.changes == ()
    one, two = method.estimate(state), method.estimate(alarmed)
    assert np.all(np.abs(one.theta - two.theta) < 0.05 * one.std)


def test_alarm_after_alarm_does_not_keep_the_poles_where_they_are():
    """Each put the clock off until after the next: the poles of an early search stayed for good."""
    u, y = samples(8, 3000, noise=0.3)
    method, found = online.ThreeModel(), []
    state = method.init(ASKED, DT)
    for k in range(3000):
        state, _ = method.step(state, u[k], y[k])
        x, stage = state
        soon = x[slots.TICK] - x[slots.COUNT] <= 5.0
        if stage.searching or x[slots.SUSPECT] or not soon:
            continue
        state = method.alarmed(online.State(x.copy(), stage))
        found.append(stage.poles)
    assert state.changes == ()
    assert len({one.tobytes() for one in found}) >= 2
    away = np.abs(np.sort_complex(state.stage.poles) - np.sort_complex(np.roots([1.0, 3.0, 9.0])))
    assert away.max() < 0.3


# ------------------------------------------------------------------------------------- residuals
def setting():
    return online.ThreeModel().init(ASKED, DT).stage.setting


def coloured(seed, count):
    rng = np.random.default_rng(seed)
    noise, keep = np.zeros(count), 0.95
    for k in range(1, count):
        noise[k] = keep * noise[k - 1] + rng.standard_normal()
    return noise / noise.std()


def test_what_the_true_model_leaves_is_the_noise():
    u, y = samples(6, 400, noise=0.0)
    left = left_by(setting(), Record(u + 1.0, y + 5.0, dt=DT), np.array([3.0, 9.0, 2.0, 3.0]))
    assert np.max(np.abs(left)) < 1e-9


def test_refined_coefficients_are_nearer_the_truth_and_know_how_near():
    theta, errors, before = np.array([3.0, 9.0, 2.0, 3.0]), [], []
    for seed in range(12):
        u, y = samples(seed, 600, noise=0.0)
        record = Record(u, y + 0.2 * y.std() * coloured(seed, 600), dt=DT)
        start = theta * (1.0 + 0.15 * np.random.default_rng(seed).standard_normal(4))
        work = refined(setting(), record, start, 0.05 * theta)
        while True:
            try:
                next(work)
            except StopIteration as end:
                found = end.value
                break
        errors.append((found.theta - theta) / np.sqrt(np.diagonal(found.cov)))
        before.append(np.abs(start - theta) / np.abs(found.theta - theta))
    assert np.median(before) > 2.0
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.6


def test_coloured_noise_alone_is_not_driven_by_an_input():
    theta = np.array([3.0, 9.0, 2.0, 3.0])
    u, y = samples(7, 400)
    assert is_driven(setting(), Record(u, y, dt=DT), theta)
    rest = 0.01 * np.random.default_rng(8).standard_normal(400)
    assert not is_driven(setting(), Record(rest, coloured(9, 400), dt=DT), theta)


def test_whitened_gain_of_equal_residuals_is_nothing():
    noise = coloured(10, 600)
    assert np.all(gain_of(noise, noise) == 0.0)
    assert gain_of(2.0 * noise, noise).sum() == pytest.approx(2 * 588 * np.log(2.0))


# -------------------------------------------------------------------------------------- findings
@pytest.mark.slow
def test_no_estimate_before_the_input_has_moved_the_plant():
    rng = np.random.default_rng(11)
    u, y = samples(11, 2000, noise=0.0)
    u[:800], y[:800] = 0.0, 0.0
    u = u + 0.002 * rng.standard_normal(u.size)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0] + 0.05 * coloured(12, 2000)
    run = online.run(online.ThreeModel(), Record(u, y, dt=DT), ASKED, every=5.0)
    ready = np.isfinite(run.theta[:, 0])
    assert not np.any(ready[run.time < 800 * DT])
    assert ready[-1]
    assert run.state.changes == ()
    assert np.all(np.abs(run.estimate.theta - [3.0, 9.0, 2.0, 3.0]) < 5.0 * run.estimate.std)
    assert repr(run).endswith(f" times, 2000 samples, {run.estimate!r})")


@pytest.mark.slow
def test_findings_of_samples_and_noise():
    u, y = samples(13, 1500)
    y = y + 0.3 * coloured(14, 1500)
    y[1000:1100] = y[1000]
    y[500] = np.nan
    estimate = online.run(online.ThreeModel(), Record(u, y, dt=DT), ASKED, every=1e9).estimate
    codes = {finding.code for finding in estimate.findings}
    assert {"noise-model", "stuck-sensor", "missing-samples"} <= codes
    plain = online.run(
        online.ThreeModel(), Record(*samples(15, 1500), dt=DT), ASKED, every=1e9
    ).estimate
    assert not [finding for finding in plain.findings if finding.matters]


@pytest.mark.parametrize(
    "method",
    [
        online.ThreeModel(),
        online.RecursiveLeastSquares(),
        online.Kalman(drift=1e-6),
        online.Gradient(),
    ],
    ids=lambda one: one.name,
)
@pytest.mark.fast("three-model", "kalman", "gradient", "recursive-least-squares")
def test_three_inputs_and_three_outputs(method):
    rng = np.random.default_rng(16)
    u = rng.choice([-1.0, 1.0], (1000, 3)).repeat(4, 0)
    den = [1.0, 3.0, 9.0]
    num = [[[2.0], [1.0], [0.5]], [[0.3, 1.0], [2.0], [1.5]], [[1.0], [-1.0], [3.0]]]
    model = TransferFunction(num, [[den] * 3 for _ in range(3)])
    names = {"input_names": ["a", "b", "c"], "output_names": ["x", "y", "z"]}
    blank = Record(u, np.zeros((4000, 3)), dt=DT, **names)
    y = simulate(model, blank)
    y = y + 0.02 * y.std(axis=0) * rng.standard_normal(y.shape)
    structure = Structure(2, [[0, 0, 0], [1, 0, 0], [0, 0, 0]], offset=False, initial_state="rest")
    run = online.run(method, Record(u, y, dt=DT, **names), structure, every=1e9)
    truth = np.array([3.0, 9.0, 2.0, 1.0, 0.5, 0.3, 1.0, 2.0, 1.5, 1.0, -1.0, 3.0])
    assert run.estimate.theta.size == 12
    allowed = 0.02 if method.name == "three-model" else 0.3
    assert np.max(np.abs(run.estimate.theta / truth - 1.0)) < allowed


# -------------------------------------------------------------------------- what is kept, and looks
def fed(method, u, y):
    return method.feed(method.init(ASKED, DT), u[:, None], y[:, None])[0]


@pytest.mark.slow
def test_an_estimator_that_forgets_does_not_keep_its_samples_for_ever():
    """Its newest samples were run against the search of all of them, which always won."""
    state = fed(online.ThreeModel(forgetting=0.99), *samples(6, 2600))
    assert len(kept_samples(state)) <= 2100


@pytest.mark.slow
def test_an_estimator_that_forgets_soon_keeps_none():
    assert fed(online.ThreeModel(forgetting=0.9), *samples(6, 2600)).stage.past == ()


def test_the_clock_asks_for_a_look_that_no_alarm_asked_for_and_nobody_is_told():
    u, y = samples(7, 1500)
    method, looked = online.ThreeModel(), 0
    state = method.init(ASKED, DT)
    for k in range(1500):
        state, _ = method.step(state, u[k], y[k])
        if state.values[slots.SUSPECT]:
            looked += 1
            assert state.values[slots.DUE] == state.values[slots.SUSPECT]
    assert looked > 100
    assert state.changes == ()
    codes = [f.code for f in method.estimate(state).findings]
    assert "varying" not in codes


@pytest.mark.slow
def test_refined_coefficients_use_the_pauses_of_noise_that_comes_and_goes():
    """The samples of little noise tell the most; all alike, the errors were half as large again."""
    asked, spread = setting(), []
    theta = np.array([3.0, 9.0, 2.0, 3.0])
    for seed in range(12):
        u, y = samples(20 + seed, 960, 0.0)
        strength = np.where(np.arange(960) // 160 % 2, 1.0, 0.05)
        y = y + 0.3 * y.std() * strength * np.random.default_rng(seed).standard_normal(960)
        new = drain(refined(asked, Record(u, y, dt=DT), theta, 0.05 * theta))
        spread.append(((new.theta - theta) / theta, np.sqrt(np.diag(new.cov)) / theta))
    error, said = (np.sqrt(np.mean(np.square(one), axis=0)) for one in zip(*spread, strict=True))
    assert np.all(error < 2.0 * said)
    assert np.all(said < 0.02)


def test_coarse_samples_are_not_set_aside_as_far_off():
    """At rest most residuals are next to nothing, so each step of the converter looked far."""
    u = np.tile(np.repeat([1.0, -1.0, 0.0], [12, 12, 90]), 6)
    y = simulate(PLANT, Record(u, u, dt=DT))
    y = y + 0.03 * y.std() * np.random.default_rng(3).standard_normal(y.shape)
    coarse = 0.3 * y.std() * np.round(y / (0.3 * y.std()))
    fine, rough = (gross_outliers([Record(u, one, dt=DT)], ASKED)[0].sum() for one in (y, coarse))
    assert rough <= fine + 10
