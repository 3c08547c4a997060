"""What a stream meets: gaps, stuck and clipped sensors, outliers, a plant that changes, no input.

Each has a flag that says what is wrong; none may blow up a covariance, leave a nan behind, or move
the estimate far away.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from oracles import levels
from tridentify import Record, Structure, TransferFunction, identify, online, simulate
from tridentify.errors import TridentifyError

REST = {"offset": False, "initial_state": "rest"}
FREE = {"offset": True, "initial_state": "free"}
DT = 0.05
TRUTH = np.array([1.0, 3.0, 0.2, 0.5])
PLANT = TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0])
ASKED = Structure(2, 1, **REST)
Flag = online.Flag
PLAIN = {
    "three-model": online.ThreeModel(),
    "least squares": online.RecursiveLeastSquares(on_change="restart"),
    "kalman": online.Kalman(drift=1e-4, on_change="restart"),
    "gradient": online.Gradient(),
}
FORGETTING = {
    "three-model, exponential": lambda f: online.ThreeModel(forgetting=f, forget="exponential"),
    "three-model, directional": lambda f: online.ThreeModel(forgetting=f, forget="directional"),
    "least squares, exponential": lambda f: online.RecursiveLeastSquares(
        forgetting=f, forget="exponential"
    ),
    "least squares, directional": lambda f: online.RecursiveLeastSquares(
        forgetting=f, forget="directional"
    ),
    "least squares, resetting": lambda f: online.RecursiveLeastSquares(
        forgetting=f, forget="resetting"
    ),
    "kalman": lambda f: online.Kalman(drift=math.sqrt((1.0 - f) / DT) * 0.1),
}
# How far from the truth an answer on a clean record of this noise may be, relative.
NEAR = {"three-model": 0.08, "least squares": 0.2, "kalman": 0.2, "gradient": 0.3}
EVERY = 20.0
"""Seconds between the points of a run; each costs an estimate."""
every_method = pytest.mark.parametrize("key", list(PLAIN), ids=str)


def signals(n_samples=6000, noise=0.05, seed=1, model=PLANT, u=None):
    u = levels(n_samples, 4, seed) if u is None else u
    y = simulate(model, Record(u, u, dt=DT))[:, 0]
    sigma = noise * np.std(y)
    return u, y + sigma * np.random.default_rng(seed + 5).standard_normal(u.size), sigma


def fold(method, state, u, y):
    """In blocks, which are the same as samples one by one to the last bit (test_online_blocks)."""
    return method.feed(state, u[:, None], y[:, None])[0]


def every_flag(method, u, y):
    """Flags of the state after each sample."""
    flags = method.feed(method.init(ASKED, DT), u[:, None], y[:, None])[2]
    return [Flag(int(one)) for one in flags]


def off(theta, truth=TRUTH):
    return float(np.max(np.abs(theta / truth - 1.0)))


def sane(run):
    """No nan, no infinity, in the end or on the way."""
    estimate = run.estimate
    assert np.all(np.isfinite(estimate.theta))
    assert np.all(np.isfinite(estimate.cov))
    ready = np.isfinite(run.theta[:, 0])
    assert np.all(np.isfinite(run.theta[ready]))
    assert np.all(np.isfinite(run.std[ready]))
    first = np.argmax(ready)
    assert np.all(ready[first:]), "was ready, and no longer is"
    return estimate


# --------------------------------------------------------------------------------- all is well
@pytest.mark.slow
@every_method
def test_a_good_record_raises_no_flag(key):
    u, y, _ = signals()
    run = online.run(PLAIN[key], Record(u, y, dt=DT), ASKED)
    assert not run.state.flags
    assert not run.state.seen & ~Flag.NOT_READY & ~Flag.NOT_EXCITED & ~Flag.OUTLIER
    assert run.state.changes == ()
    assert run.flags[0] & Flag.NOT_READY
    assert not run.flags[-1]


# -------------------------------------------------------------------------------- missing
@every_method
@pytest.mark.fast("three-model", "kalman")
def test_missing_outputs_are_flagged_and_survived(key):
    u, y, _ = signals(1600)
    y[np.random.default_rng(2).random(y.size) < 0.1] = np.nan
    y[900:1100] = np.nan
    run = online.run(PLAIN[key], Record(u, y, dt=DT), ASKED, every=EVERY)
    assert off(sane(run).theta) < NEAR[key]
    assert run.state.seen & Flag.MISSING_OUTPUT
    for k, flag in enumerate(every_flag(PLAIN[key], u[:1300], y[:1300])):
        assert bool(flag & Flag.MISSING_OUTPUT) == bool(np.isnan(y[k])), k
    assert np.array_equal(np.isnan(run.innovations[500:, 0]), np.isnan(y[500:]))


@every_method
@pytest.mark.fast("three-model", "gradient")
def test_missing_from_the_first_sample(key):
    u, y, _ = signals(1500)
    y[:300] = np.nan
    run = online.run(PLAIN[key], Record(u, y, dt=DT), Structure(2, 1, **FREE), every=EVERY)
    assert off(sane(run).theta) < NEAR[key]


@every_method
@pytest.mark.fast("three-model", "least squares")
def test_missing_inputs_are_held_and_flagged(key):
    """The input is held over a gap: the same as if the last value had been sent again."""
    u, y, _ = signals(1200)
    gaps = np.zeros(1200, bool)
    gaps[601::4] = True  # within a held level: nothing is lost
    method = PLAIN[key]
    with_gaps, whole = method.init(ASKED, DT), method.init(ASKED, DT)
    for k in range(1200):
        with_gaps, one = method.step(with_gaps, np.nan if gaps[k] else u[k], y[k])
        whole, two = method.step(whole, u[k], y[k])
        assert np.array_equal(one, two, equal_nan=True)
        assert bool(with_gaps.flags & Flag.MISSING_INPUT) == bool(gaps[k])
    assert with_gaps.seen & Flag.MISSING_INPUT
    assert np.array_equal(method.estimate(with_gaps).theta, method.estimate(whole).theta)


@every_method
@pytest.mark.fast("three-model", "gradient")
def test_missing_inputs_from_the_first_sample(key):
    u, y, _ = signals(1500)
    method, state = PLAIN[key], PLAIN[key].init(Structure(2, 1, **FREE), DT)
    state = fold(method, state, np.full(20, np.nan), y[:20])
    state = fold(method, state, u[20:], y[20:])
    assert off(method.estimate(state).theta) < 2 * NEAR[key]


@every_method
def test_jitter_is_flagged_while_it_lasts(key):
    u, y, _ = signals(1200)
    method = PLAIN[key]
    state = fold(method, method.init(ASKED, DT), u[:600], y[:600])
    state, _ = method.step(state, u[600], y[600], interval=DT * (1 + 1e-9))
    assert not state.seen & Flag.JITTER
    state, _ = method.step(state, u[601], y[601], interval=1.5 * DT)
    assert state.flags & Flag.JITTER
    assert state.time == pytest.approx(601.5 * DT)
    state = fold(method, state, u[602:], y[602:])
    assert not state.flags & Flag.JITTER
    assert state.seen & Flag.JITTER


def test_jitter_is_exact():
    rng = np.random.default_rng(3)
    t = np.cumsum(DT * rng.uniform(0.3, 1.7, 1000))
    u = levels(1000)
    y = simulate(PLANT, Record(u, u, t=t))
    run = online.run(online.ThreeModel(), Record(u, y, t=t), ASKED, every=EVERY)
    assert off(run.estimate.theta) < 1e-6


@every_method
@pytest.mark.fast("three-model", "least squares")
def test_jitter_does_not_bias(key):
    rng = np.random.default_rng(3)
    t = np.cumsum(DT * rng.uniform(0.3, 1.7, 1200))
    u = levels(1200)
    y = simulate(PLANT, Record(u, u, t=t))[:, 0]
    y = y + 0.05 * y.std() * rng.standard_normal(1200)
    run = online.run(PLAIN[key], Record(u, y, t=t), ASKED, every=EVERY)
    assert off(sane(run).theta) < NEAR[key]


@every_method
@pytest.mark.fast("least squares", "gradient", "kalman")
def test_a_long_pause_between_two_samples(key):
    """An hour without a sample: the plant has settled, the estimate stays."""
    u, y, sigma = signals(2500)
    u2, y2, _ = signals(1500, seed=2)
    method = PLAIN[key]
    state = fold(method, method.init(ASKED, DT), u, y)
    before = method.estimate(state)
    final = float(PLANT.frequency_response(np.array([1e-9]))[0, 0, 0].real) * u[-1]
    decay = simulate(PLANT, Record(u2 - u[-1], y2, dt=DT))[:, 0] + final
    noisy = decay + sigma * np.random.default_rng(9).standard_normal(1500)
    state, _ = method.step(state, u2[0], noisy[0], interval=3600.0)
    state = fold(method, state, u2[1:], noisy[1:])
    after = method.estimate(state)
    assert np.all(np.isfinite(after.cov))
    assert off(after.theta) < max(NEAR[key], 1.5 * off(before.theta))


# -------------------------------------------------------------------------------- sensors
@pytest.mark.slow
@every_method
def test_a_sensor_that_sticks_for_five_seconds(key):
    u, y, _ = signals(1500)
    y[900:1000] = y[900]
    run = online.run(PLAIN[key], Record(u, y, dt=DT), ASKED, every=EVERY)
    assert off(sane(run).theta) < NEAR[key]
    assert run.state.seen & Flag.STUCK
    assert not run.state.flags & Flag.STUCK
    where = np.flatnonzero([flag & Flag.STUCK for flag in every_flag(PLAIN[key], u, y)])
    assert where.min() >= 900
    assert where.max() <= 1010
    assert np.any((where > 940) & (where < 999))


@every_method
@pytest.mark.fast("three-model")
def test_a_value_that_comes_twice_is_not_stuck(key):
    """A converter of many steps repeats one sample in several hundred by chance."""
    u, y, _ = signals(1200)
    y[[800, 1100]] = y[[799, 1099]]
    state = fold(PLAIN[key], PLAIN[key].init(ASKED, DT), u, y)
    assert not state.seen & Flag.STUCK


@every_method
@pytest.mark.fast("three-model", "least squares", "kalman", "gradient")
def test_an_output_that_rests_is_not_stuck(key):
    """Without noise and without input an output stands still: no sensor is to blame."""
    u = levels(2000)
    u[1000:] = 0.0
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
    state = fold(PLAIN[key], PLAIN[key].init(ASKED, DT), u[:1000], y[:1000])
    assert not state.seen & Flag.STUCK
    state = fold(PLAIN[key], state, u[1000:], y[1000:])
    assert off(PLAIN[key].estimate(state).theta) < NEAR[key]


@every_method
@pytest.mark.fast("three-model", "least squares")
def test_an_output_that_is_clipped(key):
    u, y, _ = signals(2500)
    limit = 1.3 * np.std(y)
    share = np.mean(np.abs(y) > limit)
    assert 0.05 < share < 0.3
    clipped = Record(u, np.clip(y, -limit, limit), dt=DT)
    run = online.run(PLAIN[key], clipped, ASKED, every=EVERY)
    assert run.state.seen & Flag.SATURATED
    if key == "three-model":
        # samples at a limit that is known were taken for another plant
        assert not run.state.changes
    assert off(sane(run).theta) < 2 * NEAR[key]


@pytest.mark.slow
@every_method
def test_one_outlier_is_flagged_and_does_nothing(key):
    """A hundred times the spread at once: less than a standard error of harm."""
    u, y, _ = signals(1200)
    clean = online.run(PLAIN[key], Record(u, y, dt=DT), ASKED, every=1e9).estimate
    wrong = y.copy()
    wrong[900] += 100.0 * np.std(y)
    run = online.run(PLAIN[key], Record(u, wrong, dt=DT), ASKED, every=EVERY)
    assert every_flag(PLAIN[key], u[:901], wrong[:901])[900] & Flag.OUTLIER
    assert not run.state.seen & Flag.CHANGED
    found = sane(run)
    limit = 1.0 if key == "three-model" else 3.0
    assert np.max(np.abs(found.theta - clean.theta) / clean.std) < limit


@every_method
@pytest.mark.fast("kalman")
def test_one_sample_in_twenty_is_an_outlier(key):
    u, y, sigma = signals(3500)
    rng = np.random.default_rng(11)
    wrong = rng.random(y.size) < 0.05
    y[wrong] += 30.0 * sigma * rng.standard_normal(int(wrong.sum()))
    run = online.run(PLAIN[key], Record(u, y, dt=DT), ASKED, every=EVERY)
    assert run.state.seen & Flag.OUTLIER
    found = sane(run)
    assert off(found.theta) < 2 * NEAR[key]
    if key == "three-model":
        assert np.max(np.abs(found.theta - TRUTH) / found.std) < 5.0


HUGE = [
    *(math.inf, 1e300, -1e308, 1e30),
    *(pytest.param(one, marks=pytest.mark.slow) for one in (-math.inf, 1e160)),
]


@every_method
@pytest.mark.parametrize("value", HUGE, ids=str)
@pytest.mark.fast("inf-three-model", "inf-least squares", "1e+30-kalman", "inf-gradient")
def test_values_that_cannot_be_leave_no_trace(key, value):
    """Once and for twenty samples: no nan, no infinity, and near the truth again."""
    u, y, _ = signals(1500)
    method = PLAIN[key]
    state = fold(method, method.init(ASKED, DT), u[:750], y[:750])
    for k in range(750, 1500):
        bad = value if k == 750 or 900 <= k < 920 else y[k]
        try:
            state, innovation = method.step(state, u[k], bad)
        except TridentifyError:
            assert not math.isfinite(bad)
            state, innovation = method.step(state, u[k], np.nan)
        if bad is not value and k > 850:
            assert np.all(np.isfinite(innovation))
    found = method.estimate(state)
    assert np.all(np.isfinite(found.cov))
    assert off(found.theta) < NEAR[key]
    assert state.seen & (Flag.OUTLIER | Flag.MISSING_OUTPUT | Flag.SATURATED)


@every_method
@pytest.mark.parametrize(
    ("value", "at"),
    [
        *((math.inf, 0), (1e30, 0), (1e300, 3), (math.inf, 40), (1e30, 40)),
        *(
            pytest.param(value, at, marks=pytest.mark.slow)
            for value, at in ((1e300, 0), (math.inf, 3), (1e30, 3), (1e300, 40))
        ),
    ],
    ids=str,
)
@pytest.mark.fast("inf-0-three-model", "inf-0-least squares", "inf-0-kalman", "1e+30-40-gradient")
def test_values_that_cannot_be_at_the_beginning(key, value, at):
    if (value, at) == (1e30, 0) and key != "three-model":
        pytest.skip("a finite first sample has nothing that it could be judged by")
    u, y, _ = signals(3500)
    method = PLAIN[key]
    state = method.init(ASKED, DT)
    state = fold(method, state, u[:at], y[:at])
    try:
        state, _ = method.step(state, u[at], value)
    except TridentifyError:
        assert not math.isfinite(value)
        state, _ = method.step(state, u[at], np.nan)
    state = fold(method, state, u[at + 1 :], y[at + 1 :])
    found = method.estimate(state)
    assert np.all(np.isfinite(found.cov))
    assert off(found.theta) < 2 * NEAR[key]


@every_method
@pytest.mark.parametrize("value", [1e300, 1e30, math.inf], ids=str)
@pytest.mark.fast("1e+300-gradient", "1e+30-least squares", "inf-kalman", "inf-three-model")
def test_an_input_that_cannot_be(key, value):
    """One impossible input: refused, or flagged; never a nan ever after."""
    u, y, _ = signals(1500)
    method = PLAIN[key]
    state = fold(method, method.init(ASKED, DT), u[:1250], y[:1250])
    try:
        state, _ = method.step(state, value, y[1250])
    except TridentifyError:
        state, _ = method.step(state, np.nan, y[1250])
    state = fold(method, state, u[1251:], y[1251:])
    found = method.estimate(state)
    assert np.all(np.isfinite(found.theta))
    assert np.all(np.isfinite(found.cov))
    assert state.seen & (Flag.MISSING_INPUT | Flag.OUTLIER | Flag.CHANGED)


# ------------------------------------------------------------------------ a plant that changes
def changing(n_samples, when, first, second, noise=0.05, seed=1):
    """Output of a plant `b1 s + b0` over `s^2 + a1 s + a0` whose coefficients step at a sample.

    The state goes on: ``y`` and its derivatives as far as the input's steps let them.
    """
    u = levels(n_samples, 4, seed)
    y, x = np.empty(n_samples), np.zeros(2)
    steps = []
    for a1, a0, b1, b0 in (first, second):
        # y = x0, x0' = x1 - a1 x0 + b1 u, x1' = -a0 x0 + b0 u
        block = np.zeros((3, 3))
        block[0] = [-a1, 1.0, b1]
        block[1] = [-a0, 0.0, b0]
        steps.append(expm(block * DT))
    for k in range(n_samples):
        y[k] = x[0]
        step = steps[k >= when]
        x = step[:2, :2] @ x + step[:2, 2] * u[k]
    sigma = noise * np.std(y)
    return u, y + sigma * np.random.default_rng(seed + 5).standard_normal(n_samples)


SECOND = np.array([2.0, 7.0, 0.2, 0.5])
CHANGES = {
    "stiffness and damping": SECOND,
    "gain": np.array([1.0, 3.0, 0.4, 1.0]),
    "sign of the gain": np.array([1.0, 3.0, -0.2, -0.5]),
    "stiffness by a third": np.array([1.0, 4.0, 0.2, 0.5]),
}


@pytest.mark.parametrize(
    "change",
    [c if c == "gain" else pytest.param(c, marks=pytest.mark.slow) for c in CHANGES],
)
@every_method
@pytest.mark.fast("three-model-gain", "kalman-gain")
def test_a_step_of_the_coefficients_is_found(key, change):
    """Within 50 s, none before, and what comes after is the new plant."""
    when, second = 2500 if change == "gain" else 10_000, CHANGES[change]
    u, y = changing(2 * when, when, TRUTH, second)
    run = online.run(PLAIN[key], Record(u, y, dt=DT), ASKED, every=25.0)
    assert run.state.changes, "no change found"
    assert when <= run.state.changes[0] <= when + 1000
    assert run.state.seen & Flag.CHANGED
    assert not run.flags[-1] & Flag.CHANGED
    estimate = run.estimate
    assert np.all(np.isfinite(estimate.cov))
    if key != "gradient":
        assert off(estimate.theta, second) < NEAR[key]
        assert len(run.state.changes) <= 2
    before = run.theta[np.searchsorted(run.time, (when - 10) * DT) - 1]
    assert off(before) < NEAR[key]


@pytest.mark.slow
@pytest.mark.parametrize("key", ["three-model", "least squares"])
def test_a_change_may_be_flagged_only(key):
    kind = type(PLAIN[key])
    u, y = changing(12_000, 6000, TRUTH, SECOND)
    record = Record(u, y, dt=DT)
    flag = online.run(kind(on_change="flag"), record, ASKED)
    restart = online.run(kind(on_change="restart"), record, ASKED)
    assert flag.state.changes
    assert 6000 <= flag.state.changes[0] <= 7000
    # without a restart the old samples still count
    assert off(flag.estimate.theta, SECOND) > 2 * off(restart.estimate.theta, SECOND)
    both = kind(on_change="flag", forgetting=0.998)
    assert off(online.run(both, record, ASKED, every=1e9).estimate.theta, SECOND) < 2 * NEAR[key]


@pytest.mark.slow
def test_several_changes_one_after_the_other():
    plants = [TRUTH, SECOND, TRUTH, SECOND]
    parts = [changing(16_000, 4000 * k, plants[k - 1], plants[k]) for k in (1, 2, 3)]
    # glue at the changes: each part is its own run of the plant, from 2000 samples before
    u = np.concatenate([p[0][4000 * k - 2000 : 4000 * k + 2000] for k, p in enumerate(parts, 1)])
    y = np.concatenate([p[1][4000 * k - 2000 : 4000 * k + 2000] for k, p in enumerate(parts, 1)])
    run = online.run(online.ThreeModel(), Record(u, y, dt=DT), Structure(2, 1, **FREE))
    assert len(run.state.changes) >= 3
    for when in (2000, 6000, 10_000):
        assert any(when <= c <= when + 1000 for c in run.state.changes)
    assert off(run.estimate.theta, SECOND) < 0.15


@pytest.mark.slow
def test_the_standard_error_after_a_change_is_that_of_the_samples_since():
    """A restart forgets: no more certain than the new stretch of the record allows."""
    u, y = changing(14_000, 10_000, TRUTH, SECOND)
    run = online.run(online.ThreeModel(), Record(u, y, dt=DT), ASKED)
    since = Record(u[10_000:], y[10_000:], dt=DT)
    alone = identify(since, Structure(2, 1, offset=False, initial_state="free"))
    assert np.all(run.estimate.std > 0.8 * alone.std)
    assert np.all(run.estimate.std < 1.5 * alone.std)
    assert np.max(np.abs(run.estimate.theta - SECOND) / run.estimate.std) < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("key", ["three-model", "least squares", "kalman"])
def test_a_slow_drift_is_followed(key):
    """a0 from 3 to 6 over 500 s: with forgetting the end is nearer the end than the mean."""
    n = 10_000
    u, y, x = levels(n), np.empty(n), np.zeros(2)
    for k in range(n):
        y[k] = x[0]
        a0 = 3.0 + 3.0 * k / n
        block = np.array([[-1.0, 1.0, 0.2], [-a0, 0.0, 0.5], [0.0, 0.0, 0.0]])
        step = expm(block * DT)
        x = step[:2, :2] @ x + step[:2, 2] * u[k]
    y = y + 0.02 * np.std(y) * np.random.default_rng(4).standard_normal(n)
    method = {
        "three-model": online.ThreeModel(forgetting=0.995),
        "least squares": online.RecursiveLeastSquares(forgetting=0.995),
        "kalman": online.Kalman(drift={"a0": 0.1}),
    }[key]
    found = online.run(method, Record(u, y, dt=DT), ASKED, every=1e9).estimate
    assert abs(found.parameters["a0"].value - 6.0) < 0.6


# --------------------------------------------------------------------------- no excitation
def paused(value, good=6000, idle=100_000, again=3000, noise=0.05):
    """Good excitation, a long time of one input value, and good excitation again."""
    u = np.concatenate([levels(good), np.full(idle, value), levels(again, 4, 2)])
    return signals(u.size, noise, u=u)


@pytest.mark.slow
@pytest.mark.parametrize("value", [0.0, 1.0])
@pytest.mark.parametrize("forgetting", [0.99, 0.999])
@pytest.mark.parametrize("key", list(FORGETTING), ids=str)
def test_a_long_time_without_excitation(key, forgetting, value):
    """Over 100,000 samples nothing winds up, and the flag says what is wrong."""
    u, y, _ = paused(value)
    run = online.run(FORGETTING[key](forgetting), Record(u, y, dt=DT), ASKED, every=25.0)
    sane(run)
    index = np.rint(run.time / DT)
    good = (index > 5000) & (index < 6000)
    idle = (index > 8000) & (index < 106_000)
    assert np.all(run.std[idle] < 100.0 * run.std[good].max(axis=0))
    assert sum(bool(f & Flag.NOT_EXCITED) for f in np.array(run.flags)[idle]) > 0.9 * idle.sum()
    assert not run.state.flags & Flag.NOT_EXCITED
    assert run.state.changes == ()
    before = np.max(np.abs(run.theta[good] / TRUTH - 1.0))
    during = np.max(np.abs(run.theta[idle] / TRUTH - 1.0))
    assert during < 2.0 * before + 0.2
    assert off(run.estimate.theta) < (0.4 if forgetting == 0.999 else 1.2)


@pytest.mark.slow
@pytest.mark.parametrize("key", list(FORGETTING), ids=str)
def test_without_excitation_and_without_noise(key):
    """Not even noise keeps the covariance from a division by zero."""
    u, y, _ = paused(0.0, idle=50_000, noise=0.0)
    run = online.run(FORGETTING[key](0.99), Record(u, y, dt=DT), ASKED, every=25.0)
    assert off(sane(run).theta) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("key", list(FORGETTING), ids=str)
def test_excitation_of_one_direction_only(key):
    """A sine tells two numbers of four; forgetting must not lose the other two to the noise."""
    n = 60_000
    u = np.concatenate([levels(6000), 2.0 * np.sin(1.5 * DT * np.arange(n)), levels(3000, 4, 2)])
    u, y, _ = signals(u.size, u=u)
    run = online.run(FORGETTING[key](0.995), Record(u, y, dt=DT), ASKED, every=25.0)
    sane(run)
    assert off(run.estimate.theta) < 0.6
    assert np.nanmax(np.abs(run.theta)) < 100.0


@pytest.mark.slow
@pytest.mark.parametrize("key", list(FORGETTING), ids=str)
def test_no_output_for_a_long_time(key):
    """A hundred thousand samples missing: nothing is forgotten for want of news."""
    u, y, _ = signals(60_000)
    y[6000:56_000] = np.nan
    run = online.run(FORGETTING[key](0.995), Record(u, y, dt=DT), ASKED, every=25.0)
    assert off(sane(run).theta) < 0.4
    before = run.std[np.searchsorted(run.time, 5900 * DT)]
    late = run.std[np.searchsorted(run.time, 55_000 * DT)]
    limit = 100.0 if key == "kalman" else 3.0  # a random walk goes on unseen
    assert np.all(late < limit * before)


# ------------------------------------------------------------------------------- a long time
@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "n_samples"),
    [
        *((key, 2_000_000) for key in FORGETTING if key.startswith("least")),
        *((key, 300_000) for key in FORGETTING if not key.startswith("least")),
        *(
            pytest.param(key, 20_000_000, marks=[pytest.mark.slow, pytest.mark.timeout(900)])
            for key in FORGETTING
            if key.startswith("least")
        ),
        pytest.param(
            "three-model, exponential",
            5_000_000,
            marks=[pytest.mark.slow, pytest.mark.timeout(900)],
        ),
    ],
)
def test_the_covariance_stays_positive_definite(key, n_samples):
    u, y, _ = signals(n_samples)
    run = online.run(FORGETTING[key](0.999), Record(u, y, dt=DT), ASKED)
    estimate = sane(run)
    scale = np.sqrt(np.diag(estimate.cov))
    assert np.all(scale > 0)
    assert np.linalg.eigvalsh(estimate.cov / np.outer(scale, scale)).min() > 0
    assert np.all(run.std[-50:] < 3.0 * np.median(run.std[-50:], axis=0))
    assert off(estimate.theta) < 0.5


@pytest.mark.slow
def test_a_state_does_not_grow(tmp_path):
    """The file after 30,000 samples is no larger than after 10,000."""
    u, y, _ = signals(30_000)
    for method in (*PLAIN.values(), FORGETTING["three-model, exponential"](0.999)):
        sizes = []
        for n in (10_000, 30_000):
            state = online.run(method, Record(u[:n], y[:n], dt=DT), ASKED).state
            sizes.append(state.save(tmp_path / "state.json").stat().st_size)
        assert sizes[1] < 1.05 * sizes[0] + 500


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1e-300, 1e-9, 1e3, 1e12, 1e300])
def test_no_rate_blows_a_gradient_up(rate):
    """Backward Euler with normalised steps is stable for any rate."""
    u, y, sigma = signals(2500)
    method = online.Gradient(rate=rate)
    run = online.run(method, Record(u, y, dt=DT), ASKED, every=EVERY)
    late = run.innovations[1000:, 0]
    assert np.all(np.isfinite(late))
    ready = np.isfinite(run.theta[:, 0])
    assert np.all(np.abs(run.theta[ready]) < 1e6)
    if rate > 1.0:
        assert np.sqrt(np.mean(late**2)) < 10.0 * np.std(y) + sigma


@pytest.mark.parametrize("scale", [1e-12, 1e12])
@pytest.mark.fast("1000000000000.0")
def test_normalised_steps_do_not_know_the_size_of_the_signals(scale):
    u, y, _ = signals(3000)
    plain = online.run(online.Gradient(), Record(u, y, dt=DT), ASKED, every=1e9).estimate
    scaled = online.run(
        online.Gradient(), Record(scale * u, scale * y, dt=DT), ASKED, every=1e9
    ).estimate
    assert scaled.theta == pytest.approx(plain.theta, rel=1e-3)
