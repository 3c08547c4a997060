"""Two candidates on the same held-out samples, and what is recommended of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tridentify.judgement.selection.paired import GROUPS, Unseen, contrasts, without
from tridentify.judgement.selection.rule import Trial, recommend

N = 400
TIME = np.arange(N) / N


def unseen(error, *terms):
    columns = np.column_stack(terms) if terms else np.zeros((N, 0))
    return Unseen((np.asarray(error)[:, None],), ((columns,),))


def noise(seed, size=0.01):
    return size / np.sqrt(N) * np.random.default_rng(seed).standard_normal(N)


def trial(size, error, *terms, sound=True):
    one = unseen(error, *terms)
    return Trial(size, one, one, sound, True)


def manoeuvre():
    """A response that is over after a tenth of the record."""
    return np.where(TIME < 0.1, np.sin(60.0 * TIME), 0.0) / np.sqrt(N)


def test_what_is_wrong_during_a_short_manoeuvre_is_wrong():
    # over blocks of equal length all of the difference lies in one, and looks like scatter
    raw, fair = contrasts(unseen(noise(0) + 0.1 * manoeuvre()), unseen(noise(0)))
    assert raw.groups == GROUPS
    assert not raw.as_good
    assert not fair.as_good


def test_what_is_wrong_in_a_few_samples_is_wrong():
    # an output that jumps: the difference lies in samples that no group can share
    jumps = np.zeros(N)
    jumps[[50, 130, 160, 333]] = 1.0, 0.3, 0.8, 0.5
    raw, fair = contrasts(unseen(noise(5) + 0.1 * jumps), unseen(noise(5, 0.002)))
    assert raw.other < 0.01 * raw.own
    assert not raw.as_good
    assert not fair.as_good


def test_one_sample_alone_says_nothing():
    once = np.zeros(N)
    once[200] = 0.1
    assert contrasts(unseen(noise(5, 1e-9) + once), unseen(noise(5, 1e-9)))[0].as_good


def test_what_follows_chance_is_no_better():
    rng = np.random.default_rng(1)
    slow = np.cumsum(rng.standard_normal((2, N)), axis=1) / N
    assert contrasts(unseen(slow[0]), unseen(slow[1]))[0].as_good
    assert contrasts(unseen(slow[1]), unseen(slow[0]))[0].as_good


def test_what_an_initial_state_explains_is_nobodys_merit():
    swing = 0.1 / np.sqrt(N) * np.cos(5.0 * TIME) * np.exp(-TIME)
    other = np.exp(-TIME) * np.sin(5.0 * TIME), np.exp(-TIME) * np.cos(5.0 * TIME)
    raw, fair = contrasts(unseen(noise(2) + swing), unseen(noise(3), *other))
    assert not raw.as_good
    assert fair.as_good
    assert fair.own == pytest.approx(fair.other, rel=0.2)


@pytest.mark.slow
def test_a_level_of_t_holds_for_noise_that_remembers():
    rng = np.random.default_rng(4)
    false, keep, many = 0, np.exp(-1 / 20), 400
    for _ in range(many):
        e = rng.standard_normal((2, N))
        for k in range(1, N):
            e[:, k] += keep * e[:, k - 1]
        false += not contrasts(unseen(e[0]), unseen(e[1]))[0].as_good
    assert false / many < 0.03  # 1 % claimed; the errors of two candidates are never so unlike


def test_missing_samples_do_not_count():
    error = noise(5)
    error[10:20] = np.nan
    left = without(np.ones((N, 1)), error)
    assert np.array_equal(np.isnan(left), np.isnan(error))
    assert abs(np.nanmean(left)) < 1e-12
    assert contrasts(unseen(error), unseen(noise(5)))[0].as_good


def test_without_terms_nothing_is_taken_away():
    raw, fair = contrasts(unseen(noise(6)), unseen(noise(7)))
    assert raw == fair


def test_more_coefficients_are_not_wanted_where_fewer_predict_as_well():
    wave = manoeuvre()
    trials = [
        trial(2, noise(0) + 0.15 * wave),
        trial(4, noise(0) + 0.02 * noise(1), sound=False),
        trial(6, noise(0)),
    ]
    found = recommend(trials, None, explains=False, sharp=False)
    assert (found.place, found.best, found.by) == (0, 2, "useful")


def test_a_small_one_that_is_of_no_use_is_not_recommended():
    wave = 10.0 * manoeuvre()
    trials = [
        trial(2, noise(0) + wave),
        trial(4, noise(0) + 0.02 * noise(1), sound=False),
        trial(6, noise(0)),
    ]
    assert recommend(trials, None, explains=False, sharp=False).place == 2


def test_what_explains_the_record_and_predicts_better_is_recommended():
    trials = [trial(2, noise(0) + 0.1 * manoeuvre()), trial(4, noise(0))]
    assert recommend(trials, 1, explains=True, sharp=True).place == 1
    assert recommend(trials[::-1], 0, explains=True, sharp=True).place == 0


def wave(rate):
    return np.sin(2.0 * np.pi * rate * TIME) / np.sqrt(N)


def of_sizes(*errors, sizes=(3, 5), sound=(True, True), vague=(False, False)):
    rows = zip(sizes, errors, sound, vague, strict=True)
    return [
        Trial(k, unseen(one), unseen(one), ok, True, (k - 1, k), bad) for k, one, ok, bad in rows
    ]


def test_what_is_slight_is_no_reason_for_poles_that_may_stand_for_a_delay():
    # refuted by far, and yet two hundredths of what was measured
    few, many = of_sizes(noise(0, 0.002) + 0.0195 * wave(20.0), noise(0, 0.002))
    assert not contrasts(few.unseen, many.unseen)[0].as_good
    late = replace(few, late=True)
    found = recommend([late, many], 1, explains=True, sharp=True, ends=False)
    assert (found.place, found.by) == (0, "slight")
    # without a delay there is nothing else that the poles may be
    assert recommend([few, many], 1, explains=True, sharp=True, ends=False).place == 1
    # where still larger ones explain no more, the order has ended
    assert recommend([late, many], 1, explains=True, sharp=True, ends=True).place == 1


def test_what_is_slight_is_a_reason_where_no_delay_is_missing_beside_the_poles():
    few, many = of_sizes(noise(0, 0.002) + 0.0195 * wave(20.0), noise(0, 0.002))
    late = replace(few, late=True)
    missing = replace(late, misses=True)
    sure = {"explains": True, "sharp": True, "ends": False}
    assert recommend([missing, many], 1, **sure, lags=True).place == 1
    # the poles may stand for a delay, or nothing in its residual speaks against it
    assert recommend([missing, many], 1, **sure).place == 0
    assert recommend([late, many], 1, **sure, lags=True).place == 0
    # held-out samples do not tell the two apart
    alike = replace(trial(3, noise(1, 0.002)), late=True, misses=True)
    larger = trial(5, noise(2, 0.00198))
    assert recommend([alike, larger], 1, **sure, lags=True).place == 0


def test_what_is_of_some_size_is_a_reason():
    few, many = of_sizes(noise(0, 0.002) + 0.06 * wave(20.0), noise(0, 0.002))
    trials = [replace(few, late=True), many]
    assert recommend(trials, 1, explains=True, sharp=True, ends=False).place == 1


def test_badly_known_coefficients_are_no_reason_for_more_of_them():
    errors = noise(1), noise(1, 0.0099)
    vague = of_sizes(*errors, sound=(False, True), vague=(True, False))
    assert recommend(vague, None, explains=False, sharp=False).place == 0
    # whatever else speaks against it does
    wrong = of_sizes(*errors, sound=(False, True), vague=(False, False))
    assert recommend(wrong, None, explains=False, sharp=False).place == 1


def test_a_difference_counts_less_its_standard_error():
    raw, _ = contrasts(unseen(noise(0) + 0.02 * wave(20.0)), unseen(noise(1)))
    plain = 100.0 * (np.sqrt(raw.own) - np.sqrt(raw.other))
    assert raw.points == pytest.approx(plain * (1.0 - 1.0 / raw.t))
    assert 0.0 < raw.points < plain


def test_of_as_many_coefficients_a_delay_is_less_than_a_zero():
    late, zero = (
        Trial(4, unseen(noise(k)), unseen(noise(k)), True, True, order)
        for k, order in ((2, (2, 2)), (3, (3, 2)))
    )
    for trials in ([late, zero], [zero, late]):
        place = recommend(trials, None, explains=False, sharp=False).place
        assert trials[place] is late


def test_what_has_fewer_poles_than_rise_above_the_noise_may_not_leave_twice_as_much():
    """Three edges: the groups differ, no difference is significant, and yet one is no model."""
    first, second = (np.where(abs(TIME - at) < 0.05, 1.0, 0.0) / np.sqrt(40) for at in (0.2, 0.7))
    rows = [
        Trial(2, unseen(noise(5) + 0.3 * first), Unseen(), True, True, (1, 1)),
        Trial(3, unseen(noise(6) + 0.15 * second), Unseen(), True, True, (2, 2)),
    ]
    assert all(one.as_good for one in contrasts(rows[0].unseen, rows[1].unseen))
    picked = [recommend(rows, None, explains=False, sharp=True, least=k).place for k in (1, 2)]
    assert picked == [0, 1]
