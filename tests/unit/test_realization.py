"""Orthonormal cascades against transfer functions evaluated another way."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.linalg import solve_continuous_lyapunov

from tridentify.numerics.realization import (
    cascade,
    degree_basis,
    denominator,
    filter_map,
    monomials,
    numerators,
    roots_of,
    sort_poles,
)

POLES = {
    "one": [-3.0],
    "laguerre": [-2.0] * 5,
    "kautz": [-0.3 + 2j, -0.3 - 2j] * 3,
    "mixed": [-1 + 2j, -1 - 2j, -3.0, -0.5, -4 + 1j, -4 - 1j],
    "stiff": [-1e-2, -1.0, -1e2],
    "resonant": [-0.01 + 1j, -0.01 - 1j, -0.03 + 3j, -0.03 - 3j],
}


@pytest.fixture(params=POLES)
def poles(request):
    return np.array(POLES[request.param], dtype=complex)


def points(poles):
    """Points right of the imaginary axis, of the size of the poles."""
    sizes = np.geomspace(0.3 * np.abs(poles).min(), 3 * np.abs(poles).max(), 7)
    return sizes * np.exp(1j * np.linspace(-1.5, 1.5, 7))


def states(bank, s):
    """(points, q): ``(s - A)^{-1} B``."""
    return np.array([np.linalg.solve(x * np.eye(bank.order) - bank.a, bank.b) for x in s])


def product(poles, s):
    return np.prod(s[:, None] - np.asarray(poles)[None, :], axis=1)


def values(coefficients, s):
    """(points, rows) of polynomials in descending powers, one a row."""
    return np.array([np.polyval(row, s) for row in np.atleast_2d(coefficients)]).T


def close(found, expected, tolerance=1e-10):
    assert np.max(np.abs(found - expected)) <= tolerance * np.max(np.abs(expected))


def random_row(q):
    return np.random.default_rng(q).standard_normal(q)


# ---------------------------------------------------------------------------- the cascade itself
def test_impulse_responses_are_orthonormal(poles):
    bank = cascade(poles)
    gramian = solve_continuous_lyapunov(bank.a, -np.outer(bank.b, bank.b))
    assert gramian == pytest.approx(np.eye(bank.order), abs=1e-10)
    assert bank.a + bank.a.T == pytest.approx(-np.outer(bank.b, bank.b), abs=1e-13)


def test_characteristic_polynomial_is_the_product_over_the_poles(poles):
    bank, s = cascade(poles), points(poles)
    found = np.array([np.linalg.det(x * np.eye(bank.order) - bank.a) for x in s])
    assert found == pytest.approx(product(poles, s), rel=1e-9)


def test_what_leaves_the_last_section_has_passed_an_all_pass(poles):
    bank, s = cascade(poles), points(poles)
    passed = 1.0 - states(bank, s) @ bank.b
    # real sections count as (p - s) / (p + s), so the sign is that of the zeros -pole
    assert passed == pytest.approx(product(-poles, s) / product(poles, s), rel=1e-8)


def test_real_poles_give_the_takenaka_malmquist_functions():
    rates, s = np.array([0.5, 2.0, 7.0]), points(np.array([-0.5, -7.0]))
    found = states(cascade(-rates.astype(complex)), s)
    for k, rate in enumerate(rates):
        before = product(rates[:k], s) / product(-rates[:k], s)
        assert found[:, k] == pytest.approx(np.sqrt(2 * rate) / (s + rate) * before, rel=1e-12)


@pytest.mark.parametrize("wrong", [[0.0], [1.0], [-1 + 1j, -2.0, -1 - 1j], [-1 + 1j], [1j, -1j]])
def test_unstable_poles_and_torn_pairs_are_refused(wrong):
    with pytest.raises(ValueError, match="poles"):
        cascade(np.array(wrong, dtype=complex))


def test_a_pair_the_wrong_way_round_is_refused():
    with pytest.raises(ValueError, match="poles"):
        cascade(np.array([-2.0, -1 - 1j, -1 + 1j]))


def test_sorted_poles_are_pairs_side_by_side_from_slow_to_fast():
    found = sort_poles(np.array([-5.0, -1 - 2j, -0.1, -4 + 3j, -1 + 2j, -4 - 3j]))
    expected = [-0.1, -1 + 2j, -1 - 2j, -5.0, -4 + 3j, -4 - 3j]
    assert found[[0, 1, 2]].tolist() == expected[:3]
    assert sorted(found[3:].tolist(), key=str) == sorted(expected[3:], key=str)
    assert found.imag.sum() == 0.0
    cascade(found)  # does not complain


# ------------------------------------------------------------------------- numerators and degrees
def test_denominator_is_the_product_over_the_poles(poles):
    assert denominator(poles) == pytest.approx(np.poly(poles).real, rel=1e-12)


def test_numerators_over_the_denominator_are_the_states(poles):
    bank, s = cascade(poles), points(poles)
    expected = states(bank, s)
    close(values(numerators(poles), s) / product(poles, s)[:, None], expected)


def test_degree_basis_is_orthonormal_and_sorted_by_degree(poles):
    bank = cascade(poles)
    basis = degree_basis(bank)
    assert basis.rows @ basis.rows.T == pytest.approx(np.eye(bank.order), abs=1e-12)
    coefficients = basis.rows @ numerators(poles)
    scale = np.abs(coefficients).max()
    for d, row in enumerate(coefficients):
        above, leading = row[: bank.order - 1 - d], row[bank.order - 1 - d]
        assert np.all(np.abs(above) < 1e-11 * scale)
        assert leading == pytest.approx(basis.leading[d], rel=1e-8)


def test_monomials_are_powers_over_the_denominator(poles):
    bank, s = cascade(poles), points(poles)
    found = states(bank, s) @ monomials(bank, bank.order).T
    expected = s[:, None] ** np.arange(bank.order) / product(poles, s)[:, None]
    assert found == pytest.approx(expected, rel=1e-7)


# ----------------------------------------------------------------------- products and new poles
@pytest.mark.parametrize("inner_poles", [[-3.0], [-1 + 2j, -1 - 2j], [-0.7, -0.7, -6.0]])
def test_filter_map_multiplies_transfer_functions(poles, inner_poles):
    inner = cascade(np.array(inner_poles, dtype=complex))
    bank = cascade(np.concatenate([poles, inner.poles]))
    s, row = points(poles), np.append(random_row(poles.size), np.zeros(inner.order))
    signal = states(bank, s) @ row + 0.7
    expected = states(inner, s) * signal[:, None]
    coordinates = np.tensordot(row + 0.7 * bank.b, filter_map(inner, bank), 1)
    close(states(bank, s) @ coordinates.T, expected, 1e-9)


def test_filter_map_projects_where_the_bank_lacks_poles():
    """Without the filter's pole in the bank the coordinates are those of the nearest signal."""
    inner, bank = cascade(np.array([-3.0 + 0j])), cascade(np.array([-1.0 + 0j, -2.0]))
    found = np.tensordot(bank.b, filter_map(inner, bank), 1)[0]
    t = np.linspace(0, 40, 400_001)
    first = np.sqrt(2.0) * np.exp(-t)
    second = 2.0 * (3.0 * np.exp(-2 * t) - 2.0 * np.exp(-t))
    filtered = np.sqrt(6.0) * np.exp(-3 * t)
    expected = [trapezoid(filtered * first, t), trapezoid(filtered * second, t)]
    assert found == pytest.approx(expected, rel=1e-6)


def test_roots_of_a_changed_denominator(poles):
    bank = cascade(poles)
    row = 0.3 * random_row(bank.order)
    expected = np.roots(np.poly(poles).real + np.append(0.0, row @ numerators(poles)))
    found = roots_of(bank, row)
    assert np.poly(found).real == pytest.approx(np.poly(expected).real, rel=1e-9)
    assert np.all(np.diff(np.abs(found)) >= -1e-12)


def test_poles_beyond_the_largest_magnitude_are_sorted():
    huge = complex(-1e308, 1.5e308)
    found = sort_poles(np.array([huge.conjugate(), -2.0, huge, -1.0]))
    assert found.tolist() == [-1.0, -2.0, huge, huge.conjugate()]
