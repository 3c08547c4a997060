"""An integrator under a relay, dithered: the loop moves by itself, and the reference drives little.

Passes among stable plants come to rest at slow poles whose errors are a tenth of what they are, or
nowhere; the root is that of the mirrored predictor.
"""

import numpy as np
import pytest

from oracles import binary, sampled_loop
from tridentify import Record, Structure, ThreeModel

GAIN, DT = 1.75, 0.07


def under_a_relay(seed: int) -> Record:
    rng, dither, sign = np.random.default_rng(seed), 0.45 * binary(400, 10, seed), [1.0]

    def control(k, y):
        if abs(y[0]) > 0.1:
            sign[0] = -np.sign(y[0])
        return 0.86 * sign[0] + dither[k]

    noise = 0.05 * rng.standard_normal((400, 1))
    u, y = sampled_loop([[([GAIN], [1.0, 0.0])]], control, noise, DT)
    return Record(u, y, dt=DT, reference=dither)


@pytest.mark.parametrize("seed", [7, 8, 13], ids=["nowhere", "at the limit", "small errors"])
@pytest.mark.slow
def test_an_integrator_that_the_dither_hardly_moves_has_errors_that_say_so(seed):
    record = under_a_relay(seed)
    found = ThreeModel(controller="sampled").estimate([record], Structure(1, 0))
    away = np.abs(found.theta - [0.0, GAIN])
    assert np.all(away < 3.5 * found.std)
    # no worse than that a response over three records is told from none
    assert found.std[0] < 3.0 / record.duration
    assert found.loop is not None
    assert found.loop.mirrored
