"""Refined instrumental variables: where they end, how they get there, and how good that is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim

from oracles import register
from tridentify import (
    OutputError,
    Record,
    RefinedInstrumentalVariable,
    Status,
    Structure,
    TransferFunction,
    identify,
    simulate,
)
from tridentify.errors import ConvergenceError, OptionError, UnsupportedError
from tridentify.studies.cramer_rao import output_sensitivities

pytestmark = pytest.mark.unjudged

METHOD = RefinedInstrumentalVariable()
PLANT = TransferFunction([0.2, 0.5], [1.0, 1.0, 3.0])
TRUTH = np.array([1.0, 3.0, 0.2, 0.5])
REST = Structure(2, 1, offset=False, initial_state="rest")


def levels(count, hold, seed=1, channels=1):
    """Random levels +-1, each held for `hold` samples."""
    signs = np.sign(np.random.default_rng(seed).standard_normal((-(-count // hold), channels)))
    return np.repeat(signs, hold, axis=0)[:count]


def record(model=PLANT, dt=0.05, count=400, noise=0.0, seed=0, intersample="zoh", free=None):
    """A response to levels of eight samples each, one input for each of the model's."""
    u = levels(count, 8, channels=len(model.num[0]))
    empty = np.zeros((count, len(model.num)))
    blank = Record(u, empty, dt=dt, intersample=intersample)
    y = simulate(model, blank, free_response=free)
    y = y + noise * np.std(y, axis=0) * np.random.default_rng(seed).standard_normal(y.shape)
    return Record(u, y, dt=dt, intersample=intersample)


# --------------------------------------------------------------------------------- without noise
SHORT_PERIOD = [1.0, 1.0, 3.0]
PLANTS = {
    "short period": (PLANT, Structure(2, 1, offset=False, initial_state="rest"), TRUTH),
    "direct term": (
        TransferFunction([0.3, 0.2, 0.5], SHORT_PERIOD),
        Structure(2, 2, offset=False, initial_state="rest"),
        [1.0, 3.0, 0.3, 0.2, 0.5],
    ),
    "two by two": (
        TransferFunction(
            [[[0.2, 0.5], [1.0]], [[2.0], [-0.3, 0.4]]], [[SHORT_PERIOD] * 2, [SHORT_PERIOD] * 2]
        ),
        Structure(2, [[1, 0], [0, 1]], offset=False, initial_state="rest"),
        [1.0, 3.0, 0.2, 0.5, 1.0, 2.0, -0.3, 0.4],
    ),
}


@pytest.mark.parametrize("case", PLANTS)
@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("dt", [0.2, 0.05])
@pytest.mark.fast("0.05-foh-direct term", "0.2-foh-direct term", "0.2-foh-short period")
def test_joining_the_output_by_lines_does_not_move_the_end(case, intersample, dt):
    """The error of order dt^2 that state-variable filters leave is gone at the fixed point."""
    model, structure, truth = PLANTS[case]
    found = identify(record(model, dt, intersample=intersample), structure, METHOD)
    assert found.status is Status.CONVERGED
    assert np.allclose(found.theta, truth, rtol=1e-8)


@pytest.mark.parametrize(
    ("structure", "offset", "drift"),
    [
        (Structure(2, 1, offset=False, initial_state="free"), 0.0, 0.0),
        (Structure(2, 1, offset=True, initial_state="free"), 7.0, 0.0),
        (Structure(2, 1, offset=False, drift=True, initial_state="free"), 0.0, 0.2),
        (Structure(2, 1, offset=True, drift=True, initial_state="free"), 7.0, -0.2),
        (Structure(2, 1, offset="auto", drift="auto", initial_state="auto"), 7.0, -0.2),
    ],
    ids=["free", "offset", "drift", "all", "auto"],
)
def test_nuisance_terms_come_back_exactly(structure, offset, drift):
    data = record(free=np.array([[0.7, -1.0]]))
    y = data.y + offset + drift * data.t[:, None]
    found = identify(Record(data.u, y, dt=data.dt), structure, METHOD)
    assert np.allclose(found.theta, TRUTH, rtol=1e-7)
    terms = found.nuisance[0]
    moved = terms.input_reference[0] * 0.5 / 3.0  # the reference times the static gain
    assert terms.offset[0] == pytest.approx(offset + moved, abs=1e-7)
    assert terms.drift[0] == pytest.approx(drift, abs=1e-8)


def test_experiments_have_offsets_of_their_own():
    one, two = record(noise=0.02, seed=1), record(noise=0.02, seed=2, count=300)
    pair = [one, Record(two.u, two.y + 9.0, dt=two.dt)]
    found = identify(pair, Structure(2, 1, offset=True, initial_state="rest"), METHOD)
    assert found.nuisance[1].offset[0] - found.nuisance[0].offset[0] == pytest.approx(9.0, abs=0.01)
    assert np.all(np.abs(found.theta - TRUTH) < 4.0 * found.std)


# ------------------------------------------------------------------------------------------- end
@pytest.mark.parametrize("noise", [0.1, 1.0])
def test_fixed_point_is_the_least_output_error(noise):
    data = record(noise=noise)
    found, other = (identify(data, Structure(2, 1), m) for m in (METHOD, OutputError()))
    assert found.gradient < 1e-4
    assert np.all(np.abs(found.theta - other.theta) < 1e-3 * other.std)
    assert np.allclose(found.std, other.std, rtol=1e-3)
    assert found.structure == other.structure


def textbook_pass(theta, data):
    """One pass of SRIVC for two poles and one zero, with the filters of another simulator."""
    a, b, t = np.append(1.0, theta[:2]), theta[2:], data.t

    def filtered(power, signal, joined):
        return lsim((power, a), signal, t, interp=joined)[1]

    p, one = [1.0, 0.0], [1.0]
    # p^k b / a^2 u: the filtered output of the model
    square = np.convolve(a, a)
    twice = [
        lsim((np.convolve(power, b), square), data.u[:, 0], t, interp=False)[1]
        for power in (p, one)
    ]
    inputs = [filtered(power, data.u[:, 0], False) for power in (p, one)]
    outputs = [filtered(power, data.y[:, 0], True) for power in (p, one)]
    second = data.y[:, 0] - a[1] * outputs[0] - a[2] * outputs[1]
    z = np.column_stack([-twice[0], -twice[1], *inputs])
    phi = np.column_stack([-outputs[0], -outputs[1], *inputs])
    return np.linalg.solve(z.T @ phi, z.T @ second)


@pytest.mark.slow
def test_passes_end_where_those_of_the_textbook_do():
    data = record(noise=0.3)
    theta = TRUTH.copy()
    for _ in range(30):
        theta = textbook_pass(theta, data)
    found = identify(data, REST, RefinedInstrumentalVariable(tolerance=1e-8))
    assert np.all(np.abs(found.theta - theta) < 1e-5 * found.std)


def test_two_outputs_are_weighted_by_their_noise():
    """A second output of pure noise, whatever its scale, takes nothing away from the first."""
    model, structure, _ = PLANTS["two by two"]
    clean = record(model)
    rng = np.random.default_rng(3)
    noise = np.std(clean.y, axis=0) * rng.standard_normal(clean.y.shape) * [0.02, 2.0]
    data = Record(clean.u, clean.y + noise, dt=clean.dt)
    both = identify(data, structure, METHOD)
    scaled = identify(Record(data.u, data.y * [1.0, 1e4], dt=data.dt), structure, METHOD)
    alone = identify(
        data.select(outputs=["y1"]),
        Structure(2, [[1, 0]], offset=False, initial_state="rest"),
        METHOD,
    )
    assert np.all(both.std[:2] < 1.01 * alone.std[:2])
    assert np.all(np.abs(both.theta[:2] - alone.theta[:2]) < 0.3 * alone.std[:2])
    assert np.allclose(scaled.theta[:5], both.theta[:5], rtol=1e-7)


@pytest.mark.parametrize("rate", [1e-6, 1e6])
def test_unit_of_time_does_not_matter(rate):
    data = record(noise=0.1)
    usual = identify(data, Structure(2, 1), METHOD)
    found = identify(Record(data.u, data.y, dt=data.dt / rate), Structure(2, 1), METHOD)
    unit = np.array([rate, rate**2, rate, rate**2])
    assert np.allclose(found.theta / unit, usual.theta, rtol=1e-8)
    assert np.allclose(found.std / unit, usual.std, rtol=1e-6)


# ------------------------------------------------------------------------------------- the passes
def test_trace_tells_starts_and_passes():
    found = identify(record(noise=0.3), Structure(2, 1), METHOD)
    names = [start.name for start in found.trace.starts]
    assert names == ["SvfLeastSquares", "SvfInstrumentalVariable"]
    assert "standard errors" in found.trace.stopped
    assert found.trace.passes[-1].gradient < 1e-4 < found.trace.passes[0].gradient
    assert "lowest AICc" in found.trace.decisions[0]


def test_finer_tolerance_takes_more_passes_and_ends_nearer():
    data = record(noise=0.5)
    rough, fine = (
        identify(data, REST, RefinedInstrumentalVariable(tolerance=value)) for value in (0.3, 1e-9)
    )
    assert len(rough.trace.passes) < len(fine.trace.passes)
    assert fine.gradient < 1e-9 < rough.gradient
    assert np.all(np.abs(rough.theta - fine.theta) < 0.3 * fine.std)


def test_passes_that_run_out_are_not_called_converged():
    data, method = record(noise=0.5), RefinedInstrumentalVariable(max_passes=1)
    found = identify(data, REST, method, throw=False)
    assert found.status is Status.MAX_PASSES
    with pytest.raises(ConvergenceError, match="passes ran out"):
        identify(data, REST, method)


@pytest.mark.slow
def test_unstable_pole_on_the_way_is_reflected_and_said():
    """Noise alone, three poles: some pass of some draw leaves the left half plane."""
    u, notes = levels(100, 5), []
    structure = Structure(3, 2, offset=False, initial_state="rest")
    for seed in range(4):
        y = np.random.default_rng(seed).standard_normal(100)
        found = identify(Record(u, y, dt=0.05), structure, METHOD, throw=False)
        assert found.model.is_stable
        notes += [one.note for one in found.trace.passes]
    assert "reflected an unstable pole" in notes


@pytest.mark.parametrize("value", [0, -3, 2.5, "7", None])
def test_bad_number_of_passes_is_refused(value):
    with pytest.raises(OptionError, match=r"found max_passes.*expected"):
        RefinedInstrumentalVariable(max_passes=value)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "x", None])
def test_bad_tolerance_is_refused(value):
    with pytest.raises(OptionError, match=r"found tolerance.*expected"):
        RefinedInstrumentalVariable(tolerance=value)


def test_missing_outputs_are_refused():
    data = record()
    y = data.y.copy()
    y[7] = np.nan
    with pytest.raises(UnsupportedError, match="1 missing output"):
        identify(Record(data.u, y, dt=data.dt), REST, METHOD)


# ------------------------------------------------------------------------------------ many draws


BENCHMARKS = {
    "second order": ([3.0], [1.0, 4.0, 3.0], register(7, (7, 6), 1016, 8), 0.05),
    "rao-garnier": (
        [-6400.0, 1600.0],
        [1.0, 5.0, 408.0, 416.0, 1600.0],
        register(10, (10, 7), 1000, 7),
        0.01,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BENCHMARKS)
def test_bound_is_reached_without_a_failure(case):
    """10 dB, 150 draws: no bias, root mean square error within 10 % of the Cramer-Rao bound.

    With 150 draws a root mean square is itself uncertain by 6 %; below the bound counts as at it.
    """
    num, den, u, dt = BENCHMARKS[case]
    model, truth = TransferFunction(num, den), np.array([*den[1:], *num])
    clean = simulate(model, Record(u, u, dt=dt))[:, 0]
    sigma = np.std(clean) * 10**-0.5
    scores = output_sensitivities(model, u, dt)
    bound = sigma * np.sqrt(np.diag(np.linalg.inv(scores.T @ scores)))
    structure = Structure(len(den) - 1, len(num) - 1, offset=False, initial_state="rest")
    errors, stds = [], []
    for seed in range(150):
        noise = np.random.default_rng(1000 + seed).standard_normal(u.size)
        found = identify(Record(u, clean + sigma * noise, dt=dt), structure, METHOD)
        assert found.status is Status.CONVERGED
        errors.append(found.theta - truth)
        stds.append(found.std)
    mean = np.mean(errors, axis=0) / (np.std(errors, axis=0) / np.sqrt(len(errors)))
    assert np.all(np.abs(mean) < 3.0)
    assert np.all(np.sqrt(np.mean(np.square(errors), axis=0)) < 1.1 * bound)
    assert np.allclose(np.median(stds, axis=0), bound, rtol=0.1)
