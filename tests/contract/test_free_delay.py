"""What a method promises with `Capability.FREE_DELAY`: delays with standard errors.

The yardstick is `simulate` with a known delay, whose exactness has tests of its own.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import (
    METHODS,
    Estimate,
    OutputError,
    Record,
    Structure,
    TransferFunction,
    identify,
    simulate,
)
from tridentify import errors as err
from tridentify.estimation.methods.capability import Capability

pytestmark = pytest.mark.unjudged

FLAG = Capability.FREE_DELAY
ABLE = [key for key, method in METHODS.items() if FLAG in method().capabilities]
one_of_them = pytest.mark.parametrize(
    "key", [ABLE[0], *(pytest.param(key, marks=pytest.mark.slow) for key in ABLE[1:])]
)
"""For what the search does, which they share; what differs is compared for each of them."""
UNABLE = [key for key in METHODS if key not in ABLE]
DT = 0.05
SECOND = ([2.0], [1.0, 1.0, 4.0])
REST = {"delay": "free", "offset": False, "initial_state": "rest"}
FREE = {"delay": "free", "offset": True, "initial_state": "free"}


def binary(n_samples, n_inputs=1, seed=3, hold=6):
    rng = np.random.default_rng(seed)
    signs = np.sign(rng.standard_normal((-(-n_samples // hold), n_inputs)))
    return np.repeat(signs, hold, axis=0)[:n_samples]


def made(model, *, n=400, dt=DT, noise=0.0, seed=0, intersample="zoh", u=None, offset=0.0):
    """A record of a model with delays."""
    u = binary(n, model.n_inputs) if u is None else u
    names = {
        "input_names": ["e", "r"][: model.n_inputs],
        "output_names": ["q", "v"][: model.n_outputs],
    }
    blank = Record(u, np.zeros((len(u), model.n_outputs)), dt=dt, intersample=intersample, **names)
    y = simulate(model, blank) + offset
    y = y + noise * np.std(y, axis=0) * np.random.default_rng(seed).standard_normal(y.shape)
    return Record(u, y, dt=dt, intersample=intersample, **names)


@pytest.mark.parametrize("key", UNABLE)
def test_a_method_without_the_flag_refuses(key):
    record = made(TransferFunction(*SECOND, delay=0.3))
    with pytest.raises(err.UnsupportedError, match=r"delay='free'"):
        identify(record, Structure(2, 0, delay="free"), METHODS[key]())


@pytest.mark.parametrize("key", ABLE)
@pytest.mark.parametrize(("num", "den"), [SECOND, ([2.0], [1.0, 1.5]), ([-1.0, 3.0], SECOND[1])])
@pytest.mark.parametrize(
    ("delay", "intersample"), [(0.0, "zoh"), (0.3, "zoh"), (0.337, "zoh"), (0.337, "foh")]
)
@pytest.mark.fast("0.3-zoh-num1-den1-three-model", "0.337-zoh-num2-den2-output-error")
def test_without_noise_the_delay_comes_back(key, num, den, delay, intersample):
    record = made(TransferFunction(num, den, delay=delay), intersample=intersample)
    structure = Structure(len(den) - 1, len(num) - 1, **REST)
    estimate = identify(record, structure, METHODS[key]())
    assert estimate.names[-1] == "delay"
    assert estimate.theta == pytest.approx([*den[1:], *num, delay], rel=1e-7, abs=1e-8)
    assert estimate.model.delay[0, 0] == estimate.theta[-1]
    assert estimate.parameters["delay"].unit == "s"


@one_of_them
@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.fast("1e-06-*")
def test_fast_and_slow_systems_alike(key, scale):
    num, den = np.array([2.0 * scale**2]), np.array([1.0, scale, 4.0 * scale**2])
    record = made(TransferFunction(num, den, delay=0.337 / scale), dt=DT / scale)
    estimate = identify(record, Structure(2, 0, **REST), METHODS[key]())
    assert estimate.theta == pytest.approx([*den[1:], *num, 0.337 / scale], rel=1e-7)


@one_of_them
@pytest.mark.slow
def test_every_input_has_a_delay_of_its_own(key):
    model = TransferFunction(
        [[[2.0], [1.0, 3.0]]], [[[1.0, 2.0], [1.0, 1.0, 4.0]]], delay=[[0.21, 0.6]]
    )
    record = made(model, n=600)
    separate = Structure([[1, 2]], [[0, 1]], **REST)
    estimate = identify(record, separate, METHODS[key]())
    assert estimate.names[-2:] == ("delay[e]", "delay[r]")
    assert estimate.theta == pytest.approx([2.0, 2.0, 1.0, 4.0, 1.0, 3.0, 0.21, 0.6], rel=1e-6)


@pytest.mark.slow
@one_of_them
def test_outputs_share_the_delay_of_the_input(key):
    den = [1.0, 1.0, 4.0]
    model = TransferFunction([[[2.0]], [[1.0, 3.0]]], [[den], [den]], delay=0.4)
    estimate = identify(made(model), Structure(2, [[0], [1]], **REST), METHODS[key]())
    assert estimate.theta == pytest.approx([1.0, 4.0, 2.0, 1.0, 3.0, 0.4], rel=1e-6)


@pytest.mark.parametrize("key", ABLE)
@pytest.mark.parametrize("options", [REST, FREE], ids=["rest", "free"])
@pytest.mark.fast("free-three-model", "rest-output-error")
def test_the_covariance_is_that_of_finite_differences_of_simulate(key, options):
    record = made(TransferFunction(*SECOND, delay=0.337), noise=0.1, offset=1.0 * options["offset"])
    estimate = identify(record, Structure(2, 0, **options), METHODS[key]())
    start = 0
    if options is FREE:
        start = int(np.argmax(np.isfinite(estimate.predict(record)[:, 0])))

    def output(theta):
        model = TransferFunction([theta[2]], [1.0, *theta[:2]], delay=theta[3])
        return simulate(model, record)[start:, 0]

    theta = np.array(estimate.theta)
    columns = [
        (output(theta + h * e) - output(theta - h * e)) / (2 * h)
        for h, e in zip(1e-6 * np.abs(theta), np.eye(4), strict=True)
    ]
    if options is FREE:
        late = Record(record.u[start:], record.y[start:], dt=DT)
        nothing = TransferFunction([0.0], [1.0, *theta[:2]])
        columns += [simulate(nothing, late, free_response=c)[:, 0] for c in np.eye(2)[:, None]]
        columns.append(np.ones(len(columns[0])))
    jacobian = np.stack(columns, axis=1)
    cov = estimate.noise_variance[0] * np.linalg.inv(jacobian.T @ jacobian)[:4, :4]
    size = np.sqrt(np.diag(cov))
    assert estimate.std == pytest.approx(size, rel=0.01)
    assert (estimate.cov - cov) / np.outer(size, size) == pytest.approx(0.0, abs=0.02)
    assert estimate.gradient < 1e-3


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3))])
@one_of_them
def test_a_delay_of_several_periods_is_no_trap(key, seed):
    """A light damping gives the cost a minimum along the delay for every period."""
    model = TransferFunction([9.0], [1.0, 0.3, 9.0], delay=5.3)
    record = made(model, n=800, noise=0.3, seed=seed)
    estimate = identify(record, Structure(2, 0, **REST), METHODS[key]())
    delay = estimate.parameters["delay"]
    assert abs(delay.value - 5.3) < 5 * delay.std < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("key", ABLE)
def test_an_output_ahead_of_the_input_gives_no_negative_delay(key):
    record = made(TransferFunction(*SECOND), noise=0.05)
    ahead = Record(np.roll(record.u, 4, axis=0), record.y, dt=DT)
    estimate = identify(ahead, Structure(2, 0, **REST), METHODS[key](), throw=False)
    assert estimate.parameters["delay"].value == pytest.approx(0.0, abs=1e-9)


@one_of_them
@pytest.mark.slow
def test_experiments_of_other_steps_share_the_delay(key):
    model = TransferFunction(*SECOND, delay=0.33)
    records = [made(model, noise=0.1, offset=2.0), made(model, n=200, dt=0.08, noise=0.1, seed=1)]
    together = identify(records, Structure(2, 0, **FREE), METHODS[key]())
    alone = identify(records[0], Structure(2, 0, **FREE), METHODS[key]())
    assert np.all(together.std < alone.std)
    assert abs(together.theta[-1] - 0.33) < 4 * together.std[-1]


@pytest.mark.judged
@pytest.mark.parametrize("key", ABLE)
def test_the_estimate_survives_a_file_and_predicts(key, tmp_path):
    record = made(TransferFunction(*SECOND, delay=0.337), noise=0.05)
    estimate = identify(record, Structure(2, 0, **REST), METHODS[key]())
    estimate.save(tmp_path / "model.json")
    again = Estimate.load(tmp_path / "model.json")
    assert again.structure.delay == "free"
    assert np.array_equal(again.predict(record), estimate.predict(record))
    assert np.std(estimate.residual(record)) == pytest.approx(0.05 * np.std(record.y), rel=0.15)
    assert "delay" in estimate.summary()


@pytest.mark.parametrize("key", ABLE)
def test_missing_samples_do_not_count(key):
    record = made(TransferFunction(*SECOND, delay=0.337), noise=0.05)
    y = np.array(record.y)
    y[50:90] = np.nan
    estimate = identify(Record(record.u, y, dt=DT), Structure(2, 0, **REST), METHODS[key]())
    assert abs(estimate.theta[-1] - 0.337) < 4 * estimate.std[-1]


@pytest.mark.judged
@one_of_them
@pytest.mark.slow
def test_a_fast_pole_that_a_delay_could_be_shows_in_the_standard_error(key):
    """A time constant of a fifth of a step, seen through noise: delay and pole trade places."""
    slow = TransferFunction([2.0], np.convolve([1.0, 1.5], [0.01, 1.0]) / 0.01, delay=0.3)
    record = made(TransferFunction(np.array([2.0]) / 0.01, slow.den[0][0], delay=0.3), noise=0.2)
    two = identify(record, Structure(2, 0, **REST), METHODS[key](), throw=False)
    one = identify(record, Structure(1, 0, **REST), METHODS[key]())
    assert abs(one.theta[-1] - 0.31) < 5 * one.std[-1]
    vague = two.parameters["a1"].relative_std > 0.5 or not two.status.ok
    assert vague or two.std[-1] > 1.5 * one.std[-1]
    if two.parameters["a1"].relative_std > 0.5:
        assert any("Standard error above half" in line for line in two.cautions)


@pytest.mark.parametrize("key", ABLE)
def test_as_many_zeros_as_poles_are_refused(key):
    record = made(TransferFunction(*SECOND, delay=0.3))
    with pytest.raises(err.UnsupportedError, match=r"as many zeros as poles.*delay in seconds"):
        identify(record, Structure(2, 2, **REST), METHODS[key]())


def test_a_start_with_a_delay_begins_there():
    record = made(TransferFunction(*SECOND, delay=0.337), noise=0.02)
    start = TransferFunction([2.0], [1.0, 1.2, 3.5], delay=0.3)
    near = identify(record, Structure(2, 0, **REST), OutputError(start=start))
    assert abs(near.theta[-1] - 0.337) < 4 * near.std[-1]
    assert near.trace.starts[0].name == "the start given"
