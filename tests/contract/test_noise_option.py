"""`ThreeModel(noise=...)`: coloured noise is found, said, and paid for in the standard errors.

The bound of generalised least squares is computed here, by filtering the scores with the true noise
model.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
import pickle
import random

import numpy as np
import pytest
from scipy.signal import lfilter

from oracles import binary, by_exponential
from tridentify import Estimate, Record, Structure, ThreeModel, TridentifyError, identify
from tridentify import errors as err

REST = {"offset": False, "initial_state": "rest"}
STRUCTURE = Structure(2, 1, **REST)
TRUTH = np.array([1.0, 3.0, 0.2, 0.5])
DT = 0.05
MODES = ("white", "ar", "auto")
every_mode = pytest.mark.parametrize("mode", MODES)
coloured = pytest.mark.parametrize("mode", ["ar", "auto"])
slow = pytest.mark.slow
pytestmark = pytest.mark.unjudged


def respond(theta, u, dt=DT, intersample="zoh"):
    return by_exponential(theta[2:], np.append(1.0, theta[:2]), u, dt, intersample)


def noise_of(d, n_samples, rng, c=(1.0,)):
    """Stationary noise c(q)/d(q) e, of standard deviation 1."""
    v = lfilter(c, d, rng.standard_normal(n_samples + 2000))[2000:]
    reply = lfilter(c, d, np.eye(1, 20_000)[0])
    return v / np.linalg.norm(reply)


SLOW, RINGING, ALTERNATING = (1.0, -0.9), (1.0, -1.6, 0.9), (1.0, 0.8)
WHITE = (1.0,)


def short_period(d=SLOW, noise=0.2, seed=0, n_samples=1500):
    u = binary(n_samples)
    y = respond(TRUTH, u)
    sigma = noise * np.std(y)
    return Record(u, y + sigma * noise_of(d, n_samples, np.random.default_rng(seed)), dt=DT)


@functools.cache
def solved(mode, d=SLOW, n_samples=800):
    """(record, estimate), estimated once for all tests."""
    record = short_period(d, n_samples=n_samples)
    return record, identify(record, STRUCTURE, ThreeModel(noise=mode))


def bound(record, sigma, d):
    """Standard errors of generalised least squares under the true noise model."""
    columns = []
    for k in range(4):
        step = np.zeros(4)
        step[k] = 1e-5
        up, down = respond(TRUTH + step, record.u[:, 0]), respond(TRUTH - step, record.u[:, 0])
        columns.append(lfilter(d, [1.0], up - down) / 2e-5)
    scores = np.stack(columns, axis=1)
    innovation = sigma / np.linalg.norm(lfilter([1.0], d, np.eye(1, 20_000)[0]))
    return innovation * np.sqrt(np.diag(np.linalg.inv(scores.T @ scores)))


def whitened(residual, coefficients):
    """What the coefficients leave over, as those of D(q) v = e or of v_k = sum phi_i v_{k-i}."""
    phi = np.asarray(coefficients, float)
    tried = [lfilter(np.append(1.0, s * phi), [1.0], residual)[phi.size :] for s in (-1.0, 1.0)]
    return min(tried, key=np.std)


def correlation(e, lags=10):
    e = e - e.mean()
    return np.array([e[k:] @ e[:-k] for k in range(1, lags + 1)]) / (e @ e)


# ---------------------------------------------------------------------------------- the option
def test_option_has_a_default_and_three_values():
    assert ThreeModel().noise in MODES
    assert [ThreeModel(noise=mode).noise for mode in MODES] == list(MODES)
    assert ThreeModel(noise="ar") != ThreeModel(noise="white")
    assert pickle.loads(pickle.dumps(ThreeModel(noise="ar"))) == ThreeModel(noise="ar")
    with pytest.raises(dataclasses.FrozenInstanceError):
        ThreeModel().noise = "ar"


@pytest.mark.parametrize(
    "value",
    ["pink", "AR", "", "white ", None, True, 2, math.nan, ["ar"], ("white", "ar"), b"ar"],
    ids=repr,
)
def test_other_noise_is_refused(value):
    with pytest.raises(err.OptionError) as caught:
        identify(short_period(n_samples=200), STRUCTURE, ThreeModel(noise=value))
    message = str(caught.value)
    assert "noise" in message
    assert "found" in message
    assert "expect" in message
    assert all(word in message for word in MODES)
    assert "\n" not in message


# --------------------------------------------------------------------------- what is reported
@every_mode
@pytest.mark.fast("auto", "white")
def test_noise_model_has_one_row_per_output(mode):
    _, found = solved(mode)
    assert len(found.noise_model) == 1
    row = np.asarray(found.noise_model[0], float)
    assert row.ndim == 1
    assert np.all(np.isfinite(row))
    assert row.size == 0 if mode == "white" else row.size >= 1


def test_noise_model_cannot_be_changed():
    _, found = solved("ar")
    with pytest.raises((ValueError, TypeError)):
        found.noise_model[0][0] = 0.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        found.noise_model = ()


COLOURS = {"slow": SLOW, "ringing": RINGING, "alternating": ALTERNATING}
CASES = [pytest.param("auto", "slow")]
CASES += [pytest.param("auto", name, marks=slow) for name in ("ringing", "alternating")]
CASES += [pytest.param("ar", name, marks=slow) for name in COLOURS]


@pytest.mark.parametrize(("mode", "colour"), CASES)
def test_noise_model_is_the_one_that_made_the_noise(mode, colour):
    d = COLOURS[colour]
    record, found = solved(mode, d, 2500)
    row = np.asarray(found.noise_model[0], float)
    assert row.size >= len(d) - 1
    few = np.abs(np.abs(row[: len(d) - 1]) - np.abs(d[1:]))
    assert np.all(few < 0.12), row
    left = whitened(found.residual(record)[:, 0], row)
    assert np.all(np.abs(correlation(left)) < 4.0 / np.sqrt(left.size))
    signs = [np.append(1.0, row), np.append(1.0, -row)]
    assert any(np.all(np.abs(np.roots(poly)) < 1.0) for poly in signs), "a stationary model"


@slow
def test_white_noise_is_left_white_by_auto():
    """A whiteness test may cry wolf now and then; not in three of twelve."""
    alarms = 0
    for seed in range(12):
        record = short_period(WHITE, seed=seed, n_samples=500)
        found = identify(record, STRUCTURE, ThreeModel(noise="auto"))
        alarms += len(found.noise_model[0]) > 0
        if not len(found.noise_model[0]):
            plain = identify(record, STRUCTURE, ThreeModel(noise="white"))
            assert np.array_equal(found.theta, plain.theta)
            assert np.array_equal(found.cov, plain.cov)
    assert alarms <= 3, alarms


@slow
def test_ar_on_white_noise_does_no_harm():
    record = short_period(WHITE)
    plain = identify(record, STRUCTURE, ThreeModel(noise="white"))
    found = identify(record, STRUCTURE, ThreeModel(noise="ar"))
    assert np.all(np.abs(found.theta - plain.theta) < 0.3 * plain.std)
    assert np.allclose(found.std, plain.std, rtol=0.1)


@pytest.mark.parametrize(("mode", "colour"), CASES)
def test_standard_errors_are_those_of_generalised_least_squares(mode, colour):
    d = COLOURS[colour]
    record, found = solved(mode, d, 2500)
    sigma = 0.2 * np.std(respond(TRUTH, record.u[:, 0]))
    expected = bound(record, sigma, d)
    assert np.allclose(found.std, expected, rtol=0.15), found.std / expected
    assert np.all(np.abs(found.theta - TRUTH) < 4.5 * found.std)
    plain = identify(record, STRUCTURE, ThreeModel(noise="white"))
    assert not np.allclose(plain.std, expected, rtol=0.15), "white noise must look wrong here"


@every_mode
def test_prediction_and_residual_stay_those_of_the_output(mode):
    record, found = solved(mode)
    clean = respond(found.theta, record.u[:, 0])
    assert np.allclose(found.predict(record)[:, 0], clean, atol=1e-9)
    spread = np.std(record.y)
    assert found.fit[0] == pytest.approx(
        100.0 * (1.0 - np.sqrt(np.mean((record.y[:, 0] - clean) ** 2)) / spread), rel=1e-6
    )


@coloured
def test_save_load_pickle_and_words_keep_the_noise_model(mode, tmp_path):
    _, found = solved(mode)
    found.save(tmp_path / "model.json")
    for again in (Estimate.load(tmp_path / "model.json"), pickle.loads(pickle.dumps(found))):
        assert len(again.noise_model) == 1
        assert np.array_equal(again.noise_model[0], found.noise_model[0])
        assert np.array_equal(again.cov, found.cov)
        assert again.summary() == found.summary()
    told = found.summary() + " ".join(found.trace.decisions) + " ".join(found.cautions)
    assert "noise" in told.lower()


@pytest.mark.slow
@pytest.mark.judged
def test_white_on_coloured_noise_is_cautioned_and_auto_is_not():
    record = short_period(n_samples=500)
    plain, found = (identify(record, STRUCTURE, ThreeModel(noise=n)) for n in ("white", "auto"))
    assert any("white" in line or "colour" in line for line in plain.cautions)
    assert not any("not white" in line for line in found.cautions), found.cautions


# ----------------------------------------------------------------------------- units and order
@pytest.mark.parametrize(("mode", "scale"), [("auto", 1e-9), ("ar", -1e7)])
def test_units_of_the_output_do_not_move_the_noise_model(mode, scale):
    record, plain = solved(mode)
    found = identify(Record(record.u, scale * record.y, dt=DT), STRUCTURE, ThreeModel(noise=mode))
    assert len(found.noise_model[0]) == len(plain.noise_model[0])
    assert np.allclose(found.noise_model[0], plain.noise_model[0], atol=1e-4)
    assert np.allclose(found.noise_variance, scale**2 * plain.noise_variance, rtol=1e-3)
    factor = np.array([1.0, 1.0, scale, scale])
    assert np.all(np.abs(found.theta / factor - plain.theta) < 0.01 * plain.std)


@pytest.mark.parametrize(("mode", "faster"), [("auto", 1e6), ("ar", 1e-6)])
def test_unit_of_time_does_not_move_the_noise_model(mode, faster):
    record, plain = solved(mode)
    quick = identify(Record(record.u, record.y, dt=DT / faster), STRUCTURE, ThreeModel(noise=mode))
    factor = faster ** np.array([1.0, 2.0, 1.0, 2.0])
    assert np.all(np.abs(quick.theta / factor - plain.theta) < 0.01 * plain.std)
    assert np.allclose(quick.noise_model[0], plain.noise_model[0], atol=1e-4)


@slow
@coloured
def test_every_output_has_noise_of_its_own(mode):
    u, rng = binary(3000), np.random.default_rng(3)
    clean = np.stack([respond(TRUTH, u), respond([1.0, 3.0, 0.0, 4.0], u)], axis=1)
    added = np.stack([noise_of(WHITE, 3000, rng), noise_of(RINGING, 3000, rng)], axis=1)
    record = Record(u, clean + 0.1 * np.std(clean, axis=0) * added, dt=DT)
    structure = Structure(2, [[1], [0]], **REST)
    found = identify(record, structure, ThreeModel(noise=mode))
    assert len(found.noise_model) == 2
    assert np.all(np.abs(found.theta - [1.0, 3.0, 0.2, 0.5, 4.0]) < 4.5 * found.std)
    assert np.all(np.abs(np.abs(found.noise_model[1][:2]) - [1.6, 0.9]) < 0.12)
    assert np.all(np.abs(found.noise_model[0]) < 0.12)
    turned = Record(u, record.y[:, ::-1], dt=DT)
    other = identify(turned, Structure(2, [[0], [1]], **REST), ThreeModel(noise=mode))
    assert [len(row) for row in other.noise_model] == [len(row) for row in found.noise_model][::-1]


@slow
@coloured
def test_two_records_share_one_noise_model_and_do_not_run_into_each_other(mode):
    """The second record starts far away: a filter that runs over the seam would ring there."""
    first = short_period(seed=1)
    second = Record(first.u, short_period(seed=2).y + 50.0, dt=DT)
    structure = Structure(2, 1, offset=True, initial_state="rest")
    found = identify([first, second], structure, ThreeModel(noise=mode))
    assert len(found.noise_model) == 1
    assert abs(abs(found.noise_model[0][0]) - 0.9) < 0.1
    assert np.all(np.abs(found.theta - TRUTH) < 4.5 * found.std)
    assert abs(found.nuisance[1].offset[0] - 50.0) < 0.2


# ----------------------------------------------------------------------------------- hard cases
@every_mode
@pytest.mark.parametrize("intersample", ["zoh", pytest.param("foh", marks=slow)])
def test_record_without_noise_is_exact_in_every_mode(mode, intersample):
    u = binary(400)
    y = respond(TRUTH, u, DT, intersample)
    record = Record(u, y, dt=DT, intersample=intersample)
    found = identify(record, STRUCTURE, ThreeModel(noise=mode))
    assert np.allclose(found.theta, TRUTH, rtol=1e-6)
    assert np.all(np.isfinite(found.std))


@slow
@coloured
def test_missing_samples_are_left_out_or_refused(mode):
    record = short_period(n_samples=2000)
    y = record.y[:, 0].copy()
    y[300:340] = np.nan
    y[1000::37] = np.nan
    try:
        found = identify(Record(record.u, y, dt=DT), STRUCTURE, ThreeModel(noise=mode))
    except TridentifyError as refusal:
        message = str(refusal)
    else:
        assert np.all(np.isfinite(found.std))
        assert np.all(np.abs(found.theta - TRUTH) < 4.5 * found.std)
        assert abs(abs(found.noise_model[0][0]) - 0.9) < 0.15
        return
    assert "missing" in message or "nan" in message


@pytest.mark.parametrize(
    ("mode", "n_samples"),
    [("ar", 6), ("auto", 9), ("auto", 15)]
    + [pytest.param(mode, n, marks=slow) for mode in ("ar", "auto") for n in (8, 12, 30, 60)],
)
@pytest.mark.fast("auto-9", "ar-6")
def test_short_records_get_a_short_noise_model_or_none(mode, n_samples):
    record = short_period(n_samples=n_samples)
    try:
        found = identify(record, STRUCTURE, ThreeModel(noise=mode), throw=False)
    except TridentifyError as refusal:
        message = str(refusal)
        assert "\n" not in message
        return
    assert len(found.noise_model[0]) <= n_samples // 3
    assert np.all(np.isfinite(found.theta))
    assert np.all(np.isfinite(found.noise_model[0]))


HARD = {
    "a random walk": lambda rng, n: np.cumsum(rng.standard_normal(n)) / 10.0,
    "moving average": lambda rng, n: noise_of(WHITE, n, rng, (1.0, 0.9)),
    "zero on the circle": lambda rng, n: noise_of(WHITE, n, rng, (1.0, -1.0)),
    "a pure tone": lambda rng, n: np.sin(1.7 * np.arange(n)),
    "mains hum and hiss": lambda rng, n: np.sin(0.9 * np.arange(n)) + 0.1 * rng.standard_normal(n),
    "one spike": lambda rng, n: 30.0 * np.eye(n)[n // 2],
    "a quantised output": lambda rng, n: np.round(rng.standard_normal(n)),
    "heavy tails": lambda rng, n: rng.standard_t(2, n),
    "a ramp": lambda rng, n: np.linspace(-1.0, 1.0, n),
}


FAST = ("a pure tone", "a ramp")


@pytest.mark.parametrize(
    ("mode", "case"),
    [("ar", case) for case in FAST]
    + [
        pytest.param(mode, case, marks=slow)
        for mode, case in itertools.product(["ar", "auto"], HARD)
        if not (mode == "ar" and case in FAST)
    ],
)
@pytest.mark.fast("ar-a pure tone")
def test_noise_of_other_kinds_ends_in_an_answer_or_a_refusal(mode, case):
    u = binary(400)
    y = respond(TRUTH, u)
    y = y + 0.3 * np.std(y) * HARD[case](np.random.default_rng(2), 400)
    try:
        found = identify(Record(u, y, dt=DT), STRUCTURE, ThreeModel(noise=mode), throw=False)
    except TridentifyError as refusal:
        message = str(refusal)
        assert "\n" not in message
        return
    assert np.all(np.isfinite(found.theta))
    assert np.all(np.isfinite(found.noise_model[0]))
    assert np.all(found.noise_variance > 0)


@slow
@coloured
def test_offset_and_drift_go_along_with_coloured_noise(mode):
    plain = short_period(noise=0.1, n_samples=2000)
    record = Record(plain.u, plain.y + 3.0 + 0.01 * plain.t[:, None], dt=DT)
    structure = Structure(2, 1, offset=True, drift=True, initial_state="free")
    found = identify(record, structure, ThreeModel(noise=mode))
    assert np.all(np.abs(found.theta - TRUTH) < 4.5 * found.std)
    assert found.nuisance[0].drift[0] == pytest.approx(0.01, abs=0.003)


@coloured
def test_no_chance_and_no_trace_left_behind(mode):
    record, one = solved(mode)
    before, plain = np.random.get_state(), random.getstate()  # noqa: NPY002
    two = identify(record, STRUCTURE, ThreeModel(noise=mode))
    after = np.random.get_state()  # noqa: NPY002
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    assert random.getstate() == plain
    assert np.array_equal(one.theta, two.theta)
    assert np.array_equal(one.cov, two.cov)
    assert np.array_equal(one.noise_model[0], two.noise_model[0])
