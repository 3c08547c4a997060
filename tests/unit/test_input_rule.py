"""Whether a recorded input follows from recorded samples, and the kind of controller taken so."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

import tridentify as tri
from oracles import continuous_loop, sampled_loop
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.closed_loop.input_rule import InputRule, input_rule

pytestmark = pytest.mark.unjudged

DT, FINE, N = 0.1, 10, 700
CHANNEL = ([1.0, 2.0], [1.0, 1.2, 4.0])
TRUTH = np.array([1.2, 4.0, 1.0, 2.0])
PI = (np.zeros((1, 1)), np.ones(1), np.array([1.0]), 2.0)


def moved(seed, held=15):
    rng = np.random.default_rng(seed)
    return rng, np.repeat(rng.choice([-1.0, 1.0], N // held + 1), held)[:N]


def continuous(seed, *, noise=0.2, digits=None, gain=None):
    """A continuous controller that sees what the noise does between the samples."""
    rng, r = moved(seed)
    pole = np.exp(-DT / FINE / 0.15)
    driving = rng.standard_normal(N * FINE + 500)
    v = noise * lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], driving)[500:]
    law = PI if gain is None else (np.zeros((0, 0)), np.zeros(0), np.zeros(0), gain)
    u, y = continuous_loop(CHANNEL, law, np.repeat(r, FINE), v, DT / FINE)
    return recorded(u[::FINE], y[::FINE], r, digits)


def sampled(seed, *, noise=0.2, limit=np.inf, memory=True, digits=None, late=0, every=1):
    """A computer's controller, with the samples that are recorded."""
    rng, r = moved(seed)
    total, stays, waiting = 0.0, 0.0, [0.0] * late

    def control(k, y):
        nonlocal total, stays
        if k % every:
            return stays
        total += every * DT * (r[k] - y[0]) * memory
        waiting.append(float(np.clip(2.0 * (r[k] - y[0]) + total, -limit, limit)))
        stays = waiting.pop(0)
        return stays

    u, y = sampled_loop([[CHANNEL]], control, noise * rng.standard_normal((N, 1)), DT)
    return recorded(u, y, r, digits)


def recorded(u, y, r, digits=None):
    u, y = (one if digits is None else np.round(one, digits) for one in (u, y))
    return tri.Record(u, y, dt=DT, reference=r)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.fast("0")
def test_a_rule_of_the_samples_is_seen_and_its_absence_too(seed):
    assert input_rule([sampled(seed)], 2) is InputRule.SAMPLED
    assert input_rule([sampled(seed, late=1)], 2) is InputRule.SAMPLED
    assert input_rule([sampled(seed, memory=False)], 2) is InputRule.STATIC
    assert input_rule([continuous(seed)], 2) is InputRule.NONE
    assert input_rule([continuous(seed, gain=2.0)], 2) is InputRule.STATIC


def without_reference(record, between="zoh"):
    return tri.Record(record.u, record.y, dt=DT, intersample=between)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.fast("0")
def test_the_rule_is_seen_where_the_set_point_is_not_recorded(seed):
    made = {
        InputRule.SAMPLED: sampled(seed),
        InputRule.NONE: continuous(seed),
        InputRule.STATIC: sampled(seed, memory=False),
    }
    assert [input_rule([without_reference(one)], 2) for one in made.values()] == list(made)
    static = continuous(seed, gain=2.0)
    assert input_rule([without_reference(static)], 2) is InputRule.STATIC


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(70, 74))
def test_a_controller_seen_in_the_samples_settles_what_its_input_does_between_them(seed):
    structure = tri.Structure(2, 1)
    found = tri.identify(without_reference(sampled(seed), "auto"), structure)
    assert (found.route, found.intersample) == ("direct", "zoh")
    assert found.trace.about(DecisionKind.SEEN_HELD)
    assert not found.trace.about(DecisionKind.RESTS_ON_HELD)
    assert not any(one.severity == "error" for one in found.findings)
    assert np.max(np.abs(found.theta - TRUTH) / found.std) < 4.0
    assert np.max(found.std / TRUTH) < 0.5
    left_open = tri.identify(without_reference(continuous(seed), "auto"), structure)
    assert not left_open.trace.about(DecisionKind.SEEN_HELD)


def test_a_limit_does_not_hide_the_rule():
    record = sampled(3, limit=2.0)
    assert np.mean(np.abs(record.u) == 2.0) > 0.05
    assert input_rule([record], 2) is InputRule.SAMPLED


def test_rounded_numbers_tell_nothing_that_is_wrong():
    assert input_rule([sampled(4, digits=9)], 2) is InputRule.SAMPLED
    assert input_rule([sampled(4, digits=2)], 2) is InputRule.UNKNOWN
    assert input_rule([continuous(4, digits=4)], 2) is InputRule.NONE
    assert input_rule([continuous(4, digits=1)], 2) is not InputRule.SAMPLED


@pytest.mark.parametrize("seed", range(40, 45))
@pytest.mark.fast("40")
def test_four_digits_show_the_rule_where_the_input_moves_much_more(seed):
    """The rounding of the rule's own sum is what counts, not the worst case of all its signals."""
    assert input_rule([sampled(seed, digits=4)], 2) is InputRule.SAMPLED
    assert input_rule([continuous(seed, digits=3)], 2) is not InputRule.SAMPLED
    assert input_rule([continuous(seed, digits=3, gain=2.0)], 2) is not InputRule.SAMPLED


def test_noise_that_is_held_shows_the_plant_in_the_rule_of_a_continuous_controller():
    rng, r = moved(6)
    u, y = continuous_loop(CHANNEL, PI, r, 0.2 * rng.standard_normal(N), DT)
    assert input_rule([recorded(u, y, r)], 2) is InputRule.LONGER


def held_beside_a_dither(seed, step):
    """Fast samples of a continuous loop, moved at the set point and at the plant's input."""
    rng, r = moved(seed)
    dither = np.repeat(rng.standard_normal(N // 7 + 1), 7)[:N]
    noise = 0.02 * rng.standard_normal(N)
    u, y = continuous_loop(CHANNEL, PI, r, noise, step, dither=dither)
    return tri.Record(u, y, dt=step, reference=np.column_stack([r, dither]))


@pytest.mark.parametrize("seed", range(60, 65))
@pytest.mark.fast("60")
def test_a_part_of_a_rule_is_none_however_little_it_leaves(seed):
    """Two lags leave a millionth of the input, and more of them leave nothing."""
    rule = input_rule([held_beside_a_dither(seed, 0.01)], 2)
    assert rule is InputRule.LONGER


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-4])
@pytest.mark.fast("0.0")
def test_a_rule_is_seen_beside_the_noise_and_not_where_there_is_none(noise):
    """Without noise all signals follow from the reference, and each from any other."""
    rules = [input_rule([make(12, noise=noise)], 2) for make in (sampled, continuous)]
    if noise:
        assert rules == [InputRule.SAMPLED, InputRule.NONE]
    else:
        assert rules == [InputRule.UNKNOWN] * 2


@pytest.mark.parametrize("noise", [0.0, 1e-5])
@pytest.mark.slow
def test_a_continuous_loop_without_noise_is_found_to_many_digits(noise):
    """Its driven input is right between the samples to fourth order in the pieces of intervals."""
    estimate = tri.identify(continuous(13, noise=noise), tri.Structure(2, 1))
    assert estimate.loop.sampling == "continuous"
    assert np.all(np.abs(estimate.theta / TRUTH - 1.0) < (1e-3 * noise / 1e-5 or 1e-6))
    assert not noise or np.all(np.abs(estimate.theta - TRUTH) < 4.0 * estimate.std)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [14, 15])
def test_a_dither_without_noise_does_not_tell_the_kind_and_that_is_said(seed):
    """Beside an integrator both kinds explain such a record with so many poles, to rounding."""
    _, r = moved(seed)
    u, y = continuous_loop(CHANNEL, PI, np.zeros(N), np.zeros(N), DT, dither=r)
    estimate = tri.identify(recorded(u, y, r), tri.Structure(2, 1))
    assert np.all(np.abs(estimate.theta - TRUTH) < 2.0 * estimate.std)
    assert any(one.code == "intersample" for one in estimate.findings)


@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.slow
def test_a_computer_slower_than_the_record_holds_its_input_for_all_to_see(every):
    """No rule of the samples makes such an input, and it would count as continuous."""
    record = sampled(9, every=every)
    assert input_rule([record], 2) is InputRule.HELD
    assert input_rule([sampled(9, every=every, limit=2.0)], 2) is InputRule.HELD
    estimate = tri.identify(record, tri.Structure(2, 1))
    assert estimate.loop.sampling == "sampled"
    assert np.all(np.abs(estimate.theta - TRUTH) < 4.0 * estimate.std)


def test_coarse_numbers_that_repeat_are_not_held():
    record = continuous(10, noise=0.02)
    coarse = recorded(np.round(record.u, 1), record.y, record.reference)
    assert np.mean(np.diff(coarse.u[:, 0]) == 0.0) > 0.3
    assert input_rule([coarse], 2) is not InputRule.HELD


@pytest.mark.parametrize("seed", [7, *(pytest.param(k, marks=pytest.mark.slow) for k in (8, 9))])
def test_missing_samples_leave_the_rule_where_enough_are_seen_with_their_past(seed):
    lost = np.random.default_rng(seed).random(N)
    rules, alone = {}, {}
    for share in (0.05, 0.5):
        for whole in (sampled(seed), continuous(seed)):
            y = np.where(lost[:, None] < share, np.nan, whole.y)
            record = recorded(whole.u, y, whole.reference)
            rules.setdefault(share, []).append(input_rule([record], 2))
            alone.setdefault(share, []).append(input_rule([without_reference(record)], 2))
    assert rules[0.05] == [InputRule.SAMPLED, InputRule.NONE]
    assert alone[0.05][1] is InputRule.NONE
    assert InputRule.SAMPLED not in alone[0.5]
    assert rules[0.5] == [InputRule.UNKNOWN, InputRule.UNKNOWN]


def test_uneven_time_and_few_samples_tell_nothing():
    whole = sampled(7)
    few = tri.Record(whole.u[:60], whole.y[:60], dt=DT, reference=whole.reference[:60])
    assert input_rule([few], 2) is InputRule.UNKNOWN
    t = DT * np.arange(N) + 0.01 * np.random.default_rng(0).uniform(size=N)
    uneven = tri.Record(whole.u, whole.y, t=t, reference=whole.reference)
    assert input_rule([uneven], 2) is InputRule.UNKNOWN


@pytest.mark.parametrize("make", [sampled, pytest.param(continuous, marks=pytest.mark.slow)])
@pytest.mark.unjudged
def test_the_kind_is_taken_by_what_the_input_shows(make):
    """Of a continuous controller in noise that moves, the residual alone speaks for the other."""
    estimate = tri.identify(make(8), tri.Structure(2, 1))
    assert estimate.loop.sampling == make.__name__
    assert np.all(np.abs(estimate.theta - TRUTH) < 4.0 * estimate.std)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20, 32))
def test_no_continuous_controller_is_taken_for_a_sampled_one_in_silence(seed):
    record = continuous(seed, gain=2.0 if seed % 2 else None)
    estimate = tri.identify(record, tri.Structure(2, 1))
    far = np.max(np.abs(estimate.theta - TRUTH) / estimate.std)
    told = [one for one in estimate.findings if one.code == "intersample"]
    assert estimate.loop.sampling == "continuous" or told
    assert far < 5.0 or any(one.severity != "note" for one in told)
