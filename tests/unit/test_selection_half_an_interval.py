"""A zero that stands for the half interval between a held input and one that is joined by lines."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from tridentify import Record, Structure, select_structure

pytestmark = pytest.mark.unjudged

STEP, FINE = 0.12, 20
"""[s], and steps of the simulation in one of them."""

CANDIDATES = [Structure(n, m) for n, m in ((1, 0), (2, 0), (2, 1), (3, 0), (3, 1), (3, 2))]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_levels_that_are_joined_by_lines_are_not_held(seed: int) -> None:
    """They repeat their values as held ones do; of the right order alone it is seen at once."""
    rng = np.random.default_rng([7057, seed])
    n = 300
    u = np.repeat(rng.uniform(-1.0, 1.0, n), 9)[:n]
    t = np.arange(n * FINE) * STEP / FINE
    moved = np.interp(t, t[::FINE], u)
    y = signal.lsim(([8.0], [1.0, 3.4, 6.8, 8.0]), moved, t)[1][::FINE]
    y = y + 0.02 * y.std() * rng.standard_normal(n)
    found = select_structure(Record(u, y, dt=STEP, intersample="auto"), CANDIDATES)
    assert found.recommended is not None
    assert found.recommended.label == "3, 0"
    assert found.recommended.estimate is not None
    assert found.recommended.estimate.intersample == "foh"
