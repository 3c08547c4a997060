"""A sine from rest: needless poles beside as many zeros are told as such."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("poles", [3, 4])
@pytest.mark.fast("3-0")
def test_more_poles_beside_as_many_zeros_are_told(seed, poles):
    """With one zero less the smaller structure would miss the response, and none be told."""
    rng = np.random.default_rng([831, seed])
    u = np.sin(0.125 * np.arange(400))
    clean = simulate(TransferFunction([2.0, 16.0], [1.0, 2.4, 16.0]), Record(u, u, dt=0.05))[:, 0]
    record = Record(u, clean + 0.1 * clean.std() * rng.standard_normal(u.size), dt=0.05)
    found = identify(record, Structure(poles, 1)).findings
    assert "order-high" in [one.code for one in found if one.matters]
    right = identify(record, Structure(2, 1)).findings
    assert "order-high" not in [one.code for one in right]
