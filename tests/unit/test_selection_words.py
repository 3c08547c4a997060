"""The recommendation in words, from rows made by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tridentify import Structure
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.selection import SelectionRow
from tridentify.judgement.selection.criteria import Criteria
from tridentify.judgement.selection.rule import Contender, Verdict
from tridentify.judgement.selection.words import in_words, reason_of


@pytest.fixture
def rows(double):
    return [
        SelectionRow(Structure(n, n - 1), double.estimate, relative_std=share, widest=name, ok=True)
        for n, share, name in ((1, 0.1, "a0"), (2, 0.1, "a0"), (3, 0.8, "a2"))
    ]


def contenders(last=-3.0, usable=True):
    return [
        Contender(Criteria(3, 500, 90.0), 1, True),
        Contender(Criteria(5, 500, 2.0), 2, True),
        Contender(Criteria(7, 500, last), 3, usable),
    ]


def test_a_larger_one_that_is_little_better_and_badly_known(rows):
    said = reason_of(rows, contenders(-5.0), 1, False)
    assert "3 poles and 2 zeros lower AICc by 2.9 only, while a2 is known to 80 %" in said
    assert "-2 log L falls by 7.0, less than the 12.4" in said
    assert "2 poles and 1 zero are recommended." in said
    assert "1 pole and no zero are too few: -2 log L is 88.0 higher" in said


def test_the_lowest_criterion_is_said_as_such(rows):
    said = reason_of(rows, contenders(1.0), 1, False)
    assert said.startswith("2 poles and 1 zero have the lowest AICc; the best of the larger")


def test_an_end_that_is_not_usable_hints_at_what_is_missing(rows):
    said = reason_of(rows, contenders(-60.0, usable=False), 1, False)
    assert "perhaps a delay" in said


def test_doubts_are_told(rows):
    rows[1] = dataclasses.replace(rows[1], relative_std=0.7, widest="b1")
    said = reason_of(rows, contenders(1.0), 1, True)
    assert "Its b1 is known to 70 % only" in said
    assert "follows the input" in said


def test_what_explains_a_residual_that_follows_the_input_is_named(rows):
    play = "Of all causes tried, play of 0.08 between u and what it drives explains it best."
    findings = [
        Finding("noise-model", "note", "The noise is not white."),
        Finding("nonlinear", "warning", f"The residual of y is correlated with u. {play}"),
    ]
    rows[1] = dataclasses.replace(
        rows[1], estimate=dataclasses.replace(rows[1].estimate, findings=tuple(findings))
    )
    assert reason_of(rows, contenders(1.0), 1, True).endswith(play)
    assert play not in reason_of(rows, contenders(1.0), 1, False)
    told = [dataclasses.replace(row, cross_fit=np.array([90.0])) for row in rows]
    verdict = Verdict(1, 1, "held-out", sound=True)
    assert in_words(told, contenders(), verdict, missed=True).endswith(play)
    larger = Finding("order-low", "warning", "Of all causes tried, 3 poles explain it best.")
    told[1] = dataclasses.replace(
        told[1], estimate=dataclasses.replace(told[1].estimate, findings=(larger, findings[1]))
    )
    assert "all causes" not in in_words(told, contenders(), verdict, missed=True)


def test_without_any_estimate_the_first_failure_speaks():
    row = SelectionRow(Structure(1, 0), None, "found nothing; expected more; do it")
    said = reason_of([row], [Contender(Criteria(0, 1, 0.0), 0, False)], None, False)
    assert said.endswith("found nothing; expected more; do it")


def verdict_of(rows, fits, by, place=0, best=1):
    told = [
        dataclasses.replace(row, cross_fit=np.array([fit]))
        for row, fit in zip(rows, fits, strict=True)
    ]
    return in_words(told, contenders(), Verdict(place, best, by, True), False)


def test_fair_terms_are_told_where_they_decide(rows):
    said = verdict_of(rows, (92.5, 98.2, 90.0), "size")
    assert "below the best, 2 poles and 1 zero (98.20 %) where offset and initial state are" in said
    assert "left aside" not in verdict_of(rows, (97.5, 98.2, 90.0), "size")


def test_what_predicts_better_is_not_said_to_be_below_the_best(rows):
    said = verdict_of(rows, (92.3, 90.5, 80.0), "size")
    assert "no worse than the best of those that are sound, 2 poles and 1 zero (90.50 %)" in said
    assert "below the best" not in said


def test_a_smaller_one_of_use_is_told_as_such(rows):
    said = verdict_of(rows, (83.7, 90.5, 80.0), "useful")
    assert said.startswith("1 pole and no zero predict samples that were left out to 83.70 %,")
    assert "none predicts clearly better than a candidate that has no more coefficients" in said


def test_a_fit_that_is_clearly_lower_is_not_called_as_good_without_the_reason(rows):
    told = [
        dataclasses.replace(row, cross_fit=np.array([fit]))
        for row, fit in zip(rows, (51.7, 89.1, 80.0), strict=True)
    ]
    said = in_words(told, contenders(), Verdict(0, 1, "held-out", True, fair=True), False)
    assert "left out to 51.70 %, less than the best, 2 poles and 1 zero (89.10 %), but" in said
    assert "offset, drift and free responses are left aside" in said
    assert "left aside" not in verdict_of(rows, (88.7, 89.1, 80.0), "held-out")


def test_a_larger_one_that_stood_for_a_non_linearity(rows):
    verdict = Verdict(1, 2, "bent", sound=True, instead=(2, "play between u and y"))
    said = in_words(rows, contenders(), verdict, missed=True)
    assert said.startswith("2 poles and 1 zero are recommended: with play between u and y")
    assert "3 poles and 2 zeros" in said
