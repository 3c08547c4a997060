"""The search for delays: derivatives, kinks, ends of the range, and the profile."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, TransferFunction, simulate
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Recorder, finish
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.search.delay_search import delay_places
from tridentify.estimation.search.delays import with_delays
from tridentify.models.regression import Experiment

POLES = np.array([-1.0 + 2.0j, -1.0 - 2.0j])


def problem(intersample="foh", delays=(0.113, 0.27), noise=(), **terms):
    rng = np.random.default_rng(0)
    u = np.repeat(np.sign(rng.standard_normal((60, 2))), 5, axis=0)
    y = rng.standard_normal((300, 2)).cumsum(axis=0)
    chosen = {"free": False, "offset": False, "drift": False} | terms
    e = Experiment(u, y, 0.05, intersample, **chosen, noise=noise)
    base = Problem.of([e], 2, ((0, 1), (1, 0)))
    return base.delayed(np.array(delays)).freed(np.array([5.0, 5.0]))


@pytest.mark.parametrize(
    "terms",
    [{}, {"free": True, "offset": True}, {"noise": (np.array([-0.5]), np.zeros(0))}],
    ids=["rest", "free", "coloured"],
)
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_the_score_of_a_delay_is_that_of_finite_differences(terms, intersample):
    base = problem(intersample, **terms)
    point = evaluate(base, POLES)
    matrix, output = point.jacobian()
    weights = point.weights[output]
    residual = np.concatenate([fit.residual for fit in point.fits])
    slope = -2.0 * (weights**2 * residual) @ matrix[:, point.width["delay"]]
    for k in range(2):
        step = 1e-6 * np.eye(2)[k]
        ahead = evaluate(base, POLES, delays=base.delays + step)
        behind = evaluate(base, POLES, delays=base.delays - step)
        assert slope[k] == pytest.approx((ahead.objective - behind.objective) / 2e-6, rel=1e-4)


def test_a_known_delay_has_no_score():
    point = evaluate(problem().freed(None), POLES)
    assert point.step(0.0).delays is None
    assert "delay" not in point.width


def test_a_delay_at_an_end_of_its_range_does_not_count_when_it_pulls_outward():
    rng = np.random.default_rng(2)
    u = np.repeat(np.sign(rng.standard_normal((60, 1))), 5, axis=0)
    blank = Record(u, u, dt=0.05, intersample="foh")
    y = simulate(TransferFunction([2.0], [1.0, 2.0, 5.0]), blank)
    e = Experiment(np.roll(u, 4, axis=0), y, 0.05, "foh", False, False, False)
    base = Problem.of([e], 2, ((0,),)).freed(np.array([5.0]))
    step = evaluate(base, POLES).step(0.0)
    assert step.delays == pytest.approx([0.0])
    behind = Experiment(u, np.roll(y, 4, axis=0), 0.05, "foh", False, False, False)
    low = Problem.of([behind], 2, ((0,),))
    late = low.delayed(np.array([0.1])).freed(np.array([0.1]))
    assert evaluate(late, POLES).step(0.0).delays == pytest.approx([0.1])
    assert evaluate(late.freed(np.array([5.0])), POLES).step(0.0).delays[0] > 0.1


def test_a_kink_is_an_end_not_a_failure():
    """First order, held input, whole steps: without noise but for one sample's error."""
    rng = np.random.default_rng(1)
    u = np.repeat(np.sign(rng.standard_normal((60, 1))), 5, axis=0)
    blank = Record(u, u, dt=0.05)
    for seed in range(6):
        y = simulate(TransferFunction([2.0], [1.0, 1.5], delay=0.2), blank)
        y = y + 1e-3 * np.random.default_rng(seed).standard_normal(y.shape)
        e = Experiment(u, y, 0.05, "zoh", False, False, False)
        base = Problem.of([e], 1, ((0,),)).delayed(np.array([0.2])).freed(np.array([5.0]))

        def at(poles, base=base, **where):
            return evaluate(base, poles, **where)

        point, status, _ = finish(at, at(np.array([-1.5 + 0j])), Recorder())
        assert status.ok
        assert point.problem.delays == pytest.approx([0.2], abs=2e-3)


def test_places_of_a_record_and_room_around_them():
    rng = np.random.default_rng(1)
    u = np.repeat(np.sign(rng.standard_normal((60, 1))), 5, axis=0)
    blank = Record(u, u, dt=0.05)
    y = simulate(TransferFunction([4.0], [1.0, 1.0, 4.0], delay=1.23), blank)
    record = Record(u, y + 0.05 * rng.standard_normal(y.shape), dt=0.05)
    rest = Structure(2, 0, delay="free", offset=False, initial_state="rest")
    (place,) = delay_places([record], rest)
    assert place.delays == pytest.approx([1.23], abs=0.02)
    assert place.rivals == ()
    known, limits = with_delays([record], rest, [place.delays])
    assert limits[0] > 10.0
    free = Structure(2, 0, delay="free", offset=False, initial_state="free")
    known, limits = with_delays([record], free, [place.delays])
    assert 1.3 < limits[0] < 1.5
    start = build([record], known, Nuisances("free", False, False)).experiments[0].start
    assert start * 0.05 >= limits[0] - 1e-9


@pytest.mark.parametrize("seed", [4, 9, 12])
@pytest.mark.slow
def test_needless_poles_do_not_send_the_delay_away(seed):
    # a first order with dead time under a slow input and slow noise, asked for with four poles
    rng = np.random.default_rng(seed)
    u = lfilter([1.0], [1.0, -1.7, 0.78], rng.standard_normal(300))
    u /= np.std(u)
    plant = TransferFunction([0.135], [1.0, 0.045], delay=27.0)
    y = simulate(plant, Record(u, u, dt=9.0, intersample="foh"))[:, 0]
    noise = lfilter([1.0], [1.0, -1.5, 0.63], rng.standard_normal(300))
    y += 0.15 * np.std(y) * noise / np.std(noise)
    record = Record(u, y, dt=9.0, intersample="foh")
    (place,) = delay_places([record], Structure(4, 0, delay="free", initial_state="free"))
    assert place.delays[0] < 40.0
