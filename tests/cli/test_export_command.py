"""``tridentify export`` and ``tridentify excite``."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tridentify import (
    OutputError,
    Structure,
    TransferFunction,
    identify,
    read_record,
)
from tridentify.export import write_json

pytestmark = pytest.mark.unjudged


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "plant.json"
    plant = TransferFunction([2.0, 3.0], [1.0, 3.0, 9.0], input_names=["elevator"])
    return write_json(plant, path)


@pytest.mark.parametrize(
    ("name", "begins"),
    [
        ("plant.m", b"%"),
        ("plant.mat", b"MATLAB 5.0"),
        ("copy.json", b"{"),
        ("plant.h", b"/*"),
        ("plant.py", b'"""A continuous'),
    ],
)
def test_every_kind_of_file_is_written(run, model, tmp_path, name, begins):
    options = ["--dt", 0.01] if name.endswith(".h") else []
    outcome = run("export", model, tmp_path / "out" / name, *options)
    assert outcome.code == 0, outcome.err
    assert (tmp_path / "out" / name).read_bytes().startswith(begins)
    assert name in outcome.out


def test_a_table_is_of_an_estimate(run, model, noisy, tmp_path):
    refused = run("export", model, tmp_path / "plant.csv")
    assert refused.code == 2
    assert "found a model without standard errors" in refused.err
    record = read_record(noisy, time="t", inputs=["elevator"], outputs=["q"])
    estimate = identify(record, Structure(2, 1, initial_state="rest"), OutputError())
    saved = estimate.save(tmp_path / "model.json")
    assert run("export", saved, tmp_path / "plant.csv").code == 0
    rows = (tmp_path / "plant.csv").read_text().splitlines()
    assert [row.split(",")[0] for row in rows[1:]] == list(estimate.names)


def test_an_estimate_becomes_c(run, noisy, tmp_path):
    record = read_record(noisy, time="t", inputs=["elevator"], outputs=["q"])
    estimate = identify(record, Structure(2, 1, initial_state="rest"), OutputError())
    saved = estimate.save(tmp_path / "model.json")
    header = tmp_path / "f.h"
    options = ["--method", "tustin", "--prewarp", 3, "--number", "float", "--name", "short_period"]
    outcome = run("export", saved, header, "--dt", 0.02, *options, "--json")
    assert outcome.code == 0, outcome.err
    assert json.loads(outcome.out) == {"files": [str(header)]}
    text = header.read_text()
    assert "short_period_step" in text
    assert f"{estimate.theta[0]:.17g}" in text
    assert "Tustin" in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["plant.json", "plant.txt"], ".mat, .m, .h, .py, .csv or .json"),
        (["plant.json", "plant.c"], ".mat, .m, .h, .py, .csv or .json"),
        (["plant.json", "plant.h"], "--dt"),
        (["plant.json", "plant.mat", "--dt", "0.1"], "leave it out"),
        (["nothing.json", "plant.m"], "nothing.json"),
        (["plant.json", "plant.h", "--dt", "0.1", "--prewarp", "3"], "prewarp"),
        (["plant.json", "plant.h", "--dt", "0.1", "--method", "euler"], "--method"),
    ],
)
def test_what_cannot_be_exported_is_one_line(run, model, monkeypatch, tmp_path, arguments, words):
    monkeypatch.chdir(tmp_path)
    outcome = run("export", *arguments)
    assert outcome.code == 2
    assert len(outcome.error_lines) == 1
    assert words in outcome.err
    assert [path.name for path in tmp_path.iterdir()] == ["plant.json"]


def test_models_of_another_schema_or_damaged_are_refused(run, model, tmp_path):
    content = json.loads(model.read_text())
    for changed in ({**content, "model_schema": 99}, {"model_schema": 1}, [1, 2]):
        model.write_text(json.dumps(changed))
        outcome = run("export", model, tmp_path / "plant.m")
        assert outcome.code == 2
        assert len(outcome.error_lines) == 1


SIGNALS = {
    "prbs": ["--order", 6, "--clock", 0.1],
    "multisine": ["--duration", 10, "--band", "0.7,12"],
    "3-2-1-1": ["--for-frequency", 3, "--tail", 5],
    "doublet": ["--width", 0.5, "--lead", 1],
    "chirp": ["--duration", 20, "--band", "0.5,20"],
}


@pytest.mark.parametrize("signal", SIGNALS)
def test_every_signal_is_made_and_read_back(run, tmp_path, signal):
    path = tmp_path / "plan.csv"
    options = [*SIGNALS[signal], "--amplitude", 0.05, "--input", "elevator", "--out", path]
    outcome = run("excite", signal, "--dt", 0.02, *options)
    assert outcome.code == 0, outcome.err
    assert "crest factor" in outcome.out
    again = np.genfromtxt(path, delimiter=",", skip_header=1)
    assert np.abs(again[:, 1]).max() == pytest.approx(0.05, rel=1e-3)
    assert path.read_text().startswith("t [s],elevator\n")


def test_the_precision_of_a_plan_is_told(run, model):
    options = ["--for-frequency", 3, "--tail", 5, "--model", model, "--noise", 0.01]
    outcome = run("excite", "3-2-1-1", "--dt", 0.02, *options)
    assert outcome.code == 0, outcome.err
    assert "Cramer-Rao" in outcome.out
    assert "a1" in outcome.out
    document = json.loads(run("excite", "3-2-1-1", "--dt", 0.02, *options, "--json").out)
    assert document["precision"]["names"] == ["a1", "a0", "b1", "b0"]


@pytest.mark.slow
def test_a_plan_for_a_model_has_the_names_and_units_of_its_inputs(run, noisy, tmp_path):
    names = {"inputs": ["elevator"], "outputs": ["q"], "units": {"elevator": "deg", "q": "deg/s"}}
    estimate = identify(read_record(noisy, **names), Structure(2, 1), OutputError())
    saved, path = estimate.save(tmp_path / "model.json"), tmp_path / "plan.csv"
    options = ["--dt", 0.05, "--width", 0.5, "--model", saved, "--out", path]
    assert run("excite", "doublet", *options).code == 0
    assert path.read_text().startswith("t [s],elevator [deg]\n")
    assert run("excite", "doublet", *options, "--input", "de").code == 0
    assert path.read_text().startswith("t [s],de [deg]\n")


@pytest.fixture
def plant(noisy, tmp_path):
    """A saved estimate of which the input is in radians."""
    units = {"elevator": "rad", "q": "rad/s"}
    record = read_record(noisy, inputs=["elevator"], outputs=["q"], units=units)
    return identify(record, Structure(2, 1), OutputError()).save(tmp_path / "model.json")


DOUBLET = ["doublet", "--dt", 0.05, "--width", 0.5]


@pytest.mark.slow
def test_the_amplitude_is_in_the_unit_of_the_input(run, plant, model, tmp_path):
    asked = [*DOUBLET, "--model", plant, "--json"]
    plain = run("excite", *asked)
    assert json.loads(plain.out)["amplitude"] == pytest.approx([np.radians(1.0)])
    assert "--amplitude is not stated: 0.01745 rad is taken" in plain.err
    for text, expected in (("2deg", np.radians(2.0)), ("0.03", 0.03), ("0.03 rad", 0.03)):
        found = run("excite", *asked, "--amplitude", text)
        assert json.loads(found.out)["amplitude"] == pytest.approx([expected])
        assert "not stated" not in found.err
    without = run("excite", *DOUBLET, "--amplitude", "3V", "--out", tmp_path / "plan.csv")
    assert without.code == 0
    assert (tmp_path / "plan.csv").read_text().startswith("t [s],u [V]\n")
    bare = run("excite", *DOUBLET, "--model", model, "--noise", 0.01, "--amplitude", "1deg")
    assert bare.code == 2
    assert "the model states no unit" in " ".join(bare.err.split())
    for text in ("2V", "much", "2e999"):
        refused = run("excite", *asked, "--amplitude", text)
        assert refused.code == 2
        assert "in rad, the unit of the input" in " ".join(refused.err.split())


def test_pulses_begin_and_end_at_rest_unless_it_is_said_otherwise(run, tmp_path):
    def made(*options):
        assert run("excite", *options, "--out", tmp_path / "plan.csv").code == 0
        return np.genfromtxt(tmp_path / "plan.csv", delimiter=",", skip_header=1)[:, 1]

    pulses = np.flatnonzero(made(*DOUBLET))
    assert (pulses[0], pulses.size) == (10, 20)
    assert len(made(*DOUBLET)) == 10 + 20 + 70
    assert len(made(*DOUBLET, "--lead", 0, "--tail", 1)) == 20 + 20
    swept = made("chirp", "--dt", 0.05, "--duration", 5, "--band", "1,9", "--lead", 1, "--tail", 2)
    assert not swept[:20].any()
    assert not swept[-40:].any()
    assert len(swept) == 20 + 100 + 40


@pytest.mark.slow
def test_noise_may_differ_between_outputs(run, tmp_path, clean, write_table):
    rng = np.random.default_rng(5)
    both = {"t": clean["t"], "elevator": clean["elevator"]}
    both |= {name: clean["q"] + 1e-3 * rng.standard_normal(len(clean["q"])) for name in ("q", "r")}
    record = read_record(write_table("both.csv", both), inputs=["elevator"], outputs=["q", "r"])
    saved = identify(record, Structure(2, 1), OutputError()).save(tmp_path / "model.json")

    def noise(*options):
        found = run("excite", *DOUBLET, "--model", saved, "--json", *options)
        assert found.code == 0, found.err
        return json.loads(found.out)["precision"]["noise_std"]

    own = noise()
    assert noise("--noise", 0.5) == [0.5, 0.5]
    assert noise("--noise", 0.5, "--noise", 0.25) == [0.5, 0.25]
    assert noise("--noise", "r=0.25") == pytest.approx([own[0], 0.25])
    for wrong in (["--noise", "p=1"], ["--noise", "a"], ["--noise", "q=1", "--noise", "q=2"]):
        assert run("excite", *DOUBLET, "--model", saved, *wrong).code == 2


def test_no_two_columns_of_the_plan_are_alike(run, plant):
    told = run("excite", *DOUBLET, "--model", plant).out
    assert "95 % of draws" not in told
    assert "relative" in told


@pytest.mark.slow
def test_the_optimal_input_for_a_saved_model(run, model):
    options = ["--model", model, "--noise", 0.01, "--coefficient", "a0", "--json"]
    several = json.loads(run("excite", "optimal", "--dt", 0.05, *options).out)
    two = json.loads(run("excite", "optimal", "--dt", 0.05, *options, "--binary").out)
    assert several["amplitude"] == pytest.approx([1.0])
    place = several["precision"]["names"].index("a0")
    assert two["precision"]["std"][place] < several["precision"]["std"][place]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["prbs", "--dt", "0.1", "--width", "1"], "--width with prbs"),
        (["chirp", "--dt", "0.1", "--duration", "5"], "--band"),
        (["multisine", "--dt", "0.1", "--duration", "5", "--band", "1"], "--band"),
        (["doublet", "--dt", "0.1", "--width", "1", "--noise", "1"], "--model"),
        (["optimal", "--dt", "0.1"], "--model"),
        (["doublet", "--dt", "0.1"], "found no --width and no --for-frequency"),
        (["doublet", "--dt", "0.1", "--width", "1", "--input", "a", "--input", "b"], "2 inputs"),
        (["sine", "--dt", "0.1"], "sine"),
        (["prbs"], "--dt"),
    ],
)
def test_what_makes_no_plan_is_one_line(run, arguments, words):
    outcome = run("excite", *arguments)
    assert outcome.code == 2
    assert len(outcome.error_lines) == 1
    assert words in outcome.err
