"""A plant by its coprime factors, from a loop that is fast against its sampling."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import binary, companion, continuous_loop
from tridentify import Record, Structure, ThreeModel, identify
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.coprime.factors import Factors, Fit
from tridentify.estimation.closed_loop.coprime.plant_form import Rows
from tridentify.estimation.closed_loop.coprime.search import Coprime, applies, coprime_root
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.estimation.closed_loop.unstable import autoregressive

TRUTH = np.array([0.6, -9.0, 3.0])
PLANT = ([TRUTH[2]], [1.0, *TRUTH[:2]])
LAW = companion([1400.0, 6770.0], [1.0, 34.05, 588.8])
"""An observer and its feedback: poles of the loop at 5 and 12 rad/s, turned by 45 degrees."""
DT = 0.057
"""Times the fastest pole of the loop: one."""


def loop(seed: int, count: int, noise: float) -> Record:
    rng = np.random.default_rng(seed)
    r = binary(count, 10, seed)
    e = noise * rng.standard_normal(count)
    u, y = continuous_loop(PLANT, LAW, np.zeros(count), e, DT, dither=r)
    return Record(u, y, dt=DT, reference=r)


def factors_of(record: Record):
    begun = Plant(1.05 * TRUTH[:2], (0.95 * TRUTH[2:],))
    return coprime_root([Loop(driven(record), "continuous")], [begun], autoregressive)


@pytest.mark.slow
def test_plant_in_a_fast_loop():
    """The response between the samples is that of the loop, which an exponential steps through."""
    found = factors_of(loop(3, 300, 1e-3))
    errors = np.sqrt(np.diag(found.cov))
    assert np.all(np.abs(found.plant.theta - TRUTH) < 4.0 * errors)
    assert np.all(errors < 0.02 * np.abs(TRUTH).max() * np.array([1.0, 1.0, 0.3]))
    assert found.fit.factors.x.shape[1] == 3


@pytest.mark.slow
def test_none_of_an_input_that_carries_no_noise():
    """The controller has a sensor of its own, without noise: no standard error is that of rounding.

    A controller that is a little other than linear and continuous, as one that was simulated in
    steps, shows in the plant otherwise, where its row counts beyond measure.
    """
    heard = loop(3, 300, 0.0)
    y = heard.y[:, 0] + 0.01 * np.std(heard.y) * np.random.default_rng(5).standard_normal(300)
    record = Record(heard.u, y, dt=DT, reference=heard.reference)
    assert factors_of(record) is None
    found = identify(record, Structure(2, 0), ThreeModel(controller="continuous"))
    assert np.all(np.abs(found.theta - TRUTH) < 4.0 * found.std)
    assert np.all(found.std > 1e-5 * np.abs(TRUTH))


def test_none_of_a_controller_that_works_on_samples():
    """Whatever it is said to be: its input follows from the samples."""
    record = loop(3, 200, 0.01)
    rule, before = np.zeros(record.n_samples), 0.0
    for k, seen in enumerate(record.reference[:, 0] - record.y[:, 0]):
        before = rule[k] = 0.5 * before + 3.0 * seen
    plants = [Plant(TRUTH[:2], (TRUTH[2:],))]
    sampled = Record(rule, record.y, dt=DT, reference=record.reference)
    assert applies([Loop(driven(record), "continuous")], plants)
    assert not applies([Loop(driven(sampled), "continuous")], plants)


def fit_near(record: Record, plant: Plant) -> Fit:
    factors = Factors(
        plant,
        np.array([[1.0, 34.05, 588.8]]),
        np.array([-5.0 + 5.0j, -5.0 - 5.0j, -12.0 + 13.0j, -12.0 - 13.0j]),
    )
    loops = (Loop(driven(record), "continuous"),)
    return Fit(loops, factors, Rows.plain(loops[0], plant, 0.1))


def test_steps_lead_to_the_plant():
    """From poles that are nearly those of the loop, without noise."""
    begun = Plant(1.05 * TRUTH[:2], (0.95 * TRUTH[2:],))
    ended = fit_near(loop(3, 100, 0.0), begun).descended()
    np.testing.assert_allclose(ended.factors.plant.theta, TRUTH, rtol=1e-4)


def test_only_where_a_pole_is_clearly_right_of_zero():
    """It is at 2.7 rad/s, and moves by a sixth of what the last denominator coefficient does."""
    fit = fit_near(loop(3, 20, 0.0), Plant(TRUTH[:2], (TRUTH[2:],)))
    for error, clear in ((3.0, True), (5.0, False)):
        assert Coprime(fit, np.diag([0.0, error, 0.0]) ** 2).clearly_grows == clear


def test_derivatives():
    """By differences, of every coefficient of plant, controller and loop."""
    fit = fit_near(loop(3, 100, 0.0), Plant(TRUTH[:2], (TRUTH[2:],)))
    factors = fit.factors
    slopes = fit.derivatives(0)
    for k in range(slopes.shape[1]):
        step = np.zeros(slopes.shape[1])
        step[k] = 1e-4 / np.abs(slopes[:, k]).max()
        up, down = (fit.at(factors.moved(side * step)).driven[0] for side in (1.0, -1.0))
        np.testing.assert_allclose((up - down) / (2e-4), slopes[:, k] * step[k] / 1e-4, atol=1e-5)


@pytest.mark.slow
def test_intervals_hold():
    """Of a loop that is fast against its sampling, input mostly noise."""
    method, scores = ThreeModel(controller="continuous"), []
    for seed in range(12):
        found = identify(loop(seed, 1000, 0.01), Structure(2, 0), method)
        scores.append((found.theta - TRUTH) / found.std)
    table = np.array(scores)
    assert np.all(np.abs(table.mean(axis=0)) * np.sqrt(len(table)) < 3.5)
    assert np.mean(np.abs(table) < 1.96) > 0.8
    assert 0.6 < table.std() < 1.4
