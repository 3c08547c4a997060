"""``tridentify validate``: the verdict as text and JSON, channels by other names, exit codes."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tridentify import Structure, ThreeModel, identify, read_record

pytestmark = pytest.mark.unjudged


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("models")


@pytest.fixture(scope="module")
def flight(table_at, folder, held):
    """A noisy response to a random square wave."""
    rng = np.random.default_rng(4)
    u = 0.05 * np.repeat(rng.choice([-1.0, 1.0], 40), 15)
    q = held([2.0, 3.0], u) + 1e-3 * rng.standard_normal(u.size)
    return table_at(folder / "flight.csv", {"t": 0.02 * np.arange(u.size), "elevator": u, "q": q})


@pytest.fixture(scope="module")
def models(flight, folder):
    """Models of the right and of too low an order."""
    record = read_record(flight, time="t", inputs=["elevator"], outputs=["q"])
    white = ThreeModel(noise="white")
    for name, structure in (("right", Structure(2, 1)), ("low", Structure(1, 0))):
        identify(record, structure, white).save(folder / f"{name}.json")
    return folder


def test_a_right_model_is_called_so(run, flight, models):
    outcome = run("validate", models / "right.json", flight, "--check")
    assert outcome.code == 0
    assert "Nothing speaks against the model" in outcome.out
    assert "the record that was identified" in outcome.out
    assert "past inputs (q)" in outcome.out


def test_what_is_wrong_is_said_with_a_remedy_and_tells_scripts(run, flight, models):
    outcome = run("validate", models / "low.json", flight)
    assert outcome.code == 0
    text = " ".join(outcome.out.split())
    assert "correlated with elevator at lag" in text
    assert "what to do: " in text
    checked = run("validate", models / "low.json", flight, "--check", "--json")
    assert checked.code == 1
    document = json.loads(checked.out)
    assert document["ok"] is False
    assert document["findings"][0]["message"].split(":")[0] in text
    assert not checked.error_lines


def test_columns_may_be_called_otherwise_in_another_file(run, write_table, held, models):
    rng = np.random.default_rng(5)
    u = 0.05 * np.repeat(rng.choice([-1.0, 1.0], 30), 15)
    y = held([2.0, 3.0], u) + 1e-3 * rng.standard_normal(u.size) + 0.3
    columns = {"t": 5.0 + 0.02 * np.arange(u.size), "de": u, "rate [rad/s]": y}
    path = write_table("other.csv", columns)
    outcome = run(
        "validate", models / "right.json", path, "--input", "de", "--output", "rate", "--json"
    )
    document = json.loads(outcome.out)
    assert document["ok"] is True
    assert document["own"] is False
    assert document["transfer"]["expected_fit"] == pytest.approx(document["fit"], abs=1.0)
    assert document["output_names"] == ["q"]


def test_the_step_of_the_model_serves_files_of_its_columns_without_time(
    run, write_table, held, folder
):
    rng = np.random.default_rng(6)
    u = 0.05 * np.repeat(rng.choice([-1.0, 1.0], 30), 15)
    y = held([2.0, 3.0], u) + 1e-3 * rng.standard_normal(u.size)
    path = write_table("clock.csv", {"clk": 0.02 * np.arange(u.size), "elevator": u, "q": y})
    record = read_record(path, dt=0.02, inputs=["elevator"], outputs=["q"])
    identify(record, Structure(2, 1), ThreeModel(noise="white")).save(folder / "by-step.json")
    outcome = run("validate", folder / "by-step.json", path, "--json")
    assert json.loads(outcome.out)["own"] is True
    assert "0.02 s, as when the model was identified" in outcome.err
    named = run("validate", folder / "by-step.json", path, "--input", "elevator", "--output", "q")
    assert named.code != 0
    assert "--dt" in " ".join(named.error_lines)


def test_time_that_the_model_was_identified_by_is_found_again_by_its_steps(
    run, write_table, held, folder
):
    rng = np.random.default_rng(7)
    u = 0.05 * np.repeat(rng.choice([-1.0, 1.0], 30), 15)
    y = held([2.0, 3.0], u) + 1e-3 * rng.standard_normal(u.size)
    clock = 3000.0 + 20.0 * np.arange(u.size)
    count = np.arange(u.size)  # rises as well, by other steps
    columns = {"no": count, "Test Clock (ms)": clock, "elevator": u, "q": y}
    path = write_table("named.csv", columns)
    record = read_record(path, time="Test Clock", inputs=["elevator"], outputs=["q"])
    identify(record, Structure(2, 1), ThreeModel(noise="white")).save(folder / "named.json")
    outcome = run("validate", folder / "named.json", path, "--json")
    assert json.loads(outcome.out)["own"] is True
    assert "column 'Test Clock (ms)' as time, by its steps of 0.02 s" in outcome.err


@pytest.mark.slow
def test_the_folder_gets_the_figure_and_the_numbers(run, flight, models, tmp_path):
    outcome = run("validate", models / "right.json", flight, "--out", tmp_path / "v", "--json")
    files = sorted(path.name for path in (tmp_path / "v").iterdir())
    assert files == ["fit.svg", "report.html", "residual-tests.svg", "validation.json"]
    kept = json.loads((tmp_path / "v" / "validation.json").read_text())
    shown = json.loads(outcome.out)
    assert [test["p_value"] for test in kept["tests"]] == [t["p_value"] for t in shown["tests"]]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--input", "de"], "found no column 'de'"),
        (["--input", "elevator", "--input", "q"], "found 2 --input for a model with 1 (elevator)"),
        (["--level", "1"], "found level=1.0"),
        (["--experiment", "2"], "found --experiment 2 with 1 file; expected 1,"),
        (["--experiment", "0"], "found --experiment 0"),
        (["--to", "0.2"], "samples of output 'q'"),
    ],
)
def test_bad_input_is_one_line(run, flight, models, options, says):
    outcome = run("validate", models / "right.json", flight, *options)
    assert outcome.code == 2
    assert len(outcome.error_lines) == 1
    assert says in outcome.error_lines[0]
    assert not outcome.out


def test_a_model_that_is_not_there_is_one_line(run, flight, tmp_path):
    outcome = run("validate", tmp_path / "none.json", flight)
    assert outcome.code == 2
    assert len(outcome.error_lines) == 1


def test_an_experiment_counts_from_one(run, flight, models):
    outcome = run("validate", models / "right.json", flight, "--experiment", "1", "--json")
    assert json.loads(outcome.out)["own"] is True
