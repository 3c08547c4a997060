"""Two motors, a belt and a sprung pulley: its speed without its sign, 500 samples at 20 ms.

The counter sees the magnitude: ``y = |third-order response|``. What a linear model can do: on the
records with levels of mostly one sign it finds the resonance near 22 rad/s and explains a little
more than half. What it cannot: with inputs of both signs the magnitude has next to nothing to do
with a linear response, and no model comes near; that must not look like an answer.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Structure, ThreeModel, TransferFunction, identify, read_record, simulate

pytestmark = pytest.mark.unjudged

PLAIN = ThreeModel(noise="white", finish="likelihood")
THREE = Structure(3, 0, offset=True, initial_state="free")


@pytest.fixture(scope="module")
def record(folder):
    def read(name):
        return read_record(folder("coupled-drives") / name, time="t", inputs=["u"], outputs=["y"])

    return read


@pytest.mark.slow
def test_mostly_one_sign_shows_the_resonance(record, judged):
    whole = record("data_unif2.csv")
    first, second = whole.split(whole.t[300])
    estimate = identify(first, THREE, PLAIN)
    assert estimate.fit[0] == pytest.approx(61.3, abs=0.3)
    assert judged(estimate.model, second)[0] == pytest.approx(57.8, abs=0.5)
    poles = estimate.model.poles
    assert np.max(poles.imag) == pytest.approx(22.1, abs=0.2)


def test_the_harder_record_is_hardly_predicted(record, judged):
    whole = record("data.csv")
    first, second = whole.split(whole.t[300])
    estimate = identify(first, Structure(2, 0, offset=True, initial_state="free"), PLAIN)
    assert estimate.fit[0] == pytest.approx(43.7, abs=0.3)
    assert judged(estimate.model, second)[0] == pytest.approx(23.5, abs=0.5)


@pytest.mark.judged
@pytest.mark.parametrize(
    "name",
    [
        "data_prbs1.csv",
        *(pytest.param(f"data_prbs{k}.csv", marks=pytest.mark.slow) for k in (2, 3)),
    ],
)
@pytest.mark.slow
def test_both_signs_give_no_linear_model(record, judged, name):
    estimate = identify(record(name), THREE, PLAIN, throw=False)
    assert estimate.fit[0] < 10.0
    assert judged(estimate.model, record("data_unif2.csv"))[0] < 15.0
    assert estimate.cautions


def test_published_coefficients_are_not_those_of_continuous_time(record):
    """They come from a model that was integrated by Euler's rule at the sampling interval."""
    given = record("data_prbs1.csv")
    model = TransferFunction([5163.0], [1.0, 19.93, 509.8, 2835.0])
    exact = np.abs(simulate(model, given)[:, 0])
    a = np.array([[-19.93, -509.8, -2835.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    x, euler = np.zeros(3), np.empty(given.n_samples)
    for k, u in enumerate(given.u[:, 0]):
        euler[k] = abs(5163.0 * x[2])
        x = x + given.dt * (a @ x + np.array([u, 0.0, 0.0]))
    y = given.y[:, 0]
    spread = np.linalg.norm(y - y.mean())
    fits = [100.0 * (1.0 - np.linalg.norm(y - one) / spread) for one in (exact, euler)]
    assert fits[0] == pytest.approx(20.6, abs=1.0)
    assert fits[1] == pytest.approx(76.8, abs=1.0)
