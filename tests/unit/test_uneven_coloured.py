"""Coloured noise on uneven time: no advice that the estimator refuses, no errors told too small."""

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate, validate


def jittered(seed: int) -> Record:
    """A second-order system in noise that wanders, at instants that scatter by a third."""
    rng = np.random.default_rng(seed)
    n = 500
    t = np.cumsum(0.05 * (1.0 + 0.3 * rng.uniform(-1.0, 1.0, n)))
    u = np.repeat(rng.choice([-1.0, 1.0], n // 10), 10)
    y = simulate(TransferFunction([6.0], [1.0, 2.0, 6.0]), Record(u, np.zeros(n), t=t))[:, 0]
    noise = np.zeros(n)
    for k, e in enumerate(rng.standard_normal(n)):
        noise[k] = 0.9 * noise[k - 1] + e
    return Record(u, y + 0.1 * noise / np.std(noise), t=t)


@pytest.mark.slow
def test_the_errors_come_from_the_scores() -> None:
    assert ThreeModel().estimate([jittered(0)], Structure(2, 0)).errors == "scores"


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.slow
def test_what_is_advised_can_be_done(seed: int) -> None:
    record = jittered(seed)
    estimate = identify(record, Structure(2, 0))
    found = [*estimate.findings, *validate(estimate, record).findings]
    assert any(one.code in ("noise-model", "drift") for one in found)
    assert not any("noise='ar'" in one.remedy for one in found)


@pytest.mark.slow
def test_errors_from_the_scores_are_not_told_to_be_too_small() -> None:
    record = jittered(0)
    estimate = identify(record, Structure(2, 0))
    assert estimate.errors == "scores"
    (told,) = [f for f in validate(estimate, record).findings if f.code == "noise-model"]
    assert told.severity == "note"
    assert "do not allow" not in told.message
