"""A judgement that came with an estimate is not made twice, and never given for another."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate, validate
from tridentify.judgement.validation import assess

U = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 25), 8)
PLANT = TransferFunction([9.0], [1.0, 1.2, 9.0])
Y = simulate(PLANT, Record(U, U, dt=0.05))[:, 0]
Y = Y + 0.08 * np.random.default_rng(1).standard_normal(U.size)
RECORD = Record(U, Y, dt=0.05)
QUICK = ThreeModel(noise="white", finish="likelihood")


def alike(one, other):
    """Whether two results are the same in every number and word."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other, equal_nan=True)
    if dataclasses.is_dataclass(one):
        names = [field.name for field in dataclasses.fields(one)]
        return all(alike(getattr(one, name), getattr(other, name)) for name in names)
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(alike, one, other))
    return one == other or (one != one and other != other)


@pytest.fixture
def counted(monkeypatch):
    """Number of judgements made."""
    made = []

    def judging(*arguments):
        made.append(arguments)
        return judge(*arguments)

    judge = assess._judge
    monkeypatch.setattr(assess, "_judge", judging)
    return made


@pytest.mark.slow
def test_validation_after_identification_is_the_judgement_that_came_with_it(counted):
    estimate = identify(RECORD, Structure(1, 0), QUICK, throw=False)
    assert len(counted) == 1
    first = validate(estimate, RECORD)
    assert len(counted) == 1
    # given away once: what a caller does to its arrays stays with the caller
    second = validate(estimate, [Record(U, Y, dt=0.05)])
    assert len(counted) == 2
    assert first is not second
    assert alike(first, second)


@pytest.mark.slow
def test_who_looks_again_gets_the_judgement_that_was_made(counted):
    # whether an input reacts is asked before all else is, and both take the same tests
    estimate = identify(RECORD, Structure(1, 0), QUICK, throw=False)
    found = assess.looked_at(estimate, [RECORD])
    assert len(counted) == 1
    assert found == assess.looked_at(estimate, [RECORD])
    assert len(counted) == 1
    assert found
    other = dataclasses.replace(estimate, theta=estimate.theta * (1 + 1e-12))
    assess.looked_at(other, [RECORD])
    assert len(counted) == 2


@pytest.mark.parametrize(
    "other",
    [
        lambda e: (e, Record(U, Y + 1e-9, dt=0.05), {}),
        lambda e: (e, Record(U, Y, dt=0.05, intersample="foh"), {}),
        lambda e: (e, RECORD, {"level": 0.95}),
        pytest.param(lambda e: (e, RECORD, {"n_lags": 7}), marks=pytest.mark.slow),
        pytest.param(lambda e: (e, RECORD, {"experiment": 0}), marks=pytest.mark.slow),
        lambda e: (dataclasses.replace(e, theta=e.theta * (1 + 1e-12)), RECORD, {}),
        pytest.param(
            lambda e: (dataclasses.replace(e, cov=2.0 * e.cov), RECORD, {}), marks=pytest.mark.slow
        ),
    ],
)
@pytest.mark.slow
def test_anything_else_is_judged_by_itself(other, counted):
    estimate, record, options = other(identify(RECORD, Structure(1, 0), QUICK, throw=False))
    validate(estimate, record, **options)
    assert len(counted) == 2
