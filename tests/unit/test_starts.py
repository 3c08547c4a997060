"""Starting poles: exact where the record or the parallel model is, ranked by an honest AICc."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, TransferFunction, simulate
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.search.band import rate_limits, relocated_poles
from tridentify.estimation.search.starts import (
    discrete_poles,
    enriched_starts,
    laguerre_starts,
    spread_starts,
)
from tridentify.models.parallel import fit_parallel
from tridentify.models.regression import Experiment, regress
from tridentify.models.series_parallel import fit_series_parallel
from tridentify.numerics.realization import cascade
from tridentify.numerics.slices import drain

DT = 0.05
NUMERATORS = [[[5.0, 7.0], [2.0]], [[1.0], [-3.0, 1.0]]]
DENOMINATOR = [1.0, 2.0, 6.0, 5.0]  # (p + 1) (p^2 + p + 5)
POLES = np.roots(DENOMINATOR)


def problem(
    n_records=1,
    n=300,
    *,
    den=DENOMINATOR,
    noise=0.0,
    offset=0.0,
    intersample="zoh",
    terms=(False, False, False),
):
    experiments = []
    for seed in range(n_records):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.standard_normal((-(-n // 4), 2)), 4, axis=0)[:n]
        model = TransferFunction(NUMERATORS, [[den] * 2] * 2)
        y = simulate(model, Record(u, u, dt=DT, intersample=intersample)) + offset
        y = y + noise * np.std(y, axis=0) * rng.standard_normal(y.shape)
        experiments.append(Experiment(u, y, DT, intersample, *terms))
    return Problem.of(experiments, len(den) - 1, ((1, 0), (0, 1)))


def plain(base):
    e = base.experiments[0]
    return Variant(e.free, e.offset, e.drift, (None,) * len(base.experiments))


def polynomial(poles):
    return np.poly(poles).real


# ------------------------------------------------------------------- discrete-time least squares
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("n_records", [1, 3])
def test_discrete_poles_are_exact_without_noise(intersample, n_records):
    """Whatever the state at the start and the offset: both fit into the regression."""
    base = problem(n_records, offset=3.0, intersample=intersample)
    later = [
        Experiment(e.u[40:].copy(), e.y[40:], DT, intersample, True, True, False)
        for e in base.experiments
    ]
    base = Problem.of(later, base.n_poles, base.n_zeros)
    assert polynomial(discrete_poles(base)) == pytest.approx(DENOMINATOR, rel=1e-6)


def test_discrete_poles_skip_windows_with_missing_samples():
    base = problem()
    base.experiments[0].y[::7] = np.nan
    assert polynomial(discrete_poles(base)) == pytest.approx(DENOMINATOR, rel=1e-6)


def test_discrete_poles_of_a_slower_output_are_a_guess_rather_than_a_crash():
    base = problem()
    base.experiments[0].y[::2] = np.nan
    found = discrete_poles(base)
    assert found.size == 3
    assert np.all(found.real < 0)


def test_discrete_poles_of_a_very_short_record_spread_over_the_band():
    found = discrete_poles(problem(n=8))
    low, high = rate_limits(problem(n=8))
    assert found.size == 3
    assert np.all((np.abs(found) > 0.99 * low) & (np.abs(found) < 1.01 * high))


# --------------------------------------------------------------------- parallel model into poles
@pytest.mark.parametrize("terms", [(False, False, False), (True, True, False)])
def test_both_reductions_are_exact_when_the_operators_hold_the_system(terms):
    """With its poles among the operators the parallel model is the system itself."""
    base = problem(terms=terms)
    start = drain(enriched_starts(base, plain(base), POLES[[0, 1, 2]]))[0]
    assert polynomial(start.reduced_poles()) == pytest.approx(DENOMINATOR, rel=1e-5)
    assert polynomial(start.filtered_poles()) == pytest.approx(DENOMINATOR, rel=1e-5)


@pytest.mark.parametrize("terms", [(False, False, False), (True, True, False)])
def test_machine_code_reduces_as_the_two_steps_are_derived(terms):
    """Through filters of as many poles as the denominator has, and of one more."""
    base = problem(noise=0.3, terms=terms)
    near = min(laguerre_starts(base, [plain(base)]), key=lambda one: abs(one.rate - 2.0))
    for start in (near, drain(enriched_starts(base, plain(base), POLES[[0, 1, 2]]))[0]):
        whole = tuple(regress(e, start.bank) for e in base.experiments)
        regressions = start.variant.regressions(whole, start.bank)
        rows = np.eye(start.order, start.bank.order)
        fit = fit_parallel(regressions, rows, np.zeros(start.order), free_rows=rows)
        samples = sum(e.n_samples for e in base.experiments)
        weights = 1.0 / np.sqrt(fit.cost / samples)
        (filter_,) = start.filters
        step = fit_series_parallel(
            regressions, start.bank, fit.response, cascade(filter_), 3, base.n_zeros, weights
        )
        np.testing.assert_allclose(start.reduction.costs, fit.cost, rtol=1e-9)
        expected = base.admissible(step.poles)[0]
        np.testing.assert_allclose(start.filtered_poles(), expected, rtol=1e-6)


def test_laguerre_functions_of_the_systems_only_pole_hold_it():
    base = problem(den=[1.0, 6.0, 12.0, 8.0])  # (p + 2)^3
    low, high = rate_limits(base)
    near = min(laguerre_starts(base, [plain(base)]), key=lambda start: abs(start.rate - 2.0))
    assert low < near.rate < high
    assert polynomial(near.reduced_poles()) == pytest.approx([1.0, 6.0, 12.0, 8.0], rel=2e-2)


def test_reduced_poles_are_stable_whatever_the_noise():
    base = problem(noise=30.0)
    for start in laguerre_starts(base, [plain(base)]) + spread_starts(base, [plain(base)]):
        found = start.reduced_poles()
        assert found is None or np.all(found.real < 0)


def test_a_spread_alone_brings_no_filter():
    base = problem()
    assert all(s.filtered_poles() is None for s in spread_starts(base, [plain(base)]))


# ------------------------------------------------------------------------------------ the ranking
def aicc(start):
    """From the fitted parallel model itself; k counts weights, nuisance terms and variances."""
    base = start.problem
    experiments = base.experiments
    n = np.array(
        [sum(np.isfinite(e.y[:, i]).sum() for e in experiments) for i in range(base.n_outputs)]
    )
    nuisance = sum(start.order * e.free + e.offset + e.drift for e in experiments)
    k = base.n_outputs * (start.order * base.n_inputs + nuisance + 1)
    return n @ np.log(start.reduction.costs / n) + 2 * k + 2 * k * (k + 1) / (n.sum() - k - 1)


CASES = {
    "plain": {},
    "nuisance terms": {"terms": (True, True, True)},
    "first-order hold": {"intersample": "foh", "terms": (False, True, False)},
}


@pytest.mark.parametrize("case", CASES)
def test_criterion_is_that_of_the_fitted_parallel_model(case):
    base = problem(noise=0.1, **CASES[case])
    for start in laguerre_starts(base, [plain(base)])[:3]:
        assert start.criterion == pytest.approx(aicc(start), abs=1e-3)


@pytest.mark.parametrize("terms", [(False, False, False), (True, True, False)])
def test_criterion_of_several_experiments_is_that_of_their_common_weights(terms):
    base = problem(4, 120, noise=0.1, terms=terms)
    start = laguerre_starts(base, [plain(base)])[0]
    assert start.criterion == pytest.approx(aicc(start), abs=1e-3)


def test_criterion_counts_only_the_samples_that_are_there():
    base = problem(noise=0.1)
    base.experiments[0].y[np.random.default_rng(5).random((300, 2)) < 0.4] = np.nan
    start = laguerre_starts(base, [plain(base)])[0]
    assert start.criterion == pytest.approx(aicc(start), abs=1e-3)


def test_starts_come_best_first_over_the_whole_band():
    base = problem(noise=0.1)
    found = laguerre_starts(base, [plain(base)])
    values = [start.criterion for start in found]
    assert values == sorted(values)
    rates = [start.rate for start in found]
    assert (min(rates), max(rates)) == pytest.approx(rate_limits(base))


def test_rate_limits_are_three_over_the_duration_and_0_7_over_the_step():
    assert rate_limits(problem(n=301)) == pytest.approx((3.0 / 15.0, 0.7 / DT))
    low, high = rate_limits(problem(n=4))
    assert low < high


# ------------------------------------------------------------------------------ runaway poles
def test_runaway_poles_come_back_into_the_band_and_the_others_stay():
    base = problem()
    _low, high = rate_limits(base)
    poles = np.array([-1.5, -50.0 * high, -60.0 * high], dtype=complex)
    found = relocated_poles(base, poles)
    assert len(found) > 5
    for moved in found:
        assert np.any(np.isclose(moved, -1.5))
        assert moved.size == 3
        assert np.all(moved.real < 0)
        assert np.all(np.abs(moved) < 1.01 * high)


def test_the_fastest_pair_moves_where_none_ran_away():
    base = problem()
    found = relocated_poles(base, np.array([-1.0, -2.0 + 3.0j, -2.0 - 3.0j]))
    rates = sorted({round(float(np.abs(moved).max()), 6) for moved in found})
    assert len(rates) > 5
    assert all(np.any(np.isclose(moved, -1.0)) for moved in found)
