"""Every row of a selection is what `identify` gives, whatever else stands in the table."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify import select_structure as select
from tridentify.judgement.selection import default_candidates

pytestmark = pytest.mark.unjudged

PLANT = TransferFunction([2.0, 3.0], [1.0, 2.0, 9.0])
RIGHT, LARGE = (Structure(n, m, offset=False, initial_state="rest") for n, m in ((2, 1), (3, 2)))


def made(seed, n=300, level=0.05):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 6), 6)
    y = simulate(PLANT, Record(u, u, dt=0.05))
    return Record(u, y + level * np.std(y) * rng.standard_normal(y.shape), dt=0.05)


@pytest.fixture(scope="module")
def record():
    return made(71)


def assert_same(row, estimate, fit):
    scale = np.maximum(np.abs(estimate.theta), np.asarray(estimate.std))
    assert np.all(np.abs(row.estimate.theta - estimate.theta) <= 1e-9 * scale)
    assert row.estimate.status is estimate.status
    assert row.fit == pytest.approx(fit, abs=1e-9)


@pytest.mark.slow
def test_a_needless_pole_and_zero_are_what_identify_gives_in_any_company(record):
    alone = identify(record, LARGE)
    rows = [
        next(row for row in select(record, company).rows if row.structure is LARGE)
        for company in ([LARGE], [RIGHT, LARGE])
    ]
    for row in rows:
        assert row.identified
        assert_same(row, alone, alone.fit)
        assert np.array_equal(row.estimate.cov, alone.cov)
    assert np.array_equal(rows[0].cross_fit, rows[1].cross_fit)
    assert rows[0].estimate.trace.decisions[:2] == rows[1].estimate.trace.decisions[:2]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "n", "level"), [(1, 300, 0.05), (2, 200, 0.3), (3, 600, 0.02)])
def test_each_of_ten_rows_is_what_identify_gives_in_any_company(seed, n, level):
    one = made(seed, n, level)
    assert_ten_are_their_own(one, default_candidates([one]), seed)


def assert_ten_are_their_own(record, structures, seed):
    """Each of the rows as `identify` gives it, and as in a table with one or two others."""
    table = select(record, structures, integrators=False, delays=False)
    rows = {row.structure: row for row in table.rows if row.structure in structures}
    for structure, row in rows.items():
        if row.estimate is not None:
            alone = identify(record, structure, throw=False)
            assert_same(row, alone, alone.fit)
    rng = np.random.default_rng(seed)
    for count in (2, 3):
        picked = [structures[k] for k in rng.permutation(len(structures))[:count]]
        fewer = select(record, picked, integrators=False, delays=False)
        for few in fewer.rows:
            row = rows[few.structure]
            if row.estimate is not None:
                assert_same(few, row.estimate, row.fit)
                assert few.cross_fit == pytest.approx(row.cross_fit, abs=1e-9)


def test_a_row_that_cannot_be_recommended_may_be_left_at_the_maximum(record):
    found = select(record, [RIGHT, LARGE], finish=False)
    best, beside = found.rows
    assert found.recommended is best
    assert best.identified
    # a posterior mean is looked for where it may decide; the maximum is known before
    reached = ThreeModel(finish="likelihood").estimate([record], LARGE)
    assert not beside.identified
    assert_same(beside, reached, reached.fit)
    assert "not finished" in found.summary()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_orders_beyond_those_that_explain_no_more_begin_from_the_shared_starts_alone(seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 5)
    y = simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=0.05))
    record = Record(u, y + 0.03 * rng.standard_normal(y.shape), dt=0.05)
    structures = [Structure(n, n - 1, offset=False, initial_state="rest") for n in (1, 2, 3)]
    found = select(record, structures, finish=False)
    assert found.recommended is found.rows[0]
    assert found.rows[0].identified
    assert not found.rows[2].identified
    whole = ThreeModel(finish="likelihood").estimate([record], structures[2])
    # searched as a whole it would explain no more than candidates with needless poles do by luck
    fall = record.n_samples * np.log(found.rows[2].estimate.cost / whole.cost)
    assert fall < 4.0 * np.log(record.n_samples)


def test_poles_that_are_known_need_no_search(record):
    method = ThreeModel(noise="white")
    searched = method.estimate([record], RIGHT)
    poles = np.roots(searched.model.den[0][0]).astype(complex)
    near = method.estimate([record], RIGHT, near=poles * 1.05)
    assert len(near.trace.starts) == 1
    assert near.theta == pytest.approx(searched.theta, abs=1e-3 * np.min(searched.std))
    assert near.std == pytest.approx(searched.std, rel=1e-3)
