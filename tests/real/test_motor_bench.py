"""A motor bench with a flexible coupling: its position drifts by more than the response.

Every part of the record shows the resonance of the coupling near 76 Hz, where the measured
frequency response peaks too; the slow part is told from the drift by the noise model alone.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Structure, identify, read_record

ASKED = Structure(4, 2)
RESONANCE = 2 * np.pi * 76.4


@pytest.fixture(scope="module")
def record(folder):
    path = folder("motor-bench-multisine") / "data.parquet"
    pytest.importorskip("pyarrow")
    found = read_record(path, inputs=["iq"], outputs=["theta_m"], time="t", intersample="auto")
    return found.slice(1.0, 4.0).decimate(2)


@pytest.mark.slow
def test_both_halves_find_the_resonance_and_agree(record):
    halves = [identify(one, ASKED, throw=False) for one in record.split(2.5)]
    for one in halves:
        assert np.max(one.model.poles.imag) == pytest.approx(RESONANCE, rel=0.01)
    first, second = halves
    off = np.abs(first.theta - second.theta) / np.hypot(first.std, second.std)
    assert np.sum(off < 3.0) >= 6
    assert off.max() < 6.0
