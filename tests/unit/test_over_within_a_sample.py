"""A pole whose response is over within a sample: the record tells no more than that it is fast."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.selection.soundness import FAST, doubts


def told(
    seed: int, model: TransferFunction, asked: Structure, noise: float
) -> tuple[list[str], tuple[str, ...]]:
    """Codes of the findings, and what speaks against recommending it."""
    rng = np.random.default_rng([821, seed])
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 8)
    clean = simulate(model, Record(u, u, dt=0.2))[:, 0]
    record = Record(u, clean + noise * clean.std() * rng.standard_normal(u.size), dt=0.2)
    estimate = identify(record, asked)
    return [one.code for one in estimate.findings], doubts(estimate, [record])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.fast("1")
def test_a_needless_pole_faster_than_the_samples_is_told(seed):
    lag = TransferFunction([0.8], [1.0, 0.5])
    codes, against = told(seed, lag, Structure(2, 0), 0.1)
    assert "outside-the-record" in codes
    assert FAST in against
    codes, against = told(seed, lag, Structure(1, 0), 0.1)
    assert "outside-the-record" not in codes
    assert FAST not in against


def test_a_fast_pole_that_the_samples_tell_is_none():
    fast = TransferFunction([0.5 * 17.0], np.poly([-0.5, -17.0]))
    codes, against = told(5, fast, Structure(2, 0), 1e-4)
    assert "outside-the-record" not in codes
    assert FAST not in against


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 5))]
)
def test_an_output_that_follows_from_sample_to_sample_tells_no_time_constant(seed):
    """What is possible between the samples bounds such a pole to a tenth, and not the record."""
    rng = np.random.default_rng([822, seed])
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 8)
    y = np.append(0.0, u[:-1]) + 0.02 * rng.standard_normal(u.size)
    found = identify(Record(u, y, dt=0.02), Structure(1, 0)).findings
    assert "outside-the-record" in [one.code for one in found]


def test_beside_an_integrator_it_speaks_against_a_candidate_too():
    motor = TransferFunction([60.0], [1.0, 31.5, 45.0, 0.0])
    asked = Structure(3, 0, fixed={"a0": 0.0}, offset=False, drift=False)
    assert FAST in told(0, motor, asked, 0.02)[1]
