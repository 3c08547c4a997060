"""Which nuisance terms are tried, and that every choice is fitted as if it were the only one."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, errors
from tridentify.estimation.likelihood.cost import evaluate, evaluate_variant
from tridentify.estimation.likelihood.setup.nuisance import (
    Nuisances,
    build,
    build_base,
    candidates,
    reference_of,
)

POLES = np.array([-0.5 + 1.5j, -0.5 - 1.5j])
REST, EQUILIBRIUM, FREE = "rest", "equilibrium", "free"


def record(n=80, *, trim=(0.5, -2.0), intersample="zoh", missing=0.0, seed=0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal((n, 2)), 3, axis=0)[:n]
    u[:3] = 0.0
    y = np.cumsum(rng.standard_normal((n, 2)), axis=0) + 5.0
    y[rng.random(y.shape) < missing] = np.nan
    return Record(u + np.array(trim), y, dt=0.1, intersample=intersample)


def choices(record, **options):
    found = candidates([record], Structure(2, 1, **options))
    return {(c.initial_state, c.offset, c.drift) for c in found}


def test_everything_open_gives_the_whole_list():
    expected = {(REST, False), (REST, True), (EQUILIBRIUM, True), (FREE, False), (FREE, True)}
    assert choices(record()) == {(*c, False) for c in expected}
    assert choices(record(), drift="auto") == {(*c, d) for c in expected for d in (False, True)}


def test_the_structure_narrows_the_list():
    assert choices(record(), offset=False, initial_state=REST) == {(REST, False, False)}
    assert choices(record(), offset=True, drift=True, initial_state=FREE) == {(FREE, True, True)}
    assert choices(record(), offset=False) == {(REST, False, False), (FREE, False, False)}
    assert choices(record(), initial_state=EQUILIBRIUM) == {(EQUILIBRIUM, True, False)}


def test_an_input_that_starts_at_zero_is_in_equilibrium_at_rest():
    found = choices(record(trim=(0.0, 0.0)))
    assert (EQUILIBRIUM, True, False) not in found
    assert (REST, True, False) in found


def test_the_leanest_choice_comes_first():
    structure = Structure(2, 1, drift="auto")
    counts = [c.count(2, 2, 1) for c in candidates([record()], structure)]
    assert counts == sorted(counts)


def test_unknowns_are_counted_per_output_and_experiment():
    assert Nuisances(FREE, True, True).count(3, 2, 4) == (3 + 1 + 1) * 2 * 4
    assert Nuisances(EQUILIBRIUM, True, False).count(3, 2, 4) == 8
    assert Nuisances(REST, False, False).count(3, 2, 4) == 0


def step(n=40):
    return Record(np.ones(n), np.linspace(0.0, 1.0, n), dt=0.1)


@pytest.mark.parametrize("state", [FREE, EQUILIBRIUM])
def test_a_constant_input_needs_a_start_at_rest(state):
    with pytest.raises(errors.ConstantInputError, match="initial_state='rest'"):
        candidates([step()], Structure(2, 0, initial_state=state))
    assert {c.initial_state for c in candidates([step()], Structure(2, 0))} == {REST}


def test_short_records_are_offered_only_what_they_can_pay_for():
    # 10 coefficients in 20 output samples: rest 10, offsets 12, a free state 14, with offsets 16
    structure = Structure(2, 1)
    assert len(candidates([record(10)], structure)) == 5
    found = candidates([record(8)], structure)  # 16 samples
    assert {c.initial_state for c in found} == {REST, EQUILIBRIUM}
    with pytest.raises(errors.TooFewSamplesError, match="12 output samples for 10 unknowns"):
        candidates([record(6)], structure)


def test_the_input_counts_from_its_first_value_where_that_is_absorbed():
    some = record()
    for nuisances, shifted in [
        (Nuisances(REST, True, False), False),
        (Nuisances(FREE, False, False), False),
        (Nuisances(FREE, True, False), True),
        (Nuisances(EQUILIBRIUM, True, False), True),
    ]:
        expected = some.u[0] if shifted else np.zeros(2)
        assert np.array_equal(reference_of(some, nuisances), expected)
        problem = build([some], Structure(2, 1), nuisances)
        assert np.array_equal(problem.experiments[0].u, some.u - expected)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("missing", [0.0, 0.2])
@pytest.mark.parametrize("zeros", [1, 2], ids=["strictly proper", "biproper"])
@pytest.mark.parametrize("options", [{}, {"initial_state": EQUILIBRIUM, "drift": "auto"}])
def test_every_choice_costs_what_it_would_cost_alone(intersample, missing, zeros, options):
    """One pass over the samples serves all choices; each must give its own residual."""
    records = [
        record(80 - 20 * k, intersample=intersample, missing=missing, seed=k) for k in (0, 1)
    ]
    structure = Structure(2, zeros, **options)
    offered = candidates(records, structure)
    base, variants = build_base(records, structure, offered)
    assert len(variants) == len(offered) > 1
    for choice, variant in zip(offered, variants, strict=True):
        found = evaluate_variant(base, variant, POLES)
        alone = evaluate(build(records, structure, choice), POLES)
        assert found.rss == pytest.approx(alone.rss, rel=1e-9), choice.label
        assert found.problem.n_nuisance == alone.problem.n_nuisance
        assert found.gradient == pytest.approx(alone.gradient, rel=1e-6), choice.label


def test_an_equilibrium_costs_the_same_where_a_free_state_cannot_be_paid_for():
    records, structure = [record(8)], Structure(2, 1)
    offered = candidates(records, structure)
    base, variants = build_base(records, structure, offered)
    for choice, variant in zip(offered, variants, strict=True):
        found = evaluate_variant(base, variant, POLES)
        alone = evaluate(build(records, structure, choice), POLES)
        assert found.rss == pytest.approx(alone.rss, rel=1e-9), choice.label


def test_experiments_are_made_once_for_a_record_and_again_for_another_question():
    one, other = record(), record()
    structure, rest = Structure(2, 1), Nuisances(REST, False, False)

    def seen(record, terms=rest, structure=structure, **how):
        return build([record], structure, terms, **how).experiments[0]

    first = seen(one)
    assert seen(one) is first
    assert seen(one, structure=Structure(3, 0)) is first
    assert seen(other) is not first
    assert seen(one, Nuisances(REST, True, False)).offset
    assert seen(one, Nuisances(FREE, True, False)).u[0].tolist() == [0.0, 0.0]
    assert seen(one, Nuisances(FREE, True, False), shift=False).u[0].tolist() == [0.5, -2.0]
    late = seen(one, structure=Structure(2, 1, delay=0.2))
    assert late.delays is not None
    assert seen(one, structure=Structure(2, 1, delay=0.3)).delays.max() == 0.3
