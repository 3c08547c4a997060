"""The shipped demonstration record against its stated truth, by routes of the test's own."""

from __future__ import annotations

import csv
import hashlib
import importlib.util
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy import signal
from scipy.linalg import expm

COLUMNS = ["t", "delta_e", "alpha", "q", "alpha_true", "q_true"]
LETTERS = {"alpha": ("b1", "b0"), "q": ("c1", "c0")}


@pytest.fixture(scope="module")
def folder(repository: Path) -> Path:
    return repository / "src" / "tridentify" / "data"


@pytest.fixture(scope="module")
def description(folder: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((folder / "short_period.json").read_text(encoding="utf-8"))
    return loaded


@pytest.fixture(scope="module")
def record(folder: Path) -> dict[str, np.ndarray]:
    return read(folder / "short_period.csv")


@pytest.fixture(scope="module")
def script(repository: Path) -> ModuleType:
    """The generating script as a module; skips without the engine."""
    pytest.importorskip("jsbsim")
    path = repository / "examples" / "jsbsim_short_period.py"
    spec = importlib.util.spec_from_file_location("jsbsim_short_period", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def read(path: Path) -> dict[str, np.ndarray]:
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    values = np.array(rows, dtype=float)
    return {name: values[:, column] for column, name in enumerate(header)}


def five_state_response(model: dict[str, Any], elevator: np.ndarray, dt: float) -> np.ndarray:
    """Deviations of alpha and q, (n, 2), for an elevator held between the samples."""
    block = np.zeros((6, 6))
    block[:5, :5], block[:5, 5] = model["A"], model["B"]
    step = expm(block * dt)
    state, output = np.zeros(5), []
    for value in elevator - elevator[0]:
        output.append(state[1:3])
        state = step[:5, :5] @ state + step[:5, 5] * value
    return np.array(output)


def fitted(
    coefficients: dict[str, float], channel: str, elevator: np.ndarray, dt: float
) -> np.ndarray:
    """Deviation (n,) of one output of the two-pole model, by its discrete equivalent."""
    numerator = [coefficients[name] for name in LETTERS[channel]]
    denominator = [1.0, coefficients["a1"], coefficients["a0"]]
    b, a, _ = signal.cont2discrete((numerator, denominator), dt, method="zoh")
    return np.asarray(signal.lfilter(np.ravel(b), a, elevator - elevator[0]))


def test_file_is_the_described_one(folder: Path, description: dict[str, Any]) -> None:
    content = (folder / description["record"]["file"]).read_bytes()
    assert hashlib.sha256(content).hexdigest() == description["record"]["sha256"]
    assert len(content) < 100_000
    assert b"\r" not in content


def test_header_units_and_time(record: dict[str, np.ndarray], description: dict[str, Any]) -> None:
    stated = description["record"]
    assert list(record) == COLUMNS
    assert stated["units"] == dict(
        zip(COLUMNS, ("s", "rad", "rad", "rad/s", "rad", "rad/s"), strict=True)
    )
    assert stated["intersample"] == "zoh"
    expected = stated["sample_interval"] * np.arange(stated["n_samples"])
    np.testing.assert_allclose(record["t"], expected, rtol=0, atol=1e-12)
    assert all(np.all(np.isfinite(column)) for column in record.values())


def test_elevator_is_the_stated_manoeuvre(
    record: dict[str, np.ndarray], description: dict[str, Any]
) -> None:
    flight, trim = description["flight"], description["trim"]["delta_e"]
    edge, level = flight["start"], np.zeros(record["t"].size)
    for step in description["manoeuvre"]["steps"]:
        end = edge + step["units"] * flight["unit"]
        level[(record["t"] > edge - 1e-6) & (record["t"] < end - 1e-6)] = step["sign"]
        edge = end
    expected = trim + level * np.radians(flight["amplitude"])
    np.testing.assert_allclose(record["delta_e"], expected, rtol=0, atol=1e-12)
    # The drag table has a kink at zero elevator, which a linear model cannot have.
    assert np.all(record["delta_e"] < 0.0)


def test_record_starts_in_the_stated_trim(
    record: dict[str, np.ndarray], description: dict[str, Any]
) -> None:
    before = record["t"] <= description["flight"]["start"]
    for channel in ("alpha", "q"):
        drift = record[f"{channel}_true"][before] - description["trim"][channel]
        assert np.abs(drift).max() < 1e-5


def test_five_state_model_reproduces_the_noise_free_response(
    record: dict[str, np.ndarray], description: dict[str, Any]
) -> None:
    model = five_state_response(description["five_state_model"], record["delta_e"], 0.02)
    for column, channel in enumerate(("alpha", "q")):
        flown = record[f"{channel}_true"] - record[f"{channel}_true"][0]
        # What is left is the engine's nonlinearity at one degree of elevator. A delay of half a
        # sample would leave more than 4 % of the peak in alpha.
        assert np.abs(flown - model[:, column]).max() < 0.02 * np.abs(flown).max()


def test_noise_is_as_stated(record: dict[str, np.ndarray], description: dict[str, Any]) -> None:
    noise = np.column_stack([record[name] - record[f"{name}_true"] for name in ("alpha", "q")])
    std = np.array([description["noise"]["std"][name] for name in ("alpha", "q")])
    np.testing.assert_allclose(np.degrees(std), [0.25, 0.2], rtol=1e-12)
    # Standard errors of a standard deviation and of correlations of n samples.
    n_samples = len(noise)
    assert np.all(np.abs(noise.std(axis=0) / std - 1.0) < 4.0 / np.sqrt(2.0 * n_samples))
    white = noise / std
    lagged = np.abs(white[1:].T @ white[:-1]) / n_samples
    assert np.all(lagged < 4.0 / np.sqrt(n_samples))
    assert abs(white[:, 0] @ white[:, 1]) / n_samples < 4.0 / np.sqrt(n_samples)
    draw = np.random.default_rng(description["noise"]["seed"]).standard_normal(noise.shape)
    np.testing.assert_allclose(noise, std * draw, rtol=0, atol=2e-12)


def test_short_period_agrees_with_the_state_matrices(description: dict[str, Any]) -> None:
    model, truth = description["five_state_model"], description["short_period"]
    assert model["states"] == ["V", "alpha", "q", "theta", "h"]
    a_matrix = np.array(model["A"])[1:3, 1:3]
    b_column = np.array(model["B"])[1:3, None]
    numerators, denominator = signal.ss2tf(a_matrix, b_column, np.eye(2), np.zeros((2, 1)))
    expected = {
        "a1": denominator[1], "a0": denominator[2],
        "b1": numerators[0, 1], "b0": numerators[0, 2],
        "c1": numerators[1, 1], "c0": numerators[1, 2],
        "natural_frequency": np.sqrt(denominator[2]),
        "damping": denominator[1] / np.sqrt(4.0 * denominator[2]),
    }  # fmt: skip
    assert truth == pytest.approx(expected, rel=1e-10)
    poles = np.linalg.eigvals(np.array(model["A"]))
    pair = np.poly(poles[np.argsort(-np.abs(poles))][:2]).real
    assert model["fast_pair"] == pytest.approx({"a1": pair[1], "a0": pair[2]}, rel=1e-10)


def test_short_period_agrees_with_an_earlier_analysis(description: dict[str, Any]) -> None:
    """Another program's linearisation of the same engine and condition, to its printed digits."""
    assert description["flight"]["aircraft"] == "A4"
    assert (description["flight"]["speed"], description["flight"]["altitude"]) == (200.0, 5000.0)
    earlier = {
        "a1": 2.0423, "a0": 12.294, "b1": -0.059195, "b0": -12.03, "c1": -11.972, "c0": -11.961,
        "natural_frequency": 3.5063, "damping": 0.29124,
    }  # fmt: skip
    assert description["short_period"] == pytest.approx(earlier, rel=5e-5)


@pytest.mark.parametrize("name", ["noise_free_reference", "noisy_reference"])
@pytest.mark.parametrize("fit", ["alpha", "q", "alpha_and_q"])
def test_reference_is_the_minimum_of_the_output_error(
    record: dict[str, np.ndarray], description: dict[str, Any], name: str, fit: str
) -> None:
    reference = description[name][fit]
    channels = ["alpha", "q"] if fit == "alpha_and_q" else [fit]
    suffix = "_true" if name == "noise_free_reference" else ""
    std = description["noise"]["std"]

    def residual(coefficients: dict[str, float], channel: str) -> np.ndarray:
        model = fitted(coefficients, channel, record["delta_e"], 0.02)
        left = record[channel + suffix] - model
        # The best offset for given coefficients is the mean.
        return np.asarray((left - left.mean()) / std[channel])

    def cost(coefficients: dict[str, float]) -> float:
        return float(sum(np.sum(residual(coefficients, one) ** 2) for one in channels))

    best = reference["coefficients"]
    rms = [std[one] * np.sqrt(np.mean(residual(best, one) ** 2)) for one in channels]
    np.testing.assert_allclose(reference["residual_rms"], rms, rtol=1e-6)
    lowest = cost(best)
    for key, standard_error in reference["standard_error_at_stated_noise"].items():
        for sign in (1.0, -1.0):
            moved = best | {key: best[key] + sign * 0.01 * standard_error}
            # Along one axis a hundredth of the standard error costs at least 1e-4 in chi-square.
            assert cost(moved) - lowest > 0.9e-4


def test_truth_is_what_a_correct_fit_finds(description: dict[str, Any]) -> None:
    truth = description["short_period"]
    for fit in description["noise_free_reference"].values():
        for key, value in fit["coefficients"].items():
            # b1 is hardly identifiable from this record; all others are within half a percent.
            assert value == pytest.approx(truth[key], rel=0.02 if key == "b1" else 0.005)
    for fit in description["noisy_reference"].values():
        for key, value in fit["coefficients"].items():
            error = (value - truth[key]) / fit["standard_error_at_stated_noise"][key]
            assert abs(error) < 3.0


@pytest.mark.slow
def test_engine_gives_the_shipped_record_again(
    script: ModuleType,
    record: dict[str, np.ndarray],
    description: dict[str, Any],
    tmp_path: Path,
) -> None:
    import jsbsim

    if jsbsim.__version__ != description["provenance"]["engine_version"]:
        pytest.skip("another version of the engine than that of the shipped record")
    script.main(["--out", str(tmp_path)])
    again = read(tmp_path / "short_period.csv")
    for name in COLUMNS:
        np.testing.assert_allclose(again[name], record[name], rtol=0, atol=1e-9)
    made = json.loads((tmp_path / "short_period.json").read_text(encoding="utf-8"))
    assert made["short_period"] == pytest.approx(description["short_period"], rel=1e-8)


@pytest.mark.slow
def test_small_manoeuvre_follows_the_linearised_truth(script: ModuleType) -> None:
    flight = replace(script.Flight(), amplitude=0.1)
    aircraft = script.Aircraft(flight.aircraft)
    trim = aircraft.trim(flight.speed, flight.altitude)
    a_matrix, b_column = aircraft.linearise(trim)
    _, elevator = script.elevator_input(flight, trim.delta_e)
    flown = aircraft.fly(trim, elevator, 0.02, flight.frame)
    model = five_state_response({"A": a_matrix, "B": b_column}, elevator, 0.02)
    error = np.abs(flown - flown[0] - model).max(axis=0) / np.abs(model).max(axis=0)
    assert np.all(error < 0.003)


@pytest.mark.slow
def test_same_engine_and_condition_as_a_public_record(
    script: ModuleType, shared_data: Path
) -> None:
    """The A-4 doublet of the public records, made by another program with the same engine."""
    public = shared_data / "jsbsim-a4-doublet"
    if not public.is_dir():
        pytest.skip("no jsbsim-a4-doublet among the public records")
    truth = json.loads((public / "truth.json").read_text(encoding="utf-8"))
    record = read(public / "data.csv")
    aircraft = script.Aircraft("A4")
    trim = aircraft.trim(truth["trim"]["V"], truth["trim"]["h"])
    found = script.short_period(*aircraft.linearise(trim))
    names = {"natural_frequency": "wn", "damping": "zeta"}
    for name, value in found.items():
        assert value == pytest.approx(truth["short_period"][names.get(name, name)], rel=1e-6)
    flown = aircraft.fly(trim, record["delta_e_rad"], 0.005, 1e-4)
    np.testing.assert_allclose(flown[:, 0], record["alpha_rad"], rtol=0, atol=1e-5)
    np.testing.assert_allclose(flown[:, 1], record["q_rad_s"], rtol=0, atol=4e-5)
