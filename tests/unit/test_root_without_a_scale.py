"""A predictor that runs off leaves errors of no size, and nothing is divided by that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tridentify import Record
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.closed_loop.linear_errors import Loop
from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.estimation.closed_loop.unstable import root
from tridentify.estimation.closed_loop.unstable_answer import _follows


@pytest.mark.slow
def test_the_references_are_asked_of_errors_without_a_scale_too():
    rng = np.random.default_rng(0)
    r, u, y = np.repeat(rng.choice([-1.0, 1.0], 15), 10), np.zeros(150), np.zeros(150)
    x, noise = 0.0, 0.02 * rng.standard_normal(150)
    for k in range(150):
        y[k] = x + noise[k]
        u[k] = 2.0 * (r[k] - y[k])
        x = 0.9 * x + 0.1 * u[k]
    loops = [Loop(driven(Record(u, y, dt=0.1, reference=r)), "sampled")]
    found = root(loops, [Plant(np.ones(1), (np.ones(1),))], None, lambda text: None)
    assert found is not None
    assert found.still
    assert not _follows(loops, found)
    assert _follows(loops, replace(found, variance=0.0, amplification=np.inf, moved=np.inf))
