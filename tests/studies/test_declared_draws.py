"""One draw and what many say: noise, bounds, bias, coverage, and failures that are rows."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from declared import document, numbers
from tridentify.errors import OptionError
from tridentify.studies import read_study, run_study, shipped_study, study_from
from tridentify.studies.declared import draw as drawing
from tridentify.studies.declared import run as running
from tridentify.studies.declared.draw import (
    Row,
    autocorrelation,
    draw_row,
    drawn,
    generator,
    prepare,
)
from tridentify.studies.declared.nouns import DeclaredNoise, cells
from tridentify.studies.declared.result import statistics_of
from tridentify.studies.declared.working import Draw

BOUND_AGREES = 1e-8
"""Relative: the benchmarks' sensitivities are central differences, good to 1e-9."""
SIGMAS = 4.0
"""Standard errors: one test in 16,000 fails by chance, and the draws are always the same."""


def test_bounds_are_those_computed_without_the_package(repository: Path) -> None:
    stored = json.loads((repository / "benchmarks/results/efficiency.json").read_text())
    theirs = [np.array(cell["bound"]) for cell in stored["data"]["cells"].values()]
    ours = [prepare(cell).bound for cell in cells(read_study(shipped_study("efficiency")))]
    assert len(ours) == len(theirs) == 9
    for own, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(own, other, rtol=BOUND_AGREES)


@pytest.mark.parametrize(
    "noise",
    [
        DeclaredNoise("v", "white", "std", 1.0),
        DeclaredNoise("v", "student", "std", 1.0, (("degrees", 5.0),)),
        DeclaredNoise("v", "arma", "std", 1.0, (("ar", (1.0, -0.9)), ("ma", (1.0, 0.5)))),
    ],
)
@pytest.mark.fast("noise0", "noise1")
def test_noise_has_variance_one_and_its_autocorrelation(noise: DeclaredNoise) -> None:
    rng = np.random.default_rng(1)
    found = np.array([drawn(noise, rng, 6) for _ in range(40_000)])
    covariance = found.T @ found / len(found)
    row = autocorrelation(noise, 6)
    assert row[0] == 1.0
    # products of two variables of variance one, with heavy tails at most three times as wide
    error = 3 * math.sqrt(2 / len(found))
    np.testing.assert_allclose(covariance[0], row, atol=SIGMAS * error)
    np.testing.assert_allclose(np.diag(covariance), 1.0, atol=SIGMAS * error)


def test_records_that_are_too_long_for_coloured_noise_are_refused() -> None:
    told = document()
    told["inputs"] = {"step": {"kind": "step", "dt": 0.1, "samples": 30_001}}
    told["noises"] = {"white": {"std": 0.1}}
    assert len(cells(study_from(told))) == 2
    told["noises"] = {"arma": {"kind": "arma", "ar": [1, -0.5], "std": 0.1}}
    with pytest.raises(OptionError, match=r"expected at most 30000.*shorten the record"):
        study_from(told)


def test_autocorrelation_of_a_first_order_process() -> None:
    noise = DeclaredNoise("v", "arma", "std", 1.0, (("ar", (1.0, -0.5)), ("ma", (2.0,))))
    np.testing.assert_allclose(autocorrelation(noise, 5), 0.5 ** np.arange(5.0), rtol=1e-9)


def test_heavy_tails_say_more_of_the_place_than_a_gaussian_of_their_variance() -> None:
    told = document()
    told["noises"] = {
        "white": {"std": 0.1},
        "student": {"kind": "student", "degrees": 4, "std": 0.1},
        "nearly": {"kind": "student", "degrees": 1e6, "std": 0.1},
    }
    found = {cell.noise.name: prepare(cell).bound for cell in cells(study_from(told))}
    # (k + 1) / (k + 3) k / (k - 2) = 5/7 * 2 with k = 4
    np.testing.assert_allclose(found["student"], found["white"] / math.sqrt(10 / 7))
    np.testing.assert_allclose(found["nearly"], found["white"], rtol=1e-5)


def test_noise_depends_on_seed_cell_and_number_alone() -> None:
    first, second, *_ = cells(study_from(document()))

    def noise(cell: object, seed: int, draw: int) -> float:
        return float(generator(cell, seed, draw).standard_normal())

    told = {noise(cell, s, k) for cell in (first, second) for s in (0, 1) for k in range(3)}
    assert len(told) == 12
    assert noise(first, 0, 1) in told
    grown = document()
    grown["systems"] = {"new": {"num": [1.0], "den": [1.0, 9.0]}, **grown["systems"]}
    again = {cell.name: cell for cell in cells(study_from(grown))}[first.name]
    assert noise(again, 0, 1) == noise(first, 0, 1)


def test_the_level_is_what_was_asked_for() -> None:
    told = document()
    told["noises"] = {"r": {"ratio": 0.5}, "s": {"snr": 20}, "d": {"std": 0.25}}
    for cell in cells(study_from(told)):
        own = prepare(cell)
        mean = {"r": 0.5 * np.sqrt(np.mean(own.clean**2)), "s": np.std(own.clean) / 10, "d": 0.25}
        assert own.std == pytest.approx(mean[cell.noise.name])


def test_a_method_that_raises_leaves_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def burst(*_: object) -> None:
        raise RuntimeError("two\nlines")

    monkeypatch.setattr(drawing, "attempt", burst)
    study = study_from(document())
    row = draw_row(cells(study)[0], study.methods[0], 0, 0)
    assert (row["theta"], row["ok"]) == (None, False)
    assert row["failure"] == "RuntimeError: two lines"

    def here(draws: Iterator[Draw], seed: int, _workers: object) -> Iterator[list[Row]]:
        """In this process, where the method was replaced."""
        for one in draws:
            yield [draw_row(one.cell, one.method, seed, one.number)]

    monkeypatch.setattr(running, "rows_of", here)
    result = run_study(study, workers=1)
    assert {row.failed for row in result.statistics} == {12}
    assert "RuntimeError: two lines" in result.table()
    assert result.to_dict()["statistics"][0]["rmse"] is None


@pytest.mark.parametrize("draws", [100, pytest.param(300, marks=pytest.mark.slow)])
def test_efficient_methods_are_at_the_bound_and_their_intervals_hold(draws: int) -> None:
    told = document() | {"draws": draws}
    told["systems"] = {"first": told["systems"]["first"]}
    told["noises"] = {"white": {"ratio": 0.05}}
    told["methods"] = {"ours": {"kind": "three-model"}, "raw": told["methods"]["raw"]}
    rows = run_study(study_from(told), workers=1).statistics
    for row in (row for row in rows if row.method == "ours"):
        assert row.failed == row.flagged == row.outliers == 0
        assert abs(row.ratio - 1.0) < SIGMAS * row.ratio_error
        assert row.ratio_error == pytest.approx(1 / math.sqrt(2 * draws), rel=0.3)
        assert abs(row.bias) < SIGMAS * row.bias_error
        assert abs(row.coverage - 0.95) < SIGMAS * row.coverage_error
        assert row.seconds > 0
    raw = [row for row in rows if row.method == "raw"]
    assert any(row.ratio - 1.0 > SIGMAS * row.ratio_error for row in raw)
    assert all(math.isnan(row.coverage) for row in raw)


def test_without_noise_there_is_no_ratio_and_no_error() -> None:
    told = document()
    told["noises"] = {"none": {"ratio": 0}}
    told["methods"] = {"ours": {"kind": "three-model"}}
    for row in run_study(study_from(told), workers=1).statistics:
        assert row.draws == 1
        assert abs(row.bias) < 1e-6 * row.truth
        assert math.isnan(row.ratio)
        assert math.isnan(row.coverage)


def test_statistics_of_draws_that_are_known() -> None:
    told = document() | {"draws": 4}
    told["systems"] = {"first": told["systems"]["first"]}
    told["noises"] = {"white": {"std": 0.1}}
    told["methods"] = {"ours": told["methods"]["ours"]}
    study = study_from(told)
    (cell,) = cells(study)
    bound = prepare(cell).bound

    def row(draw: int, off: float | None, ok: bool = True) -> dict[str, object]:
        theta = None if off is None else (cell.system.theta + off * bound).tolist()
        low = None if theta is None else (np.array(theta) - 1.96 * bound).tolist()
        high = None if theta is None else (np.array(theta) + 1.96 * bound).tolist()
        return {
            **{"cell": cell.name, "method": "ours", "draw": draw, "theta": theta, "low": low},
            **{"high": high, "ok": ok, "status": "", "failure": "", "seconds": 0.1 * draw},
        }

    rows = [row(3, 20.0), row(2, None, ok=False), row(1, 3.0, ok=False), row(0, -1.0), row(4, 50.0)]
    found = statistics_of(study, rows)[1]
    assert (found.draws, found.failed, found.flagged, found.outliers) == (4, 1, 1, 1)
    assert found.bias == pytest.approx(22 / 3 * bound[1])
    assert found.ratio == pytest.approx(math.sqrt((400 + 9 + 1) / 3))
    assert found.ratio_inside == pytest.approx(math.sqrt((9 + 1) / 2))
    assert found.coverage == pytest.approx(1 / 3)
    assert found.coverage_error == pytest.approx(math.sqrt(3 / 7 * 4 / 7 / 7))
    assert found.intervals == 3
    assert found.seconds == pytest.approx(0.15)


def test_rows_do_not_depend_on_the_other_cells() -> None:
    told = document() | {"draws": 2}
    whole = numbers(run_study(study_from(told), workers=1).rows)
    told["systems"] = {"aircraft": told["systems"]["aircraft"]}
    told["methods"] = {"ours": told["methods"]["ours"]}
    part = numbers(run_study(study_from(told), workers=1).rows)
    assert len(part) == 4
    assert part == [row for row in whole if row in part]
