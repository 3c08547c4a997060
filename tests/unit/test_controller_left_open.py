"""A controller without memory, whose kind no record tells: the errors allow for either."""

import numpy as np
import pytest

from oracles import continuous_loop
from tridentify import Record, Structure, ThreeModel, identify

N, DT = 500, 0.1
CHANNEL = ([1.0, 1.0], [1.0, 0.5, 1.0])
TRUE = np.array([0.5, 1.0, 1.0, 1.0])
STATIC = (np.zeros((0, 0)), np.zeros(0), np.zeros(0), 2.0)


def record_of(seed: int, n: int = N) -> Record:
    """Its controller is continuous, and its noise held, as by a converter."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], n // 20), 20)
    u, y = continuous_loop(CHANNEL, STATIC, r, 0.01 * rng.standard_normal(n), DT)
    return Record(u, y, dt=DT, reference=r)


def test_of_a_short_record_it_is_told_and_allowed_for():
    found = identify(record_of(5, 120), Structure(2, 1))
    assert np.all(np.abs(found.theta - TRUE) < 3.0 * found.std)
    said = [one.message for one in found.findings if one.code == "intersample"]
    assert any("allow for either" in one for one in said)


@pytest.mark.parametrize("seed", [5, 6, 7])
@pytest.mark.slow
def test_errors_reach_from_one_kind_to_the_other(seed):
    record, structure = record_of(seed), Structure(2, 1)
    found = identify(record, structure)
    kinds = [
        ThreeModel(controller=kind).estimate([record], structure)
        for kind in ("sampled", "continuous")
    ]
    apart = np.abs(kinds[0].theta - kinds[1].theta)
    assert np.max(apart / kinds[0].std) > 3.0
    assert np.all(found.std > 0.5 * apart)
    assert np.all(np.abs(found.theta - TRUE) < 3.0 * found.std)
    said = [one.message for one in found.findings if one.code == "intersample"]
    assert any("allow for either" in one for one in said)
