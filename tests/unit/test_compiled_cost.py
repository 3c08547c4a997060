"""Machine code beside the functions whose derivation it follows, and beside dense solutions."""

import numpy as np
import pytest

from tridentify import Record, Structure
from tridentify.estimation.likelihood.compiled.cost import decomposed
from tridentify.estimation.likelihood.cost import evaluate, evaluate_variant
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.setup.linear_columns import linear_blocks
from tridentify.estimation.search.passes import both_steps, parallel_model
from tridentify.models.response import ColumnBlocks
from tridentify.models.series_parallel import Filtering, fit_denominators
from tridentify.numerics.kernels.cascades import bank_parts, solve_in_place
from tridentify.numerics.kernels.polynomials import expanded, numerator_table
from tridentify.numerics.kernels.small_least_squares import solve_small
from tridentify.numerics.least_squares import solve
from tridentify.numerics.realization import cascade, degree_basis, filter_map

POLES = {
    "real": [-1.0, -4.0],
    "repeated": [-2.0, -2.0, -2.0],
    "pairs": [-0.1 + 3j, -0.1 - 3j, -5 + 1j, -5 - 1j],
    "mixed": [-0.5, -1 + 2j, -1 - 2j, -30.0],
}


@pytest.mark.parametrize("repeats", [1, 2, 3])
@pytest.mark.parametrize("name", POLES)
def test_a_bank_has_its_poles_and_is_orthonormal(name: str, repeats: int) -> None:
    poles = np.array(POLES[name], dtype=np.complex128)
    n = poles.size
    a, b, rows, leading, maps = bank_parts(poles, np.array([n]), repeats, n)
    size = np.abs(a).max()
    assert np.allclose(a + a.T + np.outer(b, b), 0.0, atol=1e-13 * size)
    assert np.allclose(np.poly(a), np.poly(np.tile(poles, repeats)).real, rtol=1e-9)
    inner, first = a[:n, :n], b[:n]
    # rows sorted by degree: n - 1 - d Markov parameters of row d vanish, the next is `leading`
    assert np.allclose(rows @ rows.T, np.eye(n), atol=1e-12)
    for d in range(n):
        markov = [rows[d] @ np.linalg.matrix_power(inner, k) @ first for k in range(n - d)]
        assert np.allclose(markov[:-1], 0.0, atol=1e-9 * np.abs(leading[d]))
        assert markov[-1] == pytest.approx(leading[d], rel=1e-9)
    # the map solves A_c P + P A' = - B_c e_k' for every state k
    found = maps.reshape(a.shape[0], n, a.shape[0])
    for k, one in enumerate(found):
        expected = -np.outer(first, np.eye(a.shape[0])[k])
        assert np.allclose(inner @ one + one @ a.T, expected, atol=1e-9 * size)


@pytest.mark.parametrize("name", POLES)
def test_polynomials_are_those_of_the_state_equation(name: str) -> None:
    poles = np.array(POLES[name], dtype=np.complex128)
    bank, whole = cascade(poles), expanded(poles)
    assert np.allclose(whole, np.poly(poles).real, rtol=1e-12)
    table = numerator_table(poles)
    for p in (0.3 + 1j, 2.0 - 0.5j):
        states = np.linalg.solve(p * np.eye(poles.size) - bank.a, bank.b.astype(np.complex128))
        values = np.array([np.polyval(row, p) for row in table]) / np.polyval(whole, p)
        assert np.allclose(values, states, rtol=1e-10)


def test_denominators_stand_side_by_side() -> None:
    poles = np.array([-1.0, -2 + 1j, -2 - 1j, -3.0], dtype=np.complex128)
    a, b, rows, _, maps = bank_parts(poles, np.array([1, 3]), 2, 3)
    one, other = cascade(np.tile(poles[:1], 2)), cascade(np.tile(poles[1:], 2))
    assert np.allclose(a[:2, :2], one.a)
    assert np.allclose(a[2:, 2:], other.a)
    assert not a[:2, 2:].any()
    assert not a[2:, :2].any()
    assert np.allclose(b, np.concatenate([one.b, other.b]))
    assert np.allclose(rows[1:, :3], degree_basis(cascade(poles[1:])).rows)
    second = filter_map(cascade(poles[1:]), other)
    assert np.allclose(maps[4:].reshape(second.shape), second, atol=1e-12)


@pytest.mark.parametrize("poles", [[1.0, -1.0], [-1 + 2j, -3.0], [-1 - 2j, -1 + 2j], [0.0]])
def test_poles_of_no_cascade_are_refused(poles: list[complex]) -> None:
    with pytest.raises(ValueError, match="poles"):
        bank_parts(np.array(poles, dtype=np.complex128), np.array([len(poles)]), 2, len(poles))


def test_elimination_is_a_dense_solution() -> None:
    rng = np.random.default_rng(4)
    matrix, sides = rng.standard_normal((7, 7)), rng.standard_normal((7, 3))
    matrix[0, 0] = 0.0
    expected = np.linalg.solve(matrix, sides)
    solve_in_place(matrix, sides)
    assert np.allclose(sides, expected, rtol=1e-10)


def test_small_least_squares_are_those_of_any_size() -> None:
    rng = np.random.default_rng(2)
    matrix = rng.standard_normal((12, 4)) * np.array([1.0, 1e-8, 1e6, 1.0])
    matrix[:, 3] = matrix[:, 0] + 1e-20 * matrix[:, 1]  # of rank 3
    target = rng.standard_normal(12)
    x, cost, condition, basis, residual = solve_small(matrix, target)
    expected = solve(matrix, target)
    assert np.allclose(matrix @ x, matrix @ expected.x)
    assert cost == pytest.approx(expected.cost, rel=1e-12)
    assert basis.shape == expected.basis.shape == (12, 3)
    assert np.allclose(basis @ basis.T, expected.basis @ expected.basis.T, atol=1e-10)
    assert np.allclose(residual, target - matrix @ expected.x)
    assert condition > 1e12


def _records(n_inputs: int, n_outputs: int, count: int) -> list[Record]:
    rng = np.random.default_rng(7)
    lengths = [60 + 20 * k for k in range(count)]
    return [
        Record(
            np.sign(rng.standard_normal((n, n_inputs))), rng.standard_normal((n, n_outputs)), dt=0.1
        )
        for n in lengths
    ]


CASES = {
    "one channel": (_records(1, 1, 1), Structure(2, 1)),
    "two experiments": (_records(1, 1, 2), Structure(2, 2)),
    "two by two, one denominator": (_records(2, 2, 1), Structure(2, [[0, 1], [2, 1]])),
    "separate denominators": (_records(2, 2, 2), Structure([[1, 2], [1, 1]], [[0, 1], [1, 0]])),
}


@pytest.mark.parametrize("name", CASES)
def test_every_choice_is_fitted_as_its_columns_say(name: str) -> None:
    records, structure = CASES[name]
    question = Question.of(records, structure)
    base, n = question.base, question.base.n_poles
    poles = -np.linspace(0.7, 3.0, n).astype(np.complex128)
    for variant in question.variants:
        point = evaluate_variant(base, variant, poles)
        assert len(point.fits) == base.n_outputs
        for i, fit in enumerate(point.fits):
            columns = ColumnBlocks()
            for e, regression in enumerate(point.regressions):
                blocks = linear_blocks(point.problem, point.branches, regression, e, i)
                columns.add(blocks, regression.targets[i])
            matrix, target = columns.assemble()
            expected = solve(matrix, target)
            assert np.allclose(fit.matrix, matrix, atol=1e-10 * np.abs(matrix).max())
            assert point.rss[i] == pytest.approx(expected.cost, rel=1e-9)
            assert np.allclose(fit.residual, target - matrix @ expected.x, atol=1e-8)


@pytest.mark.parametrize("name", CASES)
def test_outputs_change_as_scores_and_columns_say(name: str) -> None:
    records, structure = CASES[name]
    question = Question.of(records, structure)
    poles = -np.linspace(0.7, 3.0, question.base.n_poles).astype(np.complex128)
    for variant in question.variants:
        point = evaluate_variant(question.base, variant, poles)
        for i in range(question.base.n_outputs):
            for e, regression in enumerate(point.regressions):
                found = point.changes(e, i)
                expected = np.zeros_like(found)
                expected[:, point.width["a"]] = -point.score_states.signals(regression, e, i)
                blocks = linear_blocks(point.problem, point.branches, regression, e, i)
                for key, block in blocks.items():
                    expected[:, point.width[i, key]] = block
                assert np.allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", CASES)
def test_unknowns_stand_where_their_columns_do(name: str) -> None:
    records, structure = CASES[name]
    question = Question.of(records, structure)
    poles = -np.linspace(0.7, 3.0, question.base.n_poles).astype(np.complex128)
    for variant in question.variants:
        point = evaluate_variant(question.base, variant, poles)
        assert point.jacobian()[0].shape[1] == max(own.stop for own in point.width.values())
        for i, fit in enumerate(point.fits):
            for key in fit.columns.width:
                known = fit.columns.pick(fit.solution.x, key)
                assert np.array_equal(point.terms(key, i), known)
            assert not point.terms("none", i).size


@pytest.mark.parametrize("name", CASES)
def test_steps_1_and_2_are_those_of_their_own_rooms(name: str) -> None:
    records, structure = CASES[name]
    base = Question.of(records, structure).base
    poles = -np.linspace(0.7, 3.0, base.n_poles).astype(np.complex128)
    for variant in Question.of(records, structure).variants:
        point = evaluate_variant(base, variant, poles, 3)
        steps, found = both_steps(point)
        first, second = steps()
        parallel = parallel_model(point)
        expected = fit_denominators(
            point.regressions,
            parallel.response,
            [Filtering.adapted(branch) for branch in point.branches],
            base.n_zeros,
            point.weights,
        )
        size = np.abs(parallel.beta).max()
        assert np.allclose(first.coefficients, parallel.beta.ravel(), atol=1e-9 * size)
        assert first.condition == pytest.approx(parallel.condition, rel=1e-6)
        assert np.allclose(np.sort(found), np.sort(expected.poles), rtol=1e-7)
        whole = base.vector(expected.poles, expected.b)
        assert np.allclose(second.coefficients, whole, rtol=1e-6, atol=1e-7 * np.abs(whole).max())
        assert second.condition == pytest.approx(expected.condition, rel=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_scores_are_derivatives_of_the_cost(name: str) -> None:
    records, structure = CASES[name]
    question = Question.of(records, structure)
    problem = question.variants[-1].problem(question.base)
    n = problem.n_poles
    poles = -np.linspace(0.7, 3.0, n).astype(np.complex128)
    point = evaluate(problem, poles)
    slopes = 2.0 * point._scores[1] @ point._scores[0]
    for k in range(n):
        branch = next(one for one in point.branches if one.poles.start <= k < one.poles.stop)
        # a real pole z moves by -(l B) (alpha r): taken from the roots of a (1 + alpha X)
        step, costs = 1e-5, []
        for sign in (1.0, -1.0):
            row = np.zeros(branch.inner.order)
            row[k - branch.poles.start] = sign * step
            moved = poles.copy()
            eigen = np.linalg.eigvals(branch.inner.a - np.outer(branch.inner.b, row))
            moved[branch.poles] = np.sort(eigen.real)[::-1]
            costs.append(evaluate(problem, moved).objective)
        slope = (costs[0] - costs[1]) / (2 * step)
        assert slope == pytest.approx(slopes[k], rel=1e-4, abs=1e-5)


def test_decomposition_of_scores() -> None:
    rng = np.random.default_rng(3)
    scores, residual = rng.standard_normal((20, 3)), rng.standard_normal(20)
    s, vt, scale, projection, total = decomposed(scores, residual)
    step = (vt.T @ (projection / s)) / scale
    assert np.allclose(step, np.linalg.lstsq(scores, residual, rcond=None)[0])
    assert total == pytest.approx(np.linalg.norm(residual))
