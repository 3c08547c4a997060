"""A reference that drives nothing is said to; one that drives the loop is not, sines included."""

from __future__ import annotations

import loops
import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.methods.by_reference.followed import driving_findings

N, DT = 300, 0.2
LAW = loops.Controller(loops.tustin(loops.System.of([2.0, 1.0], [1.0, 0.0]), DT), True)


def record_of(r: np.ndarray, given: np.ndarray, seed: int) -> Record:
    v = 0.3 * np.random.default_rng(seed).standard_normal(N)
    still = np.zeros((N, 1))
    u, y = loops.run(loops.System.of([1.0], [1.0, 1.0]), LAW, r[:, None], v[:, None], still, DT)
    return Record(u, y, dt=DT, reference=given)


def steps(seed: int) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], N // 20), 20)


def noise_for_a_reference() -> Record:
    return record_of(steps(1), np.random.default_rng(2).standard_normal(N), 3)


def test_noise_drives_nothing():
    (found,) = driving_findings([driven(noise_for_a_reference())])
    assert (found.code, found.matters) == ("loop-not-excited", True)
    assert "drives nothing" in found.message


@pytest.mark.slow
def test_noise_that_is_given_for_a_reference_is_told():
    record = noise_for_a_reference()
    estimate = ThreeModel().estimate([record], Structure(1, 0))
    assert [one.code for one in estimate.findings if one.matters][:1] == ["loop-not-excited"]
    assert "drives nothing" in estimate.findings[0].message


@pytest.mark.parametrize("kind", ["steps", "sine"])
def test_a_reference_that_drives_the_loop_is_not(kind):
    r = steps(4) if kind == "steps" else np.sin(0.3 * DT * np.arange(N))
    assert driving_findings([driven(record_of(r, r, 5))]) == ()
