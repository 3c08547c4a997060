"""Advice names what is wrong with a record before anything is fitted, and keeps still otherwise."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.signal import lfilter

import tridentify
from tridentify import DataError, Record, TransferFunction, advise, frequency_response, simulate
from tridentify.errors import ScaleError

DT = 0.05
SYSTEM = TransferFunction([2.0, 6.0], [1.0, 2.0, 9.0])
N = 800


def held(seed, n=N, hold=6):
    rng = np.random.default_rng([seed, 1])
    return np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]


def noisy(seed, u, noise=0.02, system=SYSTEM, **options):
    rng = np.random.default_rng([seed, 2])
    y = simulate(system, Record(u, np.zeros(len(u)), dt=DT, **options))
    return y[:, 0] + noise * rng.standard_normal(len(u))


def codes(found, *, notes=False):
    return [f.code for f in found.findings if f.matters or notes]


@pytest.fixture(scope="module")
def good():
    u = held(0)
    return Record(u, noisy(0, u), dt=DT, input_names=["elevator"], output_names=["q"])


@pytest.fixture(scope="module")
def found(good):
    return advise(good)


def test_a_good_record_is_called_so(found):
    assert found.findings == ()
    assert found.ok
    low, high = found.frequency.band()
    assert low < 1.0 < 10.0 < high
    assert found.poles in (1, 2)
    assert found.behaviour == "zoh"
    assert found.delays[0].low == 0.0
    text = " ".join(found.summary().split())
    assert "nothing stands in the way" in text
    assert "elevator excites from" in text
    assert "q answers elevator" in text


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.slow
def test_right_records_with_coloured_noise_raise_nothing(seed):
    u = held(seed)
    rng = np.random.default_rng([seed, 3])
    colour = lfilter([1.0], [1.0, -0.7], rng.standard_normal(N))
    found = advise(Record(u, noisy(seed, u, 0.0) + 0.03 * colour, dt=DT))
    assert codes(found, notes=True) == []


def test_spikes_are_named_with_their_times_and_left_out(good):
    y = good.y[:, 0].copy()
    y[[100, 401]] += [0.9, -0.8]
    found = advise(Record(good.u, y, dt=DT))
    assert codes(found, notes=True) == ["bad-samples"]
    assert found.findings[0].times == pytest.approx((5.0, 20.05))
    assert not found.ok


@pytest.mark.parametrize("noise", [1e-9, 1e-7, 1e-5])
@pytest.mark.slow
def test_a_response_with_hardly_any_noise_has_no_bad_samples(noise):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 30), 20)
    system = TransferFunction([5.0, 40.0], [1.0, 4.0, 40.0])
    y = simulate(system, Record(u, u, dt=0.01))[:, 0] + noise * rng.standard_normal(u.size)
    assert "bad-samples" not in codes(advise(Record(u, y, dt=0.01)))
    y[400] += 0.05 * np.std(y)
    assert "bad-samples" in codes(advise(Record(u, y, dt=0.01)))


@pytest.mark.slow
def test_the_first_sample_but_two_may_be_bad(good):
    y = good.y[:, 0].copy()
    y[2] += 1.0
    assert advise(Record(good.u, y, dt=DT)).findings[0].times == pytest.approx((0.1,))


@pytest.mark.parametrize("length", [40, 300])
@pytest.mark.slow
def test_a_sensor_that_hangs(good, length):
    y = good.y[:, 0].copy()
    y[200 : 200 + length] = y[199]
    found = advise(Record(good.u, y, dt=DT))
    assert codes(found)[0] == "stuck-sensor"
    times = found.findings[0].times
    assert times[0] == pytest.approx(199 * DT)
    assert times[-1] == pytest.approx((199 + length) * DT)


@pytest.mark.slow
def test_a_response_without_noise_does_not_hang_at_rest():
    u = np.concatenate([np.zeros(100), held(3, 300), np.zeros(400)])
    y = simulate(SYSTEM, Record(u, u, dt=DT))
    assert "stuck-sensor" not in codes(advise(Record(u, y, dt=DT)))


@pytest.mark.slow
def test_a_saturated_sensor(good):
    found = advise(Record(good.u, np.clip(good.y, -0.5, 0.5), dt=DT))
    assert "saturation" in codes(found)


@pytest.mark.slow
def test_a_coarse_converter(good):
    found = advise(Record(good.u, 0.1 * np.round(good.y / 0.1), dt=DT))
    assert "quantisation" in codes(found)


@pytest.mark.slow
def test_a_delay_with_its_range():
    u = held(5)
    late = TransferFunction([2.0, 6.0], [1.0, 2.0, 9.0], delay=0.3)
    found = advise(Record(u, noisy(5, u, system=late), dt=DT))
    (seen,) = found.delays
    assert seen.low <= 0.3 <= seen.high
    assert seen.high - seen.low < 0.15
    assert codes(found, notes=True) == ["delay"]
    assert found.ok


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.slow
def test_many_operators_do_not_stand_for_a_delay_before_two_lags(seed):
    rng = np.random.default_rng([seed, 31])
    u = np.repeat(rng.choice([-1.0, 1.0], 150), 4)
    late = TransferFunction([27.8], [1.0, 10.6, 27.8], delay=0.15)
    noise = lfilter([1.0], [1.0, -0.8], rng.standard_normal(600))
    y = simulate(late, Record(u, u, dt=DT))[:, 0] + 0.03 * noise
    (seen,) = advise(Record(u, y, dt=DT)).delays
    assert seen.low - 1e-9 <= 0.15 <= seen.high + 1e-9
    assert abs(seen.value - 0.15) < 0.6 * DT
    assert seen.fall > 25.0


@pytest.mark.slow
def test_a_measured_input_stated_as_held():
    fine = lfilter([0.05], [1.0, -0.95], np.repeat(held(7), 10))
    y = simulate(SYSTEM, Record(fine, fine, dt=DT / 10))[::10, 0]
    y = y + 0.005 * np.random.default_rng(1).standard_normal(N)
    stated = advise(Record(fine[::10], y, dt=DT))
    assert codes(stated) == ["intersample"]
    assert stated.behaviour != "zoh"
    assert codes(advise(Record(fine[::10], y, dt=DT, intersample="auto"))) == []


def looped():
    rng = np.random.default_rng(11)
    # x' = -x + u, sampled with u held; u = r - 0.8 y
    a, reference, state = np.exp(-DT), held(11), 0.0
    u, y = np.zeros(N), np.zeros(N)
    noise = 0.15 * rng.standard_normal(N)
    for k in range(N):
        y[k] = state + noise[k]
        u[k] = reference[k] - 0.8 * y[k]
        state = a * state + (1.0 - a) * u[k]
    return u, y, reference


@pytest.mark.slow
def test_feedback():
    u, y, reference = looped()
    found = advise(Record(u, y, dt=DT))
    assert "feedback" in codes(found)
    assert "open the loop" in found.summary()
    assert "as many zeros as" in found.summary()
    # nothing is to be opened where the reference was recorded
    followed = advise(Record(u, y, dt=DT, reference=reference))
    assert ("feedback", "note") in [(one.code, one.severity) for one in followed.findings]
    assert "open the loop" not in followed.summary()


@pytest.mark.slow
def test_a_drift(good):
    t = np.arange(N) / N
    size = np.std(good.y)
    assert "drift" in codes(advise(Record(good.u, good.y[:, 0] + 2.0 * size * t, dt=DT)))


@pytest.mark.slow
def test_a_disturbance_that_wanders(good):
    size = np.std(good.y)
    found = 0
    for seed in range(6):
        steps = np.random.default_rng(seed).standard_normal(N) / np.sqrt(N)
        wandering = Record(good.u, good.y[:, 0] + 1.5 * size * np.cumsum(steps), dt=DT)
        found += "drift" in codes(advise(wandering))
    assert found >= 3


@pytest.mark.slow
def test_a_single_tone_and_a_constant_input(good):
    u = np.sin(2.0 * DT * np.arange(N))
    assert "not-excited" in codes(advise(Record(u, noisy(1, u), dt=DT)))
    constant = advise(Record(np.ones(N), good.y, dt=DT))
    assert codes(constant)[0] == "constant-input"
    assert constant.poles is None
    assert "excites" not in constant.summary()


@pytest.mark.slow
def test_no_response_and_an_input_that_does_nothing(good):
    rng = np.random.default_rng(13)
    silent = advise(Record(good.u, rng.standard_normal(N), dt=DT))
    assert codes(silent) == ["no-response"]
    assert not silent.ok
    both = np.column_stack([good.u[:, 0], held(14)])
    beside = advise(Record(both, good.y, dt=DT, input_names=["elevator", "flap"]))
    assert codes(beside) == ["no-response"]
    assert "flap" in beside.findings[0].message
    assert {seen.input for seen in beside.delays} == {"elevator"}


@pytest.mark.slow
def test_gaps_are_told():
    t = DT * np.arange(N)
    t[400:] += 0.5
    u = held(15)
    y = noisy(15, u)
    y[50:60] = np.nan
    found = advise(Record(u, y, t=t))
    gaps = [f for f in found.findings if f.code == "missing-samples"]
    assert [f.severity for f in gaps] == ["note", "note"]
    assert gaps[1].times == pytest.approx((399 * DT,))


@pytest.mark.slow
def test_rows_that_were_lost_from_a_measured_record():
    t = DT * np.arange(N)
    u = np.sin(0.5 * t) + 0.5 * np.sin(1.3 * t + 1.0)
    y = noisy(2, u, 0.001, intersample="foh")
    kept = np.r_[0:300, 340:N]
    found = advise(Record(u[kept], y[kept], dt=DT, intersample="foh"))
    assert "lost-rows" in codes(found)
    lost = next(f for f in found.findings if f.code == "lost-rows")
    assert lost.times == pytest.approx((300 * DT,))


@pytest.mark.slow
def test_experiments_together(good):
    u = held(21)
    other = Record(u, 3.0 + noisy(21, u), dt=DT, input_names=["elevator"], output_names=["q"])
    found = advise([good, other])
    assert codes(found) == []
    assert found.n_samples == 2 * N


def test_it_can_be_stored_and_shown(found):
    document = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert document["inputs"] == ["elevator"]
    assert document["ok"] is True
    page = found._repr_html_()
    assert "nothing stands in the way" in page
    assert repr(found) == "Advice(nothing found)"


def test_too_little_and_the_wrong_records_are_refused(good):
    with pytest.raises(DataError, match="expected at least 40"):
        advise(Record(np.ones(30), np.arange(30.0), dt=1.0))
    with pytest.raises(DataError, match="different sets of channels"):
        advise([good, Record(good.u, good.y, dt=DT)])


@pytest.mark.parametrize("survey", [advise, frequency_response])
@pytest.mark.parametrize(
    ("u", "y", "t"), [(1e200, 1.0, 1.0), (1.0, 1e-200, 1.0), (1.0, 1.0, 1e-130), (1.0, 1.0, 1e60)]
)
def test_numbers_without_room_are_refused(good, survey, u, y, t):
    """Seen: squares that overflow, and warnings of libraries."""
    with pytest.raises(ScaleError, match="choose"):
        survey(Record(good.u * u, good.y * y, dt=DT * t))


def test_names_are_public(found):
    assert tridentify.advise is advise
    assert isinstance(found, tridentify.Advice)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_a_swing_after_one_step_is_no_delay(seed):
    """However alike its periods are: the output leaves its rest when the input does."""
    rng = np.random.default_rng([seed, 17])
    u = (np.arange(500) >= 60).astype(float)
    plant = TransferFunction([8.0], [1.0, 1.2, 16.0])
    y = simulate(plant, Record(u, np.zeros(500), dt=0.05))[:, 0]
    found = advise(Record(u, y + 0.05 * y.std() * rng.standard_normal(500), dt=0.05))
    assert all(one.value < 0.3 for one in found.delays)
    assert not [one.code for one in found.findings if one.code in ("delay", "drift")]


def autoregressive(seed, memory, n=500):
    noise = np.random.default_rng([seed, 31]).standard_normal(n + 600)
    return lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], noise)[600:]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 4, 6])
def test_an_input_is_not_taken_to_act_on_what_wanders_by_itself(seed):
    """Least squares follows coloured noise by many operators; its own past tells as much of it."""
    u = held(seed, 500, 15)
    assert codes(advise(Record(u, autoregressive(seed, 0.9), dt=DT)), notes=True) == ["no-response"]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.slow
def test_a_late_or_a_weak_response_is_not_denied(seed):
    u = held(seed, 500, 15)
    late = TransferFunction([8.0], [1.0, 1.2, 16.0], delay=3.0)
    y = simulate(late, Record(u, np.zeros(500), dt=DT))[:, 0]
    y = y + 0.5 * y.std() * np.random.default_rng([seed, 32]).standard_normal(500)
    assert "no-response" not in codes(advise(Record(u, y, dt=DT)))


@pytest.mark.parametrize("seed", [5, 6, 7])
@pytest.mark.slow
def test_a_strong_drift_is_no_noise_of_long_memory(seed):
    u = held(seed, 500, 15)
    plant = TransferFunction([8.0], [1.0, 1.2, 16.0])
    y = simulate(plant, Record(u, np.zeros(500), dt=DT))[:, 0]
    y = y + 0.05 * y.std() * np.random.default_rng([seed, 33]).standard_normal(500)
    assert codes(advise(Record(u, y + 3.0 * y.std() * np.linspace(0.0, 1.0, 500), dt=DT))) == [
        "drift"
    ]


@pytest.mark.slow
def test_slow_disturbances_are_told_where_they_are():
    plant = TransferFunction([8.0], [1.0, 1.2, 16.0])
    told, wrong = 0, 0
    for seed in range(12):
        u = held(seed, 500, 15)
        y = simulate(plant, Record(u, np.zeros(500), dt=DT))[:, 0]
        noise = 0.05 * np.random.default_rng([seed, 34]).standard_normal(500)
        for memory, size in ((0.99, 0.6), (0.9, 0.1)):
            disturbed = y + y.std() * (noise + size * autoregressive(seed, memory))
            drifts = "drift" in codes(advise(Record(u, disturbed, dt=DT)))
            told, wrong = told + (drifts and size > 0.5), wrong + (drifts and size < 0.5)
    assert told >= 7
    assert wrong == 0


@pytest.mark.slow
def test_what_a_heading_sums_up_is_no_drift():
    """A rudder, a feed pump or a drive, held at steps, and the angle or the level it makes."""
    system, wrong = TransferFunction([1.0], [1.0, 0.9, 0.0]), 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 7])
        u = np.repeat(rng.uniform(-1.0, 1.0, N // 14 + 1), 14)[:N]
        summed = simulate(system, Record(u, u, dt=DT))[:, 0]
        y = summed + 0.02 * np.std(summed) * rng.standard_normal(N)
        wrong += "drift" in codes(advise(Record(u, y, dt=DT)))
    assert wrong <= 1
