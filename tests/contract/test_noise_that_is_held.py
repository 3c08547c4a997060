"""Noise that is held over some samples: new at every k-th alone, and none of it stands out."""

import numpy as np
import pytest

from oracles import sampled_loop
from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.numerics.local_size import over_phases

PLANT = ([1.5], [1.0, 1.2])


def test_innovations_of_held_noise_have_the_size_of_their_phase():
    rng = np.random.default_rng(8)
    noise = rng.standard_normal((100, 400))
    assert sum(over_phases(one) is not one for one in noise) == 0
    held = np.repeat(noise[:, ::4], 4, axis=1)
    new = held[:, 1:] - 0.8 * held[:, :-1]
    assert sum(over_phases(one) is not one for one in new) == 100
    assert np.percentile([np.max(np.abs(over_phases(one))) for one in new], 90) < 5.0


@pytest.mark.parametrize(("loop", "held"), [(False, 5), (True, 3), (True, 4)])
@pytest.mark.slow
def test_right_records_in_held_noise_carry_no_bad_samples_and_no_disturbances(loop, held):
    found: list[str] = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        moves = np.repeat(rng.choice([-1.0, 1.0], 25), 24)
        noise = np.repeat(0.06 * rng.standard_normal(moves.size), held)[: moves.size]
        if loop:
            u, y = sampled_loop(
                [[PLANT]], lambda k, y, r=moves: 1.5 * (r[k] - y[0]), noise[:, None], 0.05
            )
            record = Record(u, y, dt=0.05, reference=moves, intersample="zoh")
        else:
            y = simulate(TransferFunction(*PLANT), Record(moves, moves, dt=0.05))[:, 0] + noise
            record = Record(moves, y, dt=0.05, intersample="zoh")
        end = identify(record, Structure(1, 0), ThreeModel(starts=1), throw=False)
        assert np.all(np.abs(end.theta - [1.2, 1.5]) < 4.0 * end.std)
        found += [one.code for one in end.findings if one.matters]
    assert not {"bad-samples", "drift", "noise-model"} & set(found)
