"""Findings of one estimate: no two contradict each other, and none advises what was done."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
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
from tridentify.data import short_period
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.finding import FEWER, Finding, joined
from tridentify.estimation.answer.trust import class_of
from tridentify.judgement.cautions.residual import response_as_noise
from tridentify.report.html import report_page, settled

DT, N = 0.05, 800
PLANT = TransferFunction([9.0], [1.0, 1.5, 9.0])


def held(seed):
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], N // 8), 8)


def with_a_mode(seed, share, size):
    """The plant, and a mode of 8 rad/s with a share of its static gain."""
    u = held(seed)
    mode = TransferFunction([64.0 * share], [1.0, 0.8, 64.0])
    y = sum(simulate(one, Record(u, u, dt=DT))[:, 0] for one in (PLANT, mode))
    return Record(u, y + size * np.random.default_rng(100 + seed).standard_normal(N), dt=DT)


@pytest.fixture(scope="module")
def too_low():
    record = short_period().select(outputs=["q"])
    return identify(record, (1, 0)), record


@pytest.mark.undrawn
def test_a_model_that_a_constant_beats_is_not_usable_and_says_why(too_low):
    estimate, record = too_low
    assert estimate.fit[0] < 0.0
    first = estimate.findings[0]
    assert (first.code, first.severity) == ("order-low", "error")
    assert "poles=2 and zeros=1" in first.remedy
    # its poles are too few to show the response, which is there
    assert "no-response" not in [one.code for one in estimate.findings]
    page = report_page(estimate, settled(estimate, record))
    assert page.verdict == "bad"
    assert page.headline.startswith("Not usable: a constant follows q more closely")
    assert page.headline.endswith("the order is too low.")
    said = " ".join([*(one.text for one in page.findings), page.to_do, estimate._repr_html_()])
    assert "use fewer poles" not in said
    assert "use fewer poles" not in " ".join(estimate.summary().split())


def test_a_record_without_a_response_still_says_so():
    rng = np.random.default_rng(0)
    record = Record(np.sign(rng.standard_normal(300)), rng.standard_normal(300), dt=0.1)
    estimate = identify(record, (1, 0), throw=False)
    assert "no-response" in [one.code for one in estimate.findings]
    assert class_of(estimate, estimate.findings) == "bad"


def test_remedies_that_contradict_each_other_are_reconciled():
    vague = Finding("not-determined", "warning", "b0.", f"Excite the system more{FEWER}.")
    high = Finding("order-high", "warning", "One pole explains it as well.", "Use poles=1.")
    low = Finding("order-low", "warning", "The order is too low.", "Use poles=3.")
    remedies = {one.code: one.remedy for one in joined([low], [vague])}
    assert remedies == {"order-low": "Use poles=3.", "not-determined": "Excite the system more."}
    # without a remedy of its own a larger model leaves that of the other alone
    unsaid = Finding("order-low", "warning", "Larger models were tried.")
    assert vague in joined([unsaid], [vague])
    levels = {one.code: (one.severity, one.remedy) for one in joined([low], [high])}
    assert levels["order-low"] == ("note", "")
    assert levels["order-high"] == ("warning", "Use poles=1.")
    wrong = Finding("order-low", "error", "The order is too low.", "Use poles=3.")
    silent = Finding("no-response", "error", "No response.")
    assert joined([wrong], [high, silent]) == (wrong,)


@pytest.mark.parametrize("seed", [3, 4, 5])
@pytest.mark.slow
def test_a_larger_model_is_advice_where_the_fit_rises(seed):
    record = with_a_mode(seed, 0.02, 0.05)
    estimate = identify(record, Structure(2, 0), throw=False)
    (low,) = (one for one in estimate.findings if one.code == "order-low")
    assert low.severity == "warning"
    assert "poles=4" in low.remedy
    assert "the sum of squares of the whitened residual falls by" in low.effect


@pytest.mark.slow
def test_a_larger_model_is_a_note_where_the_fit_does_not_rise():
    record = with_a_mode(4, 0.02, 0.2)
    estimate = identify(record, Structure(2, 0), throw=False)
    (low,) = (one for one in estimate.findings if one.code == "order-low")
    assert (low.severity, low.remedy) == ("note", "")
    assert "explains this correlation, not the response" in low.message
    assert "response of the model" in validate(estimate, record).verdict


def spoiled(loss, seed=6):
    u = held(seed)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
    y = y + 0.05 * np.random.default_rng(seed).standard_normal(N)
    y[[90, 300, 301, 555]] += [1.5, -1.0, 1.2, 2.0]
    record = Record(u, y, dt=DT)
    return identify(record, Structure(2, 0), ThreeModel(loss=loss)), record


@pytest.mark.parametrize("loss", ["huber", "student"])
@pytest.mark.slow
def test_a_robust_fit_is_not_told_to_use_a_robust_loss(loss):
    estimate, _ = spoiled(loss)
    # bad samples of another record were not set aside
    checked = validate(estimate, spoiled(loss, seed=8)[1])
    own = [one for one in checked.findings if one.code == "bad-samples"]
    assert own
    assert all("the robust loss gives them little weight" in one.remedy for one in own)
    said = " ".join(one.text for one in (*estimate.findings, *checked.findings))
    assert "use a robust loss" not in said.lower()


@pytest.mark.slow
def test_a_robust_fit_in_coloured_noise_is_not_told_of_a_noise_model_it_cannot_have():
    u = held(7)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
    y = y + 0.1 * lfilter([1.0], [1.0, -0.8], np.random.default_rng(7).standard_normal(N))
    record = Record(u, y, dt=DT)
    found = validate(identify(record, Structure(2, 0), ThreeModel(loss="huber")), record).findings
    assert "noise-model" in [one.code for one in found]
    assert not any("noise='ar'" in one.remedy for one in found)


@pytest.mark.parametrize("drift", [False, True])
@pytest.mark.slow
def test_what_drifts_under_a_noise_model_is_not_told_to_have_one(drift):
    record = wandering(3)
    structure = Structure(2, 0, drift=drift)
    estimate = identify(record, structure, ThreeModel(noise="ar"), throw=False)
    assert estimate.noise_model[0].size
    own = [one for one in validate(estimate, record).findings if one.code == "drift"]
    assert own
    assert all("noise='ar'" not in one.remedy for one in own)
    assert not any(drift and "drift=True" in one.remedy for one in own)
    # what was not tried, or brings nothing, is not advised
    assert all("With a drift" in one.effect for one in own if "drift=True" in one.remedy)


def test_an_error_of_the_estimate_is_not_left_out_for_a_warning_of_the_tests():
    mild = Finding("noise-model", "warning", "The residual is correlated.", outputs=("y",))
    grave = Finding("noise-model", "error", "White weights were kept.", outputs=("y",))
    assert joined([mild], [grave]) == (grave,)
    assert joined([grave], [mild]) == (grave,)


@pytest.mark.slow
def test_a_noise_model_that_was_at_hand_and_not_kept_is_no_advice():
    record = wandering(3)
    free = ThreeModel(noise="white")
    estimate = identify(record, Structure(2, 0), free, throw=False)
    advice = [f.remedy for f in validate(estimate, record).findings if f.code == "drift"]
    assert any("noise='ar'" in one for one in advice)
    told = DecisionKind.FAR_LIKELIER.told(" by up to 27 standard errors (AICc lower by 48)")
    decisions = (*estimate.trace.decisions, told)
    kept = replace(estimate, trace=replace(estimate.trace, decisions=decisions))
    found = [f for f in validate(kept, record).findings if f.code == "drift"]
    assert found
    assert not any("noise='ar'" in one.text or "a noise model" in one.text for one in found)


@pytest.mark.slow
def test_a_noise_model_that_was_tried_and_declined_is_no_advice_for_colour():
    u = held(8)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
    y = y + 0.1 * lfilter([1.0], [1.0, -0.8], np.random.default_rng(8).standard_normal(N))
    record = Record(u, y, dt=DT)
    estimate = identify(record, Structure(2, 0), ThreeModel(noise="white"), throw=False)

    def advice(of):
        found = validate(of, record).findings
        return next(one.remedy for one in found if one.code == "noise-model")

    assert "noise='ar'" in advice(estimate)
    why = "on whitened samples there was no usable minimum"
    decisions = (*estimate.trace.decisions, DecisionKind.NOISE_TAKEN_AS_WHITE.told(f": {why}"))
    kept = replace(estimate, trace=replace(estimate.trace, decisions=decisions))
    assert "noise='ar'" not in advice(kept)
    assert why in advice(kept)


@pytest.mark.parametrize("known", [DecisionKind.RESPONSE_AS_NOISE, DecisionKind.SLOW_AS_NOISE])
def test_that_white_weights_follow_better_is_told_only_of_what_follows_worse(known):
    """A constraint makes another end of the one that was compared with white weights."""
    estimate = identify(spoiled("squared")[1], Structure(2, 0))
    fit = float(estimate.fit[0])

    def told(white):
        line = known.told(f": fit 20.0 % where white weights reach {white:.1f} %")
        trace = replace(estimate.trace, decisions=(line,))
        return [one.code for one in response_as_noise(replace(estimate, trace=trace))]

    assert told(fit - 1.0) == []
    assert told(fit + 1.0) == ["noise-model"]


def wandering(seed):
    u = held(seed)
    slow = 0.4 * np.cos(2.0 * np.pi * 1.3 * np.arange(N) / N + 1.0)
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0] + slow
    return Record(u, y + 0.05 * np.random.default_rng(100 + seed).standard_normal(N), dt=DT)


@pytest.mark.slow
def test_samples_that_were_left_out_are_not_called_missing():
    estimate, record = spoiled("huber")
    notes = validate(estimate, record).notes
    assert "4 samples are left out as bad" in notes
    assert not any("missing" in note for note in notes)
    y = np.array(record.y)
    y[700:707] = np.nan
    gone = Record(record.u, y, dt=DT)
    notes = validate(identify(gone, Structure(2, 0), ThreeModel(loss="huber")), gone).notes
    assert "4 samples are left out as bad" in notes
    assert "7 missing samples do not count" in notes


def test_a_kind_is_one_of_those_that_are_documented():
    assert Finding("varying", "error", "a", kind="clocks").kind == "clocks"
    with pytest.raises(ValueError, match="found kind 'clock'; expected one of"):
        Finding("varying", "error", "a", kind="clock")
