"""Order selection: the table, the recommendation with its reason, what fails as a row."""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tridentify import (
    OutputError,
    Record,
    Selection,
    Structure,
    SvfLeastSquares,
    ThreeModel,
    TransferFunction,
    identify,
    select_structure,
    simulate,
)
from tridentify.errors import CandidateError, DataError, OptionError
from tridentify.judgement.selection import SelectionRow, default_candidates
from tridentify.judgement.selection.held_out import (
    HeldEstimate,
    cross_fit,
    directions,
    fold_numbers,
    folds,
    most_held,
)

pytestmark = pytest.mark.unjudged

PLANT = TransferFunction([2.0, 3.0], [1.0, 2.0, 9.0])


def at_rest(n, m):
    return Structure(n, m, offset=False, initial_state="rest")


CANDIDATES = [at_rest(1, 0), at_rest(2, 0), at_rest(2, 1), at_rest(3, 2)]


def made(plant=PLANT, n=300, level=0.05, seed=0, dt=0.05):
    """A record of a plant, driven by random steps, with white noise."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], (n // 6 + 1, plant.n_inputs)), 6, axis=0)[:n]
    y = simulate(plant, Record(u, np.zeros((n, plant.n_outputs)), dt=dt))
    y = y + level * np.std(y, axis=0) * rng.standard_normal(y.shape)
    return Record(u, y, dt=dt)


@pytest.fixture(scope="module")
def record():
    return made()


@pytest.fixture(scope="module")
def selection(record):
    return select_structure(record, CANDIDATES)


@pytest.mark.slow
def test_the_true_order_is_recommended_with_reasons(selection):
    assert selection.recommended is selection.rows[2]
    assert "2 poles and 1 zero" in selection.reason
    assert "too few" in selection.reason
    assert [row.structure for row in selection.rows] == CANDIDATES


def test_every_row_is_what_identify_gives_for_it_alone_to_the_last_bit(record, selection):
    for row in selection.rows[1:3]:
        alone = identify(record, row.structure)
        assert row.identified
        assert np.array_equal(row.estimate.theta, alone.theta)
        assert np.array_equal(row.estimate.cov, alone.cov)
        assert np.array_equal(row.fit, alone.fit)
    assert row is selection.recommended
    assert row.estimate.findings == alone.findings


@pytest.mark.slow
def test_a_row_does_not_change_with_the_company_it_keeps(record, selection):
    alone = select_structure(record, CANDIDATES[1:2]).rows[0]
    row = selection.rows[1]
    assert np.array_equal(row.fit, alone.fit)
    assert np.array_equal(row.cross_fit, alone.cross_fit)
    assert row.doubts == alone.doubts
    assert row.n_coefficients == alone.n_coefficients == 3


def test_the_first_block_left_out_with_a_free_initial_state_stays_readable():
    clean = made(TransferFunction([400.0], [1.0, 42.0, 80.0]), level=0.02, seed=4)
    structure = Structure(2, 0, offset=True, initial_state="free")
    (row,) = select_structure(clean, [structure]).rows
    assert row.cross_fit[0] == pytest.approx(row.fit[0], abs=1.0)


def test_numbers_that_say_nothing_are_words(double):
    rows = [
        SelectionRow(
            Structure(2, 1), double.estimate, fit=np.array([90.0]), cross_fit=np.array([value]),
            held_out_reason=reason, relative_std=0.1, identified=True,
        )
        for value, reason in ((-3e12, ""), (-np.inf, ""), (np.nan, "fewer than 40 samples"))
    ]  # fmt: skip
    cells = Selection(tuple(rows), None, "").table()
    assert [row[4] for row in cells] == ["< -100", "unstable", ""]
    assert cells[2][-1] == "held-out: fewer than 40 samples"


@pytest.mark.unjudged
def test_a_superfluous_pole_finds_a_place_that_is_as_good(record, selection):
    row = selection.rows[3]
    alone = identify(record, row.estimate.structure, ThreeModel(noise="white"))
    assert abs(row.aicc - alone.aicc) < 1.0
    assert row.deviance < selection.rows[2].deviance


def test_criteria_are_those_of_the_residual(record, selection):
    row = selection.rows[1]
    residual = row.estimate.residual(record)[:, 0]
    n, k = residual.size, row.n_unknowns
    deviance = n * math.log(residual @ residual / n)
    assert row.aic == pytest.approx(deviance + 2 * k)
    assert row.aicc == pytest.approx(deviance + 2 * k + 2 * k * (k + 1) / (n - k - 1))
    assert row.bic == pytest.approx(deviance + k * math.log(n))
    assert row.aicc == pytest.approx(row.estimate.aicc)
    relative = row.estimate.std / row.estimate.theta
    share = row.estimate.noise_variance[0] / np.var(record.y)
    assert row.yic == pytest.approx(math.log(share) + math.log(np.mean(relative**2)), rel=1e-5)
    assert row.relative_std == pytest.approx(np.max(np.abs(relative)))


def test_the_fit_on_blocks_left_out_is_a_fit_without_them(record, selection):
    row = selection.rows[2]
    number = fold_numbers(row.estimate, [record])[0]
    assert np.array_equal(number, folds(np.ones(record.n_samples)))
    error = np.zeros(record.n_samples)
    for fold in range(5):
        fit = OutputError(row.estimate.model)
        kept = fit.estimate([record.mask(number == fold)], row.estimate.structure)
        error[number == fold] = kept.residual(record)[number == fold, 0]
    wanted = 100 * (1 - np.linalg.norm(error) / np.linalg.norm(record.y - record.y.mean()))
    assert row.cross_fit[0] == pytest.approx(wanted, abs=1e-4)
    assert row.cross_fit[0] < row.fit[0]


@pytest.mark.parametrize("seed", [1, 3])
def test_a_single_short_transient_is_never_left_out_as_a_whole(seed):
    # all that is to be learnt happens within a twentieth of the record
    rng = np.random.default_rng(seed)
    u = np.where(np.arange(1000) < 510, 0.0, 1.0)
    y = simulate(TransferFunction([3.0, 9.0], [1.0, 2.2, 9.0]), Record(u, u, dt=0.1))[:, 0]
    step = Record(u, y + 0.3 * np.std(y) * rng.standard_normal(1000), dt=0.1)
    estimate = identify(step, at_rest(2, 1))
    held = cross_fit(HeldEstimate(estimate, (step,), ()))
    assert held.fit[0] == pytest.approx(estimate.fit[0], abs=0.5)


def test_information_is_that_of_the_coefficients(record):
    estimate = identify(record, at_rest(2, 1))
    (found,) = directions(estimate, [record])
    assert found.shape == (300, 1, 4)
    g = found[:, 0]
    assert np.allclose(g.T @ g, np.eye(4))
    parts = directions(estimate, [record, record])
    assert np.allclose(parts[0], parts[1])
    assert np.allclose(np.sum(parts[0] ** 2, axis=(1, 2)), np.sum(g**2, axis=1) / 2)
    # all of it in one fold, none of it there, and a half
    assert most_held([found], [np.zeros(300, dtype=int)]) == pytest.approx(1.0)
    assert most_held(parts, [np.zeros(300, dtype=int), np.ones(300, dtype=int)]) == pytest.approx(
        0.5
    )


def test_a_free_initial_state_is_no_coefficient():
    made_free = made(n=200)
    estimate = identify(made_free, Structure(2, 1, offset=True, initial_state="free"))
    (found,) = directions(estimate, [made_free])
    assert found.shape == (200, 1, 4)
    # what offset and initial state explain is taken away
    assert np.allclose(found[:, 0].sum(axis=0), 0.0, atol=1e-8)


def test_without_information_blocks_are_of_equal_length(record):
    estimate = identify(record, at_rest(2, 1))
    nothing = Record(np.zeros(60), np.zeros(60), dt=record.dt)
    assert directions(estimate, [nothing])[0].shape == (60, 1, 0)
    assert np.array_equal(fold_numbers(estimate, [nothing])[0], folds(np.ones(60)))


def test_an_input_that_was_left_open_costs_no_second_search(record, monkeypatch):
    asked = []
    whole = ThreeModel.estimate

    def estimate(self, records, structure, progress=None, **options):
        asked.append((structure, records[0].behaviour))
        return whole(self, records, structure, progress, **options)

    monkeypatch.setattr(ThreeModel, "estimate", estimate)
    left_open = Record(record.u, record.y, dt=record.dt, intersample="auto")
    found = select_structure(left_open, CANDIDATES[1:3])
    assert all(row.estimate is not None for row in found.rows)
    assert len(asked) == len(set(asked))
    assert len(asked) >= 2


@pytest.mark.unjudged
def test_a_second_record_judges_with_a_start_of_its_own(record):
    other = made(seed=7)
    lifted = Record(other.u[40:], other.y[40:] + 5.0, dt=other.dt)
    found = select_structure(record, [Structure(2, 1), Structure(1, 0)], validation=lifted)
    good, poor = (row.cross_fit[0] for row in found.rows)
    assert good == pytest.approx(95.0, abs=1.5)
    assert poor < 70.0


@pytest.mark.slow
def test_an_executor_changes_nothing(record):
    plain = select_structure(record, CANDIDATES[1:3])
    with ThreadPoolExecutor(2) as pool:
        again = select_structure(record, CANDIDATES[1:3], executor=pool)
    first, second = (json.dumps(one.to_dict()) for one in (plain, again))
    assert first == second


def test_a_failure_is_a_row_with_its_reason():
    clean = made(n=200, level=0.0)
    found = select_structure(clean, [Structure(2, 1), Structure(4, 3), Structure(9, 8)])
    assert found.recommended.structure == Structure(2, 1)
    assert found.recommended.estimate.parameters["a0"].value == pytest.approx(9.0, rel=1e-6)
    failed = found.rows[-1]
    assert failed.estimate is None
    assert "9 poles" in failed.reason
    assert math.isnan(failed.aicc)
    assert "failed" in found.summary()


def test_where_all_fail_nothing_is_recommended():
    still = Record(np.ones(50), np.ones(50), dt=0.1)
    found = select_structure(still, [Structure(1, 0), Structure(2, 0)])
    assert found.recommended is None
    assert "constant throughout" in found.reason
    assert found.hankel is None
    assert "recommended poles, zeros: none" in found.summary()


@pytest.mark.unjudged
@pytest.mark.slow
def test_several_channels_and_experiments_share_the_denominator():
    plant = TransferFunction(
        [[[2.0], [1.0]], [[1.0, 0.0], [3.0]]], [[[1.0, 2.0, 9.0]] * 2, [[1.0, 2.0, 9.0]] * 2]
    )
    records = [made(plant, n=250, seed=k, level=0.1) for k in (1, 2)]
    wanted = Structure(2, [[0, 0], [1, 0]])
    found = select_structure(records, [Structure(2, 0), wanted, Structure(3, 2)])
    assert found.recommended.structure == wanted
    assert found.recommended.fit.shape == (2,)
    assert found.hankel.order == 2


@pytest.mark.unjudged
@pytest.mark.slow
def test_coloured_noise_is_no_reason_for_more_poles():
    clean = made(n=300, level=0.0)
    e = np.random.default_rng(5).standard_normal(300)
    for k in range(1, 300):
        e[k] += 0.9 * e[k - 1]
    noisy = Record(clean.u, clean.y[:, 0] + 0.05 * e, dt=clean.dt)
    found = select_structure(noisy, CANDIDATES[1:])
    assert found.recommended.label == "2, 1"
    assert any("coloured" in note for note in found.notes)
    # besides coefficients and variance all rows have as many unknowns, those of the noise
    sizes = {row.n_unknowns - len(row.estimate.names) - 1 for row in found.rows}
    assert len(sizes) == 1
    assert sizes.pop() >= 1


@pytest.mark.unjudged
@pytest.mark.slow
def test_offset_and_start_are_the_same_for_all_candidates():
    record = made(seed=3)
    lifted = Record(record.u, record.y + 4.0, dt=record.dt)
    found = select_structure(lifted, [Structure(2, 0), Structure(2, 1)])
    assert found.recommended.structure == Structure(2, 1)
    # coefficients, variance, offset
    assert [row.n_unknowns - len(row.estimate.names) for row in found.rows] == [2, 2]


@pytest.mark.slow
def test_other_methods_and_unknown_delays_stand_in_the_table_too(record):
    plain = select_structure(record, [Structure(2, 1), Structure(1, 0)], method=SvfLeastSquares())
    assert plain.rows[0].estimate.method == "SvfLeastSquares"
    known = Structure(2, 1, fixed={"a0": 9.0})
    found = select_structure(record, [Structure(2, 1), known])
    assert found.rows[1].n_unknowns == found.rows[0].n_unknowns - 1
    assert found.recommended is found.rows[1]


@pytest.mark.unjudged
@pytest.mark.slow
def test_a_delay_is_found_instead_of_poles():
    late = TransferFunction([9.0], [1.0, 3.0, 9.0], delay=0.2)
    record = made(late, n=240)
    wanted = Structure(2, 0, delay="free")
    found = select_structure(record, [Structure(2, 0), Structure(3, 1), wanted])
    assert found.recommended.structure == wanted
    assert "free delay" in found.reason


def test_the_default_table_takes_all_but_the_orders_from_the_template(record):
    template = Structure(1, 0, offset=True, initial_state="free", delay=0.05)
    found = default_candidates([record], template)
    assert len(found) == 10
    assert {(s.offset, s.initial_state, s.delay) for s in found} == {(True, "free", 0.05)}
    assert max(s.poles for s in default_candidates([made(n=39)])) == 2


def test_the_answer_is_told_in_several_ways(tmp_path, selection):
    assert isinstance(selection, Selection)
    text = selection.summary()
    assert "->" in text
    assert all(row.label in text for row in selection.rows)
    assert selection._repr_html_().count("<tr>") == len(selection.rows) + 1
    document = json.loads(selection.save(tmp_path / "selection.json").read_text("utf-8"))
    assert document["recommended"] == 2
    assert document["rows"][2]["coefficients"]["a0"]["value"] == pytest.approx(9.0, rel=0.1)
    assert "recommended poles, zeros = 2, 1" in repr(selection)


@pytest.mark.parametrize(
    ("candidates", "found"),
    [([], "no candidate"), ([Structure(1, 0), "2"], "'2'"), (3, "candidates=3")],
)
def test_candidates_that_are_none(record, candidates, found):
    with pytest.raises(CandidateError, match=f"found .*{found}.*expected"):
        select_structure(record, candidates)


def test_other_bad_input_is_one_line(record):
    with pytest.raises(DataError, match="found no record"):
        select_structure([])
    with pytest.raises(CandidateError, match="knowledge of coefficients"):
        select_structure(record, template=Structure(1, 0, fixed={"a0": 1.0}))
    with pytest.raises(OptionError, match="template"):
        select_structure(record, template=2)
    with pytest.raises(OptionError, match="method"):
        select_structure(record, method="three-model")
    wide = Record(np.ones((50, 2)), np.arange(50.0), dt=0.1)
    with pytest.raises(DataError, match="validation record with 2 inputs"):
        select_structure(record, validation=wide)


def test_a_row_without_an_estimate_has_no_numbers():
    row = SelectionRow(Structure(2, 1), None, "found nothing; expected more; do it")
    assert row.status == "found nothing; expected more; do it"
    assert row.label == "2, 1"
    assert not row.ok
