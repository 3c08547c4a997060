"""Flight records that are not part of this repository: measured ones and simulated ones.

The numbers to be met are those written beside the records: a rough output-error fit for the
measured ones, and ``truth.json`` (the engine's linearisation, and what a correct estimator gets)
for the simulated ones. Skipped where the records are not there.
"""

from __future__ import annotations

import json

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, identify, read_record, validate

pytestmark = pytest.mark.unjudged

ATTAS = {
    # a1, a0, b1, b0, fit of pitch rate [percent]
    "data.csv": ((2.455, 6.355, -7.08, -6.58), 94.8),
    "data_2.csv": ((2.560, 6.405, -7.41, -6.90), 94.2),
}
ATTAS_ONE = ["data.csv", pytest.param("data_2.csv", marks=pytest.mark.slow)]
JSBSIM = [
    "jsbsim-c172p-doublet",
    *(
        pytest.param(name, marks=pytest.mark.slow)
        for name in ("jsbsim-a4-doublet", "jsbsim-t37-3211")
    ),
]
DEGREE = np.pi / 180.0
# the notes' figures are those of plain output error
PLAIN = ThreeModel(noise="white")


def attas(folder, name, outputs):
    return read_record(
        folder("attas-short-period") / name,
        time="t",
        inputs=["u_elevator"],
        outputs=outputs,
        intersample="foh",
    )


# ---------------------------------------------------------------------------------- measured
@pytest.mark.parametrize(
    "options", [{}, pytest.param({"offset": True, "initial_state": "free"}, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("name", ATTAS)
def test_attas_pitch_rate(folder, name, options):
    expected, fit = ATTAS[name]
    estimate = identify(attas(folder, name, ["y_q"]), Structure(2, 1, **options), PLAIN)
    assert np.allclose(estimate.theta, expected, rtol=0.01)
    assert estimate.fit[0] == pytest.approx(fit, abs=0.1)
    assert estimate.model.natural_frequency[0] == pytest.approx(np.sqrt(expected[1]), rel=0.005)


@pytest.mark.slow
@pytest.mark.parametrize("name", ATTAS)
def test_attas_angle_of_attack_has_the_same_poles(folder, name):
    estimate = identify(attas(folder, name, ["y_alpha"]), Structure(2, 1))
    assert np.allclose(estimate.theta[:2], ATTAS[name][0][:2], rtol=0.08)
    assert estimate.fit[0] > 85.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ATTAS_ONE)
def test_attas_both_outputs_with_one_denominator(folder, name):
    record = attas(folder, name, ["y_q", "y_alpha"])
    estimate = identify(record, Structure(2, 1))
    assert np.allclose(estimate.theta[:2], ATTAS[name][0][:2], rtol=0.06)
    assert estimate.fit[0] > 93.0
    assert estimate.fit[1] > 85.0
    assert estimate.model.is_stable


@pytest.mark.slow
@pytest.mark.parametrize("name", ATTAS_ONE)
def test_attas_noise_is_coloured_and_moves_the_coefficients_within_its_errors(folder, name):
    record = attas(folder, name, ["y_q"])
    plain, estimate = (identify(record, Structure(2, 1), method) for method in (PLAIN, None))
    assert estimate.noise_model[0].size > 1
    assert estimate.fit[0] == pytest.approx(plain.fit[0], abs=0.3)
    assert np.all(np.abs(estimate.theta - plain.theta) < estimate.std)
    # with white weights the scatter of the scores allows for the slow residual as well
    assert plain.errors == "scores"
    ratio = estimate.std / plain.std
    assert np.all((ratio > 0.5) & (ratio < 2.0))


@pytest.mark.slow
def test_attas_manoeuvres_agree_within_their_standard_errors(folder):
    one, other = (identify(attas(folder, name, ["y_q"]), Structure(2, 1)) for name in ATTAS)
    difference = (one.theta - other.theta) / np.hypot(one.std, other.std)
    assert np.all(np.abs(difference) < 3.0)


@pytest.mark.slow
def test_attas_both_manoeuvres_together(folder):
    records = [attas(folder, name, ["y_q"]) for name in ATTAS]
    estimate = identify(records, Structure(2, 1, offset=True, initial_state="free"))
    lowest = np.minimum(*(np.array(ATTAS[name][0]) for name in ATTAS))
    highest = np.maximum(*(np.array(ATTAS[name][0]) for name in ATTAS))
    slack = 0.01 * np.abs(lowest)
    assert np.all(estimate.theta > lowest - slack)
    assert np.all(estimate.theta < highest + slack)
    assert len(estimate.nuisance) == 2


def test_attas_model_of_one_manoeuvre_explains_the_other(folder):
    first, second = (attas(folder, name, ["y_q"]) for name in ATTAS)
    estimate = identify(first, Structure(2, 1), PLAIN)
    # Only the nuisance terms of the second record are fitted: its coefficients are given.
    response = _response(estimate.theta, second)
    columns = np.column_stack([np.ones(second.n_samples), _free(estimate.theta, second.t)])
    left = second.y[:, 0] - response
    left = left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]
    y = second.y[:, 0]
    fit = 100.0 * (1.0 - np.linalg.norm(left) / np.linalg.norm(y - y.mean()))
    assert fit == pytest.approx(93.8, abs=0.3)


def _response(theta, record):
    """First-order-hold response by integrating the augmented companion form."""
    from scipy.linalg import expm

    a1, a0, b1, b0 = theta
    block = np.zeros((4, 4))
    block[0], block[1, 0], block[2, 3] = [-a1, -a0, 1.0, 0.0], 1.0, 1.0
    step, u = expm(block * record.dt), record.u[:, 0]
    x, y = np.zeros(2), np.empty(u.size)
    slope = np.append(np.diff(u) / record.dt, 0.0)
    for k in range(u.size):
        y[k] = b1 * x[0] + b0 * x[1]
        x = step[:2, :2] @ x + step[:2, 2] * u[k] + step[:2, 3] * slope[k]
    return y


def _free(theta, t):
    pole = np.roots([1.0, theta[0], theta[1]])[0]
    mode = np.exp(pole * (t - t[0]))
    return np.stack([mode.real, mode.imag], axis=1)


# --------------------------------------------------------------------------------- simulated
def jsbsim(folder, name, outputs=("alpha_rad",), *, thin=4):
    """The record at 50 Hz with the trim subtracted, as its README grades an estimator."""
    path = folder(name)
    truth = json.loads((path / "truth.json").read_text(encoding="utf-8"))
    record = read_record(path / "data.csv", time="t", inputs=["delta_e_rad"], outputs=list(outputs))
    trim = {"alpha_rad": truth["trim"]["alpha"], "q_rad_s": 0.0}
    u = record.u[::thin] - truth["trim"]["de"]
    y = record.y[::thin] - np.array([trim[channel] for channel in outputs])
    return Record(u, y, dt=thin * record.dt, output_names=outputs), truth


@pytest.mark.parametrize("zeros", [1, 0])
@pytest.mark.parametrize("name", JSBSIM)
@pytest.mark.fast("jsbsim-c172p-doublet-1")
def test_jsbsim_equals_plain_output_error(folder, name, zeros):
    record, truth = jsbsim(folder, name)
    estimate = identify(record, Structure(2, zeros, offset=True, initial_state="rest"))
    reference = truth["noise_free_reference"]["fit_4par" if zeros else "fit_3par"]
    for key in ("a1", "a0", "b0"):
        assert estimate.parameters[key].value == pytest.approx(reference[key], rel=2e-3)
    if zeros:
        assert estimate.parameters["b1"].value == pytest.approx(reference["b1"], rel=2e-2)
    assert estimate.nuisance[0].offset[0] == pytest.approx(reference["offset"], abs=1e-6)


@pytest.mark.parametrize("name", JSBSIM)
def test_jsbsim_short_period_within_its_modelling_error(folder, name):
    """Raw record, angles as recorded: trim, offsets and state are for the method to find."""
    path = folder(name)
    truth = json.loads((path / "truth.json").read_text(encoding="utf-8"))["short_period"]
    record = read_record(path / "data.csv", time="t", inputs=["delta_e_rad"], outputs=["alpha_rad"])
    estimate = identify(record, Structure(2, 1))
    for key in ("a1", "a0", "b0"):
        assert estimate.parameters[key].value == pytest.approx(truth[key], rel=0.015)
    assert estimate.structure.initial_state in {"equilibrium", "free"}
    assert estimate.fit[0] > 97.0


@pytest.mark.parametrize("name", JSBSIM)
def test_jsbsim_alpha_and_q_together(folder, name):
    record, truth = jsbsim(folder, name, ("alpha_rad", "q_rad_s"))
    estimate = identify(record.slice(0.0, 4.0), Structure(2, 1))
    for key in ("a1", "a0"):
        value = truth["short_period"][key]
        assert estimate.parameters[key].value == pytest.approx(value, rel=0.02)


@pytest.mark.parametrize("name", JSBSIM)
def test_jsbsim_standard_errors_are_those_of_its_readme(folder, name):
    """White noise of 0.05 degree on the angle of attack, 50 Hz, whole record."""
    record, truth = jsbsim(folder, name)
    reference = truth["noise_free_reference"]
    rng = np.random.default_rng(5)
    level = 0.05
    y = record.y[:, 0] + level * DEGREE * rng.standard_normal(record.n_samples)
    structure = Structure(2, 1, offset=True, initial_state="rest")
    estimate = identify(Record(record.u, y, dt=record.dt), structure)
    for key in ("a1", "a0", "b1", "b0"):
        expected = level * reference["sd_per_deg_white_alpha_noise"][key]
        parameter = estimate.parameters[key]
        assert parameter.std == pytest.approx(expected, rel=0.25)
        assert abs(parameter.value - reference["fit_4par"][key]) < 4.5 * expected


@pytest.mark.judged
@pytest.mark.slow
def test_attas_first_samples_of_the_second_flight_are_named(folder):
    """They are wild; four poles with a free start fit them, and predict the rest no better."""
    first, second = (attas(folder, name, ["y_q"]) for name in ATTAS)
    findings = validate(identify(first, Structure(2, 1)), second).findings
    assert findings[0].code == "bad-samples"
    assert {0.0, 0.04} <= set(findings[0].times)
    assert "order-low" not in [one.code for one in findings]
