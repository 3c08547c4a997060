"""A limit beside a rest: an output that stands because its system does is no counterexample."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record
from tridentify.judgement.cautions.sensors import seen_in

DT = 0.05


def told(y, model, u):
    record = Record(u, y, dt=DT)
    noise = np.array([np.var(y - model)])
    return "saturation" in [one.code for one in seen_in(record, model[:, None], noise, None)]


@pytest.mark.parametrize("clipped", [True, False])
def test_a_limit_is_seen_beside_a_rest_that_lasts_longer(clipped):
    rng = np.random.default_rng(4)
    u = np.repeat(np.append([0.0, 0.0, 0.0], rng.uniform(-1.0, 1.0, 37)), 12)
    clean = by_modes(np.array([9.0]), np.array([1.0, 2.0, 9.0]), u, DT)
    most = np.quantile(np.abs(clean), 0.9) if clipped else np.abs(clean).max()
    step = most / 127.0
    y = step * np.round(np.clip(clean, -most, most) / step)
    model = clean * (y @ clean) / (clean @ clean)
    assert told(y, model, u) is clipped
