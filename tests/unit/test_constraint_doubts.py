"""Knowledge that a record contradicts is named; true knowledge is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import (
    OutputError,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)

MODEL = TransferFunction([1.5, 20.0], [1.0, 2.0, 16.0])
METHODS = [ThreeModel(), OutputError()]


def record_of(seed=3, level=0.05, n_holds=32, pole=0.0):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n_holds), 25)
    clean = simulate(MODEL, Record(u, u, dt=0.02))[:, 0]
    e = lfilter([1.0], [1.0, -pole], rng.standard_normal(u.size + 100))[100:]
    return Record(u, clean + level * clean.std() * e / e.std(), dt=0.02)


def doubts(estimate):
    return [line for line in estimate.cautions if "contradicts what is said" in line]


WRONG = [
    ({"priors": {"a1": (3.0, 0.01)}}, "prior a1 = 3 +/- 0.01 (free estimate a1 = "),
    ({"static_gain": 1.5}, "static gain = 1.5 (free estimate 1.2"),
    ({"fixed": {"a0": 12.0}}, "fixed a0 = 12 (free estimate a0 = 1"),
    ({"bounds": {"a0": (None, 12.0)}}, "bound a0 = 12 (free estimate a0 = 1"),
    ({"equalities": [({"b0": 1.0, "a0": -1.0}, 0.0)]}, "equality 1 b0 + -1 a0 = 0 (free"),
]


@pytest.mark.parametrize(("knowledge", "named"), WRONG)
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
@pytest.mark.fast(*(f"ThreeModel-knowledge{k}-*" for k in (1, 4)))
def test_wrong_knowledge_is_named_with_the_free_estimate(knowledge, named, method):
    said = doubts(identify(record_of(), Structure(2, 1, **knowledge), method))
    assert len(said) == 1
    assert named in said[0]


def test_only_the_wrong_piece_is_named():
    knowledge = {"fixed": {"a0": 16.0}, "priors": {"a1": (3.0, 0.01), "b1": (1.5, 0.1)}}
    (said,) = doubts(identify(record_of(), Structure(2, 1, **knowledge)))
    assert "prior a1" in said
    assert "fixed a0" not in said
    assert "prior b1" not in said


@pytest.mark.parametrize("pole", [0.0, 0.9])
@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
@pytest.mark.slow
def test_wrong_knowledge_is_named_in_coloured_noise(pole, method):
    structure = Structure(2, 1, fixed={"a0": 12.0})
    assert doubts(identify(record_of(pole=pole), structure, method, throw=False))


RIGHT = [
    {"fixed": {"a0": 16.0}},
    {"static_gain": 1.25},
    {"priors": {"a1": (2.0, 0.01), "b1": (1.4, 0.1)}},
    {"bounds": {"a0": (16.0, None), "a1": (2.0, None)}},
]


@pytest.mark.slow
@pytest.mark.parametrize("knowledge", RIGHT)
@pytest.mark.parametrize("pole", [0.0, 0.8])
def test_true_knowledge_raises_no_doubt(knowledge, pole):
    for seed in range(3):
        record = record_of(seed, 0.1, 12, pole)
        assert not doubts(identify(record, Structure(2, 1, **knowledge), OutputError()))


def test_a_wide_prior_far_from_the_estimate_raises_no_doubt():
    structure = Structure(2, 1, priors={"a1": (3.0, 1.0)})
    assert not doubts(identify(record_of(), structure))


@pytest.mark.slow
def test_nothing_is_said_where_the_free_fit_means_nothing():
    rng = np.random.default_rng(1)
    u = np.repeat([1.0, -1.0], 10)
    clean = simulate(MODEL, Record(u, u, dt=0.05))[:, 0]
    record = Record(u, clean + 2.0 * rng.standard_normal(u.size), dt=0.05)
    structure = Structure(2, 1, priors={"a1": (2.0, 0.2), "a0": (16.0, 1.0)})
    assert not doubts(identify(record, structure, throw=False))


@pytest.mark.slow
def test_the_constrained_residual_is_the_one_that_is_tested():
    bent = identify(record_of(), Structure(2, 1, fixed={"a0": 12.0}))
    assert any("residual of y is correlated" in line for line in bent.cautions)
    passed = "passes the portmanteau test"
    assert not any(passed in line for line in bent.trace.decisions)
    right = identify(record_of(), Structure(2, 1, fixed={"a0": 16.0}))
    assert sum(passed in line for line in right.trace.decisions) == 1
    assert not any("residual of y" in line for line in right.cautions)
