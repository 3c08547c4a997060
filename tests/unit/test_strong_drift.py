"""An output that drifts by several of its standard deviations: the drift is what is told first."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import (
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    advise,
    identify,
    simulate,
)
from tridentify.errors import DataError


def drifting(model: TransferFunction, seed: int, moves: int) -> Record:
    rng = np.random.default_rng([823, seed])
    u = np.repeat(rng.choice([-1.0, 1.0], moves), 6)
    clean = simulate(model, Record(u, u, dt=0.05))[:, 0]
    noise = 0.1 * clean.std() * rng.standard_normal(u.size)
    return Record(u, clean + noise + np.linspace(0.0, 6.0, u.size) * clean.std(), dt=0.05)


@pytest.mark.slow
def test_beside_one_pole_it_is_told_first():
    """Where the noise is stated: by default it is estimated along, and nothing is left to tell."""
    record = drifting(TransferFunction([2.0], [1.0, 2.0]), 2, 22)
    first = identify(record, (1, 0), ThreeModel(noise="ar")).findings[0]
    assert first.code == "drift"
    assert "fit of y from" in first.effect
    along = identify(record, (1, 0))
    assert not along.findings
    assert np.all(np.abs(along.theta - [2.0, 2.0]) < 4.0 * along.std)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.slow
def test_a_drift_that_was_fitted_is_told_before_another_noise(seed):
    """The other model of the noise is likelier since it makes up for the drift."""
    record = drifting(TransferFunction([2.0, 16.0], [1.0, 2.4, 16.0]), seed, 66)
    found = identify(record, Structure(2, 1), ThreeModel(noise="ar"))
    first = found.findings[0]
    assert first.code == "drift"
    assert "fit of y from" in first.effect
    better = ThreeModel().estimate([record], Structure(2, 1, drift=True))
    assert np.all(np.abs(better.theta - [2.4, 16.0, 2.0, 16.0]) < 4.0 * better.std)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_pole_that_took_the_drift_gives_it_back(seed):
    """White weights leave nothing of it: a slow pole follows the ramp instead of the response."""
    record = drifting(TransferFunction([2.0, 16.0], [1.0, 2.4, 16.0]), seed, 66)
    along = identify(record, Structure(2, 1))
    assert along.structure.drift_degree
    assert np.all(np.abs(along.theta - [2.4, 16.0, 2.0, 16.0]) < 4.0 * along.std)
    assert not [one for one in along.findings if one.severity == "error"]


def test_what_is_no_record_is_told_by_advise_too():
    with pytest.raises(DataError, match="found int in place of a record"):
        advise(3)
