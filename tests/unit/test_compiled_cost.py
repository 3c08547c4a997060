"""Machine code beside the functions whose derivation it follows, and beside dense solutions."""

import numpy as np
import pytest

from tridentify import Record, Structure
from tridentify.estimation.likelihood.compiled_cost import decomposed
from tridentify.estimation.likelihood.cost import evaluate, evaluate_variant
from tridentify.estimation.likelihood.linear_columns import linear_blocks
from tridentify.estimation.likelihood.question import Question
from tridentify.models.response import ColumnBlocks
from tridentify.numerics.kernels.cascades import bank_parts, solve_in_place
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
def test_a_bank_is_the_cascade_its_basis_and_its_map(name: str, repeats: int) -> None:
    poles = np.array(POLES[name], dtype=np.complex128)
    n = poles.size
    a, b, rows, leading, maps = bank_parts(poles, np.array([n]), repeats, n)
    bank, inner = cascade(np.tile(poles, repeats)), cascade(poles)
    basis = degree_basis(inner)
    assert np.allclose(a, bank.a, rtol=1e-13, atol=0.0)
    assert np.allclose(b, bank.b, rtol=1e-14)
    assert np.allclose(rows, basis.rows, atol=1e-12)
    assert np.allclose(leading, basis.leading, rtol=1e-12)
    found = maps.reshape(bank.order, n, bank.order)
    assert np.allclose(found, filter_map(inner, bank), atol=1e-12)


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
