"""Sections: coordinates, Jacobian, multiplicity and batched cascades, each by another route."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tridentify.estimation.posterior.many_cascades import (
    Sections,
    coordinates,
    degree_bases,
    filtered_rows,
    numerator_tables,
)
from tridentify.numerics import realization

DEGREES = (1, 2, 3, 4, 5)
every_degree = pytest.mark.parametrize("n", DEGREES)
STEP = 1e-6


def some(n, count=8):
    """Coordinates of complex and real pairs."""
    return np.random.default_rng(n).normal(size=(count, n))


def single(n, count=6):
    """The coordinates, the single cascades and the polynomials."""
    sections = Sections.of(some(n, count), n)
    return sections, *sections.cascade(1), sections.polynomials()


def resolvent(a, b, x):
    """``(x - A)^{-1} B``."""
    return np.linalg.solve(x * np.eye(b.size) - a, b)


def differences(phi, n):
    """(n, n) derivatives of ``a_{n-1} .. a_0`` along the coordinates, one a column."""
    steps = STEP * np.eye(n)
    up, down = (Sections.of(phi + sign * steps, n).polynomials() for sign in (1.0, -1.0))
    return ((up - down) / (2.0 * STEP))[:, 1:].T


# ------------------------------------------------------------------------------ one denominator
@every_degree
def test_polynomials_have_the_roots(n):
    sections = Sections.of(some(n), n)
    assert sections.degree == n
    for roots, polynomial in zip(sections.roots(), sections.polynomials(), strict=True):
        assert np.all(roots.real < 0)
        assert np.poly(roots) == pytest.approx(polynomial, rel=1e-10)


def test_a_section_is_its_natural_frequency_and_damping():
    sections = Sections.of(np.log([[3.0, 0.2, 7.0]]), 3)
    assert sections.polynomials()[0] == pytest.approx(np.polymul([1, 1.2, 9], [1, 7]))
    assert np.abs(sections.roots()[0]) == pytest.approx([3.0, 3.0, 7.0])


def test_roots_of_a_wide_real_pair_keep_their_digits():
    """``c / 2 - sqrt(c^2 / 4 - d)`` would lose all of them."""
    sections = Sections.of(np.log([[1.0, 0.5e9]]), 2)
    assert -sections.roots()[0].real == pytest.approx([1e9, 1e-9], rel=1e-14)


@every_degree
def test_geometric_mean_of_the_pole_magnitudes(n):
    sections = Sections.of(some(n), n)
    expected = np.prod(np.abs(sections.roots()), axis=1) ** (1.0 / n)
    assert sections.geometric_mean() == pytest.approx(expected)


@every_degree
def test_jacobian_is_that_of_finite_differences(n):
    phi = some(n)
    found = Sections.of(phi, n).log_jacobian()
    for one, value in zip(phi, found, strict=True):
        assert value == pytest.approx(np.linalg.slogdet(differences(one, n))[1], abs=1e-6)


@every_degree
@pytest.mark.parametrize("factor", [1e6, 1e-6])
def test_another_unit_of_time_scales_all_alike(n, factor):
    phi = some(n)
    moved = phi.copy()
    moved[:, : 2 * (n // 2) : 2] += np.log(factor)
    moved[:, n - n % 2 :] += np.log(factor)
    before, after = Sections.of(phi, n), Sections.of(moved, n)
    powers = np.arange(n + 1)
    assert after.polynomials() == pytest.approx(before.polynomials() * factor**powers, rel=1e-9)
    shift = after.log_jacobian() - before.log_jacobian()
    assert shift == pytest.approx(powers.sum() * np.log(factor), rel=1e-9)
    assert np.array_equal(after.log_multiplicity(), before.log_multiplicity())


# ------------------------------------------------------------------------------------ coordinates
def arrangements(poles):
    """All coordinates of one denominator: sections in any order, real poles paired in any way."""
    n, found = poles.size, set()
    for order in itertools.permutations(range(n)):
        phi = []
        for k in range(n // 2):
            pair = poles[list(order[2 * k : 2 * k + 2])]
            product, total = np.prod(pair), -np.sum(pair)
            if max(abs(product.imag), abs(total.imag)) > 1e-12:
                break
            w = np.sqrt(product.real)
            phi += [np.log(w), np.log(total.real / (2.0 * w))]
        else:
            last = poles[order[-1]]
            if n % 2 and last.imag:
                continue
            phi += [np.log(-last.real)] * (n % 2)
            found.add(tuple(np.round(phi, 9)))
    return np.array(sorted(found))


PAIR, OTHER = (-1 + 2j, -1 - 2j), (-0.3 + 5j, -0.3 - 5j)
POLES = {
    "one real": (-2.0,),
    "a pair": PAIR,
    "two real": (-1.0, -3.0),
    "a pair and one real": (*PAIR, -3.0),
    "three real": (-1.0, -2.5, -4.0),
    "two pairs": (*PAIR, *OTHER),
    "a pair and two real": (*PAIR, -0.5, -4.0),
    "four real": (-0.5, -1.0, -3.0, -7.0),
    "two pairs and one real": (*PAIR, *OTHER, -0.7),
    "a pair and three real": (*PAIR, -0.5, -4.0, -9.0),
    "five real": (-0.2, -0.5, -1.0, -3.0, -7.0),
}


@pytest.mark.parametrize("name", POLES)
def test_multiplicity_counts_the_coordinates(name):
    poles = np.array(POLES[name], dtype=complex)
    phi = arrangements(poles)
    sections = Sections.of(phi, poles.size)
    expected = np.broadcast_to(np.poly(poles).real, (len(phi), poles.size + 1))
    assert sections.polynomials() == pytest.approx(expected, rel=1e-7)
    assert np.exp(sections.log_multiplicity()) == pytest.approx(np.full(len(phi), len(phi)))


@pytest.mark.parametrize("name", POLES)
def test_coordinates_are_one_of_them(name):
    poles = np.array(POLES[name], dtype=complex)
    found = np.round(coordinates(realization.sort_poles(poles)), 9)
    assert np.min(np.abs(arrangements(poles) - found).max(axis=1)) < 1e-8


@given(st.integers(1, 6), st.data())
def test_coordinates_give_the_denominator_back(n, data):
    phi = np.array([data.draw(st.lists(st.floats(-4.0, 2.0), min_size=n, max_size=n))])
    before = Sections.of(phi, n)
    poles = realization.sort_poles(before.roots()[0])
    after = Sections.of(coordinates(poles)[None], n)
    assert after.polynomials() == pytest.approx(before.polynomials(), rel=1e-9)


# ----------------------------------------------------------------------------- batches of cascades
@every_degree
@pytest.mark.parametrize("repeats", [1, 2, 3])
def test_cascades_are_orthonormal_and_have_the_poles(n, repeats):
    sections = Sections.of(some(n), n)
    a, b = sections.cascade(repeats)
    gram = a + a.transpose(0, 2, 1) + b[:, :, None] * b[:, None, :]
    assert np.abs(gram).max() < 1e-12
    for one, polynomial in zip(a, sections.polynomials(), strict=True):
        whole = np.ones(1)
        for _ in range(repeats):
            whole = np.convolve(whole, polynomial)
        x = 0.4 + 1.3j
        assert np.linalg.det(x * np.eye(n * repeats) - one) == pytest.approx(np.polyval(whole, x))


@every_degree
def test_cascades_of_complex_pairs_are_those_of_one_denominator(n):
    phi = some(n)
    phi[:, 1 : 2 * (n // 2) : 2] = -np.abs(phi[:, 1 : 2 * (n // 2) : 2]) - 0.01
    sections = Sections.of(phi, n)
    a, b = sections.cascade(2)
    for s, roots in enumerate(sections.roots()):
        bank = realization.cascade(np.tile(np.conj(roots), 2))
        assert a[s] == pytest.approx(bank.a, abs=1e-12)
        assert b[s] == pytest.approx(bank.b, abs=1e-12)


@every_degree
def test_numerator_tables_are_those_of_the_resolvent(n):
    _, a, b, polynomials = single(n)
    tables = numerator_tables(a, b, polynomials)
    x = 0.3 + 1.7j
    for s in range(b.shape[0]):
        expected = resolvent(a[s], b[s], x)
        found = tables[s] @ x ** np.arange(n - 1.0, -1.0, -1.0) / np.polyval(polynomials[s], x)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


@every_degree
def test_degree_bases_are_orthonormal_and_sorted_by_degree(n):
    _, a, b, polynomials = single(n)
    tables, bases = numerator_tables(a, b, polynomials), degree_bases(a, b)
    for table, basis in zip(tables, bases, strict=True):
        assert basis.T @ basis == pytest.approx(np.eye(n), abs=1e-12)
        rows = basis.T @ table / np.abs(table).max(axis=0)
        for m in range(n):
            assert np.abs(rows[n - 1 - m :, : n - 1 - m]).max(initial=0.0) < 1e-8
            assert abs(rows[n - 1 - m, n - 1 - m]) > 1e-6


@every_degree
def test_rows_of_states_are_filtered_once_more(n):
    sections, a, b, _ = single(n)
    bank_a, bank_b = sections.cascade(2)
    every = np.tile(np.eye(2 * n), (len(bank_a), 1, 1))
    maps = filtered_rows(a, b, bank_a, every)
    x = 0.3 + 1.7j
    for s in range(b.shape[0]):
        inner, bank = resolvent(a[s], b[s], x), resolvent(bank_a[s], bank_b[s], x)
        for k in range(n):
            expected = inner * bank[k]
            size = np.abs(expected).max()
            assert maps[s, k] @ bank == pytest.approx(expected, rel=1e-8, abs=1e-8 * size)
