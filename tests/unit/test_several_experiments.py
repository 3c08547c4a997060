"""Several records, one model: against a dense route, cut in two, and through the stand-ins."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from tridentify import (
    OutputError,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.estimation.search.stand_ins import averaged, is_large, is_usable, window

pytestmark = pytest.mark.unjudged

SHARED = (
    TransferFunction([[[2.0, 1.0], [3.0]]], [[[1.0, 1.0, 4.0], [1.0, 1.0, 4.0]]]),
    lambda **options: Structure(2, [[1, 0]], **options),
    2,
)
SEPARATE = (
    TransferFunction([[[2.0], [1.0, 3.0]]], [[[1.0, 2.0], [1.0, 1.0, 4.0]]]),
    lambda **options: Structure([[1, 2]], [[0, 1]], **options),
    3,
)
SYSTEMS = pytest.mark.parametrize("system", [SHARED, SEPARATE], ids=["shared", "separate"])
FREE = {"offset": True, "drift": True, "initial_state": "free"}
METHOD = ThreeModel(noise="white", finish="likelihood")


def theta_of(model, structure):
    """The coefficients in the order of the names."""
    if structure.shared:
        return np.concatenate([model.den[0][0][1:], *model.num[0]])
    return np.concatenate([[*d[1:], *b] for d, b in zip(model.den[0], model.num[0], strict=True)])


def model_of(theta, structure):
    num, den = structure.split(theta, 1, 2)
    return TransferFunction(num, den)


def free_of(values, structure):
    """(1, n) or (1, 2, n) numerators of the free response, the shorter ones padded."""
    if structure.shared:
        return values[None, :]
    first, second = structure.poles_matrix(1, 2)[0]
    found = np.zeros((1, 2, max(first, second)))
    found[0, 0, -first:], found[0, 1, -second:] = values[:first], values[first:]
    return found


def output(theta, structure, record, local):
    """Of one experiment: free numerators, offset and slope behind the coefficients."""
    free = free_of(local[:-2], structure)
    y = simulate(model_of(theta, structure), record, free_response=free)[:, 0]
    return y + local[-2] + local[-1] * (record.t - record.t[0])


def made(system, locals_, steps, lengths, noise=0.05):
    model, wanted, _ = system
    structure = wanted(**FREE)
    records = []
    for k, (local, dt, n) in enumerate(zip(locals_, steps, lengths, strict=True)):
        rng = np.random.default_rng(k)
        u = np.repeat(np.sign(rng.standard_normal((n // 5, 2))), 5, axis=0)
        u = u + np.array([1.0, -2.0])
        blank = Record(u, np.zeros((n, 1)), dt=dt)
        y = output(theta_of(model, structure), structure, blank, np.asarray(local))
        records.append(Record(u, y + noise * rng.standard_normal(n), dt=dt))
    return records, structure


LOCALS = {
    2: [[0.4, -1.0, 3.0, 0.05], [-0.7, 0.3, -2.0, -0.1], [0.0, 0.5, 1.0, 0.0]],
    3: [[0.4, -1.0, 0.2, 3.0, 0.05], [-0.7, 0.3, 0.5, -2.0, -0.1], [0.0, 0.5, 0.1, 1.0, 0.0]],
}


@SYSTEMS
@pytest.mark.parametrize("method", [METHOD, OutputError()], ids=["three-model", "output-error"])
@pytest.mark.fast("three-model-separate", "output-error-shared")
def test_records_of_other_steps_lengths_and_trims_as_one_dense_problem(system, method):
    model, _, states = system
    locals_ = LOCALS[states]
    records, structure = made(system, locals_, (0.05, 0.08, 0.03), (300, 150, 400))
    estimate = identify(records, structure, method)
    n = estimate.theta.size

    def error(unknowns):
        parts, at = [], n
        for record in records:
            width = states + 2
            fitted = output(unknowns[:n], structure, record, unknowns[at : at + width])
            parts.append(fitted - record.y[:, 0])
            at += width
        return np.concatenate(parts)

    truth = np.concatenate([theta_of(model, structure), *locals_])
    dense = least_squares(error, truth, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert np.all(np.abs(estimate.theta - dense.x[:n]) < 1e-3 * estimate.std)
    cov = np.linalg.inv(dense.jac.T @ dense.jac)[:n, :n] * estimate.noise_variance[0]
    assert estimate.std == pytest.approx(np.sqrt(np.diag(cov)), rel=1e-3)
    for k, record in enumerate(records):
        terms = estimate.nuisance[k]
        own = dense.x[n + k * (states + 2) :][: states + 2]
        assert terms.offset[0] == pytest.approx(own[-2] + _trim(estimate, record), abs=1e-3)
        assert terms.drift[0] == pytest.approx(own[-1], abs=1e-3)
        fitted = output(dense.x[:n], structure, record, own)
        assert estimate.predict(record, experiment=k)[:, 0] == pytest.approx(fitted, abs=1e-4)


def _trim(estimate, record):
    """The offset counts from the first input, that of the dense route from zero."""
    return float((estimate.model.dc_gain @ record.u[0])[0])


@SYSTEMS
@pytest.mark.fast("shared")
def test_a_record_cut_in_two_loses_nothing_but_the_states_at_the_cut(system):
    """The covariance is that of the whole with one more free response that begins at the cut."""
    _, _, states = system
    (whole,), structure = made(system, LOCALS[states][:1], (0.05,), (400,), noise=0.002)
    cut = 160
    parts = [Record(whole.u[:cut], whole.y[:cut], dt=0.05)]
    parts.append(Record(whole.u[cut:], whole.y[cut:], dt=0.05))
    both = identify(parts, structure, METHOD)
    theta, n = both.theta, both.theta.size
    columns = [np.zeros((400, 0))]
    terms = both.nuisance[0]
    moved = Record(whole.u - terms.input_reference, whole.y, dt=0.05)
    free = terms.free_response
    for h, e in zip(1e-6 * np.abs(theta), np.eye(n), strict=True):
        ahead = simulate(model_of(theta + h * e, structure), moved, free_response=free)
        behind = simulate(model_of(theta - h * e, structure), moved, free_response=free)
        columns.append((ahead - behind) / (2 * h))
    for first, last in ((0, 400), (cut, 400)):
        # the free response of the whole goes on beyond the cut; the other begins there
        late = Record(whole.u[first:last], whole.y[first:last], dt=0.05)
        nothing = model_of(np.where(_is_b(structure), 0.0, theta), structure)
        for k in range(states):
            c = free_of(np.eye(states)[k], structure)
            own = np.zeros((400, 1))
            own[first:last] = simulate(nothing, late, free_response=c)
            columns.append(own)
    for piece in (slice(0, cut), slice(cut, 400)):
        own = np.zeros((400, 2))
        own[piece, 0], own[piece, 1] = 1.0, np.arange(400)[piece]
        columns.append(own)
    jacobian = np.hstack(columns)
    size = np.linalg.norm(jacobian, axis=0)
    cov = np.linalg.inv((jacobian / size).T @ (jacobian / size)) / np.outer(size, size)
    std = np.sqrt(np.diag(cov)[:n] * both.noise_variance[0])
    assert both.std == pytest.approx(std, rel=1e-3)
    # and the estimate barely differs from that of the whole
    alone = identify(whole, structure, METHOD)
    assert np.all(both.std >= 0.97 * alone.std)
    assert np.all(np.abs(both.theta - alone.theta) < 2.0 * both.std)


def _is_b(structure):
    return np.array([name.startswith("b") for name in structure.names(["u1", "u2"], ["y"])])


@SYSTEMS
@pytest.mark.parametrize("steps", [(0.05, 0.05), (0.05, 0.08)], ids=["one step", "two steps"])
def test_long_experiments_go_through_the_stand_ins(system, steps):
    model, _, states = system
    records, structure = made(system, LOCALS[states][:2], steps, (6000, 4000), noise=0.3)
    base = build(records, structure, Nuisances("free", True, True))
    assert is_large(base)
    for small in (window(base), averaged(base)):
        assert not is_large(small)
        assert is_usable(small)
        assert small.groups == base.groups
    assert len(averaged(base).experiments) == 2
    estimate = identify(records, structure, METHOD)
    assert np.all(np.abs(estimate.theta - theta_of(model, structure)) < 4.5 * estimate.std)
    assert estimate.status.ok


def test_no_experiment_leaks_into_the_next():
    """Two records from rest are not one: what the first left behind is not seen by the second."""
    model = TransferFunction([2.0], [1.0, 0.3])
    u = np.concatenate([np.ones(60), -np.ones(40)])
    y = simulate(model, Record(u, u, dt=0.05))
    record = Record(u, y, dt=0.05)
    rest = Structure(1, 0, offset=False, initial_state="rest")
    estimate = identify([record, record], rest, METHOD)
    assert estimate.theta == pytest.approx([0.3, 2.0], rel=1e-10)
    assert estimate.n_samples == 200
    joined = Record(np.tile(u, 2), np.vstack([y, y]), dt=0.05)
    assert abs(identify(joined, rest, METHOD).theta[0] - 0.3) > 1e-3
