"""A limit beside a rest: an output that stands because its system does is no counterexample."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record, Structure, identify
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_what_a_limit_cuts_off_is_no_disturbance_that_sets_in(seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, 40), 20)
    clean = by_modes(np.array([9.0]), np.array([1.0, 1.5, 9.0]), u, DT)
    most = np.quantile(np.abs(clean), 0.88)
    noisy = clean + 0.003 * np.std(clean) * rng.standard_normal(u.size)
    record = Record(u, most / 127.0 * np.round(127.0 * np.clip(noisy / most, -1.0, 1.0)), dt=DT)
    told = [one.code for one in identify(record, Structure(2, 0)).findings]
    assert told[0] == "saturation"
    assert "drift" not in told
