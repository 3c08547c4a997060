"""The page about a fleet, from rows that are given: what it says, and what it leaves out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fleets
from tridentify import fleet
from tridentify.errors import IdentifiabilityError
from tridentify.fleet.job import Item
from tridentify.fleet.places import Unusable
from tridentify.fleet.rows import Fit, fit_row, packed
from tridentify.fleet.store import Store, write_part
from tridentify.fleet.workers.job import Limits, Outcome
from tridentify.fleet.working import Question
from tridentify.plots import plot_fleet
from tridentify.record.formats.assemble import Wanted
from tridentify.report import write_fleet_report
from tridentify.structure import Structure


def run_of(folder: Path, rows: list[dict[str, object]]) -> fleet.Run:
    store = Store(folder)
    store.parts.mkdir()
    write_part(str(store.parts / "part-a.parquet"), rows)
    job = Fit(Structure(1, 0), None, True, Wanted(["u"], ["y"]))
    return fleet.Run(store, Question({}, None, job, None, Limits(60.0, 1 << 32)))


def good(key: str, a0: float, b0: float) -> dict[str, object]:
    value = {
        "status": "converged",
        "ok": True,
        "cautions": ["delay"] if key == "u3" else [],
        "names": ["a0", "b0"],
        "coefficients": [a0, b0],
        "standard_errors": [0.02, 0.01],
        "covariance": packed(np.diag([4e-4, 1e-4])).tolist(),
        "fit": [90.0],
        "noise_variance": [0.1],
        "n_samples": 100,
    }
    return fit_row(Outcome(Item(key, Unusable("", label="")), value))


def bad(key: str, message: str) -> dict[str, object]:
    return fit_row(Outcome(Item(key, Unusable("")), {}, "bad input", message, "NotFiniteError"))


@pytest.fixture
def run(tmp_path: Path) -> fleet.Run:
    rng = np.random.default_rng(0)
    values = rng.normal([4.0, 2.0], [0.2, 0.1], (40, 2))
    rows = [good(f"u{k}", *map(float, row)) for k, row in enumerate(values)]
    return run_of(tmp_path, [*rows, good("odd <one>", 9.0, 2.0), bad("worse", "<script>")])


def test_the_page_counts_names_and_escapes(run: fleet.Run, tmp_path: Path) -> None:
    page = write_fleet_report(run, tmp_path / "r.html", figures=tmp_path).read_text("utf-8")
    assert "41 of 42 units have an estimate." in page
    assert "1 is unlike the others." in page
    assert "odd &lt;one&gt;" in page
    assert "worse: &lt;script&gt;" in page
    assert ">delay<" in page
    assert (tmp_path / "fleet.svg").exists()
    for heading in ("Coefficients", "Units unlike the others", "Failures", "Cautions", "Settings"):
        assert f"<h2>{heading}</h2>" in page


def test_bars_count_every_unit_and_absurd_ones_do_not_stretch_the_scale(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = [good(f"u{k}", float(rng.normal(4.0, 0.2)), 2.0) for k in range(400)]
    run = run_of(tmp_path, [*rows, good("absurd", 1e6, 2.0)])
    picture = plot_fleet(run)
    assert len(picture) == 2
    (stairs,) = [p for p in picture[0].patches if type(p).__name__ == "StepPatch"]
    assert stairs.get_data().values.sum() == 401
    assert picture[0].get_xlim()[1] < 6.0


def test_a_fleet_without_estimates_has_a_page_and_no_picture(tmp_path: Path) -> None:
    run = run_of(tmp_path, [bad("a", "no"), bad("b", "no")])
    page = run.report(tmp_path / "r.html").read_text("utf-8")
    assert "0 of 2 units have an estimate." in page
    assert "verdict bad" in page
    assert "<svg" not in page
    with pytest.raises(IdentifiabilityError, match="found 2 units without estimates"):
        run.plot()


@pytest.mark.slow
@pytest.mark.undrawn
def test_own_reports_are_made_where_the_records_are_still_there(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    source = {f"u{k}": fleets.unit(rng, n=80) for k in range(9)}
    source["a/b"] = fleets.unit(rng, fleets.TRUTH * [1.0, 3.0, 1.0], n=80)
    out = tmp_path / "out"
    run = fleet.fit(source, (2, 0), out=out, judge=False, progress=False)
    page = run.report(out / "report.html", reports=1).read_text("utf-8")
    assert '<a href="units/a_b.html">a/b</a>' in page
    assert (out / "units" / "a_b.html").exists()
