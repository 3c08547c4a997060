"""Exact discretisation against scipy and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete

from tridentify.numerics.discretize import discretize
from tridentify.numerics.realization import cascade

SYSTEMS = {
    "lag": (np.array([[-2.0]]), np.array([[2.0]])),
    "two inputs": (np.array([[-1.0, 3.0], [-3.0, -0.1]]), np.array([[1.0, 0.0], [0.5, -2.0]])),
    "unstable": (np.array([[0.4, 1.0], [0.0, -3.0]]), np.array([[0.0], [1.0]])),
    "cascade": (
        cascade(np.array([-1 + 2j, -1 - 2j, -9.0])).a,
        cascade(np.array([-1 + 2j, -1 - 2j, -9.0])).b[:, None],
    ),
}


@pytest.fixture(params=SYSTEMS)
def system(request):
    return SYSTEMS[request.param]


@pytest.mark.parametrize("dt", [1e-3, 0.1, 2.0])
def test_held_input_agrees_with_scipy(system, dt):
    a, b = system
    n, m = b.shape
    transition, from_input, *_ = cont2discrete((a, b, np.eye(n), np.zeros((n, m))), dt, "zoh")
    found = discretize(a, b, dt)
    assert found.transition == pytest.approx(transition, rel=1e-11)
    assert found.from_current == pytest.approx(from_input, rel=1e-11)
    assert not found.from_next.any()


@pytest.mark.parametrize("dt", [1e-3, 0.1, 2.0])
def test_ramping_input_agrees_with_scipy(system, dt):
    """Scipy's state is ``x - from_next u``, which removes the sample ahead."""
    a, b = system
    n, m = b.shape
    transition, from_input, _, direct, _ = cont2discrete(
        (a, b, np.eye(n), np.zeros((n, m))), dt, "foh"
    )
    found = discretize(a, b, dt, "foh")
    ahead = found.from_current + found.transition @ found.from_next
    assert found.transition == pytest.approx(transition, rel=1e-11)
    assert found.from_next == pytest.approx(direct, rel=1e-9, abs=1e-16)
    assert ahead == pytest.approx(from_input, rel=1e-9, abs=1e-16)


def test_a_constant_input_makes_no_difference_between_the_holds(system):
    a, b = system
    held, ramp = discretize(a, b, 0.3, "zoh"), discretize(a, b, 0.3, "foh")
    assert ramp.from_current + ramp.from_next == pytest.approx(held.from_current, rel=1e-12)


def test_double_integrator_in_closed_form():
    a, b, dt = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 0.25
    held, ramp = discretize(a, b, dt), discretize(a, b, dt, "foh")
    assert held.transition == pytest.approx(np.array([[1.0, dt], [0.0, 1.0]]))
    assert held.from_current[:, 0] == pytest.approx([dt**2 / 2, dt])
    assert ramp.from_current[:, 0] == pytest.approx([dt**2 / 3, dt / 2])
    assert ramp.from_next[:, 0] == pytest.approx([dt**2 / 6, dt / 2])


def test_unknown_hold_is_refused():
    with pytest.raises(ValueError, match="'cubic'"):
        discretize(np.eye(1), np.eye(1), 0.1, "cubic")
