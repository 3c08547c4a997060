"""An input that moves faster than it was sampled: what lies between its samples is not known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from tridentify import Record, identify

FINE = 4
STEP = 1.0 / 8000.0


def through(num, den, u):
    """A continuous filter of what is joined by lines from one fine sample to the next."""
    b, a, _ = cont2discrete((num, den), STEP / FINE, "foh")
    return lfilter(b[0], a, u)


def first_order(seed, edge, n=2000):
    """A circuit driven by noise up to an edge [Hz], without a filter before the converter."""
    rng = np.random.default_rng([seed, 3])
    w = 2.0 * np.pi * edge
    u = through([w * w], [1.0, 1.2 * w, w * w], rng.standard_normal(n * FINE))
    y = through([2000.0], [1.0, 2000.0], u)[::FINE]
    return Record(
        u[::FINE],
        y + 0.01 * np.std(y) * rng.standard_normal(n),
        dt=STEP,
        intersample="auto",
    )


@pytest.mark.slow
def test_an_input_that_was_sampled_too_slowly_is_named():
    named = [identify(first_order(seed, 1200.0), (1, 0)).findings[0].code for seed in range(5)]
    assert named.count("intersample") >= 4


@pytest.mark.slow
def test_one_that_was_sampled_fast_enough_is_not():
    for seed in range(5):
        found = identify(first_order(seed, 200.0), (1, 0)).findings
        assert not [one.code for one in found if one.matters]
