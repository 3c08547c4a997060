"""Restricted estimates reach the bound, their intervals hold, and the test has its level."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, simulate
from tridentify.physical import PhysicalModel, estimate_physical, short_period

DERIVATIVES = {
    "Z_alpha": -0.98, "Z_delta": -0.055, "M_alpha": -8.0, "M_q": -0.91, "M_delta": -8.8,
}  # fmt: skip
DRAWS = 160
N, DT = 300, 0.02
WHITE = ThreeModel(finish="likelihood", noise="white")


def at_rest():
    model = short_period()
    return PhysicalModel(
        model.name,
        model.parameters,
        Structure(2, [[1], [1]], offset=False, initial_state="rest"),
        model.coefficients,
        input_names=model.input_names,
        output_names=model.output_names,
        start=model.start,
    )


def manoeuvre():
    u = np.zeros(N)
    for first, last, sign in ((20, 80, -1), (80, 120, 1), (120, 140, -1), (140, 160, 1)):
        u[first:last] = sign
    return u


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_short_period_over_many_draws():
    model, u = at_rest(), manoeuvre()
    truth = np.array(list(DERIVATIVES.values()))
    names = {"input_names": ["elevator"], "output_names": ["alpha", "q"]}
    rest = Record(u, np.ones((N, 2)), dt=DT, **names)

    def response(values):
        plain = dict(zip(DERIVATIVES, values, strict=True))
        return simulate(model.transfer_function(plain), rest)

    clean = response(truth)
    noise = 0.1 * clean.std(axis=0)
    step = 1e-5 * np.abs(truth)
    columns = [
        ((response(truth + h) - response(truth - h)) / (2 * h.sum()) / noise).ravel()
        for h in np.diag(step)
    ]
    j = np.stack(columns, axis=1)
    bound = np.sqrt(np.diag(np.linalg.inv(j.T @ j)))

    errors, inside, moved, p_values = [], [], [], []
    for draw in range(DRAWS):
        y = clean + noise * np.random.default_rng(draw).standard_normal(clean.shape)
        estimate = estimate_physical(model, Record(u, y, dt=DT, **names), WHITE)
        errors.append(estimate.values - truth)
        inside.append(np.abs(errors[-1]) < 1.96 * estimate.std)
        moved.append(estimate.values - estimate.by_distance)
        p_values.append(estimate.p_value)
    rms = np.sqrt(np.mean(np.square(errors), axis=0)) / bound
    assert np.all((rms > 0.85) & (rms < 1.15)), rms
    assert np.all(np.abs(np.mean(errors, axis=0)) < 0.3 * bound)
    assert 0.93 < np.mean(inside) < 0.975, np.mean(inside, axis=0)
    # at this noise the distance is as good as the likelihood
    assert np.all(np.sqrt(np.mean(np.square(moved), axis=0)) < 0.03 * bound)
    assert 0.01 < np.mean(np.array(p_values) < 0.05) < 0.11
