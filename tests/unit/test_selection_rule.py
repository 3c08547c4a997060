"""The rule by which a row is recommended, on numbers made by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify.judgement.selection.criteria import Criteria
from tridentify.judgement.selection.paired import Unseen
from tridentify.judgement.selection.rule import (
    Contender,
    Trial,
    adequate,
    choose,
    levels_off,
    needed,
    recommend,
    refuted,
)


def contender(n_unknowns, deviance, n_poles, *, n=500, usable=True, known=True):
    return Contender(Criteria(n_unknowns, n, deviance), n_poles, usable, known)


def test_the_price_is_that_of_bic_for_long_records():
    few, many = contender(4, 0.0, 2, n=10**7), contender(6, 0.0, 2, n=10**7)
    assert needed(few, many) == pytest.approx(2 * math.log(10**7), rel=1e-4)


def test_the_price_is_higher_where_samples_are_few():
    few, many = contender(4, 0.0, 2, n=30), contender(8, 0.0, 3, n=30)
    # RSS must fall by the factor that four coefficients with F = log N each make
    assert math.expm1(needed(few, many) / 30) * 22 / 4 == pytest.approx(math.log(30))
    sides = (needed(few, many) / math.log(30), 4 * 30 / 22)
    assert sides[0] < sides[1]


def test_the_least_of_the_adequate_is_chosen():
    rows = [contender(3, 100.0, 1), contender(5, 10.0, 2), contender(7, 1.0, 3)]
    assert adequate(rows) == [False, True, True]
    assert choose(rows) == 1


def test_a_large_fall_makes_the_larger_one_win():
    rows = [contender(5, 40.0, 2), contender(7, 1.0, 3)]
    assert choose(rows) == 1


def test_of_equally_many_unknowns_the_likelier_is_chosen():
    assert choose([contender(5, 10.0, 2), contender(5, 9.0, 3)]) == 1


def test_what_is_not_usable_neither_wins_nor_counts():
    rows = [contender(5, 40.0, 2), contender(7, 1.0, 3, usable=False)]
    assert choose(rows) == 0
    assert choose([contender(5, 40.0, 2, usable=False)]) is None


def test_unknown_poles_stand_back_where_others_are_known():
    rows = [contender(5, 10.0, 2, known=False), contender(6, 9.0, 2)]
    assert choose(rows) == 1
    assert choose(rows[:1]) == 0
    assert choose([contender(6, 10.0, 4, known=False), contender(6, 11.0, 3)]) == 1


def test_unknown_poles_are_no_reason_for_more_of_them():
    rows = [contender(6, 10.0, 3, known=False), contender(8, 9.0, 5)]
    assert choose(rows) == 0
    # nor for other ones with more unknowns
    assert choose([contender(6, 10.0, 4, known=False), contender(7, 10.0, 3)]) == 0
    # nor for one with as many: a zero less and a pole more is no simpler candidate
    assert choose([contender(6, 10.0, 2, known=False), contender(6, 14.0, 3)]) == 0


def test_the_order_of_the_rows_does_not_matter():
    rng = np.random.default_rng(0)
    rows = [contender(k, float(50 * rng.random()), k // 2) for k in range(3, 11)]
    best = rows[choose(rows)]
    for _ in range(10):
        mixed = [rows[k] for k in rng.permutation(len(rows))]
        assert mixed[choose(mixed)] is best


def test_what_cancels_could_be_left_out():
    orders = [(1, 0), (2, 1), (3, 2)]
    # two coefficients more must bring 2 log N = 12.4
    rows = [contender(3, 100.0, 1), contender(5, 10.0, 2), contender(7, 5.0, 3)]
    assert refuted(rows, orders) == [False, True, False]


def test_without_the_smaller_candidate_nothing_is_refuted():
    rows = [contender(4, 100.0, 2), contender(5, 10.0, 2)]
    assert refuted(rows, [(2, 0), (2, 1)]) == [False, False]
    assert refuted(rows, [None, (2, 1)]) == [False, False]
    rows = [contender(3, 100.0, 1, usable=False), contender(5, 10.0, 2)]
    assert refuted(rows, [(1, 0), (2, 1)]) == [False, False]


def test_the_likelihood_levels_off_where_larger_candidates_are_there():
    rows = [contender(3, 100.0, 1), contender(5, 10.0, 2), contender(7, 5.0, 3)]
    assert levels_off(rows, 1)
    assert not levels_off(rows, 2)
    # one that could not be used says nothing
    assert not levels_off([*rows[:2], contender(7, 5.0, 3, usable=False)], 1)


def test_the_largest_of_all_is_not_believed_for_its_noise_model_alone():
    """Whitened it predicts better, as it is worse: there are no larger ones that would end it."""
    rng = np.random.default_rng(0)
    wander = lfilter([1.0], [1.0, -0.95], rng.standard_normal((600, 1)), axis=0)
    fast = rng.standard_normal((600, 1))
    errors = (0.1 * wander + 0.1 * fast, 0.108 * wander + 0.05 * fast)
    bare = ((np.zeros((600, 0)),),)
    plain = [Unseen((one,), bare) for one in errors]
    whitened = [replace(one, noise=(np.array([-0.95]),)) for one in plain]
    trials = [
        Trial(size, one, other, True, True)
        for size, one, other in zip((4, 8), plain, whitened, strict=True)
    ]
    assert plain[0].loss < plain[1].loss
    assert recommend(trials, 1, explains=True, sharp=True).place == 1
    assert recommend(trials, 1, explains=True, sharp=True, ends=False).place == 0


@pytest.mark.parametrize(("loss", "place"), [(0.9, 1), (0.725, 0)])
def test_a_vague_candidate_stands_in_for_a_sound_one_where_it_is_of_use(loss, place):
    # either predicts every other stretch better: the difference is within its scatter
    sign = np.random.default_rng(3).choice([-1.0, 1.0], (600, 1)) / math.sqrt(600)
    first = (np.arange(600) % 200 < 100)[:, None]
    vague, sound = (
        Unseen((sign * np.where(first, *sizes),), ((np.ones((600, 1)),),))
        for sizes in ((loss, 0.3), (0.3, 0.7))
    )
    trials = [
        Trial(2, vague, vague, False, True, (0, 1), vague=True),
        Trial(4, sound, sound, True, True, (0, 2)),
    ]
    assert recommend(trials, None, explains=False, sharp=True).place == place
