"""What identify itself finds wrong with a record: the cause is named, and by what it brings."""

from __future__ import annotations

from functools import cache

import loops
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import lfilter

from tridentify import (
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
    validate,
)
from tridentify.judgement.causes import explain
from tridentify.judgement.causes.attempts.fewer import _moved
from tridentify.judgement.causes.sensors.saturation import levels
from tridentify.judgement.validation import tried

DT, N = 0.05, 800
PLANT = TransferFunction([9.0], [1.0, 1.5, 9.0])
ASKED = Structure(2, 0)


def held(seed, n=N):
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], n // 8), 8)


def response(u, plant=PLANT):
    return simulate(plant, Record(u, u, dt=DT))[:, 0]


def noise(seed, n=N, size=0.05):
    return size * np.random.default_rng(100 + seed).standard_normal(n)


def hardening(u):
    """The plant with a spring that hardens, by an integrator of its own, sample by sample."""
    state, found = np.zeros(2), []
    for value in u:
        found.append(state[0])

        def slope(_, x, value=value):
            return [x[1], 9.0 * value - 1.5 * x[1] - 9.0 * x[0] - 6.0 * x[0] ** 3]

        state = solve_ivp(slope, (0.0, DT), state, rtol=1e-8, atol=1e-10).y[:, -1]
    return np.array(found)


def late(seed):
    plant = TransferFunction([9.0], [1.0, 1.5, 9.0], delay=0.25)
    u = held(seed)
    return [Record(u, response(u, plant) + noise(seed), dt=DT)]


@cache
def cubic(seed):
    u = held(seed)
    return [Record(u, hardening(u) + noise(seed, size=0.01), dt=DT)]


def levels_at_random(seed, n=N):
    return np.repeat(np.random.default_rng(seed).standard_normal(n // 8), 8)


def clipped(seed):
    """A sensor that goes no further than 0.6 of the largest output, and noise after it."""
    u = levels_at_random(seed)
    y = response(u)
    limit = 0.6 * float(np.max(np.abs(y)))
    return [Record(u, np.clip(y, -limit, limit) + noise(seed), dt=DT)]


def clipped_above(seed):
    """The same on one side, in coloured noise."""
    u = levels_at_random(seed)
    y = response(u)
    limit = 0.5 * float(np.max(y))
    return [Record(u, np.minimum(y, limit) + coloured(seed), dt=DT)]


def coloured(seed, n=N, size=0.05):
    white = np.random.default_rng(200 + seed).standard_normal(n + 100)
    return size * 0.7 * lfilter([1.0], [1.0, -0.7], white)[100:]


def stopped(seed):
    """An actuator that goes no further than 0.8, commanded by more."""
    u = levels_at_random(seed)
    acted = np.clip(u, -0.8, 0.8)
    return [Record(u, response(acted) + noise(seed), dt=DT)]


def changed(seed):
    u = held(seed)
    other = response(u, TransferFunction([9.0], [1.0, 1.5, 12.0]))
    later = np.linspace(0.0, 1.0, N)
    y = (1.0 - later) * response(u) + later * other
    return [Record(u, y + noise(seed), dt=DT)]


def two_plants(seed):
    first, second = held(seed), held(seed + 50)
    other = TransferFunction([9.0], [1.0, 1.5, 12.0])
    return [
        Record(first, response(first) + noise(seed), dt=DT),
        Record(second, response(second, other) + noise(seed + 50), dt=DT),
    ]


def hung(seed):
    u = held(seed)
    y = response(u) + noise(seed)
    y[300:420] = y[299]
    return [Record(u, y, dt=DT)]


def one_pole_missing(seed):
    plant = TransferFunction([27.0], np.polymul([1.0, 1.5, 9.0], [1.0, 3.0]))
    u = held(seed)
    return [Record(u, response(u, plant) + noise(seed), dt=DT)]


def with_rows_lost(seed, first=410, count=14):
    u = held(seed)
    kept = np.delete(np.arange(N), np.arange(first, first + count))
    y = response(u) + noise(seed)
    return [Record(u[kept], y[kept], dt=DT)]


def closed_loop(seed, gain=1.0, wanted=None, size=0.2):
    """A controller that sees the output with its noise at every sample, and holds what it gives."""
    wanted = held(seed) if wanted is None else wanted
    n = wanted.size
    state, u, y = np.zeros(2), np.empty(n), np.empty(n)
    a = np.array([[0.0, 1.0], [-9.0, -1.5]])
    step = expm(np.block([[a, np.array([[0.0], [9.0]])], [np.zeros((1, 3))]]) * DT)[:2]
    v = noise(seed, size=size)[:n]
    for k in range(n):
        y[k] = state[0] + v[k]
        u[k] = wanted[k] + gain * (wanted[k] - y[k])
        state = step @ np.append(state, u[k])
    return [Record(u, y, dt=DT)]


def slowly_disturbed(seed):
    u = held(seed)
    slow = 0.4 * np.cos(2.0 * np.pi * 1.3 * np.arange(N) / N + 1.0)
    return [Record(u, response(u) + slow + noise(seed), dt=DT)]


CAUSES = {
    "lost-rows": with_rows_lost,
    "feedback": closed_loop,
    "nonlinear": cubic,
    "varying": changed,
    "disagreeing-experiments": two_plants,
    "stuck-sensor": hung,
}


@cache
def with_two_poles(made, seed):
    return identify(made(seed), ASKED, throw=False)


@pytest.mark.parametrize("code", CAUSES)
@pytest.mark.fast("lost-rows")
def test_the_cause_is_named_first(code):
    estimate = with_two_poles(CAUSES[code], 3)
    first = estimate.findings[0]
    assert first.code == code, [finding.text for finding in estimate.findings]
    assert first.matters
    assert first.remedy
    if code not in ("stuck-sensor", "feedback"):
        assert "With it: " in first.effect


@pytest.mark.slow
def test_a_delay_is_told_with_its_size_and_what_it_brings():
    (record,) = late(4)
    first = identify(record, ASKED, throw=False).findings[0]
    assert first.code == "delay"
    assert first.matters
    assert first.remedy
    assert "With it: " in first.effect
    assert "a delay of about 0.25 s" in first.message
    better = identify(record, Structure(2, 0, delay=0.25))
    assert abs(better.theta[1] - 9.0) < 5 * better.std[1]
    assert not better.cautions


@pytest.mark.slow
def test_an_order_that_is_too_low_is_told_where_nothing_earlier_explains_it():
    codes = [f.code for f in identify(one_pole_missing(5), ASKED, throw=False).findings]
    # a fast pole is nearly a delay, which comes first and explains as much
    assert codes
    assert codes[0] in ("order-low", "delay")


LIMITS = {
    clipped: lambda y: 0.6 * np.max(np.abs(y)),
    clipped_above: lambda y: 0.5 * np.max(y),
    stopped: lambda _: 0.8,
}


@pytest.mark.parametrize(
    ("made", "seed"),
    [
        (clipped_above, 3),
        (stopped, 3),
        *(pytest.param(made, 4, marks=pytest.mark.slow) for made in LIMITS),
        pytest.param(clipped, 3, marks=pytest.mark.slow),
    ],
)
@pytest.mark.slow
def test_a_limit_is_told_with_its_level_and_what_it_brings(made, seed):
    (record,) = made(seed)
    first = identify(record, ASKED, throw=False).findings[0]
    assert first.code == "saturation", first.text
    assert "With it: " in first.effect
    told = float(first.message.split(" explains it best")[0].split()[-1])
    limit = LIMITS[made](response(record.u[:, 0]))
    assert abs(told - limit) < 0.15 * limit


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, *(pytest.param(k, marks=pytest.mark.slow) for k in (4, 5))])
def test_a_hardening_spring_is_not_taken_for_coloured_noise(seed):
    (record,), estimate = cubic(seed), with_two_poles(cubic, seed)
    assert estimate.noise_model[0].size
    for found in (estimate.findings, validate(estimate, record).findings):
        assert next(f.code for f in found if f.matters) == "nonlinear"


@pytest.mark.slow
def test_a_short_delay_in_much_noise_is_told():
    codes = []
    for seed in range(4):
        u = held(seed)
        plant = TransferFunction([9.0], [1.0, 1.5, 9.0], delay=2 * DT)
        y = response(u, plant) + noise(seed, size=0.3)
        found = identify(Record(u, y, dt=DT), ASKED, throw=False).findings
        codes += [f.code for f in found[:1] if f.matters]
    assert codes.count("delay") >= 3


def test_a_limit_on_one_side_leaves_the_other_open():
    rng = np.random.default_rng(0)
    y = rng.standard_normal(2000)
    low, high = levels(np.maximum(y, -0.7) + 0.05 * rng.standard_normal(2000), y)
    assert np.isinf(high)
    assert abs(low + 0.7) < 0.05
    assert np.isinf(levels(y + 0.3 * rng.standard_normal(2000), y)).all()


@pytest.mark.slow
def test_right_records_are_left_alone():
    told = []
    for seed in range(12):
        u = held(seed)
        estimate = identify(Record(u, response(u) + noise(seed), dt=DT), ASKED)
        told += estimate.cautions
    assert not told


@pytest.mark.slow
def test_lost_rows_are_told_with_their_times_and_the_cut_mends_them():
    (record,) = with_rows_lost(6)
    found = identify(record, ASKED, throw=False).findings[0]
    assert found.code == "lost-rows"
    assert found.severity == "error"
    assert len(found.times) == 1
    assert abs(found.times[0] - 410 * DT) < 2.5 * DT
    parts = list(record.split(found.times[0]))
    estimate = identify(parts, Structure(2, 0, initial_state="free"))
    assert abs(estimate.theta[1] - 9.0) < 4 * estimate.std[1]
    assert "lost-rows" not in [f.code for f in estimate.findings]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.fast("1")
def test_single_bad_samples_and_steps_of_the_input_are_no_lost_rows(seed):
    u = held(seed)
    y = response(u) + noise(seed)
    y[[150, 420, 421, 600]] += [1.0, -1.2, 0.9, 1.5]
    codes = [f.code for f in identify(Record(u, y, dt=DT), ASKED, throw=False).findings]
    assert codes[0] == "bad-samples"
    assert "lost-rows" not in codes


@pytest.mark.slow
def test_a_disturbance_that_shakes_the_state_now_and_then_is_no_lost_rows():
    rng = np.random.default_rng(3)
    u = held(3)
    kicks = rng.standard_normal(N) * (rng.random(N) < 0.1)
    shaken = simulate(PLANT, Record(kicks, kicks, dt=DT))[:, 0]
    estimate = identify(Record(u, response(u) + shaken + noise(3), dt=DT), ASKED, throw=False)
    assert "lost-rows" not in [f.code for f in estimate.findings]


def measured(seed):
    """A command through an actuator, and the response to what it did, ten times finer."""
    fine = np.repeat(held(seed), 10)
    pole = np.exp(-1.0 / 25.0)
    fine = lfilter([1.0 - pole], [1.0, -pole], lfilter([1.0 - pole], [1.0, -pole], fine))
    y = simulate(PLANT, Record(fine, fine, dt=DT / 10.0))[:, 0]
    return fine[::10], y[::10]


@pytest.mark.slow
@pytest.mark.parametrize(
    "between", ["zoh", *(pytest.param(b, marks=pytest.mark.slow) for b in ("foh", "band-limited"))]
)
def test_a_smooth_measured_input_is_no_feedback(between):
    u, y = measured(7)
    record = Record(u, y + noise(7, size=0.005), dt=DT, intersample=between)
    estimate = identify(record, ASKED, throw=False)
    codes = [f.code for f in estimate.findings]
    assert "feedback" not in codes
    if between == "zoh":
        assert codes[0] == "intersample"


@pytest.mark.slow
def test_a_reference_that_stands_still_for_long_does_not_hide_the_controller():
    # a short record: the steps of the reference are all that a plain regression sees
    steps = np.repeat([0.0, 1.0, 0.5, 2.0], 50)
    (record,) = closed_loop(5, gain=0.5, wanted=steps, size=0.05)
    (finding,) = [f for f in identify(record, ASKED).findings if f.code == "feedback"]
    assert finding.severity == "warning"


@pytest.mark.slow
def test_a_plant_that_only_its_controller_holds_is_feedback_and_not_a_drift():
    drawn = loops.draw(12)
    assert drawn.poles.real.max() >= 0.0
    findings = identify(drawn.record, drawn.structure, throw=False).findings
    assert "feedback" in [f.code for f in findings]


@pytest.mark.slow
def test_a_commanded_staircase_is_no_feedback_whatever_the_model_misses():
    (record,) = cubic(8)
    estimate = identify(record, Structure(1, 0), throw=False)
    assert "feedback" not in [f.code for f in estimate.findings]


@pytest.mark.slow
def test_a_smaller_structure_that_does_as_well_is_told():
    u = held(9)
    record = Record(u, response(u) + noise(9), dt=DT)
    estimate = identify(record, Structure(4, 2), throw=False)
    found = next(f for f in estimate.findings if f.code == "order-high")
    assert found.matters
    assert "Use poles=2 and zeros=0" in found.remedy
    assert "With fewer: fit of y from" in found.effect


def test_a_structure_whose_poles_are_all_needed_is_not_called_too_high():
    plant = TransferFunction([400.0], np.polymul([1.0, 1.5, 9.0], [1.0, 2.0, 60.0]))
    u = held(10)
    record = Record(u, response(u, plant) + noise(10, size=0.002), dt=DT)
    estimate = identify(record, Structure(4, 0), throw=False)
    assert "order-high" not in [f.code for f in estimate.findings]


@pytest.mark.slow
def test_a_slow_disturbance_is_named_where_the_noise_has_no_model():
    (record,) = slowly_disturbed(11)
    first = validate(identify(record, ASKED, ThreeModel(noise="white")), record).findings[0]
    assert first.code == "drift", first.text
    assert "a slow disturbance" in first.message


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 5))]
)
@pytest.mark.slow
def test_a_stretch_at_rest_in_coloured_noise_shows_no_response(seed):
    rng = np.random.default_rng(seed)
    u = 0.001 * rng.standard_normal(400)
    wander = lfilter([1.0], [1.0, -0.97], rng.standard_normal(600))[200:]
    gusts = simulate(PLANT, Record(rng.standard_normal(400), np.zeros(400), dt=DT))[:, 0]
    for y in (5.0 + 0.02 * wander, 0.1 * gusts + 0.005 * rng.standard_normal(400)):
        estimate = identify(Record(u, y, dt=DT), Structure(2, 1), throw=False)
        assert estimate.findings[0].code == "no-response", [f.code for f in estimate.findings]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
def test_two_random_walks_have_nothing_to_do_with_each_other(seed):
    rng = np.random.default_rng(seed)
    u, y = (np.cumsum(rng.standard_normal(400)) for _ in range(2))
    estimate = identify(Record(u, y, dt=DT), Structure(2, 1), throw=False)
    assert estimate.findings[0].code == "no-response", [f.code for f in estimate.findings]


@pytest.mark.parametrize("seed", [10, 13, 24])
@pytest.mark.slow
def test_a_walk_that_follows_another_closely_does_not_respond_to_it(seed):
    """Seen: fit 60 to 70 % with coefficients of 3 to 7 stated errors, and no word."""
    rng = np.random.default_rng([seed, 91])
    u, y = (np.cumsum(rng.standard_normal(300)) for _ in range(2))
    estimate = identify(Record(u, y, dt=DT), Structure(1, 0))
    assert [f.code for f in estimate.findings if f.matters] == ["no-response"]


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.fast("0")
def test_a_ramp_through_a_gain_tells_no_time_constant(seed):
    """Seen: a time constant of one sample, four stated errors away from none, and no word."""
    u = np.linspace(0.0, 1.0, 300)
    noise = 0.02 * np.random.default_rng([seed, 602]).standard_normal(300)
    estimate = identify(Record(u, 2.0 * u + noise, dt=DT, intersample="foh"), Structure(1, 0))
    assert any("A gain alone" in f.message for f in estimate.findings if f.matters)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.fast("0")
def test_a_lag_of_one_sample_that_the_record_shows_is_told(seed):
    u = held(seed, 400)
    y = response(u, TransferFunction([20.0], [1.0, 20.0]))
    y = y + 0.2 * np.random.default_rng([seed, 603]).standard_normal(400)
    estimate = identify(Record(u, y, dt=DT), Structure(1, 0))
    assert not [f.code for f in estimate.findings if f.matters]


@pytest.mark.slow
def test_a_response_that_a_random_walk_hides_is_still_one():
    rng = np.random.default_rng(5)
    u = np.cumsum(rng.standard_normal(400))
    y = response(u) + np.cumsum(rng.standard_normal(400))
    estimate = identify(Record(u, y, dt=DT), Structure(4, 3), throw=False)
    assert "not-determined" in [f.code for f in estimate.findings]
    assert "no-response" not in [f.code for f in estimate.findings]


@pytest.mark.slow
def test_a_weak_response_in_coloured_noise_is_still_one():
    u = held(12)
    wander = lfilter([1.0], [1.0, -0.97], np.random.default_rng(12).standard_normal(N))
    y = response(u) + 0.5 * wander
    estimate = identify(Record(u, y, dt=DT), Structure(4, 3), throw=False)
    assert "no-response" not in [f.code for f in estimate.findings]


@pytest.mark.slow
def test_right_records_with_other_inputs_and_noise_are_left_alone():
    told = []
    for drawn, made in ((held, coloured), (levels_at_random, noise), (levels_at_random, coloured)):
        for seed in range(12):
            u = drawn(seed)
            estimate = identify(Record(u, response(u) + made(seed), dt=DT), ASKED)
            told += estimate.cautions[:1]
    # 3 % of 36 records
    assert len(told) <= 1, told


@pytest.mark.slow
def test_no_output_is_looked_at_twice_and_nothing_is_tried_beside_lost_rows_in_vain(monkeypatch):
    looked, made = [], []
    examine, rivals = tried.examine, explain._rivals

    def look(view, index, *rest):
        looked.append((view, index))
        return examine(view, index, *rest)

    def make(present, *rest):
        made.append(present)
        return rivals(present, *rest)

    monkeypatch.setattr(tried, "examine", look)
    monkeypatch.setattr(explain, "_rivals", make)
    (record,) = changed(3)
    y = np.array(record.y)
    y[[150, 420, 600], 0] += [1.0, -1.2, 0.9]
    spoiled = Record(record.u, y, dt=DT)
    estimate = identify(spoiled, ASKED, throw=False)
    assert {"bad-samples", "varying"} <= {f.code for f in estimate.findings}
    assert len(looked) == len(set(looked)) > 1
    # with the bad samples and without them
    assert len(made) == 2


def test_a_test_of_response_by_least_squares():
    rng = np.random.default_rng(8)
    u = rng.choice([0.0, 1.0], 40).repeat(20)[:, None]
    noise = lfilter([1.0], [1.0, -0.9], rng.standard_normal(800))
    moved = lfilter([0.0, 0.5], [1.0, -0.95], u[:, 0]) + noise
    assert _moved([moved], [u], 4, 4)
    assert not _moved([noise], [u], 4, 4)
    walks = [np.cumsum(np.random.default_rng(k).standard_normal(600)) for k in range(40)]
    pairs = zip(walks[::2], walks[1::2], strict=True)
    assert not any(_moved([y - y.mean()], [x[:, None]], 4, 4) for y, x in pairs)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_step_that_is_answered_late_shows_a_response_to_a_model_without_delay(seed: int) -> None:
    rng = np.random.default_rng(300 + seed)
    u = np.where(np.arange(150) >= 10, 30.0, 0.0)
    heater = TransferFunction([0.006], [1.0, 0.006], delay=40.0)
    y = 25.0 + simulate(heater, Record(u, u, dt=5.0))[:, 0] + 0.1 * rng.standard_normal(150)
    found = identify(Record(u, y, dt=5.0), Structure(1, 0), throw=False).findings
    assert found[0].code == "delay"
    assert not any(one.code == "no-response" for one in found)
    walk = np.cumsum(rng.standard_normal(150))
    assert not _moved([walk - walk.mean()], [u[:, None]], 1, 3)
