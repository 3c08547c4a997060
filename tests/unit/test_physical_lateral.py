"""Dutch roll and first order with dead time: simulated truth comes back within its errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete
from scipy.stats import chi2

from tridentify import Record, simulate
from tridentify.errors import OptionError
from tridentify.physical import dutch_roll, estimate_physical, first_order_dead_time

pytestmark = pytest.mark.unjudged

JET = {"Y_beta": -0.2, "Y_delta": 0.05, "N_beta": 4.0, "N_r": -0.3, "N_delta": -2.0}
HEATER = {"K": 3.0, "T": 20.0, "D": 4.3}
SEEDS = range(6)
UNLIKELY = 1e-3


def lateral(dihedral: float, u: np.ndarray, dt: float) -> np.ndarray:
    """Sideslip and yaw rate of the equations with roll rate and bank: (n, 2), input held.

    Stevens & Lewis' order of states: beta, r, p, phi; level flight at 100 m/s, angle of attack 4
    degrees; `dihedral` scales all that couples roll and yaw.
    """
    p, c = JET, dihedral
    a = np.array(
        [
            [p["Y_beta"], -1.0, 0.07 * c, 0.098 * c],
            [p["N_beta"], p["N_r"], -0.1 * c, 0.0],
            [-12.0 * c, 0.8 * c, -3.0, 0.0],
            [0.0, 0.07 * c, 1.0, 0.0],
        ]
    )
    b = np.array([[p["Y_delta"]], [p["N_delta"]], [1.0 * c], [0.0]])
    ad, bd, *_ = cont2discrete((a, b, np.eye(4), np.zeros((4, 1))), dt)
    x, found = np.zeros(4), np.empty((u.size, 2))
    for k, now in enumerate(u):
        found[k] = x[:2]
        x = ad @ x + bd[:, 0] * now
    return found


def doublet() -> np.ndarray:
    u = np.zeros(600)
    u[50:100], u[100:150] = 0.05, -0.05
    return u


def flown(seed: int, dihedral: float = 0.0, control: str = "rudder") -> Record:
    y = lateral(dihedral, doublet(), 0.02)
    noise = 0.02 * y.std(axis=0) * np.random.default_rng(seed).standard_normal(y.shape)
    names = {"input_names": [control], "output_names": ["beta", "r"]}
    return Record(doublet(), y + noise, dt=0.02, **names)


def heated(seed: int) -> Record:
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([0.0, 1.0], 12), 30)
    plant = first_order_dead_time().transfer_function(HEATER)
    y = simulate(plant, Record(u, u, dt=1.0)) + 0.05 * rng.standard_normal((u.size, 1))
    return Record(u, y, dt=1.0, input_names=["input"], output_names=["output"])


def excess(found, truth: dict[str, float]) -> float:
    """Squared error over the covariance that was stated: chi-square of as many as parameters."""
    error = found.values - np.array([truth[name] for name in found.names])
    return float(error @ np.linalg.solve(found.cov, error))


@pytest.mark.parametrize(
    ("model", "record", "truth", "seeds"),
    [
        (dutch_roll(), flown, JET, SEEDS),
        (dutch_roll(control="aileron"), lambda seed: flown(seed, control="aileron"), JET, SEEDS),
        (dutch_roll(yaw_rate_effect=None), flown, {**JET, "Y_r": 0.0}, SEEDS),
        (first_order_dead_time(), heated, HEATER, SEEDS[:3]),
    ],
    ids=["rudder", "aileron", "rudder, Y_r", "dead time"],
)
@pytest.mark.slow
def test_parameters_come_back_within_their_errors(model, record, truth, seeds) -> None:
    found = [estimate_physical(model, record(seed)) for seed in seeds]
    squared = [excess(one, truth) for one in found]
    assert max(squared) < chi2.isf(UNLIKELY / len(seeds), len(truth)), squared
    assert chi2.isf(1 - UNLIKELY, len(truth) * len(seeds)) < sum(squared), squared
    assert sum(squared) < chi2.isf(UNLIKELY, len(truth) * len(seeds)), squared
    for one in found:
        sizes = np.abs([truth[name] or 1.0 for name in one.names])
        assert np.all(np.sqrt(np.diag(one.cov)) < 0.1 * sizes)


@pytest.mark.slow
def test_roll_that_is_left_out_contradicts_the_map() -> None:
    alone, rolling = (estimate_physical(dutch_roll(), flown(0, c)) for c in (0.0, 1.0))
    assert alone.p_value > UNLIKELY
    assert rolling.p_value < 1e-9


@pytest.mark.slow
def test_first_order_with_dead_time_says_what_its_coefficients_say() -> None:
    found = estimate_physical(first_order_dead_time(), heated(0))
    np.testing.assert_allclose(found.theta, found.estimate.theta, rtol=1e-7)
    # samples before the dead time is over count for one of the two only
    np.testing.assert_allclose(found.fit, found.estimate.fit, atol=0.05)
    assert not found.notes


def test_another_surface_is_refused() -> None:
    with pytest.raises(OptionError, match="found control='flap'; expected 'rudder' or 'aileron'"):
        dutch_roll(control="flap")  # type: ignore[arg-type]
