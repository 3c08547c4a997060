"""The three routes to a response agree with each other."""

import numpy as np
import pytest
from scipy.linalg import expm

from oracles import by_exponential, by_integration, by_modes

DT, COUNT = 0.05, 60
DENS = ([1.0, 0.8], [1.0, 1.2, 6.0], [1.0, 3.0, 9.0, 8.0])


@pytest.mark.parametrize("den", DENS)
def test_modes_and_exponential_agree_on_a_held_input(den):
    u = np.random.default_rng(0).standard_normal(COUNT)
    for num in ([2.0], [0.3, 2.0][-len(den) + 1 :], [0.1, *np.ones(len(den) - 1)]):
        assert by_modes(num, den, u, DT) == pytest.approx(
            by_exponential(num, den, u, DT), rel=1e-10, abs=1e-12
        )


@pytest.mark.parametrize("den", DENS)
def test_integration_and_exponential_agree_on_a_joined_input(den):
    u = np.random.default_rng(1).standard_normal(COUNT)
    t = DT * np.arange(COUNT)
    # piece by piece the right side is smooth, so a line over the whole record is tried
    ramp = u[0] + (u[1] - u[0]) * t
    found = by_integration([2.0], den, lambda now: u[0] + (u[1] - u[0]) * now, t)
    assert found == pytest.approx(by_exponential([2.0], den, ramp, DT, "foh"), rel=1e-7, abs=1e-9)


def test_an_initial_state_decays_by_the_matrix_exponential():
    a = np.array([[-1.2, -6.0], [1.0, 0.0]])
    state = np.array([0.3, -0.2])
    expected = [np.array([0.0, 2.0]) @ expm(a * k * DT) @ state for k in range(COUNT)]
    found = by_exponential([2.0], [1.0, 1.2, 6.0], np.zeros(COUNT), DT, initial=state)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)
