"""The triangle of a record against dense filtering, column by column."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify.models.regression import BLOCK, Experiment, regress, restricted
from tridentify.numerics.realization import cascade

DT = 0.1
BANK = cascade(np.array([-0.8, -1 + 2j, -1 - 2j, -0.8, -6.0]))


def experiment(n=80, *, intersample="zoh", free=True, offset=True, drift=True, missing=0.0):
    rng = np.random.default_rng(7)
    u = rng.standard_normal((n, 2)) + np.array([0.5, -2.0])
    y = rng.standard_normal((n, 3)) + 1.0
    y[rng.random(y.shape) < missing] = np.nan
    return Experiment(u, y, DT, intersample, free, offset, drift)


def responses(a, b, u, dt, intersample):
    """(n, q) states of ``x' = a x + b u``: samples as impulses of the input or of its slope.

    Between samples a held input is constant and a ramping one has a constant slope; both are
    states of a larger system without input, whose exponential is taken once.
    """
    q = b.size
    whole = np.zeros((q + 2, q + 2))
    whole[:q, :q], whole[:q, q], whole[q, q + 1] = a, b, 1.0
    step = expm(whole * dt)[:q]
    x, found = np.zeros(q), np.empty((u.size, q))
    slope = np.append(np.diff(u), 0.0) / dt if intersample == "foh" else np.zeros(u.size)
    for k in range(u.size):
        found[k] = x
        x = step @ np.concatenate([x, [u[k], slope[k]]])
    return found


def dense(e, bank, output):
    """[impulse states | input states | inputs | 1 | ramp | y], rows of missing samples left out."""
    t = np.arange(e.n_samples) * e.dt
    columns = [np.array([expm(bank.a * x) @ bank.b for x in t])] if e.free else []
    columns += [responses(bank.a, bank.b, u, e.dt, e.intersample) for u in e.u.T]
    columns += [e.u]
    columns += [np.ones((t.size, 1))] if e.offset else []
    columns += [(t / t[-1])[:, None]] if e.drift else []
    columns += [e.y[:, [output]]]
    return np.hstack(columns)[np.isfinite(e.y[:, output])]


def gram(regression, output):
    z = np.column_stack([regression.signals[output], regression.targets[output]])
    return z.T @ z


def same(found, expected):
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.max(np.abs(found - expected) / scale) < 1e-11


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("terms", [(True, True, True), (False, True, False), (True, False, True)])
def test_inner_products_are_those_of_the_dense_columns(intersample, missing, terms):
    free, offset, drift = terms
    e = experiment(intersample=intersample, free=free, offset=offset, drift=drift, missing=missing)
    regression = regress(e, BANK)
    for i in range(3):
        z = dense(e, BANK, i)
        assert regression.counts[i] == z.shape[0]
        same(gram(regression, i), z.T @ z)


def test_layout_names_the_columns():
    e = experiment()
    regression, z = regress(e, BANK), dense(e, BANK, 1)
    layout, q = regression.layout, BANK.order
    row = np.arange(1.0, q + 1)
    pieces = {
        "impulse": (regression.impulse_signal(1, row), z[:, :q] @ row),
        "first input": (regression.input_signal(1, 0, row, 0.5), z[:, q : 2 * q] @ row),
        "second input": (regression.input_signal(1, 1, row), z[:, 2 * q : 3 * q] @ row),
        "offset": (regression.nuisance_signals(1)[:, 0], np.ones(e.n_samples)),
        "drift": (regression.nuisance_signals(1)[:, 1], np.linspace(0, 1, e.n_samples)),
        "target": (regression.targets[1], e.y[:, 1]),
    }
    pieces["first input"][1][:] += 0.5 * e.u[:, 0]
    for name, (found, expected) in pieces.items():
        assert found @ found == pytest.approx(expected @ expected), name
        other = regression.signals[1][:, layout.direct(1)]
        assert found @ other == pytest.approx(expected @ e.u[:, 1]), name


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_blocks_make_no_difference(intersample, missing, monkeypatch):
    """The impulse states die out on the way and are left out from there on."""
    e = experiment(3 * BLOCK + 100, intersample=intersample, missing=missing)
    found = regress(e, BANK)
    monkeypatch.setattr("tridentify.models.regression.BLOCK", e.n_samples)
    monkeypatch.setattr("tridentify.models.regression.NEGLIGIBLE", 0.0)
    for i in range(3):
        same(gram(found, i), gram(regress(e, BANK), i))


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("free", [True, False])
@pytest.mark.parametrize("offset", [True, False])
@pytest.mark.parametrize("drift", [True, False])
def test_fewer_nuisance_columns_are_those_of_a_smaller_record(
    intersample, missing, free, offset, drift
):
    e = experiment(intersample=intersample, missing=missing)
    small = experiment(
        intersample=intersample, missing=missing, free=free, offset=offset, drift=drift
    )
    found = restricted(regress(e, BANK), BANK, free=free, offset=offset, drift=drift)
    expected = regress(small, BANK)
    assert found.layout == expected.layout
    for i in range(3):
        same(gram(found, i), gram(expected, i))


def shifted(e, constants):
    return Experiment(e.u + constants, e.y, e.dt, e.intersample, e.free, e.offset, e.drift)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_constants_on_the_inputs_are_put_back(intersample, missing):
    constants = np.array([3.0, -0.5])
    whole = regress(experiment(intersample=intersample, missing=missing), BANK)
    small = experiment(intersample=intersample, missing=missing, free=False, drift=False)
    found = restricted(whole, BANK, free=False, offset=True, drift=False, constants=constants)
    expected = regress(shifted(small, constants), BANK)
    for i in range(3):
        same(gram(found, i), gram(expected, i))
