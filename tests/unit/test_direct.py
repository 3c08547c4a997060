"""Feedback without a reference: the direct route, what is checked of it, its standard errors."""

from __future__ import annotations

import loops
import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    Estimate,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.methods.around_maximum.predictor import predictor_noise
from tridentify.judgement.causes.attempts.feedback import GUARD, Inputs, by_predictor
from tridentify.judgement.cautions.residual import far_likelier
from tridentify.judgement.direct import widened

PLANT, COLOUR, DT = loops.System.of([1.0], [1.0, 1.0]), 0.9, 0.2
TRUTH = np.array([1.0, 1.0])


def in_loop(seed: int, n: int = 1000) -> Record:
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
@pytest.mark.slow
def test_white_noise_is_wrong_in_a_loop_and_the_direct_route_is_not(found):
    assert off(identify(in_loop(0), Structure(1, 0), ThreeModel(noise="white"))) > 5.0
    assert found.route == "direct"
    assert off(found) < 4.0
    assert any("route direct" in one for one in found.trace.decisions)


@pytest.mark.slow
def test_how_much_hangs_on_the_noise_model_is_said(found):
    (finding,) = [f for f in found.findings if f.code == "feedback"]
    assert finding.severity == "warning"
    assert "The model of the noise decides: white noise moves" in finding.effect
    assert "give it as reference" in finding.remedy


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_plant_in_the_right_half_plane_is_found_and_said_to_be_one():
    drawn = loops.draw(10)
    assert drawn.poles.real.max() > 0.1
    estimate = identify(drawn.record, drawn.structure, throw=False)
    assert estimate.route == "direct"
    assert np.all(np.abs(estimate.theta - drawn.theta) < 3.0 * estimate.std)
    assert np.max(estimate.std / np.abs(drawn.theta)) < 0.05
    said = {f.code: f for f in estimate.findings}
    assert said["feedback"].severity == "warning"
    assert "not stable" in said["unstable"].message


@pytest.mark.unjudged
def test_the_predictor_finds_the_noise_whatever_the_controller():
    record = in_loop(2, 6000)
    (a,) = predictor_noise([(record.u, record.y)])
    omega = np.linspace(0.1, 3.0, 20)
    gain = np.abs(np.polyval(np.append(1.0, a)[::-1], np.exp(-1j * omega)))
    true = np.abs(1.0 - COLOUR * np.exp(-1j * omega))
    assert np.mean(np.abs(gain / true - 1.0)) < 0.2


@pytest.mark.unjudged
@pytest.mark.slow
def test_the_chosen_order_takes_the_direct_route_too():
    assert identify(in_loop(0, 600), Structure.auto(max_poles=1)).route == "direct"


def position_loop(seed: int, gain: float = 3.0, n: int = 500) -> Record:
    """A mass under a controller with rate feedback, pushed about by forces nobody records."""
    rng = np.random.default_rng(seed)
    push = 0.1 * lfilter([0.3], [1.0, -0.7], rng.standard_normal(n))
    moved = simulate(MASS, Record(push, np.zeros(n), dt=0.1, intersample="zoh"))
    noise = gain * moved + 0.002 * rng.standard_normal((n, 1))
    law = loops.System.of(np.array([1.0 + 16.0, -16.0]) / gain, [1.0, 0.0])
    reference = np.repeat(rng.uniform(-0.3, 0.3, n // 50), 50)[:, None]
    plant = loops.System.of([gain], [1.0, 0.0, 0.0])
    u, y = loops.run(plant, loops.Controller(law), reference, noise, np.zeros((n, 1)), 0.1)
    return Record(u, y, dt=0.1, intersample="zoh")


MASS = TransferFunction([1.0], [1.0, 0.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_an_integrating_plant_that_a_controller_holds_is_found(seed):
    estimate = identify(position_loop(seed), Structure(2, 0), throw=False)
    gain = estimate.parameters["b0"]
    assert estimate.route == "direct"
    assert abs(gain.value - 3.0) < 4.0 * gain.std
    assert gain.std < 1.0


@pytest.mark.unjudged
def test_what_is_known_of_such_a_plant_goes_by_the_predictor_too():
    known = Structure(2, 0, fixed={"a1": 0.0, "a0": 0.0})
    record = position_loop(1, n=250)
    by_direct = ThreeModel(route="direct").estimate([record], known).parameters["b0"]
    assert abs(by_direct.value - 3.0) < 4.0 * by_direct.std
    white = identify(record, known, ThreeModel(noise="white")).parameters["b0"]
    assert abs(white.value - 3.0) > 10.0 * white.std


@pytest.mark.parametrize("behaviour", ["zoh", "foh", "band-limited"])
def test_no_reaction_shows_where_there_is_none(behaviour):
    wrong = 0
    for seed in range(10):
        rng = np.random.default_rng([seed, 5])
        u = lfilter([0.3], [1.0, -0.7], rng.standard_normal(400))
        still = Record(u, np.zeros(400), dt=0.1, intersample=behaviour)
        y = simulate(TransferFunction([4.0], [1.0, 1.2, 4.0]), still)
        noise = lfilter([1.0], [1.0, -0.8], rng.standard_normal((400, 1)), axis=0)
        seen = Inputs.of([Record(u, y + 0.05 * noise, dt=0.1, intersample=behaviour)])
        wrong += by_predictor(seen, 0, 0 if behaviour == "zoh" else GUARD).is_clear
    assert wrong == 0


@pytest.mark.parametrize("seed", [6, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 3, 4))])
def test_tones_of_an_input_do_not_react_to_a_hum(seed):
    # 25 tones are told by 50 past samples and not by 12, and a predictor through a hum looks far
    # back: what is left of long past inputs resembles the coming ones
    rng = np.random.default_rng([seed, 6])
    tone, phase = 4.0 * np.arange(1, 50, 2), rng.uniform(0.0, 2.0 * np.pi, 25)
    t = 0.001 * np.arange(2000)
    u = np.cos(2.0 * np.pi * np.outer(t, tone) + phase).sum(axis=1)
    record = Record(u, u, dt=0.001, intersample="band-limited")
    y = simulate(TransferFunction([4e4], [1.0, 300.0, 4e4]), record)[:, 0]
    y += np.std(y) * (0.2 * np.sin(100.0 * np.pi * t) + 0.03 * rng.standard_normal(2000))
    seen = Inputs.of([Record(u, y, dt=0.001, intersample="band-limited")])
    assert not by_predictor(seen, 0, GUARD).is_clear


def test_a_reaction_shows_in_what_the_predictor_leaves():
    record = position_loop(3)
    assert by_predictor(Inputs.of([record]), 0, 0).p_value < 1e-20
    y = record.y.copy()
    y[np.random.default_rng(3).choice(len(y), len(y) // 10, replace=False)] = np.nan
    gaps = Record(record.u, y, dt=record.dt)
    assert by_predictor(Inputs.of([gaps]), 0, 0).p_value < 1e-15


@pytest.mark.slow
@pytest.mark.unjudged
def test_asked_for_open_loop_an_end_that_is_far_likelier_is_told_not_taken():
    held = ThreeModel(route="open-loop").estimate([position_loop(1)], Structure(2, 0))
    (told,) = held.trace.about(DecisionKind.FAR_LIKELIER)
    assert [f.severity for f in far_likelier(held)] == ["error"]
    assert "standard errors" in told
    assert held.fit[0] > 0.0


@pytest.mark.unjudged
@pytest.mark.parametrize("order", [2, 1])
@pytest.mark.fast("1")
def test_nothing_is_likelier_in_open_loop_whether_or_not_the_order_is_right(order):
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 10)
    y = simulate(TransferFunction([4.0], [1.0, 1.2, 4.0]), Record(u, u, dt=0.1))
    noise = lfilter([1.0], [1.0, -0.8], rng.standard_normal((u.size, 1)), axis=0)
    estimate = ThreeModel().estimate([Record(u, y + 0.05 * noise, dt=0.1)], Structure(order, 0))
    assert not far_likelier(estimate)


def rubbing_drive(seed: int, n: int = 800) -> Record:
    """A position-controlled mass with dry friction, which no model of the noise stands for."""
    rng = np.random.default_rng(seed)
    mass, viscous, dry, dt, parts = 100.0, 200.0, 40.0, 0.01, 10
    reference = lfilter([0.06], [1.0, -0.94], np.repeat(rng.uniform(-0.2, 0.2, n // 80), 80))
    x = v = before = slope = 0.0
    u, y = np.empty(n), np.empty(n)
    for k in range(n):
        y[k] = x + 2e-5 * rng.standard_normal()
        slope, before = 0.6 * slope + 0.4 * (y[k] - before) / dt, y[k]
        u[k] = 15.0 * mass * (4.0 * (reference[k] - y[k]) - slope)
        for _ in range(parts):
            v += dt / parts * (u[k] - viscous * v - dry * np.tanh(v / 1e-3)) / mass
            x += dt / parts * v
    return Record(u, y, dt=dt, intersample="zoh")


@pytest.mark.slow
@pytest.mark.unjudged
@pytest.mark.parametrize("together", [False, True])
def test_errors_reach_as_far_as_white_noise_where_the_innovations_hold_the_past(
    found, monkeypatch, together
):
    if not together:  # most of the time goes into what is found of plant and noise together
        monkeypatch.setattr("tridentify.judgement.direct.found_together", lambda one, *_, **__: one)
    record, integrating = rubbing_drive(4), Structure(2, 0, fixed={"a0": 0.0})
    plain = ThreeModel(route="direct").estimate([record], integrating)
    wider = widened(plain, [record])
    assert wider.trace.about(DecisionKind.NOT_INDEPENDENT)
    white = identify(record, integrating, ThreeModel(noise="white", route="open-loop"))
    assert np.all(wider.std >= 0.9 * np.abs(white.theta - wider.theta))
    assert wider.std[-1] > 1.5 * plain.std[-1]
    assert not found.trace.about(DecisionKind.NOT_INDEPENDENT)
