"""An input that moves between its samples is none that a controller moves, though taken as held."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate

SEEDS = [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 1, 3, 4, 5, 6, 7))]


@pytest.mark.parametrize("seed", SEEDS)
def test_tones_that_are_taken_as_held_are_told_as_such_and_not_as_feedback(seed):
    rng = np.random.default_rng([931, seed])
    n = 160
    tones = np.arange(1, 54, 4)
    u = np.cos(2 * np.pi * np.outer(np.arange(n), tones) / n + rng.uniform(0, 6.28, tones.size))
    record = Record(u.sum(axis=1), np.zeros(n), dt=0.1, intersample="band-limited")
    pole = rng.uniform(0.3, 3.0)
    y = simulate(TransferFunction([pole], [1.0, pole]), record)[:, 0]
    y = y + 0.08 * y.std() * rng.standard_normal(n)
    estimate = identify(Record(record.u, y, dt=0.1), Structure(1, 0))
    assert estimate.route == "open-loop"
    assert estimate.findings[0].code == "intersample"
    assert "feedback" not in [one.code for one in estimate.findings]


def both_nodes(rng: np.random.Generator, intersample: str, n: int = 330, fine: int = 20) -> Record:
    """Levels behind a resistance, and what is loaded with two capacitors, measured at both."""
    length = int(rng.integers(5, 25)) * fine
    levels = np.repeat(rng.choice([-0.5, 0.5], n), length)[: n * fine]
    rate, ratio, source = rng.uniform(0.2, 0.6), rng.uniform(0.3, 2.0), rng.uniform(0.7, 4.0)
    den = [1.0, source * (1.0 + ratio) + rate, source * rate]
    nodes = [TransferFunction(num, den) for num in ([source, source * rate], [source * rate])]
    driven = Record(levels, levels, dt=1.0 / fine)
    u, y = (simulate(node, driven)[::fine, 0] for node in nodes)
    read = [0.002 * np.round(one / 0.002 + 0.5 * rng.standard_normal(n)) for one in (u, y)]
    return Record(*read, dt=1.0, intersample=intersample)


@pytest.mark.slow
@pytest.mark.judged
@pytest.mark.parametrize("intersample", ["zoh", "auto"])
def test_a_node_that_both_ends_of_a_circuit_load_is_no_controllers(intersample):
    found = []
    for seed in range(5):
        record = both_nodes(np.random.default_rng([932, seed]), intersample)
        estimate = identify(record, Structure(1, 0))
        said = {one.code for one in estimate.findings if one.matters}
        found.append(estimate.route == "direct" or bool(said & {"feedback", "loop-not-excited"}))
    assert sum(found) <= 1
