"""Banks of operators against their formulas and scipy's simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim, lsim, tf2ss

from tridentify import Record, errors
from tridentify.models.operators import (
    AllPass,
    GeneralizedBasis,
    Kautz,
    Laguerre,
    apply_operators,
)
from tridentify.numerics.realization import cascade

S = np.array([0.3j, 2.0j, 1.0 + 5.0j, 9.0])
DT = 0.1


def transfer(bank, s):
    """(points, operators)."""
    c = cascade(bank.poles)
    x = np.array([np.linalg.solve(p * np.eye(c.order) - c.a, c.b) for p in s])
    return x @ bank.rows.T + bank.direct


def test_all_pass_powers_are_equation_4():
    ratio = (S - 1.7) / (S + 1.7)
    expected = ratio[:, None] ** np.arange(1, 5)
    assert transfer(AllPass(1.7, 4), S) == pytest.approx(expected, rel=1e-12)


def test_laguerre_functions_are_their_formula():
    i = np.arange(1, 5)
    expected = np.sqrt(3.4) * (S[:, None] - 1.7) ** (i - 1) / (S[:, None] + 1.7) ** i
    assert transfer(Laguerre(1.7, 4), S) == pytest.approx(expected, rel=1e-12)


def test_with_one_added_both_span_the_same_space():
    s = 1j * np.linspace(-20, 20, 41)
    ones = np.ones((s.size, 1))
    laguerre = np.hstack([ones, transfer(Laguerre(2.0, 5), s)])
    all_pass = np.hstack([ones, transfer(AllPass(2.0, 5), s)])
    left = all_pass - laguerre @ np.linalg.lstsq(laguerre, all_pass, rcond=None)[0]
    assert np.max(np.abs(left)) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("bank", [Kautz(-0.5 + 3j, 3), GeneralizedBasis((-5, -1 - 2j, -1 + 2j))])
def test_functions_are_orthonormal_on_the_imaginary_axis(bank):
    # omega = tan(angle) turns the axis into a circle, on which the rectangle rule is exact enough
    angle = np.linspace(-np.pi / 2, np.pi / 2, 20_001)[1:-1]
    x = transfer(bank, 1j * np.tan(angle))
    weight = (angle[1] - angle[0]) / np.cos(angle) ** 2 / (2 * np.pi)
    found = (x.conj() * weight[:, None]).T @ x
    assert found == pytest.approx(np.eye(x.shape[1]), abs=1e-3)


def test_kautz_repeats_one_pair():
    assert Kautz(-0.5 - 3j, 2).poles.tolist() == [-0.5 + 3j, -0.5 - 3j] * 2


@pytest.mark.parametrize(
    ("operator", "num", "den"),
    [
        (AllPass(2.0, 2), [1.0, -4.0, 4.0], [1.0, 4.0, 4.0]),
        (Laguerre(2.0, 2), [2.0, -4.0], [1.0, 4.0, 4.0]),
    ],
)
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_operators_on_a_record_agree_with_scipy(operator, num, den, intersample):
    u = np.random.default_rng(4).standard_normal((60, 2))
    u[0] = 0.0
    record = Record(u, u, dt=DT, intersample=intersample)
    found = apply_operators(operator, record)
    assert found.shape == (60, 2, 2)
    t = np.arange(60) * DT
    for j in range(2):
        if intersample == "foh":
            expected = lsim((num, den), u[:, j], t)[1]
        else:
            step = cont2discrete(tf2ss(num, den), DT, "zoh")
            expected = dlsim(step, u[:, j])[1][:, 0]
        assert found[:, j, 1] == pytest.approx(expected, rel=1e-9, abs=1e-11)


@pytest.mark.parametrize("kind", [AllPass, Laguerre])
@pytest.mark.parametrize(
    ("gamma", "order"), [(0.0, 2), (-1.0, 2), (np.nan, 2), (np.inf, 2), (1.0, 0), (1.0, 1.5)]
)
def test_senseless_options_are_refused(kind, gamma, order):
    with pytest.raises(errors.OptionError):
        kind(gamma, order)


@pytest.mark.parametrize(
    "wrong", [(), (1.0,), (0.0,), (-1 + 1j,), (-1.0, np.nan), (2 + 1j, 2 - 1j)]
)
def test_senseless_poles_are_refused(wrong):
    with pytest.raises(errors.OptionError):
        GeneralizedBasis(wrong)


@pytest.mark.parametrize("torn", [(-1 + 2j, -3 - 2j), (-1 + 1j, -1 + 2j, -2 - 3j)])
def test_poles_that_are_no_pairs_are_refused(torn):
    with pytest.raises(errors.OptionError):
        GeneralizedBasis(torn)


def test_a_record_without_a_uniform_step_is_filtered_exactly():
    record = Record(np.ones(3), np.ones(3), t=[0.0, 1.0, 3.0])
    found = apply_operators(Laguerre(1.0, 1), record)[:, 0, 0]
    assert found == pytest.approx(np.sqrt(2.0) * (1.0 - np.exp(-record.t)), rel=1e-13)
