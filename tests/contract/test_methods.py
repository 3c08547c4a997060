"""What every row of `METHODS` owes its callers, refusals included.

A new method is one new row: every test here then runs on it. What a method cannot do it must
refuse with `UnsupportedError`; such a case is skipped, never passed over in silence. What a method
does without the promise that others make stands in a table below (`EXACT`, `CONSISTENT`), with the
reason.
"""

from __future__ import annotations

import contextlib
import json
import math
import re

import numpy as np
import pytest

from oracles import binary, by_exponential
from tridentify import (
    METHODS,
    DataError,
    Estimate,
    IdentifiabilityError,
    Record,
    Status,
    Structure,
    ThreeModel,
    TridentifyError,
    identify,
    simulate,
)
from tridentify import errors as err
from tridentify.estimation.methods.capability import Capability

pytestmark = [pytest.mark.parametrize("key", list(METHODS), ids=str), pytest.mark.unjudged]
DT = 0.05

JOINED = "it filters the sampled output joined by straight lines, an error of order dt^2"
EXACT = {
    # Without noise: the truth to rounding, or why not. ThreeModel always is the yardstick.
    "three-model": True,
    "output-error": True,
    "refined-instrumental-variable": True,
    "svf-instrumental-variable": JOINED,
    "svf-least-squares": JOINED,
    "bias-compensated-least-squares": JOINED,
}
CONSISTENT = {
    # With noise: the truth within the standard errors, or why not.
    "three-model": True,
    "output-error": True,
    "refined-instrumental-variable": True,
    "svf-instrumental-variable": True,
    "svf-least-squares": "the square of the noise biases it; its standard errors do not know",
    "bias-compensated-least-squares": True,
}


def test_every_method_says_what_it_promises(key):
    assert EXACT[key]
    assert CONSISTENT[key]
    assert EXACT["three-model"] is True
    assert CONSISTENT["three-model"] is True


def respond(num, den, u, dt=DT, initial=None):
    return by_exponential(num, den, u, dt, initial=initial)


def short_period(noise=0.03, seed=0, n_samples=400):
    """One input, one output, rest, no offset; truth 1, 3, 0.2, 0.5."""
    u = binary(n_samples)
    y = respond([0.2, 0.5], [1.0, 1.0, 3.0], u)
    y = y + noise * np.std(y) * np.random.default_rng(seed).standard_normal(u.size)
    units = {"elevator": "rad", "alpha": "rad"}
    return Record(
        u, y, dt=DT, input_names=["elevator"], output_names=["alpha"], units=units, name="run"
    )


def q_and_alpha(noise=0.03):
    """One input, two outputs, trim and offsets."""
    u, rng = binary(), np.random.default_rng(4)
    den = [1.0, 2.4, 6.3]
    y = np.stack([respond(num, den, u) for num in ([-7.0, -6.5], [-0.1, -5.0])], axis=1)
    y = y + noise * np.std(y, axis=0) * rng.standard_normal(y.shape) + np.array([0.5, 2.0])
    return Record(u + 2.0, y, dt=DT, input_names=["elevator"], output_names=["q", "alpha"])


CASES = {
    "short period": (short_period, Structure(2, 1)),
    "short period, everything known": (
        short_period,
        Structure(2, 1, offset=False, initial_state="rest"),
    ),
    "q and alpha": (q_and_alpha, Structure(2, 1, offset=True, initial_state="free")),
}


def attempt(key, record, structure, **options):
    """The estimate, or a skip with the method's own words where it declares no support."""
    try:
        return identify(record, structure, METHODS[key](), **options)
    except err.UnsupportedError as refusal:
        pytest.skip(f"{key} does not support it: {refusal}")


@pytest.fixture(scope="module")
def cache():
    return {}


@pytest.fixture(params=list(CASES))
def solved(request, key, cache):
    """(record, structure, estimate) of every case, estimated once."""
    make, structure = CASES[request.param]
    record = make()
    if (key, request.param) not in cache:
        cache[key, request.param] = attempt(key, record, structure)
    return record, structure, cache[key, request.param]


# ------------------------------------------------------------------------- what an estimate is
def test_fields_have_the_promised_shapes(key, solved):
    record, structure, estimate = solved
    n_parameters = structure.n_parameters(record.n_outputs, record.n_inputs)
    assert isinstance(estimate, Estimate)
    assert estimate.theta.shape == estimate.std.shape == (n_parameters,)
    assert estimate.cov.shape == (n_parameters, n_parameters)
    assert estimate.noise_variance.shape == estimate.fit.shape == (record.n_outputs,)
    assert estimate.names == structure.names(record.input_names, record.output_names)
    assert estimate.input_names == record.input_names
    assert estimate.output_names == record.output_names
    assert dict(estimate.units) == dict(record.units)
    assert estimate.n_samples == record.n_samples
    assert estimate.dt == pytest.approx(record.dt)
    assert estimate.intersample == record.intersample
    assert isinstance(estimate.status, Status)
    assert estimate.status.ok
    assert estimate.status.message
    assert estimate.method
    assert len(estimate.nuisance) == 1
    assert math.isfinite(estimate.cost)
    assert math.isfinite(estimate.aicc)
    assert estimate.condition >= 1.0
    assert re.fullmatch("[0-9a-f]{64}", estimate.record_fingerprint)


def test_arrays_are_read_only(key, solved):
    for array in (solved[2].theta, solved[2].cov, solved[2].noise_variance, solved[2].fit):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0.0


def test_structure_comes_back_resolved(key, solved):
    found = solved[2].structure
    assert isinstance(found.offset, bool)
    assert isinstance(found.drift, bool)
    assert found.initial_state in {"rest", "equilibrium", "free"}
    assert found.poles == solved[1].poles
    assert solved[2].nuisance[0].initial_state == found.initial_state


def test_model_holds_the_coefficients(key, solved):
    record, structure, estimate = solved
    num, den = structure.split(estimate.theta, record.n_outputs, record.n_inputs)
    for i in range(record.n_outputs):
        for j in range(record.n_inputs):
            assert np.array_equal(np.trim_zeros(estimate.model.num[i][j], "f"), num[i][j])
            assert np.array_equal(estimate.model.den[i][j], den[i][j])


def test_covariance_is_symmetric_and_positive(key, solved):
    cov = solved[2].cov
    assert np.array_equal(cov, cov.T)
    scale = np.sqrt(np.diag(cov))
    assert np.min(np.linalg.eigvalsh(cov / np.outer(scale, scale))) > 0
    assert np.array_equal(solved[2].std, scale)


def test_parameters_carry_value_error_unit_and_interval(key, solved):
    estimate = solved[2]
    assert tuple(estimate.parameters) == estimate.names
    for k, name in enumerate(estimate.names):
        parameter = estimate.parameters[name]
        assert (parameter.value, parameter.std) == (estimate.theta[k], estimate.std[k])
        low, high = parameter.interval(0.95)
        assert low < parameter.value < high
        assert (high - low) / 2 == pytest.approx(1.959963985 * parameter.std, rel=1e-8)
        wide = parameter.interval(0.99)
        assert wide[0] < low
        assert wide[1] > high


def test_residual_noise_variance_and_fit_agree(key, solved):
    record, _, estimate = solved
    predicted, residual = estimate.predict(record), estimate.residual(record)
    assert predicted.shape == residual.shape == record.y.shape
    assert np.allclose(predicted + residual, record.y, rtol=0, atol=1e-12 * np.ptp(record.y))
    squares = np.sum(residual**2, axis=0)
    spread = np.sum((record.y - record.y.mean(axis=0)) ** 2, axis=0)
    assert np.allclose(estimate.fit, 100.0 * (1.0 - np.sqrt(squares / spread)), rtol=1e-9)
    # Per channel the divisor may or may not share out the unknowns, but not more than that.
    unknowns = record.y.size - estimate.degrees_of_freedom
    assert 0 < unknowns < 20
    least, most = squares / record.n_samples, squares / (record.n_samples - unknowns)
    assert np.all(estimate.noise_variance >= least * (1 - 1e-9))
    assert np.all(estimate.noise_variance <= most * (1 + 1e-9))


def test_prediction_is_the_model_response_plus_the_nuisance_terms(key, solved):
    record, _, estimate = solved
    term = estimate.nuisance[0]
    moved = Record(record.u - term.input_reference, record.y, dt=record.dt)
    expected = simulate(estimate.model, moved, free_response=term.free_response)
    expected = expected + term.offset + np.outer(record.t - term.t0, term.drift)
    scale = np.max(np.abs(expected))
    assert np.allclose(estimate.predict(record), expected, rtol=0, atol=1e-10 * scale)


def test_truth_lies_within_the_standard_errors(key, solved):
    if CONSISTENT[key] is not True:
        pytest.skip(f"{key}: {CONSISTENT[key]}")
    record, _, estimate = solved
    truth = {
        1: [1.0, 3.0, 0.2, 0.5],
        2: [2.4, 6.3, -7.0, -6.5, -0.1, -5.0],
    }[record.n_outputs]
    assert np.all(np.abs(estimate.theta - truth) < 4.5 * estimate.std)


def test_trace_tells_the_way(key, solved):
    trace = solved[2].trace
    assert trace.passes
    assert trace.stopped
    assert [p.number for p in trace.passes] == sorted({p.number for p in trace.passes})
    for entry in trace.passes:
        assert entry.steps
        assert entry.theta.shape == solved[2].theta.shape
        assert math.isfinite(entry.cost)
        for step in entry.steps:
            assert step.name in {"parallel", "series-parallel", "series", "output error"}
            assert step.coefficients.ndim == 1
            assert step.condition >= 1.0 or math.isnan(step.condition)
    assert np.allclose(trace.passes[-1].theta, solved[2].theta, rtol=1e-5)


def test_three_model_promises_a_checked_stationary_point(key, solved):
    if key != "three-model":
        pytest.skip("a promise of ThreeModel")
    estimate = solved[2]
    assert estimate.status is Status.CONVERGED
    assert 0 <= estimate.gradient < 1e-4
    assert estimate.trace.starts
    assert all(math.isfinite(start.cost) for start in estimate.trace.starts)
    if "auto" not in (solved[1].offset, solved[1].initial_state):
        # Else the starts may have had nuisance terms that were then found unnecessary.
        assert min(s.cost for s in estimate.trace.starts) >= estimate.cost * (1 - 1e-9)
    betas = [p.beta_distance for p in estimate.trace.passes]
    assert any(math.isfinite(b) for b in betas)


def test_summary_is_text_with_every_coefficient(key, solved):
    text = solved[2].summary()
    assert all(name in text for name in solved[2].names)
    assert max(len(line) for line in text.splitlines()) <= 100
    assert "<table" in solved[2]._repr_html_()


def test_save_and_load_give_the_same_estimate(key, solved, tmp_path):
    estimate = solved[2]
    path = tmp_path / "model.json"
    estimate.save(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["model.json"]
    assert json.loads(path.read_text(encoding="utf-8"))["schema"] == 2
    again = Estimate.load(path)
    for name in ("theta", "cov", "noise_variance", "fit"):
        assert np.array_equal(getattr(again, name), getattr(estimate, name))
    for name in ("names", "status", "structure", "cost", "aicc", "n_samples"):
        assert getattr(again, name) == getattr(estimate, name)
    # nan where a method does not end on the output error
    assert np.array_equal(again.gradient, estimate.gradient, equal_nan=True)
    assert again.trace.decisions == estimate.trace.decisions
    assert len(again.trace.passes) == len(estimate.trace.passes)
    assert np.array_equal(again.predict(solved[0]), estimate.predict(solved[0]))
    assert again.summary() == estimate.summary()


# --------------------------------------------------------------------- how a method behaves
def test_method_object_is_frozen_options(key):
    method = METHODS[key]()
    assert method == METHODS[key]()
    assert method.name
    with pytest.raises((AttributeError, TypeError)):
        method.name = "other"
    with pytest.raises((AttributeError, TypeError)):
        method.anything = 1


def test_same_record_same_estimate_and_record_untouched(key):
    record = short_period()
    u, y, t = record.u.copy(), record.y.copy(), record.t.copy()
    first = attempt(key, record, Structure(2, 1))
    second = attempt(key, record, Structure(2, 1))
    assert np.array_equal(first.theta, second.theta)
    assert np.array_equal(first.cov, second.cov)
    assert first.record_fingerprint == second.record_fingerprint
    assert np.array_equal(record.u, u)
    assert np.array_equal(record.y, y)
    assert np.array_equal(record.t, t)


def test_one_record_and_a_sequence_of_one_are_the_same(key):
    record = short_period()
    alone = attempt(key, record, Structure(2, 1))
    listed = attempt(key, [record], Structure(2, 1))
    assert np.array_equal(alone.theta, listed.theta)


def test_progress_is_told_in_words(key):
    words = []
    attempt(key, short_period(), Structure(2, 1), progress=words.append)
    assert words
    assert all(isinstance(word, str) and word.strip() for word in words)


@pytest.mark.fast("output-error", "svf-*", "refined-*", "bias-*")
def test_throw_false_returns_what_throw_true_refuses(key):
    """Noise alone: whatever happens it is either an estimate with a status or a known refusal."""
    rng = np.random.default_rng(8)
    record = Record(binary(), rng.standard_normal(400), dt=DT)
    with contextlib.suppress(IdentifiabilityError):
        estimate = identify(record, Structure(3, 2), METHODS[key](), throw=False)
        assert isinstance(estimate.status, Status)
        if not estimate.status.ok:
            with pytest.raises(err.ConvergenceError):
                identify(record, Structure(3, 2), METHODS[key]())


def test_time_origin_does_not_matter(key):
    record = short_period()
    later = Record(record.u, record.y, t=record.t + 1000.0)
    first = attempt(key, record, Structure(2, 1))
    second = attempt(key, later, Structure(2, 1))
    assert np.allclose(first.theta, second.theta, rtol=1e-6)


def test_two_experiments_have_nuisance_terms_each(key):
    records = [short_period(seed=1), short_period(seed=2, n_samples=250)]
    moved = Record(records[1].u, records[1].y + 9.0, dt=DT)
    pair = [Record(records[0].u, records[0].y, dt=DT), moved]
    estimate = attempt(key, pair, Structure(2, 1, offset=True, initial_state="rest"))
    assert len(estimate.nuisance) == 2
    assert estimate.n_samples == 650
    assert estimate.nuisance[1].offset[0] == pytest.approx(9.0, abs=0.1)
    assert abs(estimate.nuisance[0].offset[0]) < 0.1
    error = np.abs(estimate.theta - [1.0, 3.0, 0.2, 0.5])
    assert np.all(error < (4.5 * estimate.std if CONSISTENT[key] is True else 0.05))


def test_missing_samples_are_left_out_not_filled(key):
    record = short_period()
    y = record.y[:, 0].copy()
    y[100:140] = np.nan
    holed = Record(record.u, y, dt=DT)
    structure = Structure(2, 1, offset=False, initial_state="rest")
    estimate = attempt(key, holed, structure)
    residual = estimate.residual(holed)[:, 0]
    assert np.array_equal(np.isnan(residual), np.isnan(y))
    assert estimate.degrees_of_freedom == 400 - 40 - 4
    assert np.all(np.abs(estimate.theta - [1.0, 3.0, 0.2, 0.5]) < 4.5 * estimate.std)


# ------------------------------------------------------------------------------------ refusals
ONES, ZEROS = np.ones(200), np.zeros(200)
STEP = respond([0.5], [1.0, 1.0, 3.0], ONES)
REFUSED = {
    "zero input": (
        lambda: Record(ZEROS, STEP, dt=DT),
        Structure(2, 0),
        err.ZeroInputError,
    ),
    "one input of two is zero": (
        lambda: Record(np.stack([binary(200), ZEROS], 1), STEP, dt=DT),
        Structure(2, 0),
        err.ZeroInputError,
    ),
    "zero output": (
        lambda: Record(binary(200), ZEROS, dt=DT),
        Structure(2, 0),
        err.ZeroOutputError,
    ),
    "one output of two is zero": (
        lambda: Record(ONES, np.stack([STEP, ZEROS], 1), dt=DT),
        Structure(2, 0),
        err.ZeroOutputError,
    ),
    "constant input, free state": (
        lambda: Record(ONES, STEP, dt=DT),
        Structure(2, 0, initial_state="free"),
        err.ConstantInputError,
    ),
    "constant input, equilibrium": (
        lambda: Record(ONES, STEP, dt=DT),
        Structure(2, 0, initial_state="equilibrium"),
        IdentifiabilityError,
    ),
    "two inputs in step": (
        lambda: Record(np.stack([binary(200), 2.0 * binary(200)], 1), STEP, dt=DT),
        Structure(2, 0),
        IdentifiabilityError,
    ),
    "fewer samples than unknowns": (
        lambda: Record(binary(5, 1), np.arange(5.0), dt=DT),
        Structure(3, 2),
        err.TooFewSamplesError,
    ),
    "jittered time": (
        lambda: Record(ONES, STEP, t=np.cumsum(DT + 0.01 * np.sin(np.arange(200.0)))),
        Structure(2, 0),
        err.NonUniformTimeError,
    ),
    "more poles than the data support": (
        lambda: short_period(noise=0.0),
        Structure(6, 5, offset=False, initial_state="rest"),
        IdentifiabilityError,
    ),
    "orders nested for other channels": (
        short_period,
        Structure(2, [[1], [0]]),
        err.ChannelCountError,
    ),
    "no record": (lambda: [], Structure(2, 0), DataError),
    "records of other channels": (
        lambda: [short_period(), q_and_alpha()],
        Structure(2, 1),
        TridentifyError,
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refusal_is_one_clear_line_of_its_own_class(key, case):
    make, structure, expected = REFUSED[case]
    if case == "jittered time" and Capability.NON_UNIFORM_TIME in METHODS[key]().capabilities:
        pytest.skip("it takes any instants (test_sampling)")
    with pytest.raises(expected) as caught:
        identify(make(), structure, METHODS[key]())
    assert isinstance(caught.value, TridentifyError)
    message = str(caught.value)
    assert "\n" not in message
    assert "found" in message
    assert "expect" in message


@pytest.mark.parametrize(
    "structure",
    [
        Structure(2, 1, delay=0.1),
        Structure(2, 1, delay="free"),
        Structure([[2]], [[1]]),
        Structure(2, 1, fixed={"a0": 3.0}),
        Structure(2, 1, bounds={"a0": (0.0, None)}),
    ],
    ids=["known delay", "free delay", "nested poles", "fixed", "bounds"],
)
def test_options_are_honoured_or_refused_never_ignored(key, structure):
    record = short_period()
    try:
        estimate = identify(record, structure, METHODS[key]())
    except err.UnsupportedError:
        return
    if structure.fixed:
        assert estimate.parameters["a0"].value == 3.0
        assert estimate.parameters["a0"].std == 0.0
    if structure.delay == 0.1:
        assert estimate.model.delay[0][0] == 0.1
    if structure.delay == "free":
        assert "delay" in estimate.names
    if structure.poles == ((2,),):
        assert estimate.theta[0] == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize(
    ("records", "structure"),
    [(np.zeros(5), Structure(2, 0)), ([np.zeros(5)], Structure(2, 0)), (short_period(), 2)],
    ids=["an array", "a list of arrays", "a number as structure"],
)
def test_arguments_in_the_wrong_place_are_named(key, records, structure):
    with pytest.raises((TridentifyError, TypeError), match=r"[Rr]ecord|[Ss]tructure"):
        identify(records, structure, METHODS[key]())


@pytest.mark.parametrize("status", list(Status))
def test_every_status_has_a_message_and_a_remedy(key, status):
    assert status.message
    assert isinstance(status.ok, bool)
    assert status.remedy or status is Status.CONVERGED


def test_step_from_rest_is_not_refused(key):
    record = Record(ONES, STEP, dt=DT)
    estimate = attempt(key, record, Structure(2, 0))
    # (omega dt)^2 / 12 is 6e-4 here
    tolerance = 1e-8 if EXACT[key] is True else 1e-3
    assert np.allclose(estimate.theta, [1.0, 3.0, 0.5], rtol=tolerance)
    assert estimate.structure.initial_state == "rest"


def test_step_in_trim_is_refused_or_said(key):
    """A constant input with an output offset: auto may not invent a gain."""
    rng = np.random.default_rng(2)
    record = Record(ONES, 5.0 + 0.01 * rng.standard_normal(200), dt=DT)
    with contextlib.suppress(IdentifiabilityError, err.ConvergenceError):
        estimate = identify(record, Structure(2, 0), METHODS[key]())
        assert estimate.status is not Status.CONVERGED


# ------------------------------------------------------------------------- the paper, as options
def test_paper_options_are_a_method_too(key):
    if key != "three-model":
        pytest.skip("an option of ThreeModel")
    method = ThreeModel.paper(gamma=2.0)
    assert method == ThreeModel.paper(gamma=2.0)
    assert method != ThreeModel()
    record = short_period(noise=0.0)
    estimate = identify(record, Structure(2, 1, offset=False, initial_state="rest"), method)
    assert np.allclose(estimate.theta, [1.0, 3.0, 0.2, 0.5], rtol=1e-3)
