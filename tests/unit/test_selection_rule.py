"""The rule by which a row is recommended, on numbers made by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from tridentify.selection.criteria import Criteria
from tridentify.selection.rule import ALPHA, PER_DECADE, Contender, adequate, choose, needed


def contender(n_unknowns, deviance, n_poles, *, n=500, usable=True):
    return Contender(Criteria(n_unknowns, n, deviance), n_poles, usable)


def test_one_more_coefficient_has_the_price_of_a_likelihood_ratio_test():
    few, many = contender(4, 0.0, 2, n=40), contender(5, 0.0, 2, n=40)
    limit = 40 * math.log1p(stats.chi2.isf(ALPHA, 1) / 35)
    assert needed(few, many, 2.0) == pytest.approx(limit)


def test_a_new_pole_is_judged_by_the_places_it_could_have_taken():
    few, many = contender(4, 0.0, 2, n=60), contender(6, 0.0, 3, n=60)
    limit = 60 * math.log1p(stats.chi2.isf(ALPHA / (PER_DECADE * 1.5), 2) / 54)
    assert needed(few, many, 1.5) == pytest.approx(limit)


def test_the_price_is_that_of_bic_for_long_records():
    few, many = contender(4, 0.0, 2, n=10**7), contender(5, 0.0, 2, n=10**7)
    assert needed(few, many, 5.0) == pytest.approx(math.log(10**7))


def test_the_least_of_the_adequate_is_chosen():
    rows = [contender(3, 100.0, 1), contender(5, 10.0, 2), contender(7, 1.0, 3)]
    assert adequate(rows, 2.0) == [False, True, True]
    assert choose(rows, 2.0) == 1


def test_a_large_fall_makes_the_larger_one_win():
    rows = [contender(5, 40.0, 2), contender(7, 1.0, 3)]
    assert choose(rows, 2.0) == 1


def test_of_equally_many_unknowns_the_likelier_is_chosen():
    assert choose([contender(5, 10.0, 2), contender(5, 9.0, 3)], 2.0) == 1


def test_what_is_not_usable_neither_wins_nor_counts():
    rows = [contender(5, 40.0, 2), contender(7, 1.0, 3, usable=False)]
    assert choose(rows, 2.0) == 0
    assert choose([contender(5, 40.0, 2, usable=False)], 2.0) is None


def test_the_order_of_the_rows_does_not_matter():
    rng = np.random.default_rng(0)
    rows = [contender(k, float(50 * rng.random()), k // 2) for k in range(3, 11)]
    best = rows[choose(rows, 2.0)]
    for _ in range(10):
        mixed = [rows[k] for k in rng.permutation(len(rows))]
        assert mixed[choose(mixed, 2.0)] is best
