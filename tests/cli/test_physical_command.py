"""`tridentify physical`: ready-made models, what is determined, what is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tridentify import Record, simulate
from tridentify.physical import (
    PhysicalEstimate,
    PhysicalModel,
    first_order_dead_time,
    mass_spring_damper,
    rc_circuit,
    rcrc_circuit,
    short_period,
)

pytestmark = pytest.mark.unjudged

AIRCRAFT = {"Z_alpha": -0.98, "Z_delta": -0.055, "M_alpha": -8.0, "M_q": -0.91, "M_delta": -8.8}
OSCILLATOR = {"m": 2.0, "c": 1.0, "k": 8.0}
LADDER = {"R1": 1e4, "C1": 1e-7, "R2": 1e4, "C2": 2e-7}


def columns(
    model: PhysicalModel, truth: dict[str, float], dt: float, *, n: int = 500, seed: int = 0
) -> dict[str, np.ndarray]:
    """A record from rest with half a percent of noise."""
    rng = np.random.default_rng(seed)
    u = np.sign(rng.standard_normal(n // 20 + 1)).repeat(20)[:n]
    record = Record(u, np.zeros((n, len(model.output_names))), dt=dt)
    y = simulate(model.transfer_function(truth), record)
    y = y + 0.005 * y.std(axis=0) * rng.standard_normal(y.shape)
    named = dict(zip(model.output_names, y.T, strict=True))
    return {"t": dt * np.arange(n), model.input_names[0]: u, **named}


@pytest.fixture
def flight(write_table) -> Path:
    return write_table("flight.csv", columns(short_period(), AIRCRAFT, 0.02, n=300))


def answered(run: Any, *arguments: object) -> dict[str, Any]:
    outcome = run("physical", *arguments, "--json")
    assert outcome.code == 0, outcome.err
    document: dict[str, Any] = json.loads(outcome.out)
    return document


def values(document: dict[str, Any]) -> dict[str, float]:
    return {item["name"]: item["value"] for item in document["parameters"]}


def test_derivatives_of_an_aircraft_within_their_standard_errors(run, flight):
    options = ["--model", "short-period", "--time", "t", "--input", "elevator"]
    document = answered(run, flight, *options, "--output", "alpha", "--output", "q")
    for item in document["parameters"]:
        assert abs(item["value"] - AIRCRAFT[item["name"]]) < 4 * item["std"]
    assert document["restrictions"]["freedom"] == 1
    assert [item["unit"] for item in document["parameters"]][:3] == ["1/s", "1/s", "1/s^2"]
    assert document["coefficients"]["status"]["ok"]


@pytest.mark.slow
def test_columns_are_taken_in_order_where_no_name_tells(run, write_table):
    raw = columns(mass_spring_damper(), OSCILLATOR, 0.05)
    path = write_table("run.csv", {"t": raw["t"], "F": raw["force"], "x": raw["position"]})
    asked = ["--model", "mass-spring-damper", "--input", "F", "--output", "x"]
    document = answered(run, path, *asked)
    assert document["channels"] == {"force": "F", "position": "x"}
    assert values(document) == pytest.approx(OSCILLATOR, rel=0.05)
    assert "force is F and position is x" in run("physical", path, *asked).out


@pytest.mark.slow
def test_columns_are_taken_by_name_then_in_order(run, flight, write_table):
    straight = ["--model", "short-period", "--input", "elevator"]
    one = answered(run, flight, *straight, "--output", "alpha", "--output", "q")
    other = answered(run, flight, *straight, "--output", "q", "--output", "alpha")
    assert values(one) == values(other)
    raw = columns(short_period(), AIRCRAFT, 0.02, n=300)
    renamed = {"t": raw["t"], "de [rad]": raw["elevator"], "AoA [rad]": raw["alpha"], "q": raw["q"]}
    path = write_table("renamed.csv", renamed)
    asked = ["--model", "short-period", "--input", "de", "--output", "q", "--output", "AoA"]
    document = answered(run, path, *asked)
    assert document["channels"] == {"elevator": "de", "alpha": "AoA", "q": "q"}
    assert values(document) == pytest.approx(values(one), rel=1e-9)
    assert "elevator is de and alpha is AoA" in run("physical", path, *asked).out


def test_the_tables_show_parameters_with_units_and_the_test(run, write_table):
    path = write_table("run.csv", columns(mass_spring_damper(), OSCILLATOR, 0.05))
    outcome = run(
        "physical", path, "--model", "mass-spring-damper", "--input", "force", "--output",
        "position",
    )  # fmt: skip
    assert outcome.code == 0
    rows = {line.split("  ")[0]: line.split() for line in outcome.out.splitlines() if line}
    for name, unit in (("m", "kg"), ("c", "m"), ("k", "N/m")):
        assert float(rows[name][1]) == pytest.approx(OSCILLATOR[name], rel=0.05)
        assert rows[name][-1].endswith(unit)
    assert "nan" not in outcome.out


@pytest.mark.slow
def test_what_cannot_be_told_apart_is_said_and_is_no_failure(run, write_table):
    path = write_table("rc.csv", columns(rc_circuit(), {"R": 1e4, "C": 1e-7}, 1e-4))
    asked = ["--model", "rc-circuit", "--input", "u", "--output", "y"]
    outcome = run("physical", path, *asked)
    assert outcome.code == 0
    assert "not determined" in outcome.out
    assert "R*C" in outcome.out
    document = answered(run, path, *asked)
    assert set(values(document).values()) == {None}
    (product,) = document["combinations"]
    assert product["value"] == pytest.approx(1e-3, rel=0.02)
    settled = answered(run, path, *asked, "--known", "R=1e4+-50")
    assert values(settled)["C"] == pytest.approx(1e-7, rel=0.03)
    assert settled["parameters"][0]["known"]


@pytest.mark.slow
def test_what_is_known_is_carried_over(run, write_table):
    path = write_table("ladder.csv", columns(rcrc_circuit(), LADDER, 2e-4))
    asked = ["--model", "rcrc-circuit", "--input", "u", "--output", "y"]
    exact = ["--known", "R1=1e4", "--known", "R2=1e4"]
    document = answered(run, path, *asked, *exact)
    assert values(document)["R1"] == 1e4
    text = run("physical", path, *asked, *exact).out
    assert "known" in next(line for line in text.splitlines() if line.startswith("R1"))


@pytest.mark.slow
def test_several_files_are_several_experiments(run, write_table):
    model = mass_spring_damper()
    paths = [
        write_table(f"{seed}.csv", columns(model, OSCILLATOR, 0.05, n=400 + 50 * seed, seed=seed))
        for seed in (1, 2)
    ]
    asked = ["--model", "mass-spring-damper", "--input", "force", "--output", "position"]
    both = answered(run, *paths, *asked)
    assert [e["n_samples"] for e in both["coefficients"]["experiments"]] == [450, 500]
    alone = answered(run, paths[0], *asked)
    assert both["parameters"][0]["std"] < alone["parameters"][0]["std"]


@pytest.mark.slow
@pytest.mark.undrawn
def test_the_folder_holds_parameters_coefficients_and_report(run, flight, tmp_path):
    options = ["--model", "short-period", "--input", "elevator"]
    document = answered(
        run, flight, *options, "--output", "q", "--output", "alpha", "--out", tmp_path / "out"
    )
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"physical.json", "model.json", "report.html", "fit.svg"} <= names
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for item in document["parameters"]:
        row = page[page.index(f'<td class="text">{item["name"]}</td>') :]
        shown = float(re.findall(r"<td[^>]*>(.*?)</td>", row)[1])
        assert shown == pytest.approx(item["value"], abs=0.6 * item["std"])
    for words in ("What speaks against the map", "Correlations", "static stability"):
        assert words in page
    assert page.index("<dt>Z_alpha</dt>") < page.index("<nav")
    kept = PhysicalEstimate.load(tmp_path / "out" / "physical.json")
    assert dict(zip(kept.names, kept.values.tolist(), strict=True)) == values(document)


def test_the_list_names_models_parameters_and_units(run):
    outcome = run("physical", "--list")
    assert outcome.code == 0
    text = outcome.out
    words = ("short-period: alpha, q from elevator", "M_delta", "1/s^2", "elevator effectiveness")
    assert all(word in text for word in words)
    assert "dc-motor-speed-current: speed, current from voltage" in text
    document = json.loads(run("physical", "--list", "--json").out)
    assert document["rc-circuit"]["parameters"][0] == {
        "name": "R",
        "unit": "ohm",
        "description": "resistance",
    }


CASES = {
    "no model": ([], "found no --model; expected one of short-period"),
    "unknown model": (["--model", "warp-drive"], "found --model 'warp-drive'"),
    "too few outputs": (
        ["--model", "short-period", "--input", "elevator", "--output", "q"],
        "found 1 --output for short period; expected 2, for alpha, q",
    ),
    "no input": (["--model", "rc-circuit", "--output", "q"], "found 0 --input"),
    "unknown column": (
        ["--model", "rc-circuit", "--input", "volt", "--output", "q"],
        "no column 'volt'",
    ),
    "knowledge of nothing": (
        ["--model", "rc-circuit", "--input", "elevator", "--output", "q", "--known", "L=1"],
        "'L' among the known parameters; expected some of R, C",
    ),
    "knowledge in words": (
        ["--model", "rc-circuit", "--input", "elevator", "--output", "q", "--known", "R=big"],
        "found --known 'R=big'",
    ),
    "knowledge that cannot be": (
        ["--model", "rc-circuit", "--input", "elevator", "--output", "q", "--known", "R=-1"],
        "expected a positive value",
    ),
    "other units than the parameters have": (
        ["--model", "mass-spring-damper", "--input", "elevator", "--output", "q", "--unit", "q=mm"],
        "found 'q' in mm; expected m",
    ),
    "free delay": (
        ["--model", "rc-circuit", "--input", "elevator", "--output", "q", "--delay", "free"],
        "identify --delay free",
    ),
}


@pytest.mark.slow
def test_a_channel_may_be_named_with_its_column(run, write_table):
    raw = columns(short_period(), AIRCRAFT, 0.02, n=300)
    path = write_table("raw.csv", {"t": raw["t"], "u=1": raw["elevator"], "y_q": raw["q"],
                                   "alpha": raw["alpha"], "q": -raw["q"]})  # fmt: skip
    asked = ["--model", "short-period", "--input", "elevator=u=1", "--output", "q=y_q"]
    document = answered(run, path, *asked, "--output", "alpha")
    assert document["channels"] == {"elevator": "u=1", "alpha": "alpha", "q": "y_q"}
    for item in document["parameters"]:
        assert abs(item["value"] - AIRCRAFT[item["name"]]) < 4 * item["std"]
    plain = [*asked[:3], "u=1", "--output", "y_q", "--output", "alpha"]
    assert answered(run, path, *plain)["channels"] == document["channels"]
    twice = run("physical", path, *asked, "--output", "q=alpha")
    assert twice.code == 2
    assert "another column for q" in twice.error_lines[0]


@pytest.mark.slow
def test_first_order_with_dead_time_of_any_units(run, write_table):
    model, truth = first_order_dead_time(), {"K": 3.0, "T": 0.6, "D": 0.13}
    path = write_table("heater.csv", columns(model, truth, 0.03))
    asked = ["--model", "first-order-dead-time", "--input", "input", "--output", "output"]
    units = ["--unit", "input=V", "--unit", "output=degC"]
    document = answered(run, path, *asked, *units)
    for item in document["parameters"]:
        assert abs(item["value"] - truth[item["name"]]) < 4 * item["std"]
    refused = run("physical", path, *asked, "--delay", "0.1")
    assert refused.code == 2
    assert "--known D=SECONDS" in refused.error_lines[0]


UNITS = {
    "angles in different units": (["alpha=deg", "q=rad/s", "elevator=rad"], "alpha in deg"),
    "a rate that is none": (["alpha=deg", "q=deg"], "q in deg"),
}


@pytest.mark.parametrize(("units", "says"), UNITS.values(), ids=UNITS.keys())
def test_units_that_do_not_go_together_are_refused(run, flight, units, says):
    words = [word for unit in units for word in ("--unit", unit)]
    options = ["--model", "short-period", "--input", "elevator", "--output", "alpha"]
    outcome = run("physical", flight, *options, "--output", "q", *words)
    assert outcome.code == 2
    assert says in outcome.error_lines[0]


@pytest.mark.slow
@pytest.mark.parametrize("units", [["alpha=deg", "q=deg/s"], ["alpha=rad", "q=1/s"], ["q=rad/s"]])
def test_units_that_go_together_are_taken(run, flight, units):
    words = [word for unit in units for word in ("--unit", unit)]
    options = ["--model", "short-period", "--input", "elevator", "--output", "alpha"]
    assert run("physical", flight, *options, "--output", "q", *words).code == 0


@pytest.mark.parametrize(("words", "says"), CASES.values(), ids=CASES.keys())
def test_a_mistake_is_one_line(run, flight, tmp_path, words, says):
    outcome = run("physical", flight, *words, "--out", tmp_path / "out")
    assert outcome.code == 2
    assert outcome.out == ""
    (line,) = outcome.error_lines
    assert line == outcome.err.splitlines()[-1]
    assert says in line
    assert [path.name for path in tmp_path.iterdir()] == ["flight.csv"]


def test_no_file_is_one_line(run):
    outcome = run("physical", "--model", "rc-circuit", "--input", "u", "--output", "y")
    assert outcome.code == 2
    assert "found no file" in outcome.error_lines[0]


@pytest.mark.slow
def test_an_answer_without_content_ends_with_code_1(run, flight, monkeypatch):
    from tridentify.cli import physical_command

    kept = physical_command.estimate_physical

    def silent(*arguments: Any, **options: Any) -> PhysicalEstimate:
        from dataclasses import replace

        found = kept(*arguments, **options)
        lost = np.full_like(found.values, np.nan)
        return replace(found, values=lost, combinations=(), notes=("nothing is determined",))

    monkeypatch.setattr(physical_command, "estimate_physical", silent)
    options = ["--model", "short-period", "--input", "elevator", "--output", "q"]
    outcome = run("physical", flight, *options, "--output", "alpha")
    assert outcome.code == 1
    assert "nothing is determined" in outcome.error_lines[0]
