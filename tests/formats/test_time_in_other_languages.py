"""Files of people who do not call time "time"."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import read_record

pytestmark = pytest.mark.unisolated


@pytest.mark.parametrize("name", ["Zeit [ms]", "temps [ms]", "Tiempo [ms]"])
def test_time_is_found_under_its_name_in_the_language_of_the_file(tmp_path, name):
    path = tmp_path / "run.csv"
    rows = [f"{20 * k};{k % 2};{0.5 * k}" for k in range(20)]
    path.write_text("\n".join([f"{name};u;y", *rows]))
    record = read_record(path, inputs=["u"], outputs=["y"])
    assert record.dt == pytest.approx(0.02)
    assert np.array_equal(record.y[:, 0], 0.5 * np.arange(20))


def test_the_english_name_comes_first(tmp_path):
    path = tmp_path / "run.csv"
    rows = [f"{0.1 * k!r},{k % 2},{k},{3 * k}" for k in range(20)]
    path.write_text("\n".join(["time,u,y,tempo", *rows]))
    record = read_record(path, inputs=["u"], outputs=["y"])
    assert record.dt == pytest.approx(0.1)
