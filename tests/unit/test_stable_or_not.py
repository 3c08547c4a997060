"""Short records by themselves that do not tell a plant that grows from one with a drift."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, tf2ss

from tridentify import Record, Structure, identify

LENGTH = 10.0


def grown(pole: float, fast: float, seed: int) -> Record:
    """Ten seconds of a plant with two real poles, in noise of a tenth."""
    rng, n = np.random.default_rng(seed), 150
    plant = tf2ss([1.0], np.poly([pole, -fast]))
    a, b, c, _, _ = cont2discrete(plant, LENGTH / n)
    u = np.repeat(rng.choice([-1.0, 1.0], 10), 15)
    y, x = np.zeros(n), np.zeros(2)
    for k in range(n):
        y[k] = (c @ x)[0]
        x = a @ x + b[:, 0] * u[k]
    y += 0.1 * y.std() * rng.standard_normal(n)
    return Record(u, y, dt=LENGTH / n, intersample="zoh")


def told(record: Record) -> tuple[bool, str]:
    found = identify(record, Structure(2, 0), throw=False)
    words = [one.message for one in found.findings if one.code == "unstable"]
    return found.model.is_stable, " ".join(words)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.slow
def test_a_plant_that_grows_is_found_or_its_pole_is_told(seed):
    stable, words = told(grown(0.15, 1.2, seed))
    assert words
    assert not stable or "does not tell whether" in words


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.slow
def test_of_a_stable_plant_no_other_pole_is_told(seed):
    stable, words = told(grown(-0.15, 1.2, seed))
    assert stable
    assert not words
