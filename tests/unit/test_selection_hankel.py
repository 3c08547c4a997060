"""Hankel singular values of the parallel model: exact without noise, and above a floor with it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from tridentify import Record, Structure, TransferFunction, select_structure, simulate
from tridentify.judgement.selection import Hankel, hankel_values
from tridentify.judgement.selection.hankel import _singular_values
from tridentify.numerics.realization import cascade

DEN = np.array([1.0, 3.0, 9.0])


def record(level, seed=0, n=400):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 5), 5)
    y = simulate(TransferFunction([2.0, 3.0], DEN), Record(u, u, dt=0.05))[:, 0]
    return Record(u, y + level * rng.standard_normal(n), dt=0.05)


def reference():
    """The values of (2 s + 3) / (s^2 + 3 s + 9) from the Gramians of its companion form."""
    a, b, c = np.array([[-3.0, -9.0], [1.0, 0.0]]), np.array([[1.0], [0.0]]), np.array([[2.0, 3.0]])
    p = solve_continuous_lyapunov(a, -b @ b.T)
    q = solve_continuous_lyapunov(a.T, -c.T @ c)
    return np.sort(np.sqrt(np.linalg.eigvals(p @ q).real))[::-1]


def test_the_values_of_a_system_on_its_own_poles_are_exact():
    bank = cascade(np.roots(DEN).astype(complex))
    # the weights that make the model, from the two states' transfer functions at two frequencies
    s = np.array([0.7j, 2.0j])
    states = np.array([np.linalg.solve(x * np.eye(2) - bank.a, bank.b) for x in s])
    weights = np.linalg.solve(states, np.polyval([2.0, 3.0], s) / np.polyval(DEN, s))
    np.testing.assert_allclose(weights.imag, 0.0, atol=1e-12)
    found = _singular_values(bank.a, weights.real[None, :])
    np.testing.assert_allclose(found, reference(), rtol=1e-10)


def test_a_fitted_model_has_them_in_units_of_the_noise():
    level = 0.02
    data = record(level)
    poles = np.repeat(np.roots(DEN), 1).astype(complex)
    found = hankel_values([data], [("own", poles)], Structure(1, 0, initial_state="rest"))
    scale = np.std(data.u) / level
    np.testing.assert_allclose(found.values, scale * reference(), rtol=0.1)


@pytest.mark.slow
def test_noise_alone_stays_below_the_floor():
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 5)
    nuisances = Structure(1, 0, offset=False, initial_state="rest")
    poles = -np.ones(5, dtype=complex)
    count = 0
    for _ in range(60):
        noise = Record(u, rng.standard_normal(300), dt=0.1)
        count += hankel_values([noise], [("Laguerre", poles)], nuisances).order > 0
    # 5 % of 60 are 3; 10 and more have a probability of 1e-3
    assert count < 10


def test_the_order_counts_what_rises_above():
    hankel = Hankel(np.array([5.0, 2.0, 1.0]), np.array([1.5, 1.0, 0.5]), 1.5, "some")
    assert hankel.order == 2
    with pytest.raises(ValueError, match="read-only"):
        hankel.values[0] = 1.0


@pytest.mark.slow
@pytest.mark.unjudged
def test_a_selection_carries_them_with_the_right_number():
    found = select_structure(record(0.02), [Structure(2, 1), Structure(1, 0)])
    assert found.hankel.order == 2
    assert found.hankel.values.size == 6
    assert "2 Hankel singular values" in " ".join(found.summary().split())
