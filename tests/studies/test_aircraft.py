"""The study of the paper's aircraft: bound, Step 2 alone, seeds, processes, text, pictures."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest
import scipy.linalg

from oracles import cramer_rao
from tridentify.errors import IdentifiabilityError, OptionError, TridentifyError
from tridentify.models.simulate import simulate
from tridentify.plots.study import (
    plot_noise_levels,
    plot_step_responses,
    response_band,
    save_study_figures,
)
from tridentify.record.record import Record
from tridentify.studies import (
    STUDIES,
    Study,
    StudyResult,
    read_study,
    run_study,
    shipped_study,
    study_from,
)
from tridentify.studies.aircraft_result import (
    ESTIMATORS,
    FAILED,
    FLAGGED,
    TRUTH,
    AircraftResult,
    Condition,
    Event,
)
from tridentify.studies.cramer_rao import information_factor, output_sensitivities
from tridentify.studies.declared.draw import drawn, generator, prepare
from tridentify.studies.declared.nouns import cells
from tridentify.studies.declared.result import DeclaredResult
from tridentify.studies.processes import THREADS, process_pool
from tridentify.studies.step_2_alone import step_2_alone
from tridentify.transfer_function import TransferFunction

DRAWS = 4
PLANT = TransferFunction([0.5], [1.0, 1.0, 3.0], input_names=["x"], output_names=["y"])
FILTER = (1.0, 5.0, 6.0, 7.0)


def short():
    """The study on records of 5 and 6 s, without noise and with as much as there is signal."""
    told = tomllib.loads(shipped_study("aircraft").read_text())
    told["inputs"]["step 50 s"]["samples"] = 120
    told["noises"]["white"]["ratio"] = [0.0, 1.0]
    return study_from(told)


def noise_free_record(n_samples, dt):
    x = np.ones(n_samples)
    return Record(x, simulate(PLANT, Record(x, x, dt=dt)), dt=dt)


def noisy_records(length, level, count):
    """Some of the records of the study."""
    cell = [one for one in cells(read_study(shipped_study("aircraft")))][5 * length + level]
    prepared = prepare(cell)
    size = prepared.u.size
    return [prepared.record(drawn(cell.noise, generator(cell, 0, k), size)) for k in range(count)]


@pytest.fixture(scope="module")
def counted():
    """A small run."""
    return AircraftResult.of(run_study(short(), draws=DRAWS, seed=3, workers=1))


@pytest.fixture
def made_up():
    """A result whose every number is chosen here: (theta, events) at noise 1 and at noise 3."""

    def make(theta, events=(), ratio=1.0):
        clean = noise_free_record(100, 0.05)
        psi = output_sensitivities(PLANT, clean.u[:, 0], 0.05)
        bound = np.sqrt(np.diag(cramer_rao(psi, (0.16 * ratio) ** 2)))
        theta = np.broadcast_to(np.asarray(theta, dtype=float), (3, *np.shape(theta)[-2:]))
        return Condition(clean, ratio, 0.16 * ratio, bound, theta, tuple(events))

    return make


# ------------------------------------------------------------------------------------- the bound
def expm_response(theta, n_samples, dt):
    """Step response at the samples by one matrix exponential each: a route of its own."""
    a1, a0, b0 = theta
    system = np.array([[0.0, 1.0, 0.0], [-a0, -a1, b0], [0.0, 0.0, 0.0]])
    start = np.array([0.0, 0.0, 1.0])
    return np.array([(scipy.linalg.expm(system * dt * k) @ start)[0] for k in range(n_samples)])


def test_sensitivities_agree_with_finite_differences_of_another_simulation():
    n_samples, dt, step = 100, 0.05, 1e-5
    exact = output_sensitivities(PLANT, np.ones(n_samples), dt)
    for k in range(3):
        shift = step * np.eye(3)[k]
        ahead = expm_response(np.array(TRUTH) + shift, n_samples, dt)
        behind = expm_response(np.array(TRUTH) - shift, n_samples, dt)
        np.testing.assert_allclose(exact[:, k], (ahead - behind) / (2 * step), atol=2e-10)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_sensitivities_of_a_biproper_model(intersample):
    """Numerator as high as the denominator, any input, both intersample behaviours."""
    theta = np.array([0.8, 2.0, 0.3, -1.0, 0.7])
    u = np.random.default_rng(0).standard_normal(60)
    record = Record(u, u, dt=0.1, intersample=intersample)

    def output(values):
        return simulate(TransferFunction(values[2:], [1.0, *values[:2]]), record)[:, 0]

    model = TransferFunction(theta[2:], [1.0, *theta[:2]])
    exact = output_sensitivities(model, u, 0.1, intersample)
    for k in range(5):
        shift = 1e-5 * np.eye(5)[k]
        slope = (output(theta + shift) - output(theta - shift)) / 2e-5
        np.testing.assert_allclose(exact[:, k], slope, atol=1e-8)


def test_bound_is_the_one_measured_before():
    """std(a1) at 100 samples, noise 0.5, 1, 2, 3 times the RMS, from an independent calculation."""
    clean = noise_free_record(100, 0.05)
    psi = output_sensitivities(PLANT, clean.u[:, 0], 0.05)
    rms = np.sqrt(np.mean(clean.y**2))
    found = [np.sqrt(cramer_rao(psi, (r * rms) ** 2)[0, 0]) for r in (0.5, 1, 2, 3)]
    np.testing.assert_allclose(found, [0.26, 0.52, 1.04, 1.55], atol=0.006)


def test_factor_is_a_root_of_the_information():
    psi = output_sensitivities(PLANT, np.ones(100), 0.05)
    factor = information_factor(psi)
    np.testing.assert_allclose(factor.T @ factor, psi.T @ psi, rtol=1e-9)
    np.testing.assert_allclose(cramer_rao(psi, 0.3), 0.3 * np.linalg.inv(psi.T @ psi), rtol=1e-9)


@pytest.mark.parametrize("psi", [np.ones((5, 2)), np.ones((1, 2))])
def test_no_bound_for_dependent_sensitivities(psi):
    with pytest.raises(IdentifiabilityError, match="linearly dependent"):
        information_factor(psi)


# ---------------------------------------------------------------------------------- Step 2 alone
def test_step_2_alone_errs_by_the_intersample_assumption_only():
    """Without noise at most 0.05 % at 0.05 s, and of second order in the step."""
    errors = []
    for dt in (0.05, 0.025, 0.0125):
        record = noise_free_record(round(5 / dt), dt)
        theta = step_2_alone(record, 2, 0, FILTER)
        errors.append(np.max(np.abs(theta / TRUTH - 1)))
    assert 1e-5 < errors[0] < 5e-4
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(order - 2) < 0.1)


def test_step_2_alone_is_least_squares_on_filtered_signals():
    """The same normal equations from signals filtered by another library."""
    import scipy.signal

    (record,) = noisy_records(length=0, level=1, count=1)
    t, y, x = record.t, record.y[:, 0], record.u[:, 0]
    powers = ([1.0, 0.0, 0.0], [1.0, 0.0], [1.0])
    filtered = [scipy.signal.lsim((power, FILTER), y, t, interp=True)[1] for power in powers]
    driven = scipy.signal.lsim(([1.0], FILTER), x, t, interp=False)[1]
    phi = np.column_stack([-filtered[1], -filtered[2], driven])
    expected = np.linalg.lstsq(phi, filtered[0], rcond=None)[0]
    np.testing.assert_allclose(step_2_alone(record, 2, 0, FILTER), expected, rtol=1e-8)


def test_step_2_alone_falls_with_the_noise():
    """The paper's eq. (6)-(9): the square of the noise pulls a1 and a0 down, b0 with them."""
    noisy = noisy_records(length=1, level=2, count=10)
    a1, a0, _ = np.median([step_2_alone(record, 2, 0, FILTER) for record in noisy], axis=0)
    assert a1 < 0.3
    assert a0 < 2.0


def test_step_2_alone_refuses_dependent_signals():
    with pytest.raises(IdentifiabilityError, match="linearly dependent"):
        step_2_alone(Record(np.ones(3), np.arange(3.0), dt=0.1), 2, 0, FILTER)


# ---------------------------------------------------------------------------- seeds and processes
def test_the_table_of_studies_keeps_its_promise(counted):
    for name, study in STUDIES.items():
        assert isinstance(study, Study)
        assert (study.name, bool(study.description)) == (name, True)
    assert isinstance(counted, StudyResult)


@pytest.mark.parametrize("options", [{"draws": 0}, {"seed": -1}, {"workers": 0}])
def test_numbers_that_make_no_sense_are_refused(options):
    with pytest.raises(OptionError, match=f"found {next(iter(options))}="):
        STUDIES["aircraft"].run(**options)


@pytest.mark.slow
def test_processes_are_single_threaded_and_the_caller_is_left_alone(monkeypatch):
    monkeypatch.setenv(THREADS[0], "7")
    monkeypatch.delenv(THREADS[1], raising=False)
    with process_pool(1) as pool:
        assert list(pool.map(os.getenv, THREADS[:2])) == ["1", "1"]
    assert os.environ[THREADS[0]] == "7"
    assert THREADS[1] not in os.environ


def test_a_dead_process_is_one_clear_error():
    with pytest.raises(TridentifyError, match=r"died.*fewer workers"), process_pool(1) as pool:
        pool.submit(os._exit, 3).result()


@pytest.mark.skipif(sys.platform == "win32", reason="signals to process groups")
@pytest.mark.parametrize(
    ("number", "workers"),
    [(signal.SIGINT, 1), pytest.param(signal.SIGKILL, 2, marks=pytest.mark.slow)],
)
@pytest.mark.slow
def test_no_process_outlives_the_caller(number, workers):
    """Ctrl-C reaches the whole group; a kill reaches the caller only."""
    program = (
        "import time, tridentify.studies.processes as p\n"
        "print('running', flush=True)\n"
        f"with p.process_pool({workers}) as pool:\n"
        "    for k, _ in enumerate(pool.map(time.sleep, [0.2] * 500)): print(k, flush=True)"
    )
    caller = subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert caller.stdout is not None
    assert caller.stdout.readline() == "running\n"
    assert caller.stdout.readline().strip().isdigit()  # a batch is done: the worker is set up
    if number == signal.SIGINT:
        os.killpg(caller.pid, number)
    else:
        caller.kill()
    _, errors = caller.communicate(timeout=20)
    assert caller.returncode != 0
    assert ("KeyboardInterrupt" in errors) == (number == signal.SIGINT)
    assert "Process SpawnProcess" not in errors
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        try:
            os.killpg(caller.pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    pytest.fail("a process is left")


# ------------------------------------------------------------------------------ numbers and text
def test_without_noise_every_estimator_finds_the_truth(counted):
    for condition in counted.conditions:
        if condition.ratio == 0:
            assert condition.n_draws == 1
            assert condition.events == ()
            errors = np.max(np.abs(condition.theta[:, 0] / TRUTH - 1), axis=1)
            assert errors[0] < 1e-3
            assert errors[1] < 1e-6
            assert errors[2] < 1e-9


def test_summary_counts_what_went_wrong(made_up):
    theta = np.array(
        [[1.0, 3.0, 0.5], [1.2, 3.3, 0.6], [-0.1, 3.0, 0.5], [50.0, 3.0, 0.5], [np.nan] * 3]
    )
    events = [
        Event(ESTIMATORS[1], 4, FAILED, "SomeError: reason"),
        Event(ESTIMATORS[1], 3, FLAGGED, "max passes"),
        Event(ESTIMATORS[2], 3, FLAGGED, "max passes"),
    ]
    summary = made_up(theta, events).summary(1)
    assert (summary.failed, summary.unstable, summary.outliers, summary.flagged) == (1, 1, 1, 1)
    np.testing.assert_allclose(summary.median, [1.1, 3.0, 0.5])
    expected = np.sqrt(np.mean((theta[:4] - TRUTH) ** 2, axis=0))
    np.testing.assert_allclose(summary.rmse, expected)


def test_a_condition_where_all_failed_is_shown_and_not_dropped(made_up):
    events = [Event(ESTIMATORS[2], k, FAILED, "BadError: no luck") for k in range(4)]
    result = AircraftResult(0, 4, 1.9, 20, (made_up(np.full((4, 3), np.nan), events),))
    text = result.table()
    assert f"{ESTIMATORS[2]} failed on 4 with BadError; the first: draw 0 at noise 1" in text
    assert "       -" in text
    numbers = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert numbers["conditions"][0]["estimators"][0]["median"] == [None] * 3
    assert len(numbers["conditions"][0]["events"]) == 4


def test_draws_are_those_of_the_file_and_what_failed_or_was_flagged_is_told():
    study = short()
    cell = cells(study)[1]
    names = [method.name for method in study.methods]
    none = dict.fromkeys(("theta", "low", "high"))

    def row(method, draw, **told):
        own = {"cell": cell.name, "method": method, "draw": draw, "failure": "", "ok": True}
        return own | none | {"status": "CONVERGED", "seconds": 0.1} | told

    rows = [row(name, k, theta=[1.0, 3.0, 0.1 * k]) for k in (1, 0) for name in names]
    rows[0] |= {"theta": None, "status": "", "ok": False, "failure": "SomeError: no way"}
    rows[1]["status"] = "MAX_PASSES"
    found = AircraftResult.of(DeclaredResult.of(study, rows))
    assert (found.seed, found.draws, found.passes) == (0, 200, 20)
    assert found.gamma == pytest.approx(7 ** (1 / 3))
    assert [c.ratio for c in found.conditions] == [0.0, 1.0, 0.0, 1.0]
    condition = found.conditions[1]
    np.testing.assert_array_equal(condition.theta[2], [[1.0, 3.0, 0.0], [1.0, 3.0, 0.1]])
    assert np.all(np.isnan(condition.theta[0, 1]))
    assert condition.events == (
        Event(names[0], 1, FAILED, "SomeError: no way"),
        Event(names[1], 1, FLAGGED, "max passes"),
    )


def test_the_bound_is_the_root_of_the_cramer_rao(counted):
    for condition in counted.conditions:
        psi = output_sensitivities(PLANT, np.ones(condition.n_samples), 0.05)
        covariance = cramer_rao(psi, condition.noise_std**2)
        np.testing.assert_allclose(condition.bound, np.sqrt(np.diag(covariance)), rtol=1e-9)


def test_text_fits_a_terminal_and_tells_the_truth(counted):
    text = counted.table()
    assert max(map(len, text.splitlines())) <= 78
    assert text.isascii()
    assert text.endswith("'The paper's aircraft' in the documentation.")
    for name in ESTIMATORS:
        assert name in text
    block = text.split("a1 [1/s], truth 1: 100 samples")[1].split("a0 [1/s^2]")[0]
    rows = [line.split() for line in block.splitlines()]
    assert [row[-1] for row in rows if row and row[-1] in ("0.71", "1.14")] == ["0.71", "1.14"]
    other = text.split("a1 [1/s], truth 1: 120 samples")[1].split("a0 [1/s^2]")[0]
    assert "1.14" not in other


# ---------------------------------------------------------------------------------------- figures
@pytest.mark.slow
def test_pictures_are_written(counted, tmp_path):
    paths = save_study_figures(counted, tmp_path / "new")
    assert [path.name for path in paths] == [
        "aircraft-step-response.svg",
        "aircraft-noise-levels.svg",
    ]
    assert all("<svg" in path.read_text(encoding="utf-8") for path in paths)
    assert save_study_figures(object(), tmp_path) == ()  # type: ignore[arg-type]


def test_pictures_have_labels_and_units(counted):
    five, six = plot_step_responses(counted), plot_noise_levels(counted)
    assert (len(five), len(six)) == (5, 4)
    assert all("[" in ax.get_ylabel() for ax in (*five, six[0], six[2]))
    assert five[-1].get_xlabel() == "time [s]"
    assert all(ax.get_xlabel() for ax in six[2:])
    for wrong in (plot_step_responses, plot_noise_levels):
        with pytest.raises(ValueError, match="expected"):
            wrong(counted, axes=[])


def test_bands_hold_the_fitted_models(counted):
    condition = counted.conditions[1]
    record = condition.example
    band = response_band(condition, 2, record)
    a1, a0, b0 = condition.theta[2, 0]
    one = simulate(TransferFunction([b0], [1.0, a1, a0]), record)[:, 0]
    assert np.all(band[0] <= band[1])
    assert np.all(band[1] <= band[2])
    assert np.max(np.abs(band[1] - one)) < 1.0


@pytest.mark.filterwarnings("error")
@pytest.mark.slow
def test_pictures_of_wild_estimates(made_up, tmp_path):
    """Failures, unstable models and medians far outside the picture draw without a warning."""
    wild = np.array([[np.nan] * 3, [-2.0, 3.0, 0.5], [300.0, 4e4, 9e3], [300.0, 4e4, 9e3]])
    conditions = (made_up(wild), made_up(wild, ratio=3.0), made_up(np.full((4, 3), np.nan)))
    result = AircraftResult(0, 4, 1.9, 20, conditions)
    drawn = plot_noise_levels(result)
    assert any("e+04" in text.get_text() or "1.33" in text.get_text() for text in drawn[1].texts)
    assert len(save_study_figures(result, tmp_path)) == 2


@pytest.mark.slow
def test_pictures_load_no_pyplot():
    code = "import sys, tridentify.plots.study; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


# ------------------------------------------------------------------------------------ statistics
@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_full_study_shows_the_papers_pattern():
    """At 1000 samples Step 2 alone collapses at once; the strategy does so much later."""
    result = STUDIES["aircraft"].run(draws=200, seed=1)
    assert isinstance(result, AircraftResult)
    short, long = result.by_length()
    at_half, at_one = long[1], long[2]
    assert at_half.summary(0).median[0] < 0.6
    for j in (1, 2):
        summary = at_half.summary(j)
        assert np.all(np.abs(summary.median - TRUTH) < 0.5 * at_half.bound)
    assert at_one.summary(0).median[0] < 0.3 < at_one.summary(1).median[0]
    # the medians that were measured before with other code, at 100 samples
    medians = [condition.summary(0).median[0] for condition in short[1:]]
    np.testing.assert_allclose(medians, [0.90, 0.75, 0.38, 0.12], atol=0.12)
    for condition in result.conditions:
        for summary in condition.summaries():
            assert summary.failed < 0.05 * condition.n_draws + 1
