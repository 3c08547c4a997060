"""`tridentify identify` on flight records that are not part of this repository."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

ATTAS = "attas-short-period"
# a1, a0, b1, b0 and fit [percent] of the pitch rate, from the notes that come with the records
PITCH_RATE = {
    "data.csv": ((2.455, 6.355, -7.08, -6.58), 94.8),
    "data_2.csv": ((2.560, 6.405, -7.41, -6.90), 94.2),
}
# how far a second-order model of the noise-free record may be from the linear truth [percent]
JSBSIM = {"jsbsim-a4-doublet": 0.6, "jsbsim-c172p-doublet": 1.0, "jsbsim-t37-3211": 0.6}


def identify(run: Any, file: Path, *options: str) -> dict[str, Any]:
    outcome = run("identify", file, "--poles", 2, "--zeros", 1, *options, "--json")
    assert outcome.code == 0, outcome.err
    document: dict[str, Any] = json.loads(outcome.out)
    return document


def values(document: dict[str, Any]) -> dict[str, float]:
    return {item["name"]: item["value"] for item in document["parameters"]}


@pytest.mark.unjudged
@pytest.mark.parametrize("file", PITCH_RATE)
@pytest.mark.fast("data.csv")
def test_attas_pitch_rate(run, shared_data, file):
    path = shared_data / ATTAS / file
    options = ["--time", "t", "--input", "u_elevator", "--output", "y_q", "--intersample", "foh"]
    document = identify(run, path, *options, "--noise", "white")
    expected, fit = PITCH_RATE[file]
    assert list(values(document).values()) == pytest.approx(expected, rel=1e-3)
    assert document["fit"][0]["fit"] == pytest.approx(fit, abs=0.05)
    assert document["status"]["name"] == "CONVERGED"
    assert any("initial state" in note for note in document["decisions"])


@pytest.mark.slow
@pytest.mark.unjudged
@pytest.mark.parametrize("file", PITCH_RATE)
def test_attas_angle_of_attack_has_the_same_poles(run, shared_data, file):
    path = shared_data / ATTAS / file
    options = ["--input", "u_elevator", "--output", "y_alpha", "--intersample", "foh"]
    document = identify(run, path, *options)
    (a1, a0, _, _), _ = PITCH_RATE[file]
    found = values(document)
    assert (found["a1"], found["a0"]) == pytest.approx((a1, a0), rel=0.05)
    assert document["fit"][0]["fit"] > 93


@pytest.mark.slow
def test_attas_held_input_fits_worse(run, shared_data):
    path = shared_data / ATTAS / "data.csv"
    fits = [
        identify(run, path, "--input", "u_elevator", "--output", "y_q", "--intersample", between)[
            "fit"
        ][0]["fit"]
        for between in ("foh", "zoh")
    ]
    assert fits[0] > fits[1] + 0.2


@pytest.mark.unjudged
@pytest.mark.parametrize(
    "name",
    [
        "jsbsim-c172p-doublet",
        *(pytest.param(n, marks=pytest.mark.slow) for n in JSBSIM if n != "jsbsim-c172p-doublet"),
    ],
)
def test_jsbsim_angle_of_attack(run, shared_data, name):
    folder = shared_data / name
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    options = ["--time", "t", "--input", "delta_e_rad", "--output", "alpha_rad"]
    trimmed = values(identify(run, folder / "data.csv", *options, "--initial-state", "equilibrium"))
    reference = truth["noise_free_reference"]["fit_4par"]
    assert trimmed == pytest.approx({key: reference[key] for key in trimmed}, rel=1.5e-3)

    chosen = values(identify(run, folder / "data.csv", *options))
    for key in ("a1", "a0", "b0"):
        error = 100 * abs(chosen[key] / truth["short_period"][key] - 1)
        assert error < JSBSIM[name], key


@pytest.mark.slow
def test_attas_report_of_both_outputs(run, shared_data, tmp_path):
    options = ["--input", "u_elevator", "--output", "y_q", "--output", "y_alpha"]
    path = shared_data / ATTAS / "data.csv"
    document = identify(run, path, *options, "--intersample", "foh", "--out", str(tmp_path / "out"))
    assert (tmp_path / "out" / "report.html").stat().st_size > 50_000
    assert [item["fit"] > 93 for item in document["fit"]] == [True, True]
    # the residual shows what a second-order model leaves out, and the user is told
    told = [item["message"] for item in document["findings"]]
    assert any("he residual of y_q" in text for text in told)
    assert document["warnings"]
