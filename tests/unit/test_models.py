"""The three models against dense least squares on regressors that scipy simulates."""

from __future__ import annotations

from functools import reduce

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import cont2discrete, dlsim, lsim, tf2ss

from tridentify.models.operators import AllPass, Laguerre
from tridentify.models.parallel import fit_parallel
from tridentify.models.regression import Experiment, regress
from tridentify.models.response import Response
from tridentify.models.series import fit_series
from tridentify.models.series_parallel import fit_series_parallel
from tridentify.numerics.realization import cascade, numerators, sort_poles

DT, GAMMA, K = 0.1, 1.7, 3
PLUS, MINUS = np.array([1.0, GAMMA]), np.array([1.0, -GAMMA])
BELOW = reduce(np.convolve, [PLUS] * K)
FILTER = np.array([1.0, 5.0, 6.0, 7.0])
FILTER_POLES = sort_poles(np.roots(FILTER))
S = np.array([0.4j, 3.0j, 1.0 + 2.0j, 6.0])


# --------------------------------------------------------------------- signals, the independent way
def filtered(num, den, u, intersample):
    """Output of ``num / den`` from rest, exact."""
    num = np.trim_zeros(np.atleast_1d(num), "f")
    direct = num[0] if num.size == len(den) else 0.0
    if direct:
        num = (num - direct * np.asarray(den))[1:]
    if not np.any(num):
        return direct * u
    system = tf2ss(num, den)
    if intersample == "foh":
        return direct * u + lsim(system, u, np.arange(u.size) * DT)[1]
    return direct * u + dlsim(cont2discrete(system, DT, "zoh"), u)[1][:, 0]


def impulse(num, den, n_samples):
    """Response of the strictly proper ``num / den`` to an impulse at the first sample."""
    a, b, c, _ = tf2ss(np.trim_zeros(np.atleast_1d(num), "f"), den)
    return np.array([(c @ expm(a * k * DT) @ b)[0, 0] for k in range(n_samples)])


def power(k):
    return np.append(1.0, np.zeros(k))


def all_pass(i):
    """Numerator of ``W_i`` over ``(p + gamma)^K``; i = 0 is one."""
    return reduce(np.convolve, [MINUS] * i + [PLUS] * (K - i), np.ones(1))


def least_squares(matrix, target):
    scale = np.linalg.norm(matrix, axis=0)
    x = np.linalg.lstsq(matrix / scale, target, rcond=None)[0] / scale
    return x, float(np.sum((target - matrix @ x) ** 2))


def block_diagonal(blocks):
    rows, columns = np.sum([block.shape for block in blocks], axis=0)
    out, at = np.zeros((rows, columns)), np.zeros(2, int)
    for block in blocks:
        out[at[0] : at[0] + block.shape[0], at[1] : at[1] + block.shape[1]] = block
        at += block.shape
    return out


def experiment(seed, n=120, *, intersample="zoh", free=False, offset=False, drift=False):
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.standard_normal((n, 2)), axis=0)
    y = np.cumsum(rng.standard_normal((n, 2)), axis=0) + 4.0
    return Experiment(u, y, DT, intersample, free, offset, drift)


def nuisance(e, free_functions=()):
    """Columns of one output: free responses, constant, ramp."""
    columns = [*free_functions]
    columns += [np.ones(e.n_samples)] if e.offset else []
    columns += [np.linspace(0, 1, e.n_samples)] if e.drift else []
    return np.array(columns).reshape(-1, e.n_samples).T


def transfer(bank, row, direct=0.0):
    x = [np.linalg.solve(s * np.eye(bank.order) - bank.a, bank.b) for s in S]
    return np.array(x) @ row + direct


TERMS = {
    "at rest": {},
    "offset": {"offset": True},
    "all": {"free": True, "offset": True, "drift": True},
}
both_holds = pytest.mark.parametrize("intersample", ["zoh", "foh"])
all_terms = pytest.mark.parametrize("terms", TERMS)


# --------------------------------------------------------------------------------------- Step 1
def parallel_bank():
    return cascade(np.concatenate([AllPass(GAMMA, K).poles, FILTER_POLES]))


def fitted(experiments, **options):
    bank, operators = parallel_bank(), AllPass(GAMMA, K)
    rows = np.pad(operators.rows, ((0, 0), (0, bank.order - K)))
    regressions = [regress(e, bank) for e in experiments]
    found = fit_parallel(
        regressions, rows, operators.direct, free_rows=np.eye(K, bank.order), **options
    )
    return found, bank, regressions


def operator_columns(e):
    return np.column_stack(
        [filtered(all_pass(i), BELOW, u, e.intersample) for u in e.u.T for i in range(1, K + 1)]
    )


def decays(e):
    """``t^i exp(-gamma t)``: all free responses of K equal poles."""
    t = np.arange(e.n_samples) * DT
    return [t**i * np.exp(-GAMMA * t) for i in range(K)] if e.free else []


@both_holds
@all_terms
def test_parallel_model_is_least_squares_on_the_operators_outputs(intersample, terms):
    experiments = [
        experiment(k, 120 - 20 * k, intersample=intersample, **TERMS[terms]) for k in (0, 1)
    ]
    found = fitted(experiments)[0]
    along = block_diagonal([nuisance(e, decays(e)) for e in experiments])
    matrix = np.hstack([np.vstack([operator_columns(e) for e in experiments]), along])
    for i in range(2):
        x, cost = least_squares(matrix, np.concatenate([e.y[:, i] for e in experiments]))
        assert found.beta[i].ravel() == pytest.approx(x[: 2 * K], rel=1e-7)
        assert found.cost[i] == pytest.approx(cost, rel=1e-9)
    condition = np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0))
    if terms != "all":
        assert found.condition == pytest.approx(condition, rel=1e-6)


def test_parallel_response_is_the_sum_of_the_operators_in_continuous_time():
    found, bank, _ = fitted([experiment(0)])
    ratio = (S - GAMMA) / (S + GAMMA)
    operators = ratio[:, None] ** np.arange(1, K + 1)
    for i, j in np.ndindex(2, 2):
        y_m = transfer(bank, found.response.rows[i, j], found.response.direct[i, j])
        assert y_m == pytest.approx(operators @ found.beta[i, j], rel=1e-10)


def test_one_division_per_coefficient_is_the_papers_formula():
    e = experiment(2)
    found = fitted([e], one_at_a_time=True)[0]
    phi = operator_columns(e)
    for i in range(2):
        expected = (phi.T @ e.y[:, i]) / np.sum(phi**2, axis=0)
        assert found.beta[i].ravel() == pytest.approx(expected, rel=1e-9)
        residual = e.y[:, i] - phi @ expected
        assert found.cost[i] == pytest.approx(residual @ residual, rel=1e-9)


def test_one_division_per_coefficient_with_nuisance_terms_removed_first():
    e = experiment(2, offset=True, drift=True)
    found = fitted([e], one_at_a_time=True)[0]
    q = np.linalg.qr(nuisance(e))[0]
    phi = operator_columns(e)
    left = phi - q @ (q.T @ phi)
    for i in range(2):
        expected = (left.T @ e.y[:, i]) / np.sum(left**2, axis=0)
        assert found.beta[i].ravel() == pytest.approx(expected, rel=1e-8)


def test_one_division_per_coefficient_is_least_squares_for_orthogonal_regressors():
    e = experiment(3)
    one_input = Experiment(e.u[:, :1].copy(), e.y, DT, "zoh", False, False, False)
    regression = regress(one_input, cascade(Laguerre(GAMMA, K).poles))
    r = np.linalg.qr(regression.input_signal(0, 0, np.eye(K)), mode="r")
    rows = np.linalg.inv(r).T
    direct = np.zeros(K)
    single = fit_parallel([regression], rows, direct, one_at_a_time=True)
    whole = fit_parallel([regression], rows, direct)
    assert single.beta == pytest.approx(whole.beta, rel=1e-9)
    assert single.cost == pytest.approx(whole.cost, rel=1e-9)
    assert whole.condition == pytest.approx(1.0)
    # and it is not for others
    literal = fit_parallel([regression], np.eye(K), direct, one_at_a_time=True)
    assert np.all(literal.cost > 1.01 * whole.cost)


# --------------------------------------------------------------------------------------- Step 2
WEIGHTS = np.array([2.0, 0.3])
BETA = np.random.default_rng(9).standard_normal((2, 2, K))
FREE = np.random.default_rng(10).standard_normal((2, 2, K))


def noise_free(bank, n_experiments):
    """``y_M = sum beta_i W_i u`` (+ a free response) on a bank, and as polynomials over BELOW."""
    operators = AllPass(GAMMA, K)
    pad = ((0, 0), (0, 0), (0, bank.order - K))
    free = FREE[:n_experiments] @ np.linalg.inv(numerators(operators.poles))
    response = Response(
        np.pad(BETA @ operators.rows, pad), BETA @ operators.direct, np.pad(free, pad)
    )
    above = np.array([all_pass(i) for i in range(1, K + 1)])
    return response, BETA @ above


def equation_error(e, index, above, c, n, zeros):
    """Matrices and target of eq. (5) for one experiment, output by output."""
    for i in range(2):
        y_m = []
        for k in range(n + 1):
            num = [np.convolve(power(k), above[i, j]) for j in range(2)]
            den = np.convolve(c, BELOW)
            y = sum(filtered(num[j], den, e.u[:, j], e.intersample) for j in range(2))
            if e.free:
                y = y + impulse(np.convolve(power(k), FREE[index, i]), den, e.n_samples)
            y_m.append(y)
        a = np.column_stack(y_m[:n][::-1])
        b = np.column_stack(
            [
                filtered(power(k), c, e.u[:, j], e.intersample)
                for j in range(2)
                for k in range(zeros[i][j], -1, -1)
            ]
        )
        free = [impulse(power(k), c, e.n_samples) for k in range(n)] if e.free else []
        yield a, b, np.array(free).reshape(-1, e.n_samples).T, y_m[n]


@both_holds
@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize(
    ("c_poles", "n", "zeros"),
    [
        (FILTER_POLES, 2, [[1, 0], [0, 1]]),
        (FILTER_POLES, 1, [[0, 0], [0, 0]]),
        (FILTER_POLES, 2, [[2, 1], [0, 2]]),
        (np.array([-1 + 1j, -1 - 1j]), 2, [[1, 0], [0, 1]]),
        (np.array([-1 + 1j, -1 - 1j]), 2, [[2, 0], [1, 2]]),
    ],
    ids=["paper", "first order", "biproper", "degree of a", "degree of a, biproper"],
)
@pytest.mark.fast("paper-True-*", "first order-False-*", "biproper-*")
def test_series_parallel_model_is_least_squares_on_equation_5(intersample, free, c_poles, n, zeros):
    bank, filter_bank = (
        cascade(np.concatenate([AllPass(GAMMA, K).poles, c_poles])),
        cascade(c_poles),
    )
    experiments = [experiment(k, 120 - 20 * k, intersample=intersample, free=free) for k in (0, 1)]
    response, above = noise_free(bank, 2)
    found = fit_series_parallel(
        [regress(e, bank) for e in experiments], bank, response, filter_bank, n, zeros, WEIGHTS
    )
    a, b, loose, target = [], [[], []], [], []
    for index, e in enumerate(experiments):
        rows = equation_error(e, index, above, np.poly(c_poles).real, n, zeros)
        for i, (a_part, b_part, free_part, left) in enumerate(rows):
            a.append(WEIGHTS[i] * a_part)
            b[i].append(-WEIGHTS[i] * b_part)
            loose.append(-WEIGHTS[i] * free_part)
            target.append(-WEIGHTS[i] * left)
    # experiments outside, outputs inside: b of each output under its own rows
    spread = [block_diagonal([b[0][k], b[1][k]]) for k in range(2)]
    matrix = np.hstack([np.vstack(a), np.vstack(spread), block_diagonal(loose)])
    x, cost = least_squares(matrix, np.concatenate(target))
    assert np.poly(found.poles).real[1:] == pytest.approx(x[:n], rel=1e-6)
    b_found = np.concatenate([b for row in found.b for b in row])
    assert b_found == pytest.approx(x[n : n + b_found.size], rel=1e-5, abs=1e-7)
    assert found.cost == pytest.approx(cost, rel=1e-7)


def test_a_model_of_the_right_order_leaves_no_equation_error():
    """Three operators over one pole are a third-order model: Step 2 finds it."""
    bank = parallel_bank()
    one = Response(
        np.pad(BETA[:1, :1] @ AllPass(GAMMA, K).rows, ((0, 0), (0, 0), (0, 3))),
        BETA[:1, :1] @ AllPass(GAMMA, K).direct,
        np.zeros((1, 1, bank.order)),
    )
    e = experiment(0)
    single = Experiment(e.u[:, :1].copy(), e.y[:, :1].copy(), DT, "zoh", False, False, False)
    filter_bank = cascade(FILTER_POLES)
    found = fit_series_parallel(
        [regress(single, bank)], bank, one, filter_bank, 3, [[3]], np.ones(1)
    )
    above = BETA[0, 0] @ np.array([all_pass(i) for i in range(1, K + 1)])
    assert np.poly(found.poles).real == pytest.approx(BELOW, rel=1e-8)
    assert found.b[0][0] == pytest.approx(above, rel=1e-8)
    assert found.cost < 1e-18


# --------------------------------------------------------------------------------------- Step 3
@both_holds
@all_terms
@pytest.mark.parametrize("weights", [None, WEIGHTS])
@pytest.mark.fast("weights1-offset-*", "None-at rest-zoh")
def test_series_model_is_least_squares_on_the_models_output(intersample, terms, weights):
    """``W_0 = 1`` and Laguerre operators behind ``y_0``; one beta, or one for each output."""
    operators = Laguerre(0.9, 2)
    behind = cascade(operators.poles)
    bank = cascade(np.concatenate([AllPass(GAMMA, K).poles, operators.poles]))
    experiments = [
        experiment(k, 120 - 20 * k, intersample=intersample, **TERMS[terms]) for k in (0, 1)
    ]
    response, above = noise_free(bank, 2)
    found = fit_series(
        [regress(e, bank) for e in experiments],
        bank,
        response,
        behind,
        operators.rows,
        operators.direct,
        free_rows=np.eye(K, bank.order),
        weights=weights,
    )
    root = np.sqrt(1.8)
    behind_num = [
        np.array([1.0, 1.8, 0.81]),
        root * np.array([1.0, 0.9]),
        root * np.array([1.0, -0.9]),
    ]
    den = np.convolve(BELOW, behind_num[0])
    scale = np.ones(2) if weights is None else weights
    beta_columns, along, target = [[], []], [[], []], [[], []]
    for i in range(2):
        for index, e in enumerate(experiments):
            columns = []
            for num in behind_num:
                y = sum(
                    filtered(np.convolve(num, above[i, j]), den, e.u[:, j], intersample)
                    for j in range(2)
                )
                if e.free:
                    y = y + impulse(np.convolve(num, FREE[index, i]), den, e.n_samples)
                columns.append(y)
            beta_columns[i].append(scale[i] * np.column_stack(columns))
            along[i].append(scale[i] * nuisance(e, decays(e)))
            target[i].append(scale[i] * e.y[:, i])
    groups = [[0], [1]] if weights is None else [[0, 1]]
    for group in groups:
        matrix = np.hstack(
            [
                np.vstack([part for i in group for part in beta_columns[i]]),
                block_diagonal([part for i in group for part in along[i]]),
            ]
        )
        left = np.concatenate([part for i in group for part in target[i]])
        x, cost = least_squares(matrix, left)
        for i in group:
            assert found.beta[i] == pytest.approx(x[:3], rel=1e-6)
        assert np.sum(found.cost[group] * scale[group] ** 2) == pytest.approx(cost, rel=1e-8)


def test_corrected_response_is_the_product_of_the_transfer_functions():
    operators = Laguerre(0.9, 2)
    bank = cascade(np.concatenate([AllPass(GAMMA, K).poles, operators.poles]))
    response, above = noise_free(bank, 1)
    found = fit_series(
        [regress(experiment(0), bank)],
        bank,
        response,
        cascade(operators.poles),
        operators.rows,
        operators.direct,
    )
    first = np.sqrt(1.8) / (S + 0.9)
    for i, j in np.ndindex(2, 2):
        series = found.beta[i] @ np.array([np.ones(S.size), first, first * (S - 0.9) / (S + 0.9)])
        expected = series * np.polyval(above[i, j], S) / np.polyval(BELOW, S)
        corrected = transfer(bank, found.response.rows[i, j], found.response.direct[i, j])
        assert corrected == pytest.approx(expected, rel=1e-8)
    worst = np.abs(found.beta - np.array([1.0, 0.0, 0.0])).max()
    assert found.distance == pytest.approx(worst)


def test_weights_are_one_and_zeros_when_the_model_is_right():
    operators = Laguerre(0.9, 2)
    bank = cascade(np.concatenate([AllPass(GAMMA, K).poles, operators.poles]))
    response, above = noise_free(bank, 1)
    e = experiment(0)
    y = [sum(filtered(above[i, j], BELOW, e.u[:, j], "zoh") for j in range(2)) for i in range(2)]
    exact = Experiment(e.u, np.array(y).T.copy(), DT, "zoh", False, False, False)
    found = fit_series(
        [regress(exact, bank)],
        bank,
        Response(response.rows, response.direct, 0 * response.free),
        cascade(operators.poles),
        operators.rows,
        operators.direct,
    )
    assert found.distance < 1e-9
