"""Logs in the time of the wall over the nights in which clocks are put forward or back."""

import warnings
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from tridentify import Record, read_record, record_from_frame
from tridentify.errors import DataError, DataWarning

SPRING = datetime(2026, 3, 28, 23, 30)
AUTUMN = datetime(2026, 10, 24, 23, 30)
N = 120


def wall(begin: datetime, change: timedelta | None, minutes: float = 5.0) -> list[datetime]:
    """What a clock shows that goes on at two (spring) or at three (autumn) by ``change``."""
    steady = [begin + timedelta(minutes=minutes * k) for k in range(N)]
    if change is None:
        return steady
    at = begin + timedelta(hours=2.5 if change > timedelta(0) else 3.5)
    return [one + change if one >= at else one for one in steady]


def read(folder: Path, times: list[datetime], form: str = "%Y-%m-%d %H:%M:%S") -> Record:
    rows = "\n".join(f"{t.strftime(form)},{k // 7 % 2},{k}" for k, t in enumerate(times))
    (folder / "log.csv").write_text(f"timestamp,heater,room\n{rows}\n")
    return read_record(folder / "log.csv", inputs=["heater"], outputs=["room"])


HOUR = timedelta(hours=1)


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S", "%d.%m.%Y %H:%M", "%m/%d/%Y %I:%M:%S %p"])
@pytest.mark.parametrize(
    ("begin", "change", "words"), [(SPRING, HOUR, "forward"), (AUTUMN, -HOUR, "back")]
)
def test_hour_is_no_time_that_passes(
    tmp_path: Path, begin: datetime, change: timedelta, words: str, form: str
) -> None:
    with pytest.warns(DataWarning, match=f"{words} by an hour"):
        record = read(tmp_path, wall(begin, change), form)
    assert record.dt == pytest.approx(300.0)
    assert record.n_samples == N


@pytest.mark.parametrize("library", ["pandas", "polars"])
@pytest.mark.parametrize(("begin", "change"), [(SPRING, HOUR), (AUTUMN, -HOUR)])
def test_frames_alike(library: str, begin: datetime, change: timedelta) -> None:
    frames = pytest.importorskip(library)
    columns = {"timestamp": wall(begin, change), "u": np.arange(N) // 7 % 2, "y": np.arange(N)}
    with pytest.warns(DataWarning, match="in the night to 2026"):
        record = record_from_frame(frames.DataFrame(columns), inputs=["u"], outputs=["y"])
    assert record.dt == pytest.approx(300.0)


def test_missing_hour_of_another_night_stays_one(tmp_path: Path) -> None:
    times = wall(SPRING + timedelta(days=1), HOUR)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = read(tmp_path, times)
    assert record.duration == pytest.approx(300.0 * (N - 1) + 3600.0)


def test_time_with_a_zone_is_taken_as_it_stands(tmp_path: Path) -> None:
    times = [one.replace(tzinfo=UTC) for one in wall(SPRING, HOUR)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = read(tmp_path, times, "%Y-%m-%dT%H:%M:%S+00:00")
    assert record.duration == pytest.approx(300.0 * (N - 1) + 3600.0)


def test_other_steps_back_are_refused_as_before(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="below each other"):
        read(tmp_path, wall(AUTUMN, -2 * HOUR))
