"""Time stamps that were rounded when they were written are those of even samples."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tridentify import read_record
from tridentify.errors import TimeNotIncreasingError
from tridentify.record.formats.time.rounded_time import raster_behind

pytestmark = pytest.mark.unisolated


def _table(path: Path, stamps: list[str], header: str = "t") -> Path:
    rng = np.random.default_rng(0)
    rows = [
        f"{t},{u:.3f},{y:.3f}"
        for t, (u, y) in zip(stamps, rng.normal(size=(len(stamps), 2)), strict=True)
    ]
    path.write_text("\n".join([f"{header},u,y", *rows]))
    return path


@pytest.mark.parametrize(
    ("rate", "written"),
    [(16000.0, "{:.6g}"), (60.0, "{:.3f}"), (128.0, "{:.3f}"), (29.97, "{:.2f}")],
)
def test_even_samples_with_rounded_stamps_are_even(
    tmp_path: Path, rate: float, written: str
) -> None:
    stamps = [written.format(2.0 + k / rate) for k in range(2000)]
    record = read_record(_table(tmp_path / "log.csv", stamps), inputs=["u"], outputs=["y"])
    assert record.dt is not None
    assert record.dt == pytest.approx(1.0 / rate, rel=3e-6)
    recorded = np.array([float(s) for s in stamps])
    assert np.abs(record.t - recorded).max() < 0.6 * float(np.ptp(np.diff(recorded)))


def test_milliseconds_that_are_whole_numbers(tmp_path: Path) -> None:
    stamps = [f"{1000.0 * k / 60.0:.0f}" for k in range(500)]
    path = _table(tmp_path / "log.csv", stamps, header="t [ms]")
    record = read_record(path, inputs=["u"], outputs=["y"])
    assert record.dt == pytest.approx(1.0 / 60.0, rel=1e-5)


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_time_that_is_uneven_by_itself_stays_so(tmp_path: Path, share: float) -> None:
    rng = np.random.default_rng(1)
    stamps = [f"{0.05 * (k + share * rng.uniform(-1.0, 1.0)) + 1.0:.4f}" for k in range(300)]
    record = read_record(_table(tmp_path / "log.csv", stamps), inputs=["u"], outputs=["y"])
    assert record.dt is None
    assert record.t == pytest.approx([float(s) for s in stamps])


def test_a_row_that_is_missing_is_not_made_up() -> None:
    stamps = np.round(np.delete(np.arange(100) / 60.0, 40), 3)
    assert raster_behind(stamps) is None


@pytest.mark.parametrize("step", [0.02, 0.020137])
def test_stamps_that_repeat(tmp_path: Path, step: float) -> None:
    stamps = [f"{np.floor(k * step):.0f}" for k in range(10_000)]
    record = read_record(_table(tmp_path / "log.csv", stamps), inputs=["u"], outputs=["y"])
    assert record.dt == pytest.approx(step, rel=2e-4)
    pauses = [f"{np.floor(k * step + (3.0 if k > 5_000 else 0.0)):.0f}" for k in range(10_000)]
    with pytest.raises(TimeNotIncreasingError):
        read_record(_table(tmp_path / "log.csv", pauses), inputs=["u"], outputs=["y"])


def test_few_stamps_and_coarse_ones_stay_as_they_are() -> None:
    assert raster_behind(np.round(np.arange(10) / 60.0, 3)) is None
    assert raster_behind(np.round(np.arange(60) * 1.3)) is None
