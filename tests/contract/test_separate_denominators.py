"""What a method promises with `Capability.SEPARATE_DENOMINATORS`: every channel its own poles.

The yardstick is a simulation of its own (companion forms, one matrix exponential a channel) and
`scipy.optimize.least_squares` on it, started from the truth.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter

from tridentify import (
    METHODS,
    Estimate,
    OutputError,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    identify,
)
from tridentify import errors as err
from tridentify.estimation.methods.capability import Capability

pytestmark = pytest.mark.unjudged

FLAG = Capability.SEPARATE_DENOMINATORS
ABLE = [key for key, method in METHODS.items() if FLAG in method().capabilities]
UNABLE = [key for key in METHODS if key not in ABLE]
DT = 0.05

MISO = (
    [[[2.0], [1.0, 3.0]]],
    [[[1.0, 2.0], [1.0, 1.0, 4.0]]],
)
SQUARE = (
    [[[2.0], [1.0, 3.0]], [[1.0, 2.0, 1.0], [0.5, 1.0]]],
    [[[1.0, 2.0], [1.0, 1.0, 4.0]], [[1.0, 3.0, 5.0, 2.0], [1.0, 0.7]]],
)
REST = {"offset": False, "initial_state": "rest"}
FREE = {"offset": True, "initial_state": "free"}


def channel(num, den, u, dt, intersample, c_0=None):
    """Response of one channel, and of an initial state with numerator ``c_0``."""
    n = len(den) - 1
    a = np.zeros((n, n))
    a[0] = -np.asarray(den[1:])
    a[1:, :-1] = np.eye(n - 1)
    b = np.eye(n)[0]
    row = np.pad(np.asarray(num, float), (n + 1 - len(num), 0))
    direct, row = row[0], row[1:] - row[0] * np.asarray(den[1:])
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n], block[n, n + 1] = a * dt, b * dt, 1.0
    step = expm(block)
    held, ramp = step[:n, n], step[:n, n + 1]
    slope = np.append(np.diff(u), 0.0) if intersample == "foh" else np.zeros(u.size)
    z, modes = np.linalg.eig(step[:n, :n])
    y = direct * u.astype(complex)
    for k, pole in enumerate(z):
        back = np.linalg.inv(modes)[k]
        drive = (back @ held) * u + (back @ ramp) * slope
        y += (row @ modes[:, k]) * lfilter([0.0, 1.0], [1.0, -pole], drive)
        if c_0 is not None:
            pulse = (back @ b) * np.eye(1, u.size)[0]
            y += (np.asarray(c_0) @ modes[:, k]) * lfilter([1.0], [1.0, -pole], pulse)
    return y.real


def split(theta, structure, shape):
    """``[output][input]`` of (den, num), by the order of the names."""
    found, at = [], 0
    poles, zeros = structure.poles_matrix(*shape), structure.zeros_matrix(*shape)
    for i in range(shape[0]):
        line = []
        for j in range(shape[1]):
            n, m = poles[i][j], zeros[i][j]
            line.append((np.append(1.0, theta[at : at + n]), theta[at + n : at + n + m + 1]))
            at += n + m + 1
        found.append(line)
    return found, at


def response(theta, structure, u, dt, shape, intersample="zoh"):
    """All outputs for ``(coefficients, then for each output: free numerators, offset)``."""
    channels, at = split(theta, structure, shape)
    y = np.zeros((len(u), shape[0]))
    for i, line in enumerate(channels):
        for j, (den, num) in enumerate(line):
            c_0 = None
            if structure.initial_state == "free":
                c_0 = theta[at : at + den.size - 1]
                at += den.size - 1
            y[:, i] += channel(num, den, u[:, j], dt, intersample, c_0)
        if structure.offset:
            y[:, i] += theta[at]
            at += 1
    return y


def flat(num, den):
    rows = [
        np.append(d[1:], b)
        for n, e in zip(num, den, strict=True)
        for b, d in zip(n, e, strict=True)
    ]
    return np.concatenate(rows)


def orders(num, den, **options):
    poles = [[len(d) - 1 for d in row] for row in den]
    zeros = [[len(b) - 1 for b in row] for row in num]
    return Structure(poles, zeros, **options)


def binary(n_samples, n_inputs, seed=3, hold=5):
    rng = np.random.default_rng(seed)
    signs = np.sign(rng.standard_normal((-(-n_samples // hold), n_inputs)))
    return np.repeat(signs, hold, axis=0)[:n_samples]


def record_of(system, structure, *, n=400, dt=DT, noise=0.0, seed=0, intersample="zoh", extra=None):
    """A record, and all that it was made of."""
    num, den = system
    shape = (len(num), len(num[0]))
    u = binary(n, shape[1])
    truth = flat(num, den)
    if extra is not None:
        truth = np.append(truth, extra)
    y = response(truth, structure, u, dt, shape, intersample)
    level = np.broadcast_to(noise, (shape[0],))
    y = y + level * np.random.default_rng(seed).standard_normal(y.shape)
    units = {"e": "rad", "r": "rad", "q": "rad/s"}
    names = {"input_names": ["e", "r"][: shape[1]], "output_names": ["q", "v"][: shape[0]]}
    kept = {k: v for k, v in units.items() if k in (*names["input_names"], *names["output_names"])}
    return Record(u, y, dt=dt, intersample=intersample, units=kept, **names), truth


def dense(record, structure, truth, shape, level):
    """Maximum-likelihood end and Cramer-Rao standard errors, by finite differences."""

    def error(theta):
        y = response(theta, structure, np.asarray(record.u), record.dt, shape, record.intersample)
        return ((y - record.y) / level).ravel()

    found = least_squares(error, truth, x_scale=np.abs(truth) + 1e-3, xtol=1e-14, ftol=1e-14)
    steps = 1e-6 * (np.abs(found.x) + 1e-2)
    jacobian = np.stack(
        [
            (error(found.x + h * e) - error(found.x - h * e)) / (2 * h)
            for h, e in zip(steps, np.eye(found.x.size), strict=True)
        ],
        axis=1,
    )
    return found.x, np.linalg.inv(jacobian.T @ jacobian)


@pytest.mark.parametrize("key", UNABLE)
def test_a_method_without_the_flag_refuses(key):
    record, _ = record_of(MISO, orders(*MISO, **REST))
    with pytest.raises(err.UnsupportedError, match=r"separate denominators.*one number"):
        identify(record, orders(*MISO), METHODS[key]())


@pytest.mark.parametrize("key", ABLE)
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("system", [MISO, SQUARE], ids=["two inputs", "two by two"])
def test_without_noise_the_truth_comes_back(key, system, intersample):
    structure = orders(*system, **REST)
    record, truth = record_of(system, structure, intersample=intersample)
    estimate = identify(record, structure, METHODS[key]())
    assert estimate.names == structure.names(record.input_names, record.output_names)
    assert estimate.theta == pytest.approx(truth, rel=1e-9)
    for i in range(record.n_outputs):
        for j in range(2):
            assert estimate.model.den[i][j] == pytest.approx(system[1][i][j], rel=1e-9)
            assert estimate.model.num[i][j] == pytest.approx(system[0][i][j], rel=1e-9)


@pytest.mark.parametrize("key", ABLE)
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_fast_and_slow_systems_alike(key, scale):
    system = (
        [[np.multiply([2.0], scale), np.multiply([1.0, 3.0], [scale, scale**2])]],
        [[np.array([1.0, 2.0 * scale]), np.array([1.0, scale, 4.0 * scale**2])]],
    )
    structure = orders(*system, **REST)
    record, truth = record_of(system, structure, dt=DT / scale)
    assert identify(record, structure, METHODS[key]()).theta == pytest.approx(truth, rel=1e-9)


EXTRA = np.array([0.5, -0.4, 1.1, 3.0, 0.7, 0.2, -0.6, 0.9, -1.0])


@pytest.mark.parametrize("key", ABLE)
def test_free_initial_states_and_offsets_are_those_of_each_channel(key, tmp_path):
    structure = orders(*SQUARE, **FREE)
    record, truth = record_of(SQUARE, structure, extra=EXTRA)
    near = TransferFunction(
        SQUARE[0],
        [[d * np.array([1.0, 1.3, 1.3, 1.3])[: len(d)] for d in row] for row in SQUARE[1]],
    )
    # a single start has no search that finds the way to it
    method = OutputError(start=near) if key == "output-error" else METHODS[key]()
    estimate = identify(record, structure, method)
    assert estimate.theta == pytest.approx(truth[: estimate.theta.size], rel=1e-8)
    assert estimate.predict(record) == pytest.approx(np.asarray(record.y), abs=1e-9)
    assert estimate.nuisance[0].free_response.shape == (2, 2, 3)
    estimate.save(tmp_path / "model.json")
    again = Estimate.load(tmp_path / "model.json")
    assert np.array_equal(again.predict(record), estimate.predict(record))
    assert again.structure == estimate.structure


@functools.cache
def noisy(options):
    """A noisy two-by-two record with noise 100:1, and its dense solution."""
    structure = orders(*SQUARE, **dict(options))
    extra = EXTRA if structure.offset else None
    level = np.array([0.2, 0.002])
    record, truth = record_of(SQUARE, structure, noise=level, extra=extra, n=300)
    return record, structure, level, truth


@pytest.mark.slow
@pytest.mark.parametrize("key", ABLE)
@pytest.mark.parametrize("options", [REST, FREE], ids=["rest", "free"])
def test_the_end_and_its_covariance_are_those_of_a_dense_route(key, options):
    record, structure, _, truth = noisy(tuple(options.items()))
    plain = {"noise": "white", "finish": "likelihood"} if key == "three-model" else {}
    estimate = identify(record, structure, METHODS[key](**plain))
    n = estimate.theta.size
    # the likelihood weights every output by its own residual
    level = np.sqrt(np.mean(estimate.residual(record) ** 2, axis=0))
    best, _ = dense(record, structure, truth, (2, 2), level)
    assert estimate.theta == pytest.approx(best[:n], abs=2e-3 * estimate.std.max(), rel=1e-4)
    assert np.all(np.abs(estimate.theta - best[:n]) < 1e-2 * estimate.std)
    level = np.sqrt(estimate.noise_variance)
    _, cov = dense(record, structure, best, (2, 2), level)
    size = np.sqrt(np.diag(cov)[:n])
    assert estimate.std == pytest.approx(size, rel=1e-3)
    assert (estimate.cov - cov[:n, :n]) / np.outer(size, size) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("key", ABLE)
def test_missing_samples_of_one_output_do_not_count(key):
    record, structure, _, truth = noisy(tuple(REST.items()))
    y = np.array(record.y)
    y[40:60, 0] = np.nan
    y[::7, 1] = np.nan
    names = {"input_names": record.input_names, "output_names": record.output_names}
    holed = Record(record.u, y, dt=DT, **names)
    estimate = identify(holed, structure, METHODS[key]())
    level = np.sqrt(np.nanmean(estimate.residual(holed) ** 2, axis=0))
    seen = np.isfinite(y)

    def error(theta):
        fitted = response(theta, structure, np.asarray(record.u), DT, (2, 2))
        return ((fitted - y) / level)[seen]

    best = least_squares(error, truth, x_scale=np.abs(truth), xtol=1e-14, ftol=1e-14).x
    assert np.all(np.abs(estimate.theta - best) < 0.05 * estimate.std)


@pytest.mark.parametrize("key", ABLE)
def test_one_channel_nested_is_the_plain_case(key):
    u = binary(300, 1)
    y = channel([2.0], [1.0, 1.0, 4.0], u[:, 0], DT, "zoh")
    y = y + 0.05 * np.random.default_rng(0).standard_normal(300)
    record = Record(u, y, dt=DT)
    nested = identify(record, Structure([[2]], [[0]], **REST), METHODS[key]())
    plain = identify(record, Structure(2, 0, **REST), METHODS[key]())
    assert nested.names == plain.names == ("a1", "a0", "b0")
    assert np.all(np.abs(nested.theta - plain.theta) < 1e-3 * plain.std)
    assert nested.status is plain.status


@pytest.mark.judged
@pytest.mark.parametrize("key", ABLE)
def test_derived_quantities_and_summary_name_the_channels(key):
    structure = orders(*MISO, **REST)
    record, _ = record_of(MISO, structure, noise=0.05)
    estimate = identify(record, structure, METHODS[key]())
    rows = {row[0]: row for row in estimate.derived_rows()}
    assert rows["real pole[q,e]"][1] == pytest.approx(-2.0, abs=5 * rows["real pole[q,e]"][2])
    assert rows["natural frequency[q,r]"][1] == pytest.approx(2.0, rel=0.05)
    assert {"dc gain[q,e]", "dc gain[q,r]", "damping[q,r]"} <= rows.keys()
    text = estimate.summary()
    assert "a0[q,e]" in text
    assert "q / r =" in text
    assert estimate.parameters["a1[q,r]"].unit == "1/s"
    assert estimate.parameters["b0[q,e]"].std > 0


@pytest.mark.parametrize("key", ABLE)
def test_experiments_of_other_steps_lengths_and_trims(key):
    structure = orders(*MISO, **FREE)
    first, truth = record_of(MISO, structure, noise=0.03, extra=[0.5, 0.3, -0.2, 2.0])
    second, _ = record_of(
        MISO, structure, n=250, dt=0.08, noise=0.03, seed=1, extra=[-0.5, 0.1, 0.4, -1.0]
    )
    together = identify([first, second], structure, METHODS[key]())
    alone = identify(first, structure, METHODS[key]())
    assert np.all(together.std < alone.std)
    assert np.all(np.abs(together.theta - truth[:6]) < 5 * together.std)
    assert together.nuisance[0].offset[0] == pytest.approx(2.0, abs=0.5)
    for k, record in enumerate((first, second)):
        assert np.std(together.residual(record, experiment=k)) == pytest.approx(0.03, rel=0.15)


@pytest.mark.parametrize("key", ABLE)
def test_nested_orders_for_other_channels_are_refused(key):
    record, _ = record_of(MISO, orders(*MISO, **REST))
    with pytest.raises(err.ChannelCountError, match="outputs"):
        identify(record, Structure([[1], [2]], [[0], [0]]), METHODS[key]())


@pytest.mark.parametrize("key", ABLE)
def test_too_many_poles_in_one_channel_are_refused(key):
    record, _ = record_of(MISO, orders(*MISO, **REST))
    with pytest.raises(err.UnsupportedOrderError, match="at most"):
        identify(record, Structure([[1, 25]], [[0, 1]]), METHODS[key]())


@pytest.mark.parametrize("key", ABLE)
def test_fewer_samples_than_unknowns_are_refused(key):
    structure = orders(*SQUARE, **FREE)
    rng = np.random.default_rng(0)
    record = Record(rng.standard_normal((12, 2)), rng.standard_normal((12, 2)), dt=DT)
    with pytest.raises(err.TooFewSamplesError, match="record longer"):
        identify(record, structure, METHODS[key]())


def test_a_start_for_other_orders_is_refused():
    record, _ = record_of(MISO, orders(*MISO, **REST))
    start = TransferFunction([[[1.0], [1.0]]], [[[1.0, 1.0], [1.0, 3.0]]])
    with pytest.raises(err.OptionError, match=r"start with 1 poles for a structure with 2"):
        identify(record, orders(*MISO, **REST), OutputError(start=start))
    with pytest.raises(err.OptionError, match="different denominators"):
        identify(record, Structure(1, 0, **REST), OutputError(start=start))


def test_a_start_with_separate_denominators_is_used():
    structure = orders(*MISO, **REST)
    record, truth = record_of(MISO, structure)
    start = TransferFunction([[[1.0], [1.0]]], [[[1.0, 3.0], [1.0, 2.0, 3.0]]])
    estimate = identify(record, structure, OutputError(start=start))
    assert estimate.theta == pytest.approx(truth, rel=1e-9)
    assert estimate.trace.starts[0].name == "the start given"


def test_the_posterior_is_not_taken_and_that_is_said():
    structure = orders(*MISO, **REST)
    record, _ = record_of(MISO, structure, noise=1.0, n=120)
    estimate = identify(record, structure, ThreeModel(finish="posterior"), throw=False)
    assert any("shared denominator and known delays" in line for line in estimate.trace.decisions)
    assert estimate.draws.shape == (0, 6)
