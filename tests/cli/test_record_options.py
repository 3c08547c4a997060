"""`tridentify identify` on records as they are: experiments, delays, gaps, units, clocks."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tridentify import Record, TransferFunction, simulate

DT = 0.02
DEN = (1.0, 3.0, 9.0)
TRUTH = {"a1": 3.0, "a0": 9.0, "b1": 2.0, "b0": 3.0}


def identified(run: Any, *arguments: object) -> dict[str, Any]:
    outcome = run("identify", *arguments, "--json")
    assert outcome.code == 0, outcome.err
    document: dict[str, Any] = json.loads(outcome.out)
    return document


def values(document: dict[str, Any]) -> dict[str, float]:
    return {item["name"]: item["value"] for item in document["parameters"]}


def noise(seed: int, n: int, size: float = 1e-3) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal(n)


# ------------------------------------------------------------------------------------ experiments
@pytest.fixture
def two_files(write_table, clean) -> tuple[Path, Path]:
    """One system, two lengths, offsets of their own."""
    n = clean["q"].size
    first = clean | {"q": clean["q"] + 0.3 + noise(1, n)}
    second = {name: column[:400] for name, column in clean.items()}
    second |= {"q": second["q"] - 0.2 + noise(2, 400)}
    return write_table("first.csv", first), write_table("second.csv", second)


def test_several_files_are_experiments_of_one_model(run, two_files, question):
    document = identified(run, *two_files, *question, "--offset", "yes")
    for name, value in values(document).items():
        assert value == pytest.approx(TRUTH[name], rel=0.05)
    assert [(e["name"], e["n_samples"]) for e in document["experiments"]] == [
        ("first", 600),
        ("second", 400),
    ]
    assert document["record"] == document["experiments"][0]
    along = {item["name"]: item["value"] for item in document["estimated_along"]}
    assert along == pytest.approx(
        {"offset[q, experiment 1]": 0.3, "offset[q, experiment 2]": -0.2}, abs=1e-3
    )
    alone = identified(run, two_files[1], *question, "--offset", "yes")
    std = [[p["std"] for p in found["parameters"]] for found in (document, alone)]
    assert np.all(np.array(std[0]) < np.array(std[1]))


@pytest.mark.slow
def test_tables_and_folder_name_the_experiments(run, two_files, question, tmp_path):
    outcome = run("identify", *two_files, *question, "--out", tmp_path / "out")
    assert outcome.code == 0
    text = " ".join(outcome.out.split())
    assert "experiment 1, first: q from elevator; 600 samples" in text
    assert "experiment 2, second: q from elevator; 400 samples" in text
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"fit-1.svg", "fit-2.svg", "residual-tests.svg"} <= written
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "first: 0 s to 11.98 s (600 samples)" in page
    assert "second: 0 s to 7.98 s (400 samples)" in page


def test_a_file_named_twice_is_no_second_experiment(run, noisy, question, monkeypatch):
    monkeypatch.chdir(noisy.parent)
    outcome = run("identify", noisy, noisy.name, *question)
    assert outcome.code == 2
    assert "twice; expected different experiments" in outcome.error_lines[0]


def test_a_file_without_the_channel_is_named(run, noisy, write_table, clean, question):
    path = write_table("other.csv", {"t": clean["t"], "aileron": clean["q"], "q": clean["q"]})
    outcome = run("identify", noisy, path, *question)
    assert outcome.code == 2
    assert "no column 'elevator' in 'other.csv'" in outcome.error_lines[0]


def test_experiments_in_different_units_are_refused(run, write_table, clean, question):
    names = {"t": "t", "elevator": "elevator"}
    paths = [
        write_table(f"{unit}.csv", {names.get(k, f"{k} [{unit}]"): v for k, v in clean.items()})
        for unit in ("rad", "deg")
    ]
    outcome = run("identify", *paths, *question)
    assert outcome.code == 2
    assert "deg" in outcome.error_lines[0]
    assert "rad" in outcome.error_lines[0]


# ----------------------------------------------------------------------------------------- delays
@pytest.fixture
def late(write_table, clean) -> Path:
    """The same record with a dead time of 0.2 s before the input."""
    u = np.concatenate((np.zeros(10), clean["elevator"][:-10]))
    q = simulate(TransferFunction([2.0, 3.0], DEN), Record(u, u, dt=DT))[:, 0]
    return write_table("late.csv", clean | {"q": q + noise(4, q.size, 1e-4)})


def test_a_known_delay(run, late, question):
    document = identified(run, late, *question, "--delay", 0.2)
    assert values(document) == pytest.approx(TRUTH, rel=0.01)
    (delay,) = document["delays"]
    assert delay == {"output": "q", "input": "elevator", "value": 0.2, "std": None, "unit": "s"}


@pytest.mark.slow
def test_a_free_delay_has_a_standard_error(run, late, question):
    document = identified(run, late, *question, "--delay", "free")
    (delay,) = document["delays"]
    assert abs(delay["value"] - 0.2) < max(4 * delay["std"], 1e-3)
    assert 0 < delay["std"] < 0.01
    row = document["parameters"][-1]
    assert (row["name"], row["value"], row["std"]) == ("delay", delay["value"], delay["std"])
    told = run("identify", late, *question, "--delay", "free").out
    assert re.search(r"exp\(-\(0\.(2|19)", told), told


def test_each_input_may_have_its_delay(run, write_table, clean):
    rudder = np.roll(clean["elevator"], 270)
    u = np.column_stack((clean["elevator"], rudder))
    model = TransferFunction([[[2.0, 3.0], [5.0]]], [[DEN, DEN]], delay=[[0.0, 0.1]])
    q = simulate(model, Record(u, u[:, 0], dt=DT))[:, 0]
    path = write_table("two.csv", clean | {"rudder": rudder, "q": q})
    options = ["--input", "elevator", "--input", "rudder", "--output", "q", "--poles", 2]
    document = identified(run, path, *options, "--zeros", "1,0", "--delay", "0,0.1")
    assert list(values(document).values()) == pytest.approx([3.0, 9.0, 2.0, 3.0, 5.0], rel=1e-6)
    assert [item["value"] for item in document["delays"]] == [0.0, 0.1]


# ------------------------------------------------------------------------- separate denominators
def test_each_channel_may_have_its_denominator(run, write_table, clean):
    rudder = np.roll(clean["elevator"], 270)
    u = np.column_stack((clean["elevator"], rudder))
    model = TransferFunction([[[2.0, 3.0], [5.0]]], [[DEN, [1.0, 2.0]]])
    q = simulate(model, Record(u, u[:, 0], dt=DT))[:, 0]
    path = write_table("two.csv", clean | {"rudder": rudder, "q": q + noise(5, q.size, 1e-5)})
    options = ["--input", "elevator", "--input", "rudder", "--output", "q"]
    document = identified(run, path, *options, "--poles", "2,1", "--zeros", "1,0")
    expected = {
        "a1[q,elevator]": 3.0,
        "a0[q,elevator]": 9.0,
        "b1[q,elevator]": 2.0,
        "b0[q,elevator]": 3.0,
        "a0[q,rudder]": 2.0,
        "b0[q,rudder]": 5.0,
    }
    assert values(document) == pytest.approx(expected, rel=0.01)
    assert document["structure"]["poles"] == [[2, 1]]


# ---------------------------------------------------------------------------- samples and units
@pytest.mark.slow
@pytest.mark.unjudged
def test_what_a_rule_calls_missing_does_not_count(run, write_table, clean, question):
    q = np.minimum(clean["q"], 0.02)
    path = write_table("saturated.csv", clean | {"q": q})
    biased = values(identified(run, path, *question))
    outcome = run("identify", path, *question, "--missing", "q >= 0.02", "--json")
    document = json.loads(outcome.out)
    assert values(document) == pytest.approx(TRUTH, rel=1e-6)
    assert abs(biased["a0"] - 9.0) > 0.1
    count = int((q >= 0.02).sum())
    assert f"{count} of 600 samples of q" in outcome.err
    assert document["record"]["n_missing"] == count


@pytest.mark.unjudged
def test_units_may_be_stated(run, noisy, question):
    document = identified(run, noisy, *question, "--unit", "q=rad/s", "--unit", "elevator=rad")
    assert document["units"] == {"q": "rad/s", "elevator": "rad"}
    assert [p["unit"] for p in document["parameters"]] == ["1/s", "1/s^2", "1/s^2", "1/s^3"]
    assert "q [rad/s] from elevator [rad]" in " ".join(
        run("identify", noisy, *question, "--unit", "q=rad/s", "--unit", "elevator=rad").out.split()
    )


@pytest.mark.slow
@pytest.mark.unjudged
def test_a_band_limited_input(run, write_table, clean, question):
    t = clean["t"]
    u = 0.05 * np.sin(1.3 * t) * np.exp(-(((t - 6.0) / 2.0) ** 2))
    fine = np.arange(8 * (t.size - 1) + 1) * DT / 8
    v = 0.05 * np.sin(1.3 * fine) * np.exp(-(((fine - 6.0) / 2.0) ** 2))
    model = TransferFunction([2.0, 3.0], DEN)
    q = simulate(model, Record(v, v, dt=DT / 8, intersample="foh"))[::8, 0]
    path = write_table("smooth.csv", {"t": t, "elevator": u, "q": q})
    document = identified(run, path, *question, "--intersample", "band-limited")
    assert values(document) == pytest.approx(TRUTH, rel=1e-3)
    assert document["record"]["intersample"] == "band-limited"


def two_clocks(folder: Path) -> Path:
    """A MATLAB file whose input is sampled five times as often as its output."""
    from scipy.io import savemat

    t = DT * np.arange(600)
    u = np.sign(np.sin(0.9 * t**1.2))
    q = simulate(TransferFunction([2.0, 3.0], DEN), Record(u, u, dt=DT))[:, 0]
    series = {
        "elevator": {"time": t, "signals": {"values": u, "label": "elevator"}},
        "q": {"time": t[::5], "signals": {"values": q[::5], "label": "q"}},
    }
    path = folder / "clocks.mat"
    savemat(path, series)
    return path


@pytest.mark.unjudged
@pytest.mark.slow
def test_channels_of_several_clocks_meet_where_they_are_told(run, tmp_path):
    path = two_clocks(tmp_path)
    listed = json.loads(run("channels", path, "--json").out)["channels"]
    names = [item["name"] for item in listed]
    inputs = next(name for name in names if name.startswith("elevator"))
    output = next(name for name in names if name.startswith("q"))
    options = ["--input", inputs, "--output", output, "--poles", 2, "--zeros", 1]
    everywhere = identified(run, path, *options)
    assert everywhere["record"]["n_samples"] == 600
    assert list(values(everywhere).values()) == pytest.approx([3.0, 9.0, 2.0, 3.0], rel=1e-5)
    few = identified(run, path, *options, "--instants", "outputs")
    assert few["record"]["n_samples"] == 120
    refused = run("identify", path, *options, "--intersample", "band-limited")
    assert refused.code == 2
    assert "channels of 2 clocks" in refused.error_lines[0]


# ------------------------------------------------------------------------------ what is reported
@pytest.mark.slow
def test_noise_loss_and_outliers_are_in_the_document(run, write_table, clean, question):
    rng = np.random.default_rng(2)
    error = noise(2, clean["q"].size)
    error[rng.choice(error.size, 30, replace=False)] += 0.1
    path = write_table("spikes.csv", clean | {"q": clean["q"] + error})
    document = identified(run, path, *question, "--loss", "student")
    assert document["loss"] == "student"
    assert document["outliers"] == {"count": 30, "by_output": {"q": 30}}
    assert document["noise_model"] == {"q": []}
    plain = identified(run, path, *question)
    assert (plain["loss"], plain["outliers"]["count"]) == ("squared", 0)


@pytest.mark.slow
def test_a_noise_model_is_in_the_document(run, write_table, clean, question):
    from scipy import signal

    coloured = signal.lfilter([1.0], [1.0, -0.9], noise(5, clean["q"].size))
    path = write_table("coloured.csv", clean | {"q": clean["q"] + coloured})
    (model,) = identified(run, path, *question, "--noise", "ar")["noise_model"].values()
    assert model[0] == pytest.approx(-0.9, abs=0.1)


@pytest.mark.slow
def test_what_is_fixed_says_so(run, noisy, question):
    outcome = run("identify", noisy, *question, "--fix", "a0=9", "--bound", "b1=0:1.5")
    rows = {line.split("  ")[0]: line.split() for line in outcome.out.splitlines() if line}
    assert rows["a0"][1:3] == ["9", "fixed"]
    assert rows["b1"][1:4] == ["1.5", "at", "bound"]
    document = identified(run, noisy, *question, "--fix", "a0=9", "--bound", "b1=0:1.5")
    assert [p["known"] for p in document["parameters"]] == ["", "fixed", "at bound", ""]


def test_a_column_where_a_file_is_expected_is_told_how_to_be_named(run, tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,a,b,y\n" + "".join(f"{k},{k % 3},{k % 2},{k}\n" for k in range(20)))
    found = run("identify", path, "b", "--input", "a", "--output", "y", "--poles", 1, "--zeros", 0)
    assert found.code == 2
    assert found.error_lines[-1].endswith(
        "found no file 'b' beside 'log.csv'; expected files; if it is a column, write the option "
        "again before it: --input a --input b, --reference r --reference s"
    )
    found = run("identify", path, "--input", "a,b", "--output", "y", "--poles", 1, "--zeros", 0)
    assert found.code == 2
    assert found.error_lines[-1].endswith("correct the name: one name each, not several in one")
