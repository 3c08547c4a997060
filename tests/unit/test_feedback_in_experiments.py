"""Feedback in several experiments: each has a level and an input of its own."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.causes.signals.surprises import small_surprises

pytestmark = pytest.mark.judged

PLANT = TransferFunction([9.0], [1.0, 1.5, 9.0])


def experiment(rng, kind, n=500):
    """Steps at random, a sine, or pulses, about levels of their own, and noise with memory."""
    t = 0.05 * np.arange(n)
    if kind == "steps":
        u = np.repeat(rng.normal(1.0, 1.0, n // 20), 20)
    elif kind == "sine":
        u = 2.0 + np.sin(1.3 * t) + 0.5 * np.sin(4.1 * t + 1.0)
    else:
        u = np.where((t > 3.0) & (t < 5.0), 1.0, -1.0)
    noise = np.zeros(n)
    for k in range(1, n):
        noise[k] = 0.7 * noise[k - 1] + 0.05 * rng.standard_normal()
    return Record(u, simulate(PLANT, Record(u, u, dt=0.05))[:, 0] + 0.3 + noise, dt=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_inputs_of_several_kinds_are_no_feedback(seed):
    rng = np.random.default_rng(seed)
    records = [experiment(rng, "sine"), experiment(rng, "steps")]
    assert not any(np.any(one) for one in small_surprises(records))
    records.append(experiment(rng, "pulse"))
    codes = [one.code for one in identify(records, Structure(2, 0)).findings if one.matters]
    assert "feedback" not in codes


@pytest.mark.parametrize("level", [0.3, 1.0, 7.1, 1e6])
@pytest.mark.parametrize("n", [60, 100, 101, 400])
def test_an_input_that_never_moves_is_no_controllers(level, n):
    """What a fit leaves of a level is rounding, which may follow anything."""
    record = Record(np.full(n, level), np.zeros(n), dt=0.05)
    assert not any(np.any(one) for one in small_surprises([record]))
