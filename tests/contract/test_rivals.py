"""What the rivals of the three-model strategy owe their callers, one by one.

The truths are simulated here with one matrix exponential, the optima found by scipy. The cases that
every row of `METHODS` shares stand in test_methods.py.
"""

from __future__ import annotations

import dataclasses
import importlib
import pickle
import random

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import fftconvolve

import tridentify
from oracles import binary, by_exponential
from tridentify import Record, Status, Structure, TransferFunction, TridentifyError, identify
from tridentify import errors as err

pytestmark = pytest.mark.unjudged

KEYS = {
    "svf-least-squares": "SvfLeastSquares",
    "svf-instrumental-variable": "SvfInstrumentalVariable",
    "refined-instrumental-variable": "RefinedInstrumentalVariable",
    "output-error": "OutputError",
    "bias-compensated-least-squares": "BiasCompensatedLeastSquares",
}
RIVALS = tuple(KEYS.values())
FILTERED = ("SvfLeastSquares", "SvfInstrumentalVariable", "BiasCompensatedLeastSquares")
UNBIASED = ("SvfInstrumentalVariable", "RefinedInstrumentalVariable", "OutputError")
REST = {"offset": False, "initial_state": "rest"}
DT = 0.05
TRUTH = np.array([1.0, 3.0, 0.2, 0.5])

every_rival = pytest.mark.parametrize("name", RIVALS)
every_filtered = pytest.mark.parametrize("name", FILTERED)


def make(name, *args, **options):
    return getattr(tridentify, name)(*args, **options)


def respond(num, den, u, dt=DT, intersample="zoh"):
    return by_exponential(num, den, u, dt, intersample)


def noisy(clean, noise, seed=0):
    rng = np.random.default_rng(seed)
    return clean + noise * np.std(clean, axis=0) * rng.standard_normal(clean.shape)


def short_period(noise=0.05, seed=0, n_samples=400, refine=1):
    """The truth is TRUTH; ``refine`` samples the same experiment more finely."""
    u, dt = np.repeat(binary(n_samples), refine), DT / refine
    return Record(u, noisy(respond(TRUTH[2:], [1.0, *TRUTH[:2]], u, dt), noise, seed), dt=dt)


def attempt(records, structure, method, **options):
    """(estimate, None), or (None, message) of a refusal: one line, of a class of ours."""
    try:
        return identify(records, structure, method, **options), None
    except TridentifyError as refusal:
        message = str(refusal)
    assert message
    assert "\n" not in message
    return None, message


def tolerance(name, jumps=False):
    """Relative error allowed without noise at 0.05 s: rounding, or what the sampled y costs.

    An output that jumps with a held input is sampled worst of all.
    """
    return 1e-8 if name == "OutputError" else 0.1 if jumps else 0.03


# -------------------------------------------------------------------- names, options, objects
@pytest.mark.parametrize(("key", "name"), KEYS.items())
def test_table_names_the_class(key, name):
    table = importlib.import_module("tridentify.identify").METHODS
    assert table[key] is getattr(tridentify, name)
    assert table is tridentify.METHODS
    assert make(name).name == name
    assert name in tridentify.__all__


@every_rival
def test_object_holds_options_only_and_stays_as_it_was(name):
    method = make(name)
    assert dataclasses.is_dataclass(method)
    before = pickle.dumps(method)
    identify(short_period(), Structure(2, 1), method)
    assert pickle.dumps(method) == before
    assert pickle.loads(before) == method
    assert hash(pickle.loads(before)) == hash(method)
    for entry in dataclasses.fields(method):
        with pytest.raises((AttributeError, TypeError)):
            setattr(method, entry.name, None)


@every_filtered
def test_filter_is_kept_as_plain_numbers(name):
    coefficients = [1.0, 4.0, 4.0]
    method = make(name, coefficients)
    as_array = make(name, filter=np.array(coefficients))
    assert method == make(name, filter=(1, 4, 4)) == as_array
    assert hash(method) == hash(as_array)
    coefficients[1] = -7.0
    assert method == as_array, "the caller's list is the caller's"


@every_filtered
def test_filter_scale_is_of_no_account(name):
    one = identify(short_period(), Structure(2, 1, **REST), make(name, [1.0, 4.0, 4.0]))
    two = identify(short_period(), Structure(2, 1, **REST), make(name, [5.0, 20.0, 20.0]))
    assert np.allclose(one.theta, two.theta, rtol=1e-8)


@every_filtered
@pytest.mark.parametrize("n", [2, 3, 5])
def test_filter_of_any_sufficient_degree(name, n):
    record = short_period(noise=0.0, refine=4)
    found = identify(record, Structure(2, 1, **REST), make(name, np.poly([-3.0] * n)))
    assert np.allclose(found.theta, TRUTH, rtol=0.02)


BAD_FILTERS = {
    "empty": (),
    "a constant": (1.0,),
    "degree below the poles": (1.0, 2.0),
    "zero in front": (0.0, 1.0, 2.0),
    "all zeros": (0.0, 0.0, 0.0),
    "unstable": (1.0, -1.0, 2.0),
    "on the axis": (1.0, 0.0, 2.0),
    "integrator": (1.0, 2.0, 0.0),
    "nan": (1.0, np.nan, 2.0),
    "infinite": (1.0, np.inf, 2.0),
    "complex": (1.0, 2.0 + 1.0j, 2.0),
    "words": ("1", "two", "3"),
    "one word": "abc",
    "a number": 3.0,
    "a matrix": ((1.0, 2.0), (3.0, 4.0)),
    "another method": object(),
}


def refused(act, *expected):
    """One clear line of its own class, wherever it is noticed."""
    with pytest.raises(expected or err.OptionError) as caught:
        act()
    message = str(caught.value)
    assert "\n" not in message
    assert "found" in message
    assert "expect" in message
    return message


@every_filtered
@pytest.mark.parametrize("case", BAD_FILTERS)
def test_bad_filter_is_refused_by_name(name, case):
    def act():
        identify(short_period(), Structure(2, 1), make(name, filter=BAD_FILTERS[case]))

    assert "filter" in refused(act, err.OptionError)


COUNTS = [0, -1, 2.5, np.nan, np.inf, "7", None]


@pytest.mark.parametrize("name", ["RefinedInstrumentalVariable", "OutputError"])
@pytest.mark.parametrize("value", COUNTS, ids=repr)
def test_bad_number_of_passes_is_refused(name, value):
    def act():
        identify(short_period(), Structure(2, 1), make(name, max_passes=value))

    assert "max_passes" in refused(act)


@pytest.mark.parametrize("value", [-1e-6, np.nan, np.inf, "small", None, 1j], ids=repr)
def test_bad_tolerance_is_refused(value):
    def act():
        method = make("RefinedInstrumentalVariable", tolerance=value)
        identify(short_period(), Structure(2, 1), method)

    assert "tolerance" in refused(act)


BAD_STARTS = {
    "a list": [1.0, 3.0, 0.2, 0.5],
    "a word": "three-model",
    "too few poles": TransferFunction([0.5], [1.0, 3.0]),
    "too many poles": TransferFunction([0.5], [1.0, 3.0, 4.0, 5.0]),
    "too many inputs": TransferFunction([[[0.5], [0.5]]], [1.0, 1.0, 3.0]),
    "too many outputs": TransferFunction([[[0.5]], [[0.5]]], [1.0, 1.0, 3.0]),
}


@pytest.mark.parametrize("case", BAD_STARTS)
def test_start_that_is_no_such_model_is_refused(case):
    def act():
        method = make("OutputError", start=BAD_STARTS[case])
        identify(short_period(), Structure(2, 1), method)

    message = refused(act, err.OptionError, err.StructureError, err.DataError)
    assert "start" in message


@pytest.mark.parametrize("name", RIVALS)
def test_no_stray_words_are_swallowed(name):
    with pytest.raises(TypeError):
        make(name, gamma=1.0)


# ----------------------------------------------------------------------------- without noise
SYSTEMS = {
    "one pole": ([2.0], [1.0, 4.0]),
    "one pole, direct": ([0.5, 5.0], [1.0, 4.0]),
    "short period": ([0.2, 0.5], [1.0, 1.0, 3.0]),
    "with direct term": ([0.3, 0.2, 0.5], [1.0, 1.0, 3.0]),
    "not minimum phase": ([-1.0, 2.0], [1.0, 2.4, 6.3]),
    "three poles": ([1.0, 4.0], [1.0, 4.0, 9.0, 10.0]),
    "slow and fast": ([5.0], [1.0, 5.3, 1.5]),
    "lightly damped": ([4.0], [1.0, 0.08, 4.0]),
}


@every_rival
@pytest.mark.parametrize(
    ("system", "intersample"),
    [(system, "zoh") for system in SYSTEMS]
    + [("short period", "foh"), ("one pole, direct", "foh")],
)
def test_noise_free_record_gives_the_truth(name, system, intersample):
    num, den = SYSTEMS[system]
    u = binary(400)
    record = Record(u, respond(num, den, u, DT, intersample), dt=DT, intersample=intersample)
    structure = Structure(len(den) - 1, len(num) - 1, **REST)
    found = identify(record, structure, make(name))
    error = np.abs(found.theta - np.append(den[1:], num))
    # The error of a small coefficient is measured on the system's own scale.
    scale = np.abs(np.append(den[1:], num)) + (0.0 if name == "OutputError" else 0.3)
    jumps = len(num) == len(den) and intersample == "zoh"
    assert np.all(error < tolerance(name, jumps) * scale), found.theta


@every_rival
def test_error_of_the_sampled_output_falls_with_the_square_of_the_step(name):
    if name == "OutputError":
        pytest.skip("exact at any step")
    options = {"filter": np.poly([-3.0, -3.0, -3.0])} if name in FILTERED else {}
    errors = []
    for refine in (1, 2, 4):
        record = short_period(noise=0.0, refine=refine)
        found = identify(record, Structure(2, 1, **REST), make(name, **options))
        errors.append(np.linalg.norm((found.theta - TRUTH) / TRUTH))
    if errors[0] < 1e-9:
        return  # better than promised
    assert errors[1] < errors[0] / 3.0, errors
    assert errors[2] < errors[1] / 3.0, errors


def shift_register(length=1000, hold=7):
    bits, out = [1] * 10, []
    for _ in range(-(-length // hold)):
        out.append(2.0 * bits[-1] - 1.0)
        bits = [bits[9] ^ bits[6], *bits[:-1]]
    return np.repeat(out, hold)[:length]


RAO_GARNIER = np.array([5.0, 408.0, 416.0, 1600.0, -6400.0, 1600.0])


@every_rival
def test_resonant_plant_without_noise(name):
    """Rao-Garnier: a mode at 2 rad/s and one at 20 rad/s, damped by 0.25 and 0.1."""
    u = shift_register()
    y = respond(RAO_GARNIER[4:], [1.0, *RAO_GARNIER[:4]], u, 0.01)
    found = identify(Record(u, y, dt=0.01), Structure(4, 1, **REST), make(name))
    relative = found.theta / RAO_GARNIER - 1.0
    # At 20 rad/s and 0.01 s the sampled output is worth (omega dt)^2 / 12 = 0.3 percent.
    assert np.all(np.abs(relative) < (1e-6 if name == "OutputError" else 0.05)), relative


@every_rival
@pytest.mark.parametrize("faster", [1e6, 1e-6])
@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.fast("0.05-1e-06-*", "0.0-1000000.0-*")
def test_unit_of_time_scales_exactly(name, faster, noise):
    record = short_period(noise)
    quick = Record(record.u, record.y, dt=DT / faster)
    factor = faster ** np.array([1.0, 2.0, 1.0, 2.0])
    plain = identify(record, Structure(2, 1, **REST), make(name))
    found = identify(quick, Structure(2, 1, **REST), make(name))
    moved = np.abs(found.theta / factor - plain.theta)
    assert np.all(moved <= 1e-7 * np.abs(plain.theta) + 2e-3 * noise * plain.std), moved
    assert found.status is plain.status
    if noise:
        assert np.allclose(found.std / factor, plain.std, rtol=1e-3)


@every_filtered
@pytest.mark.parametrize("faster", [1e6, 1e-6])
def test_unit_of_time_with_a_filter_in_that_unit(name, faster):
    record = short_period()
    quick = Record(record.u, record.y, dt=DT / faster)
    scaled = (1.0, 4.0 * faster, 4.0 * faster**2)
    plain = identify(record, Structure(2, 1, **REST), make(name, (1.0, 4.0, 4.0)))
    found = identify(quick, Structure(2, 1, **REST), make(name, scaled))
    assert np.allclose(found.theta / faster ** np.array([1, 2, 1, 2]), plain.theta, rtol=1e-7)


# --------------------------------------------------------------------------------- with noise
def spread_of(theta, record, sigma):
    """Standard errors at the bound, by central differences."""
    columns = []
    for k in range(theta.size):
        step = np.zeros(theta.size)
        step[k] = 1e-5 * abs(theta[k])
        up, down = theta + step, theta - step
        difference = respond(up[2:], [1.0, *up[:2]], record.u[:, 0], record.dt)
        difference = difference - respond(down[2:], [1.0, *down[:2]], record.u[:, 0], record.dt)
        columns.append(difference / (2.0 * step[k]))
    scores = np.stack(columns, axis=1)
    return sigma * np.sqrt(np.diag(np.linalg.inv(scores.T @ scores)))


def test_output_error_is_the_optimum_that_scipy_finds():
    record = short_period(noise=0.3)
    y, u = record.y[:, 0], record.u[:, 0]
    found = identify(record, Structure(2, 1, **REST), make("OutputError"))
    rival = least_squares(lambda x: y - respond(x[2:], [1.0, *x[:2]], u), TRUTH, xtol=1e-12)
    error = y - respond(found.theta[2:], [1.0, *found.theta[:2]], u)
    assert error @ error <= 2.0 * rival.cost * (1.0 + 1e-9)
    assert np.all(np.abs(found.theta - rival.x) < 1e-3 * found.std)
    sigma = np.sqrt(error @ error / (y.size - 4))
    assert np.allclose(found.std, spread_of(found.theta, record, sigma), rtol=0.01)


def test_output_error_and_three_model_meet_at_the_same_minimum():
    record = short_period(noise=0.3, seed=3)
    structure = Structure(2, 1, **REST)
    ours, theirs = identify(record, structure), identify(record, structure, make("OutputError"))
    assert np.all(np.abs(ours.theta - theirs.theta) < 2e-3 * ours.std)
    assert np.allclose(ours.std, theirs.std, rtol=1e-3)


@pytest.mark.parametrize("den", [[1.0, 1.0, 3.0], [1.0, 2.0, 6.0], [1.0, 0.3, 1.5]], ids=str)
def test_output_error_forgets_a_sensible_start(den):
    record, structure = short_period(noise=0.2), Structure(2, 1, **REST)
    alone = identify(record, structure, make("OutputError"))
    led = identify(record, structure, make("OutputError", start=TransferFunction([1.0], den)))
    assert np.all(np.abs(alone.theta - led.theta) < 2e-3 * alone.std)
    assert led.gradient < 1e-4


@pytest.mark.parametrize(
    "start",
    [
        TransferFunction([0.2, 0.5], [1.0, -1.0, 3.0]),
        TransferFunction([1.0], [1.0, 0.0, 0.0]),
        TransferFunction([1.0], [1.0, 1e4, 1e9]),
        TransferFunction([1e9], [1.0, 1e-5, 1e-9]),
        TransferFunction([0.0], [1.0, 1.0, 3.0]),
    ],
    ids=["unstable", "double integrator", "far too fast", "far too slow", "zero numerator"],
)
def test_output_error_from_a_hopeless_start_says_so_or_arrives(start):
    record, structure = short_period(noise=0.2), Structure(2, 1, **REST)
    best = identify(record, structure, make("OutputError"))
    found, refusal = attempt(record, structure, make("OutputError", start=start))
    if refusal is None and found.status is Status.CONVERGED:
        assert found.cost <= best.cost * (1.0 + 1e-6), "a worse minimum may not pass as the answer"


@pytest.mark.parametrize("name", ["RefinedInstrumentalVariable", "OutputError"])
def test_passes_that_run_out_are_told(name):
    record, structure = short_period(noise=0.5, n_samples=150), Structure(2, 1, **REST)
    whole = identify(record, structure, make(name), throw=False)
    cut = identify(record, structure, make(name, max_passes=1), throw=False)
    if np.any(np.abs(cut.theta - whole.theta) > 0.05 * whole.std):
        assert not cut.status.ok
        with pytest.raises(err.ConvergenceError):
            identify(record, structure, make(name, max_passes=1))


@every_rival
def test_truth_is_within_the_error_bars_at_small_noise(name):
    record = short_period(noise=0.02, refine=2)
    found = identify(record, Structure(2, 1, **REST), make(name))
    assert np.all(np.isfinite(found.std))
    assert np.all(np.abs(found.theta - TRUTH) < 4.5 * found.std + 0.02 * TRUTH)
    floor = spread_of(TRUTH, record, 0.02 * np.std(record.y))
    assert np.all(found.std > 0.6 * floor), "no standard error may undercut the bound"
    assert found.status.ok
    assert found.fit[0] > 95.0


def test_refined_instrumental_variable_is_close_to_the_optimum():
    record, structure = short_period(noise=0.2, refine=2), Structure(2, 1, **REST)
    optimum = identify(record, structure, make("OutputError"))
    refined = identify(record, structure, make("RefinedInstrumentalVariable"))
    assert np.all(np.abs(refined.theta - optimum.theta) < 0.5 * optimum.std)
    assert np.allclose(refined.std, optimum.std, rtol=0.1)


def filtered(v, c, n, dt, intersample):
    """Columns p^n v/c ... v/c of a sampled signal that is held or joined by lines, from rest."""
    unit = np.eye(n + 1)
    return np.stack([respond(unit[i], c, v, dt, intersample) for i in range(n + 1)], axis=1)


def plain_least_squares(record, c, n, m):
    phi_y = filtered(record.y[:, 0], c, n, record.dt, "foh")
    phi_u = filtered(record.u[:, 0], c, n, record.dt, record.intersample)[:, n - m :]
    phi = np.hstack([-phi_y[:, 1:], phi_u])
    return np.linalg.lstsq(phi, phi_y[:, 0], rcond=None)[0]


def test_least_squares_is_the_textbook_regression():
    """Filters of its own, the output joined by lines: the same bias, not only the same truth."""
    record = short_period(noise=1.0, n_samples=600, refine=4)
    c = [1.0, 12.0, 36.0]
    found = identify(record, Structure(2, 1, **REST), make("SvfLeastSquares", c))
    expected = plain_least_squares(record, c, 2, 1)
    bias = np.abs(expected - TRUTH)
    assert np.max(bias / TRUTH) > 0.05, "the test needs a visible bias"
    assert np.all(np.abs(found.theta - expected) < 0.02 * bias)


def limit_of_least_squares(record, variance, c, n, m):
    """The same regression on expected squares: the input's columns out first, then the noise in."""
    n_samples, dt = record.n_samples, record.dt
    clean = respond(TRUTH[2:], [1.0, *TRUTH[:2]], record.u[:, 0], dt)
    phi_y = filtered(clean, c, n, dt, "foh")
    phi_u = filtered(record.u[:, 0], c, n, dt, record.intersample)[:, n - m :]
    q = np.linalg.qr(phi_u)[0]
    left = phi_y - q @ (q.T @ phi_y)
    squares = left.T @ left
    # What a sample of noise leaves in the columns, less what the input's columns take up of it.
    reply = filtered(np.eye(1, 1000, 3)[0], c, n, dt, "foh")
    where = n_samples + 2 - np.arange(n_samples)
    seen = np.array([[fftconvolve(x[::-1], h)[where] for x in q.T] for h in reply.T])
    times = np.clip(n_samples + 3 - np.arange(1000), 0, n_samples)
    squares += variance * ((reply.T * times) @ reply - np.einsum("ikt,jkt->ij", seen, seen))
    a = np.linalg.solve(squares[1:, 1:], -squares[1:, 0])
    return np.append(a, np.linalg.lstsq(phi_u, phi_y @ np.append(1.0, a), rcond=None)[0])


@pytest.mark.parametrize("noise", [0.0, 0.5, 2.0])
@pytest.mark.parametrize("c", [(1.0, 12.0, 36.0), (1.0, 9.0, 30.0, 40.0)])
def test_predicted_bias_is_that_of_the_expected_normal_equations(noise, c):
    record = short_period(n_samples=500, refine=2)
    model = TransferFunction(TRUTH[2:], [1.0, *TRUTH[:2]])
    variance = (noise * np.std(respond(TRUTH[2:], [1.0, *TRUTH[:2]], record.u[:, 0], DT / 2))) ** 2
    found = tridentify.asymptotic_bias(model, record, variance, c)
    expected = limit_of_least_squares(record, variance, np.array(c), 2, 1) - TRUTH
    assert found.shape == (4,)
    assert np.all(np.abs(found - expected) < 0.01 * np.max(np.abs(expected)) + 1e-9), expected


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"variance": -1.0}, err.OptionError),
        ({"variance": np.nan}, err.OptionError),
        ({"variance": [1.0, 1.0]}, TridentifyError),
        ({"c": (1.0, -4.0, 4.0)}, err.OptionError),
        ({"c": (1.0, 4.0)}, err.OptionError),
        ({"c": (1.0, np.nan, 4.0)}, err.OptionError),
        ({"model": TransferFunction([1.0], [1.0, 2.0, 1.0], delay=0.1)}, err.UnsupportedError),
        ({"model": TransferFunction([[[1.0], [1.0]]], [1.0, 2.0])}, TridentifyError),
    ],
    ids=lambda value: str(value)[:30],
)
def test_bias_of_nonsense_is_refused(change, expected):
    model = change.get("model", TransferFunction(TRUTH[2:], [1.0, *TRUTH[:2]]))
    c, variance = change.get("c", (1.0, 4.0, 4.0)), change.get("variance", 0.1)
    refused(lambda: tridentify.asymptotic_bias(model, short_period(), variance, c), expected)


# --------------------------------------------------------------- channels, records, nuisances
@every_rival
def test_two_records_are_more_information_than_one(name):
    first, second = short_period(seed=1), short_period(seed=2)
    # A filter that is chosen anew for two records changes the standard errors by itself.
    structure = Structure(2, 1, **REST)
    method = make(name, (1.0, 4.0, 4.0)) if name in FILTERED else make(name)
    alone = identify(first, structure, method)
    both = identify([first, second], structure, method)
    swapped = identify([second, first], structure, method)
    assert np.allclose(both.std / alone.std, np.sqrt(0.5), rtol=0.15)
    assert both.n_samples == 800
    assert np.all(np.abs(both.theta - swapped.theta) < 1e-3 * both.std)


@every_rival
def test_records_of_different_step_belong_together(name):
    """The same system, recorded at 20 and at 40 samples a second."""
    fine = short_period(noise=0.02, seed=5, refine=2)
    both, refusal = attempt([short_period(0.02), fine], Structure(2, 1, **REST), make(name))
    assert refusal or np.allclose(both.theta, TRUTH, atol=0.05)


@every_rival
@pytest.mark.parametrize("state", ["free", "equilibrium"])
def test_trim_and_offset_do_not_spoil_the_coefficients(name, state):
    u = binary()
    u[:20] = u[0]
    held = u - u[0]
    y = noisy(respond(TRUTH[2:], [1.0, *TRUTH[:2]], held), 0.02) + 7.0
    record = Record(held + 3.0, y, dt=DT)
    structure = Structure(2, 1, offset=True, initial_state=state)
    try:
        found = identify(record, structure, make(name))
    except err.UnsupportedError as refusal:
        pytest.skip(str(refusal))
    assert np.all(np.abs(found.theta - TRUTH) < 4.5 * found.std + 0.03 * TRUTH)
    assert found.fit[0] > 95.0


@every_rival
def test_two_inputs(name):
    u = np.stack([binary(seed=1), binary(seed=2, hold=9)], axis=1)
    den = [1.0, 2.4, 6.3]
    y = respond([1.0, 5.0], den, u[:, 0]) + respond([-4.0], den, u[:, 1])
    record = Record(u, noisy(y, 0.01), dt=DT)
    found = identify(record, Structure(2, [[1, 0]], **REST), make(name))
    expected = np.array([2.4, 6.3, 1.0, 5.0, -4.0])
    assert found.names == ("a1", "a0", "b1[y,u1]", "b0[y,u1]", "b0[y,u2]")
    assert np.allclose(found.theta, expected, atol=0.03 * 6.3)


@every_rival
@pytest.mark.parametrize("scale", [1.0, 1e6])
def test_two_outputs_share_the_denominator(name, scale):
    u, den = binary(), [1.0, 2.4, 6.3]
    clean = np.stack([respond([-7.0, -6.5], den, u), respond([5.0], den, u)], axis=1)
    record = Record(u, noisy(clean, 0.01) * [1.0, scale], dt=DT)
    found = identify(record, Structure(2, [[1], [0]], **REST), make(name))
    back = found.theta / [1.0, 1.0, 1.0, 1.0, scale]
    assert np.allclose(back, [2.4, 6.3, -7.0, -6.5, 5.0], atol=0.03 * 7.0)
    num, first = found.structure.split(found.theta, 2, 1)
    assert np.array_equal(first[0][0], first[1][0])
    assert len(num) == 2


@every_rival
@pytest.mark.parametrize("missing", ["a hole", "here and there", "at the start"])
def test_missing_outputs_are_refused_or_left_out(name, missing):
    record = short_period(noise=0.02)
    y = record.y[:, 0].copy()
    where = {"a hole": np.s_[100:140], "here and there": np.s_[3::11], "at the start": np.s_[:5]}
    y[where[missing]] = np.nan
    holed = Record(record.u, y, dt=DT)
    found, refusal = attempt(holed, Structure(2, 1, **REST), make(name))
    if refusal is not None:
        assert "missing" in refusal or "nan" in refusal
        return
    assert np.allclose(found.theta, TRUTH, rtol=0.05)
    assert found.degrees_of_freedom <= np.sum(np.isfinite(y)) - 4


@every_rival
def test_direct_term_and_integrator(name):
    """A pole at zero: the right answer, or a refusal; never another system without a word."""
    u = binary(400, hold=5)
    record = Record(u, respond([1.0, 2.0], [1.0, 1.5, 0.0], u), dt=DT)
    found, refusal = attempt(record, Structure(2, 1, **REST), make(name))
    if refusal is not None:
        return
    error = np.max(np.abs(found.theta - [1.5, 0.0, 1.0, 2.0]))
    assert error < 0.05 or found.status is not Status.CONVERGED, found.theta


# -------------------------------------------------------------------------------- good manners
@every_rival
def test_nobody_else_s_random_numbers_are_touched(name):
    record = short_period(noise=0.3)
    np.random.seed(1)  # noqa: NPY002
    before, plain = np.random.get_state(), random.getstate()  # noqa: NPY002
    one = identify(record, Structure(2, 1, **REST), make(name))
    after = np.random.get_state()  # noqa: NPY002
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    assert random.getstate() == plain
    np.random.seed(2)  # noqa: NPY002
    two = identify(record, Structure(2, 1, **REST), make(name))
    assert np.array_equal(one.theta, two.theta)
    assert np.array_equal(one.cov, two.cov)


@pytest.mark.judged
@every_rival
def test_estimate_survives_pickling(name):
    record = short_period()
    found = identify(record, Structure(2, 1), make(name))
    again = pickle.loads(pickle.dumps(found))
    assert np.array_equal(again.theta, found.theta)
    assert np.array_equal(again.cov, found.cov)
    assert again.status is found.status
    assert again.summary() == found.summary()
    assert np.array_equal(again.predict(record), found.predict(record))


@pytest.mark.judged
@every_rival
def test_estimate_says_who_made_it(name):
    found = identify(short_period(), Structure(2, 1), make(name))
    assert found.method == name
    assert name in found.summary()


@every_rival
def test_bounded_coefficients_are_honoured_or_refused(name):
    structure = Structure(2, 1, bounds={"a0": (4.0, 5.0)}, **REST)
    try:
        found = identify(short_period(), structure, make(name))
    except err.UnsupportedError:
        return
    assert 4.0 <= found.parameters["a0"].value <= 5.0
