"""Long records: when the first end leaves no doubt, and what it says of the poles."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.setup.nuisance import build_base, candidates
from tridentify.estimation.methods.around_maximum.noise import PASSED
from tridentify.estimation.search.following import CERTAIN
from tridentify.estimation.search.found import Starts
from tridentify.estimation.search.search import RecordSearch
from tridentify.estimation.search.stand_ins import LARGE_RECORD, free_variant, window
from tridentify.estimation.search.starts import best_laguerre, laguerre_starts
from tridentify.numerics.converter import FEW_VALUES, quantum

pytestmark = pytest.mark.unjudged

DT = 0.1
PAIR = TransferFunction([3.0], [1.0, 1.0, 3.0])
TOLD = Structure(2, 0, offset=False, initial_state="rest")


def noisy(model, seed, n=4 * LARGE_RECORD, noise=0.3):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 5), 5)
    y = simulate(model, Record(u, u, dt=DT))[:, 0]
    return Record(u, y + noise * y.std() * rng.standard_normal(u.size), dt=DT)


def searched(record, structure):
    base, variants = build_base([record], structure, candidates([record], structure))
    search = RecordSearch(4)
    search.run(base, variants)
    return search, base, variants


def test_one_start_is_enough_where_all_is_certain_and_white():
    search, *_ = searched(noisy(PAIR, 0), TOLD)
    assert len(search.starts) == 1
    assert search.end.point.looseness < CERTAIN
    assert Starts((), (), (), 1, search.known).saw_white(search.end.point)


def test_a_superfluous_pole_makes_the_search_look_on():
    search, *_ = searched(noisy(PAIR, 0), Structure(3, 1, offset=False, initial_state="rest"))
    assert len(search.starts) > 1


def test_the_end_is_that_of_the_output_error_from_the_truth():
    record = noisy(PAIR, 1)
    found = identify(record, TOLD)
    search, base, variants = searched(record, TOLD)
    near = evaluate(variants[0].problem(base), search.seeds[0])
    assert found.cost == pytest.approx(near.rss[0] / near.counts[0], rel=1e-9)
    assert PASSED in found.trace.decisions
    assert np.all(np.abs(found.theta - [1.0, 3.0, 3.0]) < 5.0 * found.std)


@pytest.mark.slow
def test_coloured_noise_is_still_seen():
    record = noisy(PAIR, 2, noise=0.0)
    e = np.random.default_rng(3).standard_normal(record.n_samples)
    v = np.convolve(e, 0.8 ** np.arange(40))[: e.size]
    found = identify(Record(record.u, record.y + 0.1 * v[:, None], dt=DT), TOLD, ThreeModel())
    assert found.noise_model[0].size > 0


@pytest.mark.slow
def test_looseness_is_the_spread_of_the_poles_over_noise_draws():
    base = build_base([noisy(PAIR, 0)], TOLD, candidates([noisy(PAIR, 0)], TOLD))[0]
    told = evaluate(base, np.roots([1.0, 1.0, 3.0]).astype(complex)).looseness
    poles = []
    for seed in range(40):
        a = identify(noisy(PAIR, 100 + seed, 2 * LARGE_RECORD), TOLD).model.den[0][0]
        poles.append(np.roots(a)[0])
    # half the samples
    spread = np.sqrt(np.mean(np.abs(np.array(poles) - np.roots([1, 1, 3])[0]) ** 2)) / 0.5
    assert told * np.sqrt(2.0) == pytest.approx(spread, rel=0.35)


def test_half_the_grid_finds_the_best_laguerre_model():
    for seed in range(5):
        record = noisy(PAIR, seed)
        base, _ = build_base([record], TOLD, candidates([record], TOLD))
        piece = window(base)
        every = laguerre_starts(piece, [free_variant(piece)])
        found = best_laguerre(piece, free_variant(piece))
        assert found.criterion == pytest.approx(every[0].criterion, abs=5.0)


@pytest.mark.parametrize("step", [0.0, 1e-3, 0.05])
def test_many_values_have_the_step_that_they_have(step):
    values = np.random.default_rng(0).standard_normal(3 * FEW_VALUES)
    values = np.round(values / step) * step if step else values
    assert quantum(values) == pytest.approx(step, rel=1e-6)
