"""Other rates: two rates in one record, interpolation, decimation, band-limited inputs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify import Record, Structure, TransferFunction, errors, identify, simulate
from tridentify.estimation.methods.output_error import OutputError
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.numerics.interpolation import between, lowpass, moments
from tridentify.numerics.realization import cascade
from tridentify.numerics.sampled import Sampled, States

pytestmark = pytest.mark.unjudged

PLANT = TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0])
TRUTH = [1.0, 3.0, 0.2, 0.5]
WHITE = ThreeModel(noise="white")


def binary(n, hold=5, seed=1):
    signs = np.sign(np.random.default_rng(seed).standard_normal(-(-n // hold)))
    return np.repeat(signs, hold)[:n]


# ------------------------------------------------------------------------------ two rates
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_slow_outputs_are_the_fast_ones_at_their_instants(intersample):
    rng = np.random.default_rng(2)
    u = binary(601)
    whole = Record(u, u, dt=0.05, intersample=intersample)
    y = simulate(PLANT, whole) + 0.02 * rng.standard_normal((601, 1))
    slow = Record.from_rates(u, y[::4], u_dt=0.05, y_dt=0.2, intersample=intersample)
    holes = np.full_like(y, np.nan)
    holes[::4] = y[::4]
    restricted = Record(u, holes, dt=0.05, intersample=intersample)
    assert slow.dt == pytest.approx(0.05)
    found = [identify(r, Structure(2, 1), WHITE) for r in (slow, restricted)]
    assert found[0].theta == pytest.approx(found[1].theta, rel=1e-12)
    assert np.all(np.abs(found[0].theta - TRUTH) < 5.0 * found[0].std)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize(("y_dt", "y_start"), [(0.07, 0.0), (0.1, 0.013), (0.02, 0.0)])
@pytest.mark.fast("0.07-0.0-foh", "0.07-0.0-zoh")
def test_rates_without_a_common_multiple_are_exact(intersample, y_dt, y_start):
    """Outputs between the inputs: the truth without noise, from the instants of both."""
    u = binary(400)
    end = 0.05 * 399
    times = y_start + y_dt * np.arange(int((end - y_start) / y_dt))
    every = np.union1d(0.05 * np.arange(400), np.round(times, 12))
    inputs = np.interp(every, 0.05 * np.arange(400), u)
    if intersample == "zoh":
        inputs = u[np.searchsorted(0.05 * np.arange(400) - 1e-9, every, side="right") - 1]
    y = simulate(PLANT, Record(inputs, inputs, t=every, intersample=intersample))[:, 0]
    at = np.searchsorted(every, times - 1e-9)
    record = Record.from_rates(
        u, y[at], u_dt=0.05, y_dt=y_dt, y_start=y_start, intersample=intersample
    )
    assert np.isfinite(record.y).sum() == times.size
    assert identify(record, Structure(2, 1)).theta == pytest.approx(TRUTH, rel=1e-8)


def test_outputs_without_input_are_refused():
    for start, n in ((-0.1, 5), (0.0, 60), (9.0, 60)):
        with pytest.raises(errors.LengthMismatchError, match="inputs wherever"):
            Record.from_rates(np.ones(50), np.ones(n), u_dt=0.1, y_dt=0.1, y_start=start)
    with pytest.raises(errors.SamplingError):
        Record.from_rates(np.ones(50), np.ones(5), u_dt=0.1, y_dt=0.0)
    with pytest.raises(errors.NonUniformTimeError, match="band-limited"):
        Record.from_rates(np.ones(50), np.ones(5), u_dt=0.1, y_dt=0.15, intersample="band-limited")


# ---------------------------------------------------------------------------- interpolation
def test_interpolation_keeps_inputs_and_leaves_gaps_open():
    t = np.array([0.0, 0.1, 0.2, 0.35, 0.4, 2.0, 2.1])
    record = Record(np.arange(7.0), 10.0 * t, t=t)
    with pytest.warns(errors.DataWarning, match="interpolation"):
        even = record.resample(0.1)
    assert even.dt == pytest.approx(0.1)
    expected = np.where((even.t > 0.41) & (even.t < 1.99), np.nan, 10.0 * even.t)
    assert even.y[:, 0] == pytest.approx(expected, nan_ok=True)
    assert even.u[:6, 0].tolist() == [0.0, 1.0, 2.0, 2.0, 4.0, 4.0]


def test_interpolation_does_not_invent_missing_samples():
    record = Record(np.zeros(5), [0.0, np.nan, 2.0, 3.0, 4.0], t=[0.0, 1.0, 2.1, 3.0, 4.0])
    with pytest.warns(errors.DataWarning):
        even = record.resample(0.5)
    assert np.isnan(even.y[1:5, 0]).all()
    assert np.isfinite(even.y[[0, 5, 6, 7, 8], 0]).all()


# ------------------------------------------------------------------------------- decimation
@pytest.mark.parametrize("intersample", ["zoh", "foh", "band-limited"])
def test_the_filters_are_one_function_of_time(intersample):
    """A held sine is late by half a sample and lower: the filtered samples know it."""
    t = np.arange(3000.0)
    omega = 0.12
    weights = lowpass(8, intersample)
    half = weights.size // 2
    found = np.convolve(np.exp(1j * omega * t), weights[::-1], mode="valid")
    gain = found[0] / np.exp(1j * omega * half)
    plain = np.exp(1j * omega * (np.arange(weights.size) - half)) @ lowpass(8, "band-limited")
    shape = {
        "zoh": np.sinc(omega / 2 / np.pi) * np.exp(-0.5j * omega),
        "foh": np.sinc(omega / 2 / np.pi) ** 2,
        "band-limited": 1.0,
    }
    assert gain == pytest.approx(plain * shape[intersample], abs=2e-4)


def test_aliases_are_gone():
    t = np.arange(4000) * 0.01
    high = np.sin(2 * np.pi * 9.0 * t)  # above the new Nyquist rate of 5 Hz
    thin = Record(high, high, dt=0.01, intersample="band-limited").decimate(10)
    assert np.nanmax(np.abs(thin.y)) < 1e-3


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.fast("zoh")
def test_decimation_keeps_the_model(intersample):
    rng = np.random.default_rng(3)
    u = binary(20_000, 37)
    y = simulate(PLANT, Record(u, u, dt=0.01, intersample=intersample))
    record = Record(u, y + 0.05 * rng.standard_normal(y.shape), dt=0.01, intersample=intersample)
    thin = record.decimate(8)
    assert (thin.dt, thin.intersample) == (pytest.approx(0.08), "band-limited")
    estimate = identify(thin, Structure(2, 1), WHITE)
    assert np.all(np.abs(estimate.theta - TRUTH) < 5.0 * estimate.std)
    assert estimate.theta == pytest.approx(TRUTH, rel=0.03)
    held = Record(thin.u, thin.y, dt=thin.dt)  # what half a step of delay would do
    wrong = identify(held, Structure(2, 1), WHITE)
    assert np.abs(wrong.theta - TRUTH).max() > 3.0 * np.abs(estimate.theta - TRUTH).max()


def test_missing_samples_spread_as_far_as_the_filter():
    y = np.sin(0.01 * np.arange(4000))
    y[2000] = np.nan
    thin = Record(np.ones(4000), y, dt=1.0).decimate(4)
    reach = lowpass(4, "band-limited").size // 2
    lost = np.flatnonzero(np.isnan(thin.y[:, 0])) * 4
    inside = lost[(lost > 1000) & (lost < 3000)]
    assert np.abs(inside - 2000).max() <= reach
    assert np.abs(inside - 2000).max() > reach - 4


@pytest.mark.parametrize(
    ("make", "factor", "error"),
    [
        (lambda: Record(np.ones(900), np.ones(900), dt=1.0), 1, errors.OptionError),
        (lambda: Record(np.ones(900), np.ones(900), dt=1.0), 2.5, errors.OptionError),
        (lambda: Record(np.ones(60), np.ones(60), dt=1.0), 4, errors.ResampleError),
        (lambda: Record(np.ones(3), np.ones(3), t=[0, 1, 5]), 2, errors.ResampleError),
    ],
)
def test_decimation_that_makes_no_sense_is_refused(make, factor, error):
    with pytest.raises(error, match="expected"):
        make().decimate(factor)


# ----------------------------------------------------------------------------- band-limited
def multisine(t, top, seed=0, count=25):
    rng = np.random.default_rng(seed)
    omega = np.linspace(0.02, top, count)
    phase = rng.uniform(0, 2 * np.pi, count)
    return np.cos(np.multiply.outer(t, omega) + phase).sum(axis=-1), omega, phase


def test_moments_are_integrals():
    bank = cascade(np.array([-0.8, -1 + 2j, -1 - 2j]))
    x, w = np.polynomial.legendre.leggauss(40)
    places = 0.5 + 0.5 * x
    expected = sum(
        0.05 * share * np.outer(expm(bank.a * 0.1 * (1 - s)) @ bank.b, s ** np.arange(14))
        for s, share in zip(places, w, strict=True)
    )
    assert np.abs(moments(bank.a, bank.b, 0.1)[1] - expected).max() < 1e-15


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.037, 0.777])
def test_states_of_a_multisine(delay):
    """Steady states of a band-limited input, far more exact than straight lines."""
    h, n = 0.1, 500
    bank = cascade(np.array([-0.8, -1 + 2j, -1 - 2j, -6.0]))
    t = np.arange(n) * h
    u, omega, phase = multisine(t, 0.6 * np.pi / h)
    exact = np.zeros((4, n))
    for w, p in zip(omega, phase, strict=True):
        gain = np.linalg.solve(1j * w * np.eye(4) - bank.a, bank.b)
        exact += (gain[:, None] * np.exp(1j * (w * (t - delay) + p))).real
    late = multisine(t - delay, 0.6 * np.pi / h)[0]
    error = {}
    for kind in ("foh", "band-limited"):
        signal = Sampled(u[:, None], h, kind, delays=(delay,))
        found = np.empty((4, n))
        states = States(signal, bank.a, bank.b, upper=1)
        states.advance(0, 123, found)
        states.advance(123, n, found[:, 123:])
        error[kind] = np.abs(found - exact)[:, 250:-40].max() / np.abs(exact).max()
        if kind == "band-limited":
            assert np.abs(signal.direct[:, 0] - late)[60:-40].max() < 1e-5 * np.abs(u).max()
    assert error["band-limited"] < 2e-6
    assert error["foh"] > 1e-2


def test_a_constant_stays_a_constant():
    assert between(np.ones(100), np.linspace(-1, 1, 7)) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("method", [ThreeModel(), OutputError()], ids=["ThreeModel", "OutputError"])
@pytest.mark.parametrize("delay", [0.0, 0.137])
@pytest.mark.fast("0.137-OutputError", "0.0-OutputError")
def test_a_band_limited_record_gives_the_truth(method, delay):
    """Output in closed form; straight lines between the samples would be biased."""
    h, n = 0.25, 600
    t = np.arange(n) * h
    u, omega, phase = multisine(t, 0.7 * np.pi / h)
    gain = np.polyval([0.2, 0.5], 1j * omega) / np.polyval([1.0, 1.0, 3.0], 1j * omega)
    y = (gain * np.exp(1j * (np.multiply.outer(t - delay, omega) + phase))).real.sum(axis=1)
    y = y + 1e-3 * np.random.default_rng(4).standard_normal(n)
    structure = Structure(2, 1, delay=delay, initial_state="free", offset=False)
    y[:40] = y[-40:] = np.nan  # where what lies beyond the record matters
    record = Record(u, y, dt=h, intersample="band-limited")
    estimate = identify(record, structure, method)
    lines = identify(Record(u, y, dt=h, intersample="foh"), structure, method)
    assert estimate.theta == pytest.approx(TRUTH, rel=2e-3)
    assert np.abs(lines.theta - TRUTH).max() > 20.0 * np.abs(estimate.theta - TRUTH).max()


def test_band_limited_needs_even_samples_and_some_of_them():
    with pytest.raises(errors.TooFewSamplesError, match="band-limited"):
        Record([0, 1], [0, 1], dt=1.0, intersample="band-limited")
    with pytest.raises(errors.NonUniformTimeError, match="band-limited"):
        Record(np.ones(20), np.ones(20), t=np.arange(20.0) ** 1.1, intersample="band-limited")
    record = Record(np.ones(20), np.ones(20), dt=1.0, intersample="band-limited")
    with pytest.raises(errors.TooFewSamplesError, match="band-limited"):
        record.slice(0.0, 3.0)
