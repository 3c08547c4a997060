"""Triangles and columns from machine code are those of the general way, whatever the record."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.search.banks import Banks
from tridentify.models.columns import Layout
from tridentify.models.compiled_regression import cascades
from tridentify.models.experiment import MIDDLING, Experiment
from tridentify.models.regression import regress, response_of
from tridentify.numerics.discretize import discretize
from tridentify.numerics.interpolation import DEGREE, moments
from tridentify.numerics.kernels.exponentials import discrete, exponential, of_powers
from tridentify.numerics.kernels.triangles import triangularise
from tridentify.numerics.least_squares import triangle
from tridentify.numerics.realization import cascade

DT = 0.1
POLES = np.array([-1.0 + 2.0j, -1.0 - 2.0j, -30.0, -0.02, -0.02])
AR1 = np.array([-0.7])


class General(Experiment):
    """An experiment that machine code is not given."""

    charts = None


def made(kind, n=120, seed=0, gone=0, **given):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal((n // 5 + 1, 2)), 5, axis=0)[:n].copy()
    y = rng.standard_normal((n, 2))
    y[rng.choice(n, gone, replace=False), 1] = np.nan
    chosen = {"intersample": "zoh", "free": True, "offset": True, "drift": True} | given
    if chosen.get("start"):
        y[: chosen["start"]] = np.nan
    return kind(u, y, DT, **chosen)


CASES = {
    "held": {},
    "ramps": {"intersample": "foh"},
    "at rest": {"free": False, "drift": False},
    "missing": {"gone": 9},
    "whole delays": {"delays": np.array([[0.3, 0.0], [0.0, 0.5]])},
    "delays": {"delays": np.array([[0.25, 0.0], [0.25, 0.0]]), "start": 3},
    "delays of ramps": {"delays": np.array([[0.25, 0.37], [0.1, 0.0]]), "intersample": "foh"},
    "band-limited": {"intersample": "band-limited"},
    "delays of band-limited": {
        "delays": np.array([[0.25, 0.3], [0.1, 50.0]]),
        "intersample": "band-limited",
    },
    "beyond the end": {"delays": np.array([[50.0, 0.0], [0.04, 50.0]])},
    "coloured": {"noise": (AR1, np.zeros(0)), "gone": 5},
}
every_case = pytest.mark.parametrize("name", CASES)


@every_case
def test_triangles_have_the_products_of_the_columns(name):
    bank = cascade(POLES)
    found, expected = (regress(made(kind, **CASES[name]), bank) for kind in (Experiment, General))
    assert found.layout == expected.layout
    assert found.counts == expected.counts
    assert found.log_scale == pytest.approx(expected.log_scale)
    for i in range(2):
        own, other = (
            np.column_stack([one.signals[i], one.targets[i]]) for one in (found, expected)
        )
        size = np.linalg.norm(other, axis=0)
        scale = np.outer(size, size) + (size == 0).any()
        assert np.max(np.abs(own.T @ own - other.T @ other) / scale) < 1e-12


@every_case
def test_responses_are_combinations_of_the_same_columns(name):
    bank = cascade(POLES)
    e, general = (made(kind, **CASES[name]) for kind in (Experiment, General))
    n = Layout(bank.order, 2, e.free, e.offset, e.drift).n_signals
    rows = np.random.default_rng(1).standard_normal((2, n))
    for options in ({}, {"most": 7}, {"outputs": [1, 1]}):
        found = response_of(e, bank, rows, **options)
        assert found == pytest.approx(response_of(general, bank, rows, **options), abs=1e-11)


def test_long_and_uneven_records_go_the_general_way():
    assert made(Experiment).charts is not None
    assert made(Experiment, n=MIDDLING).charts is not None
    assert made(Experiment, n=MIDDLING + 1).charts is None
    assert made(Experiment, t=np.arange(120) * DT).charts is None


@pytest.mark.parametrize("size", [1e-3, 1.0, 300.0])
def test_exponential_of_a_cascade(size):
    a = cascade(POLES).a * size / 30.0
    assert exponential(a) == pytest.approx(scipy.linalg.expm(a), rel=1e-9, abs=1e-13)


def test_exponential_of_what_is_not_finite():
    assert np.isnan(exponential(np.array([[np.inf]]))).all()


@pytest.mark.parametrize("ramps", [False, True])
@pytest.mark.parametrize("weight", [1.0, 1e8])
def test_discretisation(ramps, weight):
    bank = cascade(POLES)
    found = discrete(bank.a, weight * bank.b, DT, ramps)
    kind = "foh" if ramps else "zoh"
    expected = discretize(bank.a, weight * bank.b[:, None], DT, kind)
    for own, other in zip(found, expected, strict=True):
        assert own == pytest.approx(np.squeeze(other), rel=1e-9, abs=1e-13 * weight)


@pytest.mark.parametrize("weight", [1.0, 1e8])
def test_moments_of_powers(weight):
    bank = cascade(POLES)
    transition, taps = of_powers(bank.a, weight * bank.b, DT, DEGREE)
    found = taps.T
    expected = moments(bank.a, weight * bank.b, DT)
    assert transition == pytest.approx(expected[0], rel=1e-9, abs=1e-13)
    assert found == pytest.approx(expected[1], rel=1e-9, abs=1e-13 * weight)


@pytest.mark.parametrize("count", [3, 5, 40])
def test_triangle_of_columns_that_end_early(count):
    rng = np.random.default_rng(count)
    columns = rng.standard_normal((5, count))
    columns[:2, min(4, count) :] = 0.0
    r = np.full((5, 5), np.nan)
    triangularise(columns.copy(), count, 2, min(4, count), r)
    expected = triangle(columns.T)
    assert r.T @ r == pytest.approx(expected.T @ expected)
    assert np.array_equal(r, np.triu(r))


@pytest.mark.parametrize("size", [1e-140, 1e-160, 1e-200])
def test_triangle_of_a_column_too_small_to_be_inverted(size):
    """The sum of its squares may be so small that one over it is infinite."""
    columns = np.random.default_rng(7).standard_normal((4, 12))
    columns[1] *= size
    r = np.full((4, 4), np.nan)
    triangularise(columns.copy(), 12, 0, 12, r)
    assert np.all(np.isfinite(r))
    assert r.T @ r == pytest.approx(columns @ columns.T, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("constants", [None, np.array([0.4, -0.7])])
def test_orders_are_those_of_the_columns_one_by_one(constants):
    """Against a plain solution on the triangles with the functions of each order."""
    base = Problem.of([made(Experiment, seed=k, drift=False) for k in (0, 1)], 2, ((1, 1), (1, 1)))
    variant = Variant(constants is None, True, False, (constants, None))
    banks = Banks.of(base, np.stack([np.full(5, -1.0 + 0j), np.full(5, -4.0 + 0j)]))
    for k in range(2):
        own = _seen_by(variant, base, banks.bank(k))
        table = []
        for order in range(1, 5):
            total, samples = 0.0, 0
            for i in range(2):
                total, samples = _added(own, i, order, total, samples)
            free = 2 if variant.free else 0
            unknowns = 2 * ((2 + free) * order + 1 + 2)
            room = samples - unknowns - 1.0
            table.append(total + 2.0 * unknowns + 2.0 * unknowns * (unknowns + 1.0) / room)
        orders, criteria = banks.orders([variant], 4, 2)
        best = 1 + int(np.argmin(table[1:]))
        assert orders[k, 0] == best + 1
        assert criteria[k, 0] == pytest.approx(table[best], rel=1e-9)


def _seen_by(variant, base, bank):
    return variant.regressions(tuple(regress(e, bank) for e in base.experiments), bank)


def _added(regressions, output, order, total, samples):
    """With one output's logarithm of the residual and its samples."""
    parts, targets, count = [], [], 0
    for e, r in enumerate(regressions):
        s = r.signals[output]
        shared = [s[:, r.layout.input_states(j)][:, :order] for j in range(2)]
        local = [s[:, r.layout.nuisance]] + [s[:, :order]] * r.layout.free
        local = [one * (k == e) for k in range(2) for one in local]
        parts.append(np.column_stack(shared + local))
        targets.append(r.targets[output])
        count += r.counts[output]
    matrix, target = np.vstack(parts), np.concatenate(targets)
    rest = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
    return total + count * np.log(rest @ rest / count), samples + count


def test_an_error_in_machine_code_that_other_machine_code_calls_arrives():
    """Functions are called by address, across files; what they raise is handed through."""
    with pytest.raises(ValueError, match="negative real parts"):
        cascades(np.array([[1.0 + 0.0j]]))
