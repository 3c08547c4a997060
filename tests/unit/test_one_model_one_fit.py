"""What a report says of one model agrees with itself: its fit, its coefficients, its verdict."""

from __future__ import annotations

import re
from functools import cache

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, identify, validate
from tridentify.estimation.answer.finding import Finding, beside_errors
from tridentify.estimation.answer.trust import class_of, predicts, unusable

pytestmark = pytest.mark.judged

DT, N, GAIN = 0.1, 500, 4.5


@cache
def on_a_beam(seed):
    """A ball on a beam, kept in place by a controller while forces push it that nobody records."""
    rng = np.random.default_rng(seed)
    place, speed, push = 0.0, 0.0, 0.0
    u, y = np.zeros(N), np.zeros(N)
    wanted = np.repeat(rng.uniform(-0.1, 0.1, N // 50), 50)
    before = 0.0
    for k in range(N):
        y[k] = place + 0.001 * rng.standard_normal()
        rate = (y[k] - before) / DT
        before = y[k]
        u[k] = 0.25 * (wanted[k] - y[k]) - 0.35 * rate
        for _ in range(10):
            h = DT / 10.0
            push += h * (-push / 2.0) + 0.05 * np.sqrt(h) * rng.standard_normal()
            slope = GAIN * u[k] + push
            place, speed = place + h * speed, speed + h * slope
    return Record(u, y, dt=DT, input_names=["angle"], output_names=["position"])


@cache
def estimated(seed, route):
    method = ThreeModel(route=route)
    return identify(on_a_beam(seed), Structure(2, 0), method, throw=False)


SEEDS = [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3, 4))]


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_the_direct_route_is_not_judged_by_a_simulation(seed):
    estimate = estimated(seed, "direct")
    assert estimate.status.ok
    said = unusable(estimate, estimate.findings)
    assert "a constant follows" not in said or not predicts(estimate)
    text = " ".join(one.text for one in estimate.findings)
    assert "noise='white'" not in text or not predicts(estimate)
    assert not [one for one in estimate.findings if one.code == "drift" and one.matters]
    assert predicts(estimate)
    if class_of(estimate, estimate.findings) != "bad":
        assert abs(estimate.parameters["b0"].value / GAIN - 1.0) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("route", ["open-loop", "direct"])
def test_every_fit_and_coefficient_starts_from_what_is_printed(seed, route):
    estimate = estimated(seed, route)
    # an integrator may come out a little beyond, and what is not stable has no residual to test
    stable = estimate.model.poles.real.max() < 0.0
    tested = validate(estimate, on_a_beam(seed)).findings if stable else ()
    for findings in (estimate.findings, tested):
        # two behaviours of the input are compared by fits of their own
        for one in (own for own in findings if own.code != "intersample"):
            for before in re.findall(r"fit of position from (-?[\d.]+)", one.effect):
                # samples that stand alone may be left out
                assert float(before) == pytest.approx(estimate.fit[0], abs=2.0)
            for name, before in re.findall(r"\b([ab]\d) (?:goes )?from (\S+) to", one.effect):
                assert float(before) == pytest.approx(estimate.parameters[name].value, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 4))])
def test_feedback_is_found_though_a_drift_explains_more(seed):
    estimate = estimated(seed, "auto")
    assert estimate.route == "direct"
    assert "feedback" in [one.code for one in estimate.findings]
    assert abs(estimate.parameters["b0"].value / GAIN - 1.0) < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [108, 7, 14])
def test_samples_that_only_a_bent_fit_calls_bad_hide_no_feedback(seed):
    estimate = estimated(seed, "auto")
    assert estimate.route == "direct"
    assert abs(estimate.parameters["b0"].value / GAIN - 1.0) < 0.5


def test_what_a_status_advises_gives_way_to_an_error():
    wrong = Finding("feedback", "error", "The input reacts.", "Open the loop.")
    assert beside_errors("record longer", [wrong]) == ""
    assert beside_errors("record longer", []) == "record longer"
