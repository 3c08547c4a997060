"""Closed loops over draws: no bias by the reference, poles that are not in the left half plane.

The plants have the figures of their makers; what flies or levitates them is a sampled PID
controller, and the loop is that of `oracles`, which shares no line with the package.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from oracles import continuous_loop, sampled_loop
from tridentify import (
    ClosedLoopRefinedInstrumentalVariable,
    Projection,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    TwoStage,
    identify,
)
from tridentify.uncertainty import poles

pytestmark = pytest.mark.slow

SCORES = 4.0
"""Standard errors of a mean, and of a single estimate."""


def switching(rng, count, shortest, longest):
    """Up or down for a random number of samples."""
    r, k = np.empty(count), 0
    while k < count:
        following = k + int(rng.integers(shortest, longest))
        r[k:following] = rng.choice([-1.0, 1.0])
        k = following
    return r


def pid(r, dt, proportional, integral, derivative, smoothing=0.5):
    """A sampled controller; the derivative is that of the measured output, smoothed."""
    state = {"total": 0.0, "last": 0.0, "slope": 0.0}

    def control(k, y):
        error = r[k] - y[0]
        state["total"] += dt * error
        slope = (y[0] - state["last"]) / dt
        state["slope"] += smoothing * (slope - state["slope"])
        state["last"] = y[0]
        return proportional * error + integral * state["total"] - derivative * state["slope"]

    return control


@dataclass(frozen=True)
class Plant:
    """A plant, the PID controller around it, the size of its reference and of the noise."""

    channel: tuple[list[float], list[float]]
    gains: tuple[float, float, float]
    dt: float
    pieces: tuple[int, int]
    amplitude: float
    noise: float

    @property
    def structure(self):
        return Structure(len(self.channel[1]) - 1, 0)

    def record(self, seed, count=2000):
        rng = np.random.default_rng(seed)
        r = self.amplitude * switching(rng, count, *self.pieces)
        noise = self.noise * rng.standard_normal((count, 1))
        u, y = sampled_loop([[self.channel]], pid(r, self.dt, *self.gains), noise, self.dt)
        return Record(u, y, dt=self.dt, reference=r)


# Quanser's levitation of a ball: gap [m] from current [A] at 6 mm and 0.86 A, current controlled.
# x'' = (2 g / x0) x - (2 g / i0) i, poles at +-57.2 rad/s
GRAVITY, GAP, CURRENT = 9.81, 6e-3, 0.86
MAGLEV = Plant(
    ([-2.0 * GRAVITY / CURRENT], [1.0, 0.0, -2.0 * GRAVITY / GAP]),
    (-775.0, -3000.0, -7.4),
    dt=1e-3, pieces=(20, 80), amplitude=4e-4, noise=2e-5,
)  # fmt: skip
# the AscTec Hummingbird of RotorS: roll [rad] from torque [N m], 0.007 kg m^2, motors of 20 ms
INERTIA, MOTOR = 0.007, 0.02
ROLL = Plant(
    ([1.0 / (INERTIA * MOTOR)], [1.0, 1.0 / MOTOR, 0.0, 0.0]),
    (0.45, 0.2, 0.09),
    dt=4e-3, pieces=(60, 200), amplitude=0.17, noise=2e-3,
)  # fmt: skip
ROLL_RATE = Plant(
    ([1.0 / (INERTIA * MOTOR)], [1.0, 1.0 / MOTOR, 0.0]),
    (0.09, 0.5, 0.0),
    dt=4e-3, pieces=(30, 100), amplitude=1.0, noise=0.05,
)  # fmt: skip


@pytest.mark.parametrize("seed", range(6))
def test_the_unstable_pole_of_a_levitated_ball_is_found(seed):
    estimate = identify(MAGLEV.record(seed), MAGLEV.structure, ThreeModel(controller="sampled"))
    assert estimate.route == "reference"
    found = poles(estimate)
    fastest = int(np.argmax(found.roots.real))
    true = np.sqrt(2.0 * GRAVITY / GAP)
    error = np.sqrt(found.cov[fastest, 0, 0])
    assert found.roots[fastest].imag == 0.0
    assert abs(found.roots[fastest].real - true) < SCORES * error
    assert error < 0.1 * true
    assert "unstable" in {one.code for one in estimate.findings}


@pytest.mark.parametrize("seed", range(4))
def test_the_motors_lag_of_a_multirotor_is_found_beside_its_two_integrators(seed):
    known = Structure(3, 0, fixed={"a1": 0.0, "a0": 0.0})
    estimate = identify(ROLL.record(seed), known, ThreeModel(controller="sampled"))
    assert estimate.route == "reference"
    for name, value in (("a2", 1.0 / MOTOR), ("b0", ROLL.channel[0][0])):
        row = estimate.parameters[name]
        assert abs(row.value - value) < SCORES * row.std
        assert row.std < 0.01 * value


@pytest.mark.parametrize("seed", range(8))
def test_two_integrators_that_nobody_states_are_found_within_their_errors(seed):
    """Their sum and product are known better than each."""
    method = ThreeModel(controller="sampled", noise="white")
    estimate = identify(ROLL.record(seed), ROLL.structure, method)
    truth = np.array([1.0 / MOTOR, 0.0, 0.0, ROLL.channel[0][0]])
    assert np.all(np.abs(estimate.theta - truth) < SCORES * estimate.std)


@pytest.mark.parametrize("seed", range(4))
def test_the_integrator_of_a_roll_rate_is_found(seed):
    """Nobody says that there is one; it is a pole at zero within the standard error."""
    method = ThreeModel(controller="sampled")
    estimate = identify(ROLL_RATE.record(seed), ROLL_RATE.structure, method)
    assert estimate.route == "reference"
    for name, value in zip(("a1", "a0"), ROLL_RATE.channel[1][1:], strict=True):
        row = estimate.parameters[name]
        assert abs(row.value - value) < SCORES * row.std
    slowest, fastest = sorted(estimate.model.poles.ravel(), key=abs)
    assert abs(slowest) < 0.1  # a hundredth of the loop's bandwidth
    assert fastest.real == pytest.approx(-1.0 / MOTOR, rel=0.05)


CONTINUOUS = ([1.0, 2.0], [1.0, 1.2, 4.0])
CONTINUOUS_TRUTH = {"a1": 1.2, "a0": 4.0, "b1": 1.0, "b0": 2.0}


def under_a_continuous_controller(seed, dt=0.1, count=600, noise=0.3):
    """Proportional and integral, ``2 + 1 / s``; the reference's samples are joined."""
    rng = np.random.default_rng(seed)
    controller = (np.zeros((1, 1)), np.ones(1), np.array([1.0]), 2.0)
    e = noise * rng.standard_normal(count)
    r = np.interp(np.arange(count), np.arange(0, count + 15, 15), rng.normal(size=count // 15 + 1))
    u, y = continuous_loop(CONTINUOUS, controller, r, e, dt, intersample="foh")
    return Record(u, y, dt=dt, reference=r, intersample="foh", reference_intersample="foh")


def mean_scores(records, method):
    """Mean of the errors over records, in standard errors of that mean."""
    scores = []
    for record in records:
        estimate = identify(record, Structure(2, 1), method)
        scores.append(
            [(estimate.parameters[k].value - v) / estimate.parameters[k].std
             for k, v in CONTINUOUS_TRUTH.items()]
        )  # fmt: skip
    return np.mean(scores, axis=0) * np.sqrt(len(records))


def test_open_loop_is_biased_where_the_reference_route_is_not():
    """A continuous controller answers the noise at once; joined samples of its output do not."""
    records = [under_a_continuous_controller(seed) for seed in range(20, 32)]
    by_reference = mean_scores(records, ThreeModel(controller="continuous"))
    by_input = mean_scores(records, ThreeModel(route="open-loop"))
    assert np.abs(by_reference).max() < SCORES
    assert by_input[2] < -2.0 * SCORES


def under_a_coarse_controller(seed, dt=0.1, count=600, noise=0.06):
    """``10 + 15 / s`` on samples, integrated by trapezoids: not the loop of the continuous one."""
    rng = np.random.default_rng(seed)
    r, state = switching(rng, count, 10, 40), {"total": 0.0, "last": 0.0}

    def control(k, y):
        state["total"] += 0.5 * dt * (y[0] + state["last"])
        state["last"] = y[0]
        return r[k] - 10.0 * y[0] - 15.0 * state["total"]

    e = noise * rng.standard_normal((count, 1))
    u, y = sampled_loop([[([1.0, 1.0], [1.0, 0.5, 1.0])]], control, e, dt)
    return Record(u, y, dt=dt, reference=r, intersample="zoh")


KNOWN = TransferFunction([10.0, 15.0], [1.0, 0.0])
"""Of which the sampled controller was made."""


@pytest.mark.parametrize(
    ("method", "share"),
    [(ClosedLoopRefinedInstrumentalVariable(KNOWN), 0.8), (Projection(), 0.8), (TwoStage(), 0.6)],
    ids=lambda one: getattr(one, "name", ""),
)
def test_the_methods_of_the_field_know_their_errors(method, share):
    """Instruments are not exact and inputs not complete; the two-stage one is not without bias."""
    truth, held = np.array([0.5, 1.0, 1.0, 1.0]), []
    for seed in range(16):
        estimate = method.estimate([under_a_coarse_controller(seed)], Structure(2, 1))
        held.append(np.abs(estimate.theta - truth) < 1.96 * estimate.std)
    assert np.mean(held) > share
