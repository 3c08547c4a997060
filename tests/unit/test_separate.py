"""Denominators beside one another: the cost, its derivatives, and the three models there."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, TransferFunction, simulate
from tridentify.estimation.likelihood.answer import model_of
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Recorder, coefficients
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.search.band import relocated_poles
from tridentify.estimation.search.one_mode_moved import moved_poles, place_costs
from tridentify.estimation.search.passes import adapting, parallel_model, series_model
from tridentify.estimation.search.starts import laguerre_starts
from tridentify.models.regression import Experiment
from tridentify.models.series_parallel import Filtering, fit_denominators
from tridentify.numerics.realization import denominator, roots_of, sort_poles
from tridentify.numerics.slices import drain

DT = 0.05
ORDERS = ((1, 2), (3, 2))
ZEROS = ((0, 1), (2, 2))
POLES = np.array([-2.0, -0.5 + 2j, -0.5 - 2j, -0.7, -1 + 3j, -1 - 3j, -0.4, -6.0], dtype=complex)
CASES = {
    "rest": {},
    "free": {"free": True, "offset": True, "drift": True},
    "linear input": {"intersample": "foh", "offset": True},
    "missing": {"missing": 9},
    "coloured": {"noise": (np.array([-0.6]), np.zeros(0))},
}


def made(seed=0, n=160, dt=DT, missing=0, **terms):
    rng = np.random.default_rng(seed)
    u = np.ascontiguousarray(rng.standard_normal((n, 2)).cumsum(axis=0))
    y = rng.standard_normal((n, 2)).cumsum(axis=0)
    y[rng.choice(n, missing, replace=False), 0] = np.nan
    chosen = {"intersample": "zoh", "free": False, "offset": False, "drift": False} | terms
    return Experiment(u, y, dt, **chosen)


def kept(base):
    e = base.experiments[0]
    return Variant(e.free, e.offset, e.drift, (None,) * len(base.experiments))


@pytest.fixture(params=[*CASES, "two experiments"])
def base(request):
    if request.param == "two experiments":
        terms = CASES["free"]
        return Problem.of([made(**terms), made(4, 120, 0.08, **terms)], ORDERS, ZEROS)
    return Problem.of([made(**CASES[request.param])], ORDERS, ZEROS)


def test_groups_names_and_counts():
    base = Problem.of([made(**CASES["free"])], ORDERS, ZEROS)
    assert [g.order for g in base.groups] == [1, 2, 3, 2]
    assert base.n_poles == 8
    assert base.n_coefficients == 8 + 9
    assert base.n_nuisance == 8 + 4
    assert [base.free_order(i) for i in (0, 1)] == [3, 5]
    assert base.biproper
    assert base.denominator_places().tolist() == [0, 2, 3, 6, 7, 8, 12, 13]


def test_admissible_poles_keep_to_their_denominators():
    base = Problem.of([made()], ORDERS, ZEROS)
    mixed = POLES.copy()
    mixed[0], mixed[6], mixed[7] = 9.0, -6.0, -0.4
    found, note = base.admissible(mixed)
    assert note.startswith("reflected")
    expected = POLES.copy()
    expected[0] = -9.0
    assert found == pytest.approx(expected)


def test_each_output_is_the_sum_of_its_channels(base):
    """The fit at given poles is what dense columns of every channel on its own poles give."""
    if any(a.size for e in base.experiments for a in e.noise):
        pytest.skip("the columns here are not whitened")
    point = evaluate(base, POLES)
    for i in range(2):
        rows, targets = [], []
        for k, e in enumerate(base.experiments):
            columns = []
            record = Record(e.u, np.zeros((e.n_samples, 1)), dt=e.dt, intersample=e.intersample)
            free = []
            for j in range(2):
                g = base.groups[2 * i + j]
                den = denominator(POLES[g.poles])
                zero = [[[0.0], [0.0]]]
                for power in range(ZEROS[i][j] + 1):
                    num = [[[0.0], [0.0]]]
                    num[0][j] = np.eye(ZEROS[i][j] + 1)[power]
                    dens = [[[1.0, 1.0], [1.0, 1.0]]]
                    dens[0][j] = den
                    columns.append(simulate(TransferFunction(num, dens), record)[:, 0])
                for power in range(g.order * e.free):
                    dens = [[den, [1.0, 1.0]]]
                    c_0 = np.eye(g.order)[[power]]
                    model = TransferFunction(zero, dens)
                    free.append(simulate(model, record, free_response=c_0)[:, 0])
            local = free + [np.ones(e.n_samples)] * e.offset
            local += [np.arange(e.n_samples) / e.n_samples] * e.drift
            own = [
                column if k == other else np.zeros(e.n_samples)
                for other in range(len(base.experiments))
                for column in local
            ]
            seen = np.isfinite(e.y[:, i])
            rows.append(np.stack(columns + own, axis=1)[seen])
            targets.append(e.y[seen, i])
        matrix, target = np.vstack(rows), np.concatenate(targets)
        matrix = matrix / np.linalg.norm(matrix, axis=0)
        rest = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
        assert point.rss[i] == pytest.approx(rest @ rest, rel=1e-6)


def moved(point: Point, alpha):
    """The poles of ``a_g (1 + alpha_g X_g)``."""
    return np.concatenate([roots_of(one.inner, alpha[one.poles]) for one in point.branches])


def test_the_jacobian_is_that_of_finite_differences(base):
    """Moving each ``alpha`` with the linear unknowns held changes the outputs as stated."""
    point = evaluate(base, POLES)
    matrix, _ = point.jacobian()
    own = matrix[:, point.width["a"]]
    assert own.shape[1] == 8
    # the gradient of the reduced cost by central differences
    weights = np.concatenate(
        [np.full(r.targets[i].size, point.weights[i]) for i in range(2) for r in point.regressions]
    )
    residual = np.concatenate([fit.residual for fit in point.fits])
    slope = -2.0 * (weights**2 * residual) @ own
    for k in range(8):
        step = 1e-5 * np.eye(8)[k]
        ahead, behind = evaluate(base, moved(point, step)), evaluate(base, moved(point, -step))
        found = (ahead.objective - behind.objective) / 2e-5
        assert found == pytest.approx(slope[k], rel=1e-4, abs=1e-4 * np.abs(slope).max())


def test_a_place_costs_what_the_output_error_does(base):
    variant = kept(base)
    pair = 3.0 * np.array([-0.3 + 0.9j, -0.3 - 0.9j])
    for k, held, places in (
        (0, POLES[:0], [np.array([-5.0 + 0j]), np.array([-0.3 + 0j])]),
        (2, POLES[3:4], [pair, 2.0 * pair]),
        (3, POLES[6:7], [np.array([-9.0 + 0j])]),
    ):
        costs = place_costs(base, variant, held, places, (k, POLES))
        for cost, place in zip(costs, places, strict=True):
            whole = POLES.copy()
            whole[base.groups[k].poles] = sort_poles(np.concatenate([held, place]))
            assert cost == pytest.approx(evaluate(base, whole).objective, rel=1e-9)


def test_moves_change_one_denominator_at_a_time(base):
    for move in moved_poles(base, kept(base), POLES)[:20]:
        same = [np.allclose(move.poles[g.poles], POLES[g.poles]) for g in base.groups]
        assert sum(same) == 3


def exact(**terms):
    """Experiments without noise, made by the poles above."""
    probe = Problem.of([made()], ORDERS, ZEROS)
    theta = coefficients(evaluate(probe, POLES))
    e = made(seed=7, **terms)
    record = Record(e.u, np.zeros((e.n_samples, 2)), dt=e.dt, intersample=e.intersample)
    y = simulate(model_of(probe, theta, record), record)
    whole = Experiment(e.u, y, e.dt, e.intersample, e.free, e.offset, e.drift)
    return Problem.of([whole], ORDERS, ZEROS), theta


def test_coefficients_and_model_put_them_where_the_names_say():
    base, theta = exact()
    point = evaluate(base, POLES)
    assert coefficients(point) == pytest.approx(theta, rel=1e-9)


def test_step_2_on_an_exact_output_gives_the_poles_from_afar():
    """Convex: one solution, the truth, when the parallel model is right and ``c`` is anything."""
    base, theta = exact()
    point = evaluate(base, POLES, 3)
    parallel = parallel_model(point)
    filterings = [Filtering.adapted(branch) for branch in point.branches]
    found = fit_denominators(point.regressions, parallel.response, filterings, ZEROS, np.ones(2))
    assert found.poles == pytest.approx(POLES, rel=1e-7)
    assert np.concatenate([b for row in found.b for b in row]) == pytest.approx(
        np.delete(theta, base.denominator_places()), rel=1e-6
    )


def test_passes_reach_the_truth_from_a_start():
    base, _ = exact()
    variant = kept(base)
    best = min(
        (
            evaluate(base, poles)
            for start in laguerre_starts(base, [variant])[:3]
            for poles in start.candidates()
        ),
        key=lambda point: point.objective,
    )
    ended = drain(adapting(base, variant, best.poles, Recorder(), 30))
    assert ended.objective < best.objective


def test_series_weights_are_one_and_zeros_where_the_cost_is_stationary():
    base, _ = exact(free=True, offset=True)
    point = evaluate(base, POLES, 2)
    series = series_model(point)
    assert series.heads == 4
    assert series.distance < 1e-5


def test_runaway_poles_are_put_back_in_their_own_denominator():
    base = Problem.of([made()], ORDERS, ZEROS)
    runaway = POLES.copy()
    runaway[7] = -350.0
    for poles in relocated_poles(base, runaway):
        assert poles[:6] == pytest.approx(POLES[:6])
        assert abs(poles[6:]).max() < 100.0
