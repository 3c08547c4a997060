"""What a model of the noise hides from a quick look, and what it must not make of a response."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate

pytestmark = pytest.mark.judged

Array = NDArray[np.float64]

MOTOR = TransferFunction([900.0], [1.0, 46.0, 300.0])
CIRCUIT = TransferFunction([40.0], [1.0, 1.9, 40.0])
STEP = 0.005
"""Of the motor [s]."""


def levels(rng: np.random.Generator, n: int, hold: int) -> Array:
    return np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]


def clean(plant: TransferFunction, u: Array, dt: float) -> Array:
    return simulate(plant, Record(u, u, dt=dt))[:, 0]


@pytest.mark.parametrize(
    ("shape", "seed"), [("line", 4), pytest.param("warming up", 2, marks=pytest.mark.slow)]
)
@pytest.mark.slow
def test_a_drift_that_the_noise_model_took_is_named(shape: str, seed: int) -> None:
    """Long autoregressions explain a drift; the coefficients hold, the fit does not.

    Left to itself the estimate has the drift along: the fit holds as well, a note says so, and
    there is nothing to be warned of.
    """
    rng = np.random.default_rng(seed)
    u = levels(rng, 400, 30)
    y = clean(MOTOR, u, STEP)
    way = np.linspace(0.0, 1.0, 400)
    slow = way if shape == "line" else 1.0 - np.exp(-2.0 * way)
    y = y + 1.2 * y.std() * slow + 0.02 * y.std() * rng.standard_normal(400)
    record, structure = Record(u, y, dt=STEP), Structure(2, 0)
    estimate = identify(record, structure, ThreeModel(noise="ar"), throw=False)
    assert next(one.code for one in estimate.findings if one.matters) == "drift"
    along = identify(record, structure)
    assert along.structure.drift_degree > 0
    assert any("slow disturbance is estimated along" in one for one in along.notes())
    assert along.fit[0] > 95.0 > 80.0 > estimate.fit[0]
    assert np.all(np.abs(along.theta - [46.0, 300.0, 900.0]) < 3.0 * along.std)
    assert not any(one.matters for one in along.findings)


@pytest.mark.slow
def test_a_plant_that_changes_is_named_beside_a_long_noise_model() -> None:
    """A furnace that loses a third of its losses: what one model misses looks like slow noise."""
    rng = np.random.default_rng(4)
    n, dt = 1600, 2.0
    u = levels(rng, n, 45)
    y, state = np.empty(n), np.zeros(2)
    for k in range(n):
        if k % 40 == 0:
            a0 = 2.78e-4 * (1.0 - 0.35 * k / n)
            step = expm(dt * np.array([[0.0, 1.0, 0.0], [-a0, -0.0556, 1.0], [0.0, 0.0, 0.0]]))
        y[k] = 2.2e-4 * state[0]
        state = (step @ np.append(state, u[k]))[:2]
    y = y + 0.01 * y.std() * rng.standard_normal(n)
    estimate = identify(Record(u, y, dt=dt), Structure(2, 0), throw=False)
    assert "varying" in [one.code for one in estimate.findings if one.matters]


@pytest.mark.slow
def test_a_poor_fit_beside_a_drift_is_no_missing_response() -> None:
    """The fit is worse than that of a constant, and every coefficient is known to 2 percent."""
    rng = np.random.default_rng(1)
    n, dt = 800, 0.05
    u = levels(rng, n, 12)
    y = clean(CIRCUIT, u, dt)
    y = y + 2.0 * y.std() * (1.0 - np.exp(-np.linspace(0.0, 3.0, n)))
    y = y + 0.1 * y.std() * rng.standard_normal(n)
    estimate = identify(Record(u, y, dt=dt), Structure(2, 0), throw=False)
    truth = np.array([1.9, 40.0, 40.0])
    assert float(np.max(np.abs(estimate.theta - truth) / truth)) < 0.05
    assert "no-response" not in [one.code for one in estimate.findings]


@pytest.mark.slow
def test_a_record_at_rest_says_so_where_a_pole_is_held_at_zero() -> None:
    """An integrator follows slow noise, whatever its gain."""
    rng = np.random.default_rng(2)
    n = 800
    u = 1.3 + 1e-3 * np.round(rng.standard_normal(n))
    e = rng.standard_normal(n + 100)
    for k in range(1, e.size):
        e[k] += 0.9 * e[k - 1]
    record = Record(u, 4.0 + 0.05 * e[100:], dt=0.04)
    estimate = identify(record, Structure(3, 0, fixed={"a0": 0.0}), throw=False)
    assert estimate.findings[0].code == "no-response"
