"""Places for one pole or pair: their cost is the output error's, and the way out is among them."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, simulate
from tridentify.estimation.likelihood.cost import evaluate_variant
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import Recorder, finish
from tridentify.estimation.likelihood.setup.nuisance import build_base, candidates
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.estimation.search import following
from tridentify.estimation.search.band import rate_limits
from tridentify.estimation.search.one_mode_moved import FARTHER, moved_poles, place_costs
from tridentify.estimation.search.search import RecordSearch
from tridentify.estimation.search.starts import enriched_starts
from tridentify.models.regression import Experiment
from tridentify.numerics.realization import sort_poles

DT = 0.05
AR1 = np.array([-0.6])


def made(n_samples, n_inputs, n_outputs, *, seed=0, dt=DT, missing=0, noise=(), **terms):
    """An experiment of integrated noise."""
    rng = np.random.default_rng(seed)
    u = np.ascontiguousarray(rng.standard_normal((n_samples, n_inputs)).cumsum(axis=0))
    y = rng.standard_normal((n_samples, n_outputs)).cumsum(axis=0)
    y[rng.choice(n_samples, missing, replace=False), 0] = np.nan
    chosen = {"intersample": "zoh", "free": False, "offset": False, "drift": False} | terms
    return Experiment(u, y, dt, noise=noise, **chosen)


def kept_terms(base, **changes):
    """The nuisance terms of the base, or fewer."""
    e = base.experiments[0]
    none = (None,) * len(base.experiments)
    values = {"free": e.free, "offset": e.offset, "drift": e.drift, "constants": none} | changes
    return Variant(**values)


ALL = {"free": True, "offset": True, "drift": True}
CONSTANTS = (np.array([0.4, -0.7]),)
CASES = {
    "one channel": ([made(80, 1, 1)], ((0,),), {}),
    "zero": ([made(80, 1, 1)], ((2,),), {}),
    "direct": ([made(80, 1, 1)], ((3,),), {}),
    "linear input": ([made(80, 1, 1, intersample="foh")], ((1,),), {}),
    "two by two": ([made(90, 2, 2)], ((1, 2), (0, 3)), {}),
    "nuisance": ([made(90, 2, 2, **ALL)], ((1, 2), (0, 3)), {}),
    "some of them": ([made(90, 1, 2, **ALL)], ((1,), (0,)), {"free": False, "drift": False}),
    "free only": ([made(90, 1, 1, **ALL)], ((1,),), {"offset": False, "drift": False}),
    "equilibrium": (
        [made(90, 2, 1, **ALL)],
        ((1, 0),),
        {"free": False, "drift": False, "constants": CONSTANTS},
    ),
    "missing": ([made(90, 1, 2, missing=8, offset=True)], ((1,), (0,)), {}),
    "coloured": ([made(90, 1, 1, noise=(AR1,), offset=True)], ((1,),), {}),
    "two experiments": (
        [made(60, 1, 2, **ALL), made(90, 1, 2, seed=4, dt=2.0 * DT, **ALL)],
        ((1,), (0,)),
        {"drift": False},
    ),
}
every_case = pytest.mark.parametrize("name", CASES)
POLES = {
    "complex": np.array([-0.4 + 1.5j, -0.4 - 1.5j, -3.0]),
    "real": np.array([-0.5, -1.7, -4.0], dtype=complex),
}


def case(name):
    experiments, zeros, changes = CASES[name]
    base = Problem.of(experiments, 3, zeros)
    return base, kept_terms(base, **changes)


def objective(base, variant, poles):
    return evaluate_variant(base, variant, sort_poles(poles)).objective


@every_case
@pytest.mark.parametrize("poles", POLES)
def test_costs_are_those_of_the_output_error(name, poles):
    base, variant = case(name)
    poles = POLES[poles]
    single = [np.array([-rate + 0j]) for rate in (0.3, 2.0, 9.0)]
    pairs = [rate * np.array([-0.1 + 1j, -0.1 - 1j]) for rate in (0.7, 8.0)]
    for group, places in (([2], single), ([0, 1], pairs)):
        kept = np.delete(poles, group)
        expected = [objective(base, variant, np.concatenate([kept, one])) for one in places]
        found = place_costs(base, variant, kept, places)
        assert found == pytest.approx(np.array(expected), abs=1e-6)


@every_case
@pytest.mark.parametrize("poles", POLES)
def test_moves_are_sorted_admissible_and_leave_the_others(name, poles):
    base, variant = case(name)
    poles = POLES[poles]
    moves = moved_poles(base, variant, poles)
    assert moves
    costs = [move.objective for move in moves]
    assert costs == sorted(costs)
    for move in moves[:6]:
        assert move.place.size == move.before.size
        assert np.all(np.isin(move.before, poles))
        stay = poles[~np.isin(poles, move.before)]
        assert move.objective == pytest.approx(
            objective(base, variant, np.concatenate([stay, move.place])), abs=1e-6
        )
        assert move.poles == pytest.approx(
            base.admissible(sort_poles(np.concatenate([stay, move.place])))[0]
        )
        assert np.all(move.poles.real < 0.0)


def test_places_span_the_band_at_every_damping():
    base, variant = case("one channel")
    kept = POLES["complex"]
    low, high = rate_limits(base)
    seen = [move.place for move in moved_poles(base, variant, kept)]
    sizes = np.abs(np.concatenate(seen))
    assert np.all((sizes > 0.99 * low) & (sizes < 1.01 * FARTHER * high))
    pairs = np.array([place[0] for place in seen if place.size == 2])
    assert set(np.round(-pairs.real / np.abs(pairs), 9)) == {0.1, 0.5}


@pytest.mark.parametrize(
    ("poles", "expected"),
    [
        ([-1.0], {(-1.0,)}),
        ([-1.0 + 2j, -1.0 - 2j], {(-1.0 + 2j, -1.0 - 2j)}),
        ([-1.0, -2.0], {(-1.0, -2.0), (-1.0,), (-2.0,)}),
        (
            [-1.0, -2.0, -5.0],
            {(-1.0, -2.0), (-2.0, -5.0), (-1.0, -5.0), (-1.0,), (-2.0,), (-5.0,)},
        ),
        ([-1.0 + 2j, -1.0 - 2j, -4.0], {(-1.0 + 2j, -1.0 - 2j), (-4.0,)}),
    ],
)
def test_what_moves(poles, expected):
    """Every line has a lowest place, so every group shows."""
    base = Problem.of([made(80, 1, 1)], len(poles), ((0,),))
    moves = moved_poles(base, kept_terms(base), np.array(poles, dtype=complex))
    assert {tuple(move.before.tolist()) for move in moves} == expected


@pytest.mark.parametrize("factor", [1e6, 1e-6])
def test_another_unit_of_time_moves_to_the_same_places(factor):
    base, variant = case("nuisance")
    slow = Problem.of([made(90, 2, 2, dt=DT * factor, **ALL)], 3, base.n_zeros)
    before = moved_poles(base, variant, POLES["complex"])
    after = moved_poles(slow, variant, POLES["complex"] / factor)
    assert len(before) == len(after)
    for one, other in zip(before[:5], after[:5], strict=True):
        assert other.objective == pytest.approx(one.objective, abs=1e-6)
        assert other.place * factor == pytest.approx(one.place, rel=1e-9)


# --------------------------------------------------------------------------------- the way out
STRONG = np.array([-0.3 + 0.95j, -0.3 - 0.95j])
WEAK = np.array([-0.1 + 7.0j, -0.1 - 7.0j])
TRUE = np.concatenate([STRONG, WEAK])


def weak_resonance(outputs, nuisance):
    """A slow mode in all outputs, and in the first one a light resonance in noise of 10 %."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal((50, 1)), 8, axis=0)
    den, slow, fast = (np.poly(poles).real for poles in (TRUE, STRONG, WEAK))
    first = np.polyadd(fast / fast[-1], 0.03 * np.polymul([1.0, 0.0], slow))
    nums = [[first.tolist()], [(0.5 * fast / fast[-1]).tolist()]][:outputs]
    y = simulate(TransferFunction(nums, [[den.tolist()]] * outputs), Record(u, u, dt=DT))
    y = y + 0.1 * np.std(y, axis=0) * rng.standard_normal(y.shape) + 0.5 * nuisance
    e = Experiment(u, y, DT, "zoh", nuisance, nuisance, False)
    return Problem.of([e], 4, ((3,), (2,))[:outputs])


def settler(base):
    """The cost's local minimum from given poles."""
    variant = kept_terms(base)

    def at(poles):
        return evaluate_variant(base, variant, poles)

    return lambda poles: finish(at, at(poles), Recorder(), 60)[0]


@pytest.mark.parametrize("outputs", [1, 2])
@pytest.mark.parametrize("nuisance", [False, True])
@pytest.mark.fast("True-1", "False-2")
def test_a_misspent_pair_finds_the_weak_resonance(outputs, nuisance):
    base = weak_resonance(outputs, nuisance)
    settled = settler(base)
    truth = settled(TRUE)
    elsewhere = [rate * np.array([-0.02 + 1j, -0.02 - 1j]) for rate in (0.2, 0.5, 40.0)]
    ends = [settled(sort_poles(np.concatenate([STRONG, pair]))) for pair in elsewhere]
    stuck = [end for end in ends if end.objective > truth.objective + 100.0]
    assert stuck, "the example has lost its local minima"
    for end in stuck:
        best = moved_poles(base, kept_terms(base), end.poles)[0]
        assert best.objective < end.objective - 20.0
        assert 0.6 < abs(best.place[0]) / abs(WEAK[0]) < 1.6
        out = settled(best.poles)
        assert out.objective == pytest.approx(truth.objective, abs=1e-3)
        assert out.poles == pytest.approx(TRUE, rel=0.1)


def test_at_the_right_end_no_place_is_better():
    base = weak_resonance(1, False)
    end = settler(base)(TRUE)
    assert moved_poles(base, kept_terms(base), end.poles)[0].objective > end.objective


def too_low(seed):
    """A record of two or three poles, for a model of one."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(60), 5)
    slow, fast = -np.exp(rng.uniform(-1.0, 0.0)), -np.exp(rng.uniform(0.5, 1.5))
    plants = ([slow, fast], [slow, fast, 2.0 * fast], [fast * (0.4 + 0.9j), fast * (0.4 - 0.9j)])
    den = np.real(np.poly(plants[seed % 3]))
    y = simulate(TransferFunction([den[-1]], den), Record(u, u, dt=DT))[:, 0]
    return Record(u, y + 0.05 * y.std() * rng.standard_normal(u.size), dt=DT)


@pytest.mark.parametrize("seed", range(6))
def test_one_pole_ends_where_no_other_place_of_the_band_is_lower(seed):
    record, structure = too_low(seed), Structure(1, 0, offset=False, initial_state="rest")
    base, variants = build_base([record], structure, candidates([record], structure))
    worker = RecordSearch(4)
    worker.run(base, variants)
    end = evaluate_variant(base, variants[0], worker.seeds[-1]).objective
    places = -np.geomspace(*rate_limits(base), 300).astype(complex)
    others = [evaluate_variant(base, variants[0], place[None]).objective for place in places]
    assert end <= min(others) + 1e-3


@pytest.mark.parametrize("orders", [(2, 0), (3, 0), (4, 0)])
def test_no_place_is_asked_twice_what_it_misses(orders, monkeypatch):
    asked: list[tuple[int, bytes]] = []

    def told(base, variant, poles):
        asked.append((id(variant), poles.tobytes()))
        return enriched_starts(base, variant, poles)

    monkeypatch.setattr(following, "enriched_starts", told)
    record = Record(too_low(2).u, too_low(1).y, dt=DT)  # no model of any order explains it
    structure = Structure(*orders, offset=False, initial_state="rest")
    RecordSearch(4).run(*build_base([record], structure, candidates([record], structure)))
    assert len(asked) == len(set(asked)) > 0
