"""Sensors slower than the record of a loop: repeats are those of what was recorded."""

import numpy as np
import pytest

from oracles import sampled_loop
from tridentify import Record, Structure, ThreeModel, identify

STABLE, RUNS_AWAY = ([1.5], [1.0, 1.2]), ([1.0], [1.0, 0.8, -0.5])
HELD = 3


def loop(plant, gains, n=600):
    """A loop whose sensor gives every third sample, and holds it for record and controller."""
    rng = np.random.default_rng(3)
    reference = np.repeat(rng.choice([-1.0, 1.0], n // 20), 20)
    noise, seen = 0.06 * rng.standard_normal(n), []

    def control(k, y):
        seen.append(y[0] if k % HELD == 0 else seen[-1])
        slope = (seen[-1] - seen[max(0, k - HELD)]) / (0.05 * HELD)
        return gains[0] * (reference[k] - seen[-1]) - gains[1] * slope

    u, _ = sampled_loop([[plant]], control, noise[:, None], 0.05)
    return Record(u, np.array(seen), dt=0.05, reference=reference, intersample="zoh")


@pytest.mark.parametrize(
    ("plant", "gains"), [(STABLE, (1.5, 0.0)), (RUNS_AWAY, (2.5, 0.8))], ids=["stable", "not"]
)
@pytest.mark.slow
def test_a_slow_sensor_is_told_first_and_its_consequences_are_not(plant, gains):
    record, structure = loop(plant, gains), Structure(len(plant[1]) - 1, 0)
    quick = ThreeModel(starts=1)
    found = identify(record, structure, quick, throw=False)
    assert found.route == "reference"
    first = found.findings[0]
    assert (first.code, first.kind, first.severity) == ("stuck-sensor", "slow-sensor", "error")
    assert "each value 3 times in a row" in first.message
    made = {"delay", "order-low", "drift", "bad-samples"}
    assert not {one.code for one in found.findings if one.severity != "note"} & made
    kept = record.mask((np.arange(record.n_samples) % HELD != 0)[:, None])
    mended = identify(kept, structure, quick, throw=False)
    truth = [*plant[1][1:], *plant[0]]
    assert np.all(np.abs(mended.theta - truth) < 4.0 * mended.std)
    assert "stuck-sensor" not in {one.code for one in mended.findings}
