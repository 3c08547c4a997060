"""Controllers whose kind no record tells, or not quite: the errors allow for what is left open."""

import numpy as np
import pytest

from oracles import continuous_loop, sampled_loop
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


def faster(seed: int, times: int, n: int = N) -> Record:
    """A computer of so many steps a sample, with a lead that reads the noise at every step."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10 * times)
    step, held = DT / times, [0.0]

    def control(k, y):
        error = r[k] - y[0]
        held[0] += step / 0.05 * (error - held[0]) / (1.0 + 0.5 * step / 0.05)
        return 2.0 * held[0] + 8.0 * (error - held[0]) * 0.5

    noise = 0.01 * rng.standard_normal((n * times, 1))
    u, y = sampled_loop([[CHANNEL]], control, noise, step)
    return Record(u[::times], y[::times], dt=DT, reference=r[::times])


@pytest.mark.parametrize("seed", range(30, 36))
@pytest.mark.slow
def test_a_computer_of_a_few_steps_a_sample_is_allowed_for(seed):
    found = identify(faster(seed, 4), Structure(2, 1))
    assert np.all(np.abs(found.theta - TRUE) < 4.0 * found.std)
