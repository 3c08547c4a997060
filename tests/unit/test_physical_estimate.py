"""Physical parameters from records: known truth, knowledge carried over, refusals, files."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tridentify import Record, Structure, ThreeModel, simulate
from tridentify.errors import (
    ChannelNameError,
    DataError,
    OptionError,
    PhysicalParameterError,
    UndeterminedError,
    UnreadableFileError,
    UnsupportedError,
)
from tridentify.physical import (
    PhysicalEstimate,
    PhysicalModel,
    PhysicalParameter,
    dc_motor,
    estimate_physical,
    mass_spring_damper,
    rc_circuit,
    rcrc_circuit,
    short_period,
)

pytestmark = pytest.mark.unjudged

WHITE = ThreeModel(finish="likelihood", noise="white")
MOTOR = {"R": 1.0, "L": 1e-3, "K": 0.05, "J": 1e-4, "B": 2e-4}
LADDER = {"R1": 1e4, "C1": 1e-7, "R2": 1e4, "C2": 2e-7}
AIRCRAFT = {"Z_alpha": -0.98, "Z_delta": -0.055, "M_alpha": -8.0, "M_q": -0.91, "M_delta": -8.8}
OSCILLATOR = {"m": 2.0, "c": 1.0, "k": 8.0}


def resting(model):
    """The model with nuisance terms that its records do not have."""
    structure = Structure(
        model.structure.poles, model.structure.zeros, offset=False, initial_state="rest"
    )
    return PhysicalModel(
        model.name,
        model.parameters,
        structure,
        model.coefficients,
        input_names=model.input_names,
        output_names=model.output_names,
        start=model.start,
        combinations=model.combinations,
    )


def flown(model, values, dt, *, n=500, noise=0.0, seed=0, offset=0.0):
    rng = np.random.default_rng(seed)
    u = np.sign(rng.standard_normal(n // 20 + 1)).repeat(20)[:n]
    names = {"input_names": model.input_names, "output_names": model.output_names}
    rest = Record(u, np.ones((n, len(model.output_names))), dt=dt, **names)
    y = simulate(model.transfer_function(values), rest)
    y = y + noise * y.std(axis=0) * rng.standard_normal(y.shape) + offset * y.std(axis=0)
    return Record(u, y, dt=dt, **names)


EXACT = [
    (short_period(), AIRCRAFT, 0.02, {}),
    (short_period(pitch_rate_effect=None), AIRCRAFT | {"Z_q": 0.95}, 0.02, {}),
    (dc_motor("both"), MOTOR, 2e-4, {}),
    (dc_motor(), MOTOR, 2e-4, {"R": 1.0, "K": 0.05}),
    (mass_spring_damper(), OSCILLATOR, 0.05, {}),
    (rc_circuit(), {"R": 2e4, "C": 3e-7}, 1e-3, {"R": 2e4}),
]


@pytest.mark.parametrize(("model", "values", "dt", "known"), EXACT)
@pytest.mark.fast("model5*")
def test_noise_free_records_give_the_truth(model, values, dt, known):
    estimate = estimate_physical(resting(model), flown(model, values, dt), WHITE, known=known)
    assert np.allclose(estimate.values, list(values.values()), rtol=1e-5)
    assert all(estimate.parameters[name].std == 0 for name in known)


@pytest.mark.parametrize("fit", ["likelihood", "distance"])
@pytest.mark.fast("distance")
def test_a_map_that_is_one_to_one_is_solved_with_the_delta_method(fit):
    model = mass_spring_damper()
    record = flown(model, OSCILLATOR, 0.05, noise=0.05)
    estimate = estimate_physical(resting(model), record, WHITE, fit=fit)
    free = estimate.estimate
    a1, a0, b0 = free.theta
    assert np.allclose(estimate.values, [1 / b0, a1 / b0, a0 / b0], rtol=1e-4)
    inverse = np.array([[0, 0, -1], [b0, 0, -a1], [0, b0, -a0]]) / b0**2
    expected = np.sqrt(np.diag(inverse @ free.cov @ inverse.T))
    assert np.allclose(estimate.std, expected, rtol=1e-2)
    assert estimate.freedom == 0
    assert np.isnan(estimate.p_value)
    assert estimate.test_note() == ""


@pytest.mark.slow
def test_the_restriction_of_a_short_period_is_tested():
    model = resting(short_period())
    record = flown(short_period(), AIRCRAFT, 0.02, noise=0.1)
    true = estimate_physical(model, record, WHITE)
    assert true.freedom == 1
    assert true.p_value > 0.01
    assert "agree" in true.test_note()
    wrong = flown(short_period(pitch_rate_effect=None), AIRCRAFT | {"Z_q": 0.7}, 0.02, noise=0.1)
    false = estimate_physical(model, wrong, WHITE)
    assert false.p_value < 1e-6
    assert "contradict" in false.test_note()
    assert np.all(false.fit < false.estimate.fit)


@pytest.mark.slow
def test_the_restriction_makes_the_estimate_sharper():
    record = flown(short_period(), AIRCRAFT, 0.02, noise=0.1)
    estimate = estimate_physical(resting(short_period()), record, WHITE)
    assert np.all(np.sqrt(np.diag(estimate.theta_cov)) < 1.001 * estimate.estimate.std)


@pytest.mark.slow
def test_likelihood_and_distance_agree_where_there_is_little_noise():
    record = flown(short_period(), AIRCRAFT, 0.02, noise=0.01)
    estimate = estimate_physical(resting(short_period()), record, WHITE)
    assert np.all(np.abs(estimate.values - estimate.by_distance) < 0.05 * estimate.std)
    assert np.any(estimate.values != estimate.by_distance)


@pytest.mark.slow
def test_the_likelihood_is_at_its_maximum():
    """No parameter moved either way leaves a smaller output error, by simulation alone."""
    record = flown(short_period(), AIRCRAFT, 0.02, noise=0.2)
    estimate = estimate_physical(resting(short_period()), record, WHITE)

    def cost(values):
        model = short_period().transfer_function(dict(zip(AIRCRAFT, values, strict=True)))
        return np.sum(np.log(np.sum((record.y - simulate(model, record)) ** 2, axis=0)))

    lowest = cost(estimate.values)
    for move in np.vstack([np.diag(estimate.std), -np.diag(estimate.std)]):
        low, full = cost(estimate.values + 0.05 * move), cost(estimate.values + move)
        assert lowest < low < full


@pytest.mark.slow
@pytest.mark.parametrize(("offset", "state"), [(True, "free"), (True, "rest"), (False, "free")])
def test_nuisance_terms_are_eliminated(offset, state):
    model = short_period()
    structure = Structure(2, [[1], [1]], offset=offset, initial_state=state)
    described = PhysicalModel(
        "short period", model.parameters, structure, model.coefficients,
        input_names=model.input_names, output_names=model.output_names, start=model.start,
    )  # fmt: skip
    record = flown(model, AIRCRAFT, 0.02, offset=2.0 if offset else 0.0)
    if state == "free":
        record = record.slice(1.0)
    estimate = estimate_physical(described, record, WHITE)
    assert np.allclose(estimate.values, list(AIRCRAFT.values()), rtol=1e-5)
    assert np.all(estimate.fit > 99.99)


@pytest.mark.parametrize("state", ["rest", "free"])
@pytest.mark.fast("rest")
def test_delays_and_uneven_time_belong_to_the_model(state):
    model = mass_spring_damper()
    late = PhysicalModel(
        model.name,
        model.parameters,
        Structure(2, 0, offset=False, initial_state=state, delay=0.13),
        model.coefficients,
        start=model.start,
    )
    rng = np.random.default_rng(6)
    t = np.cumsum(0.05 * (1.0 + 0.3 * rng.uniform(-1.0, 1.0, 500)))
    u = np.sign(rng.standard_normal(25)).repeat(20)
    y = simulate(late.transfer_function(OSCILLATOR), Record(u, u, t=t))
    y = y + 0.02 * y.std() * rng.standard_normal(y.shape)
    estimate = estimate_physical(late, Record(u, y, t=t), WHITE)
    a1, a0, b0 = estimate.estimate.theta
    assert np.allclose(estimate.values, [1 / b0, a1 / b0, a0 / b0], rtol=1e-4)
    assert np.all(np.abs(estimate.values - list(OSCILLATOR.values())) < 4 * estimate.std)
    assert estimate.fit[0] == pytest.approx(estimate.estimate.fit[0], abs=1e-3)


@pytest.mark.slow
def test_a_robust_loss_ends_on_the_least_distance():
    record = flown(mass_spring_damper(), OSCILLATOR, 0.05, noise=0.02)
    y = np.array(record.y)
    y[::50] += 3.0 * y.std()
    names = {"input_names": ["force"], "output_names": ["position"]}
    spoiled = Record(record.u, y, dt=record.dt, **names)
    method = ThreeModel(finish="likelihood", noise="white", loss="student")
    estimate = estimate_physical(resting(mass_spring_damper()), spoiled, method)
    assert np.array_equal(estimate.values, estimate.by_distance)
    assert "the loss is student" in estimate.notes[-1]
    assert np.all(np.abs(estimate.values - list(OSCILLATOR.values())) < 4 * estimate.std)


@pytest.mark.slow
@pytest.mark.parametrize("loss", ["huber", "student"])
def test_fits_under_a_robust_loss_count_the_same_samples(loss):
    record = flown(mass_spring_damper(), OSCILLATOR, 0.05, noise=0.02, offset=0.3)
    y = np.array(record.y)
    y[::50] += 3.0 * y.std()
    method = ThreeModel(finish="likelihood", noise="white", loss=loss)
    estimate = estimate_physical(mass_spring_damper(), record.with_outputs(y), method)
    # as many parameters as coefficients: the two are one model
    assert len(estimate.estimate.outliers) == 10
    assert estimate.fit == pytest.approx(estimate.estimate.fit, abs=0.02)


@pytest.mark.slow
@pytest.mark.judged
def test_cautions_of_the_estimate_are_shown():
    record = flown(mass_spring_damper(), OSCILLATOR, 0.05, noise=0.02)
    y = np.array(record.y)
    y[::50] += 3.0 * y.std()
    estimate = estimate_physical(mass_spring_damper(), record.with_outputs(y), WHITE)
    (caution,) = (c for c in estimate.estimate.cautions if "robust loss" in c)
    assert caution in " ".join(estimate.summary().replace("\n", " ").split())
    assert "standard deviations from the model" in estimate._repr_html_()


@pytest.mark.judged
@pytest.mark.parametrize("fit", ["likelihood", "distance"])
def test_parameters_that_are_all_known_are_tested(fit):
    record = flown(rcrc_circuit(), LADDER, 3e-4, noise=0.02)
    right = estimate_physical(rcrc_circuit(), record, known=LADDER, fit=fit)
    wrong = estimate_physical(rcrc_circuit(), record, known=LADDER | {"R1": 1.2e4}, fit=fit)
    assert right.values.tolist() == list(LADDER.values())
    assert not right.cov.any()
    assert right.freedom == wrong.freedom == 3
    assert wrong.p_value < 1e-6 < 0.01 < right.p_value
    assert "contradict the map" in wrong.summary()


@pytest.mark.slow
def test_experiments_share_the_parameters():
    records = [flown(short_period(), AIRCRAFT, 0.02, noise=0.1, seed=s, n=300) for s in (1, 2)]
    both = estimate_physical(resting(short_period()), records, WHITE)
    each = [estimate_physical(resting(short_period()), r, WHITE) for r in records]
    information = sum(np.linalg.inv(one.cov) for one in each)
    expected = np.sqrt(np.diag(np.linalg.inv(information)))
    assert np.allclose(both.std, expected, rtol=0.1)


def test_missing_samples_and_coloured_noise_are_taken_into_account():
    model = mass_spring_damper()
    record = flown(model, OSCILLATOR, 0.05, n=800)
    rng = np.random.default_rng(3)
    e = 0.02 * record.y.std() * rng.standard_normal(800)
    noise = np.zeros(800)
    for k in range(1, 800):
        noise[k] = 0.9 * noise[k - 1] + e[k]
    y = record.y[:, 0] + noise
    y[100:150] = np.nan
    names = {"input_names": ["force"], "output_names": ["position"]}
    coloured = Record(record.u, y, dt=record.dt, **names)
    estimate = estimate_physical(
        resting(model), coloured, ThreeModel(finish="likelihood", noise="ar")
    )
    assert estimate.estimate.noise_model[0].size > 0
    assert np.all(np.abs(estimate.values - list(OSCILLATOR.values())) < 4 * estimate.std)
    # on the same whitened samples the free coefficients give the same parameters
    assert np.allclose(estimate.values, estimate.by_distance, rtol=1e-3)


# ----------------------------------------------------------------------------- what is known
@pytest.mark.judged
def test_what_is_not_determined_is_nan_and_said():
    record = flown(dc_motor(), MOTOR, 2e-4, noise=0.02)
    estimate = estimate_physical(resting(dc_motor()), record, WHITE)
    assert np.all(np.isnan(estimate.values))
    assert estimate.notes[0].startswith("only 3 of the 5 unknown parameters")
    lead = MOTOR["L"] * MOTOR["J"]
    truth = {
        "L*J/K": lead / MOTOR["K"],
        "R/L + B/J": MOTOR["R"] / MOTOR["L"] + MOTOR["B"] / MOTOR["J"],
        "(B*R + K^2)/(J*L)": (MOTOR["B"] * MOTOR["R"] + MOTOR["K"] ** 2) / lead,
    }
    assert {p.name for p in estimate.combinations} == truth.keys()
    for p in estimate.combinations:
        assert abs(p.value - truth[p.name]) < 4 * p.std
        assert p.std < 0.05 * p.value
    assert estimate.value("L*J/K") == pytest.approx(truth["L*J/K"], rel=0.02)
    with pytest.raises(UndeterminedError, match="known="):
        estimate.value("J")
    with pytest.raises(PhysicalParameterError, match="mass"):
        estimate.value("mass")
    assert "not determined" in estimate.summary()


@pytest.mark.slow
def test_the_error_of_what_is_known_is_carried_over():
    record = flown(rc_circuit(), {"R": 2e4, "C": 3e-7}, 1e-3, noise=0.02)
    exact = estimate_physical(resting(rc_circuit()), record, WHITE, known={"R": 2e4})
    given = estimate_physical(resting(rc_circuit()), record, WHITE, known={"R": (2e4, 1e3)})
    assert exact.parameters["R"].std == 0
    assert given.parameters["R"].std == pytest.approx(1e3, rel=1e-3)
    relative = exact.parameters["C"].relative_std
    assert relative < 0.01
    expected = np.hypot(relative, 0.05)
    assert given.parameters["C"].relative_std == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_what_is_known_is_improved_where_the_record_knows_better():
    model = mass_spring_damper()
    record = flown(model, OSCILLATOR, 0.05, noise=0.05)
    alone = estimate_physical(resting(model), record, WHITE)
    std = alone.parameters["m"].std
    wide = estimate_physical(resting(model), record, WHITE, known={"m": (2.0, 100 * std)})
    equal = estimate_physical(resting(model), record, WHITE, known={"m": (2.0, std)})
    assert wide.values == pytest.approx(alone.values, rel=1e-3)
    assert equal.parameters["m"].std == pytest.approx(std / np.sqrt(2.0), rel=0.02)
    middle = 0.5 * (2.0 + alone.values[0])
    assert equal.values[0] == pytest.approx(middle, abs=0.1 * std)
    assert equal.freedom == 1


@pytest.mark.slow
def test_knowledge_that_contradicts_the_record_is_told():
    model = mass_spring_damper()
    record = flown(model, OSCILLATOR, 0.05, noise=0.05)
    estimate = estimate_physical(resting(model), record, WHITE, known={"m": 3.0})
    assert estimate.freedom == 1
    assert estimate.p_value < 1e-6


@pytest.mark.slow
def test_another_solution_is_told():
    model = rcrc_circuit(buffered=True)
    record = flown(model, LADDER, 2e-4, noise=0.02, n=1000)
    known = {"R1": 1e4, "R2": 1e4}
    estimate = estimate_physical(resting(model), record, WHITE, known=known)
    (other,) = estimate.alternatives
    assert np.allclose(sorted(other[[1, 3]]), sorted(estimate.values[[1, 3]]), rtol=0.02)
    assert not np.allclose(other, estimate.values, rtol=0.1)
    assert any(note.startswith("these explain the record as well") for note in estimate.notes)


@pytest.mark.slow
def test_of_equal_solutions_the_nearest_to_the_guesses_is_taken():
    """Electrical and mechanical time constant exchanged: far from the guesses, but as good."""
    record = flown(dc_motor(), MOTOR, 2e-4, noise=0.02)
    known = {"R": 1.0, "K": 0.05}
    estimate = estimate_physical(resting(dc_motor()), record, WHITE, known=known)
    assert estimate.value("L") == pytest.approx(MOTOR["L"], rel=0.05)
    (other,) = estimate.alternatives
    swapped = dict(zip(dc_motor().names, other, strict=True))
    rate = estimate.value("B") / estimate.value("J")
    assert swapped["R"] / swapped["L"] == pytest.approx(rate, rel=0.01)


@settings(max_examples=6)
@given(seed=st.integers(0, 1000))
@pytest.mark.slow
def test_units_of_the_parameters_scale_the_answer(seed):
    factors = 10.0 ** np.random.default_rng(seed).integers(-6, 7, 3)
    scale = dict(zip(OSCILLATOR, factors.tolist(), strict=True))
    base = resting(mass_spring_damper())
    record = flown(base, OSCILLATOR, 0.05, noise=0.1, n=200)
    scaled = PhysicalModel(
        "oscillator",
        [PhysicalParameter(p.name, guess=p.guess * scale[p.name], positive=True)
         for p in base.parameters],
        base.structure,
        lambda p: base.coefficients({n: v / scale[n] for n, v in p.items()}),
        input_names=base.input_names,
        output_names=base.output_names,
    )  # fmt: skip
    one, other = (estimate_physical(m, record, WHITE) for m in (base, scaled))
    assert np.allclose(other.values, one.values * factors, rtol=1e-4)
    assert np.allclose(other.std, one.std * factors, rtol=1e-2)


# --------------------------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    "known",
    [
        {"mass": 1.0},
        {"m": "heavy"},
        {"m": -1.0},
        {"m": 0.0},
        {"m": np.nan},
        {"m": (1.0, -0.1)},
        {"m": (1.0, np.inf)},
        {"m": (1.0, 0.1, 0.1)},
    ],
)
def test_knowledge_of_no_use_is_refused(known):
    record = flown(mass_spring_damper(), OSCILLATOR, 0.05)
    with pytest.raises(PhysicalParameterError) as caught:
        estimate_physical(mass_spring_damper(), record, known=known)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_channels_are_found_by_name():
    given = flown(short_period(), AIRCRAFT, 0.02, noise=0.05)
    swapped = Record(given.u, given.y[:, ::-1], dt=0.02, input_names=["de"],
                     output_names=["rate", "vane"])  # fmt: skip
    channels = {"elevator": "de", "alpha": "vane", "q": "rate"}
    model = resting(short_period())
    estimate = estimate_physical(model, swapped, WHITE, channels=channels)
    assert np.allclose(estimate.values, estimate_physical(model, given, WHITE).values)
    with pytest.raises(ChannelNameError, match="say which is which"):
        estimate_physical(model, swapped, WHITE)
    with pytest.raises(ChannelNameError, match="beta"):
        estimate_physical(model, swapped, WHITE, channels={**channels, "beta": "vane"})
    with pytest.raises(ChannelNameError):
        estimate_physical(model, swapped, WHITE, channels={**channels, "q": "roll"})


def test_one_input_and_one_output_need_no_names():
    given = flown(mass_spring_damper(), OSCILLATOR, 0.05, noise=0.01)
    plain = Record(given.u, given.y, dt=given.dt)
    estimate = estimate_physical(resting(mass_spring_damper()), plain, WHITE)
    assert estimate.values == pytest.approx(list(OSCILLATOR.values()), rel=0.05)


def test_a_method_without_covariance_is_refused():
    record = flown(mass_spring_damper(), OSCILLATOR, 0.05, noise=0.01)
    with pytest.raises(UnsupportedError, match="covariance"):
        estimate_physical(resting(mass_spring_damper()), record, ThreeModel.paper(2.0))


def test_an_unknown_fit_is_refused():
    record = flown(mass_spring_damper(), OSCILLATOR, 0.05)
    with pytest.raises(OptionError, match="guess"):
        estimate_physical(mass_spring_damper(), record, fit="guess")


# ------------------------------------------------------------------------------------ files
@pytest.mark.judged
def test_an_estimate_survives_its_file(tmp_path):
    record = flown(rcrc_circuit(), LADDER, 2e-4, noise=0.02, n=1000)
    saved = estimate_physical(resting(rcrc_circuit()), record, WHITE, known={"R1": (1e4, 500.0)})
    loaded = PhysicalEstimate.load(saved.save(tmp_path / "circuit.json"))
    assert loaded.summary() == saved.summary()
    assert loaded.known == saved.known
    assert np.array_equal(loaded.cov, saved.cov, equal_nan=True)
    assert np.array_equal(loaded.estimate.cov, saved.estimate.cov)
    assert loaded.model.dc_gain == pytest.approx(1.0, rel=1e-9)
    assert "<td>R1</td>" in saved._repr_html_()


@pytest.mark.parametrize("damage", ["schema", "missing", "text", "empty"])
@pytest.mark.fast("schema", "text")
def test_a_damaged_file_is_refused(tmp_path, damage):
    record = flown(mass_spring_damper(), OSCILLATOR, 0.05, noise=0.01, n=200)
    path = estimate_physical(resting(mass_spring_damper()), record, WHITE).save(tmp_path / "a.json")
    document = json.loads(path.read_text(encoding="utf-8"))
    if damage == "schema":
        document["physical_schema"] = 99
    elif damage == "missing":
        del document["values"]
    elif damage == "text":
        document["values"] = ["much"]
    path.write_text("" if damage == "empty" else json.dumps(document), encoding="utf-8")
    with pytest.raises(UnreadableFileError if damage == "empty" else DataError):
        PhysicalEstimate.load(path)
    with pytest.raises(UnreadableFileError):
        PhysicalEstimate.load(tmp_path / "nowhere.json")
