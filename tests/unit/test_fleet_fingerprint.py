"""What a row says was read, where the process of its record was ended."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fleets
from tridentify import fleet
from tridentify.fleet.places import fingerprint_of_file

pytestmark = pytest.mark.unjudged


@pytest.mark.slow
def test_a_file_whose_process_ends_is_told_by_its_content_however_far_it_came(
    tmp_path: Path,
) -> None:
    fleets.write_files(tmp_path, {"crash": fleets.unit(np.random.default_rng(0))})
    path, out = tmp_path / "crash.parquet", tmp_path / "results"
    options = {"judge": False, "progress": False, "workers": 1} | fleets.READING
    run = fleet.fit(str(path), (2, 0), fleets.Moody(), out=out, **options)
    row = run.rows().row(0, named=True)
    assert row["status"] == "crashed"
    assert row["fingerprint"] == fingerprint_of_file(path)
