"""Feedback without a reference: the direct route, what is checked of it, its standard errors."""

from __future__ import annotations

import loops
import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Estimate, Record, Structure, ThreeModel, identify
from tridentify.estimation.methods.predictor import predictor_noise
from tridentify.judgement.causes.revisit import problem_of, stated
from tridentify.judgement.direct import widened

PLANT, COLOUR, DT = loops.System.of([1.0], [1.0, 1.0]), 0.9, 0.2
TRUTH = np.array([1.0, 1.0])


def in_loop(seed: int, n: int = 1500) -> Record:
    """A first-order plant under a proportional controller, in strong autoregressive noise."""
    rng = np.random.default_rng(seed)
    controller = loops.Controller(loops.System.of([2.0], [1.0]))
    reference = np.repeat(rng.choice([-1.0, 1.0], n // 20 + 1), 20)[:n, None]
    noise = lfilter([0.3], [1.0, -COLOUR], rng.standard_normal((n, 1)), axis=0)
    u, y = loops.run(PLANT, controller, reference, noise, np.zeros((n, 1)), DT)
    return Record(u, y, dt=DT)


@pytest.fixture(scope="module")
def found() -> Estimate:
    """What `identify` makes of it by itself."""
    return identify(in_loop(0), Structure(1, 0))


def off(estimate: Estimate) -> float:
    """Largest error [standard errors]."""
    return float(np.max(np.abs(estimate.theta - TRUTH) / estimate.std))


@pytest.mark.unjudged
def test_white_noise_is_wrong_in_a_loop_and_the_direct_route_is_not(found):
    assert off(identify(in_loop(0), Structure(1, 0), ThreeModel(noise="white"))) > 5.0
    assert found.route == "direct"
    assert off(found) < 4.0
    assert any("route direct" in one for one in found.trace.decisions)


def test_how_much_hangs_on_the_noise_model_is_said(found):
    (finding,) = [f for f in found.findings if f.code == "feedback"]
    assert finding.severity == "warning"
    assert "The model of the noise decides: white noise moves" in finding.effect
    assert "give it as reference" in finding.remedy


def test_standard_errors_know_that_the_noise_was_estimated(found):
    record = in_loop(0)
    plain = ThreeModel(route="direct").estimate([record], Structure(1, 0))
    wider = widened(plain, [record])
    more = np.linalg.eigvalsh(wider.cov - plain.cov)
    assert more.min() > -1e-9 * np.max(plain.cov)
    assert np.all(wider.std >= plain.std)
    assert np.max(wider.std / plain.std) > 1.02
    np.testing.assert_allclose(found.std, wider.std)


def test_open_loop_errors_are_left_as_they_are():
    drawn = loops.opened(loops.draw(3, keep=lambda one: one.poles.real.max() < -0.1), 3)
    estimate = ThreeModel().estimate([drawn.record.settled("zoh")], drawn.structure)
    assert widened(estimate, [drawn.record]) is estimate


@pytest.mark.slow
def test_who_asks_for_another_route_gets_it():
    estimate = identify(in_loop(1), Structure(1, 0), ThreeModel(route="open-loop"))
    assert estimate.route == "open-loop"
    assert "feedback" in [f.code for f in estimate.findings]


def test_a_plant_in_the_right_half_plane_is_an_error_on_the_direct_route():
    drawn = loops.draw(10)
    assert drawn.poles.real.max() > 0.1
    estimate = identify(drawn.record, drawn.structure, throw=False)
    assert "feedback" in [f.code for f in estimate.findings if f.severity == "error"]


@pytest.mark.unjudged
def test_the_predictor_finds_the_noise_whatever_the_controller():
    record = in_loop(2, 6000)
    estimate = identify(record, Structure(1, 0), ThreeModel(noise="white", route="open-loop"))
    (a,) = predictor_noise(problem_of(estimate, [record], stated(estimate)))
    omega = np.linspace(0.1, 3.0, 20)
    gain = np.abs(np.polyval(np.append(1.0, a)[::-1], np.exp(-1j * omega)))
    true = np.abs(1.0 - COLOUR * np.exp(-1j * omega))
    assert np.mean(np.abs(gain / true - 1.0)) < 0.2


@pytest.mark.unjudged
@pytest.mark.slow
def test_the_chosen_order_takes_the_direct_route_too():
    assert identify(in_loop(0, 600), Structure.auto(max_poles=1)).route == "direct"
