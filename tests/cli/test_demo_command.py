"""`tridentify demo`: the shipped record, its truth, and what it tells the user to try."""

from __future__ import annotations

import io
import json
import re
import shlex
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest

from tridentify import Estimate, Record, Structure, ThreeModel, identify, read_record
from tridentify.cli import demo_command, main
from tridentify.cli.run import estimate_model
from tridentify.cli.terminal import own_command

pytestmark = [pytest.mark.undrawn, pytest.mark.unjudged]

NUMERATORS = [
    "b1 s + b0, with noise",
    "b alone, with noise",
    "b1 s + b0, without noise",
    "b alone, without noise",
]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("demo")


@pytest.fixture(scope="module")
def once() -> Callable[[Record, Structure], Estimate]:
    """`estimate_model`, which does not identify again what it has."""
    estimates: dict[tuple[tuple[str, ...], Structure], Estimate] = {}

    def known(record: Record, structure: Structure) -> Estimate:
        key = record.output_names, structure
        if key not in estimates:
            estimates[key] = estimate_model(record, structure)
        return estimates[key]

    return known


@pytest.fixture(scope="module")
def printed(place: Path, once: Callable[[Record, Structure], Estimate]) -> str:
    """What the demo prints; its files stay in `place`."""
    with pytest.MonkeyPatch.context() as context, redirect_stdout(io.StringIO()) as out:
        context.chdir(place)
        context.setattr(demo_command, "estimate_model", once)
        assert main(["demo"]) == 0
    return out.getvalue()


@pytest.fixture(scope="module")
def document(
    place: Path, printed: str, once: Callable[[Record, Structure], Estimate]
) -> dict[str, Any]:
    """The same as JSON, into the folder that is already there, without drawing once more."""
    with pytest.MonkeyPatch.context() as context, redirect_stdout(io.StringIO()) as out:
        context.setattr(demo_command, "estimate_model", once)
        context.setattr(demo_command, "write_results", lambda *_: None)
        assert main(["demo", "--json", "--out", str(place / "tridentify-demo")]) == 0
    loaded: dict[str, Any] = json.loads(out.getvalue())
    return loaded


@pytest.fixture(scope="module")
def story(repository: Path) -> dict[str, Any]:
    path = repository / "src" / "tridentify" / "data" / "short_period.json"
    loaded: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return loaded


def by_name(rows: list[dict[str, Any]], key: str) -> dict[str, float]:
    return {row["name"]: row[key] for row in rows}


def renamed(coefficients: dict[str, float]) -> dict[str, float]:
    """The names of the truth as those of a model with two outputs."""
    places = {"b": "[alpha,delta_e]", "c": "[q,delta_e]"}
    return {
        (f"b{name[1]}{places[name[0]]}" if name[0] in places else name): value
        for name, value in coefficients.items()
    }


@pytest.mark.parametrize(
    ("outputs", "part", "tolerance"), [(["alpha"], "alpha", 0.02), (["alpha", "q"], "both", 0.1)]
)
def test_with_white_weights_the_record_gives_what_a_plain_output_error_fit_finds(
    story, repository, outputs, part, tolerance
):
    path = repository / "src" / "tridentify" / "data" / "short_period.csv"
    record = read_record(path, time="t", inputs=["delta_e"], outputs=outputs)
    estimate = identify(record, Structure(2, 1), ThreeModel(noise="white"))
    reference = story["noisy_reference"]["alpha" if part == "alpha" else "alpha_and_q"]
    expected = reference["coefficients"]
    expected = expected if part == "alpha" else renamed(expected)
    # the reference counts its offset from another place; a part of a standard error is plenty
    for name, found in estimate.parameters.items():
        assert found.value == pytest.approx(expected[name], abs=tolerance * found.std)


@pytest.mark.slow
def test_the_demo_lies_near_a_plain_output_error_fit(document, story):
    reference = renamed(story["noisy_reference"]["alpha_and_q"]["coefficients"])
    both = document["alpha and q"]["comparison"]
    for name, std in by_name(both, "std").items():
        assert by_name(both, "value")[name] == pytest.approx(reference[name], abs=2.0 * std)


def test_every_coefficient_is_compared_with_its_own_truth(document, story):
    truth = story["short_period"]
    assert by_name(document["alpha"]["comparison"], "truth") == {
        name: truth[name] for name in ("a1", "a0", "b1", "b0")
    }
    wanted = renamed({name: truth[name] for name in ("a1", "a0", "b1", "b0", "c1", "c0")})
    assert by_name(document["alpha and q"]["comparison"], "truth") == wanted
    for part in ("alpha", "alpha and q"):
        for row in document[part]["comparison"]:
            error = row["value"] - row["truth"]
            assert row["error_percent"] == pytest.approx(100 * error / row["truth"])
            assert row["error_in_std"] == pytest.approx(error / row["std"])
            assert abs(row["error_in_std"]) < 3


def test_the_bias_of_b_alone_is_shown(document, printed):
    parts = document["numerators"]
    assert list(parts) == NUMERATORS
    full, short = (by_name(parts[name]["comparison"], "error_percent") for name in NUMERATORS[2:])
    for name in ("a1", "a0", "b0"):
        assert abs(full[name]) < 0.4
        assert 0.6 < short[name] < 1.0
        assert f"{short[name]:+.1f} % in {name}" in " ".join(printed.split())
    for title in NUMERATORS:
        assert title in printed
    assert printed.count("left out") == 2


def test_every_number_of_the_comparison_is_printed(document, printed):
    for part in ("alpha", "alpha and q"):
        for row in document[part]["comparison"]:
            lines = [line for line in printed.splitlines() if line.startswith(row["name"] + " ")]
            determined = row["std"] <= abs(row["value"])
            shown = f"{row['error_percent']:+.2f}" if determined else "not determined"
            assert any(shown in line for line in lines)
    assert printed.count("not determined") == 3  # b1 of alpha: alone, with q, and in the last table
    assert "6 of 6 coefficients lie within two standard errors" in printed


def test_the_folder_holds_report_model_figures_and_record(place, document):
    folder = place / "tridentify-demo"
    names = {path.name for path in folder.iterdir()}
    assert {"report.html", "model.json", "fit.svg", "bode.svg", "short_period.csv"} <= names
    assert [Path(name).name for name in document["files"]] == ["short_period.csv"]
    estimate = Estimate.load(folder / "model.json")
    assert estimate.output_names == ("alpha", "q")
    assert dict(estimate.units)["delta_e"] == "rad"
    assert "A-4" in (folder / "report.html").read_text(encoding="utf-8")
    assert [path.name for path in place.iterdir()] == ["tridentify-demo"]


def test_what_it_tells_to_try_next_works(place, printed, run, monkeypatch):
    monkeypatch.chdir(place)
    joined = printed.replace("\\\n", " ")
    (command,) = re.findall(r"tridentify (identify \S+short_period.csv .*)", joined)
    outcome = run(*shlex.split(command.partition(" --out ")[0]))
    assert outcome.code == 0
    assert "natural frequency" in outcome.out


def test_it_names_the_program_as_it_was_called(tmp_path, monkeypatch):
    program = tmp_path / "bin of mine" / "tridentify"
    program.parent.mkdir()
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setattr("sys.argv", [str(program), "demo"])
    assert own_command() == f"'{program}'"
    monkeypatch.setenv("PATH", str(program.parent))
    assert own_command() == "tridentify"
    monkeypatch.setattr("sys.argv", ["/elsewhere/tridentify/__main__.py"])
    assert own_command() == f"{shlex.quote(sys.executable)} -m tridentify"
    monkeypatch.setattr("sys.argv", ["pytest"])
    assert own_command() == "tridentify"


def test_a_folder_that_cannot_be_written_is_refused(run, tmp_path):
    (tmp_path / "file").write_text("")
    outcome = run("demo", "--out", tmp_path / "file" / "demo")
    assert outcome.code == 2
    assert len(outcome.err.splitlines()) == 1
