"""The same rows from the workers of a Dask scheduler, some of which are killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fleets
from tridentify import fleet
from tridentify.errors import OptionError, TridentifyError

distributed = pytest.importorskip("distributed", reason="needs tridentify[fleet]")

pytestmark = [
    pytest.mark.unjudged,
    pytest.mark.filterwarnings("ignore"),  # what Dask says of itself
]


def started(processes: bool) -> Any:
    """A scheduler and two workers."""
    return distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=processes,
        dashboard_address=None,
        silence_logs=50,
        host="127.0.0.1",
        protocol="tcp://",
    )


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Workers in threads, reached as those of other machines are."""
    with started(False) as made:
        yield made


@pytest.fixture(scope="module")
def processes() -> Iterator[Any]:
    """Workers that may be killed."""
    with started(True) as made:
        yield made


def pids(cluster: Any) -> list[int]:
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        return list(client.run(os.getpid).values())


@pytest.mark.slow
def test_rows_are_those_of_a_serial_run(cluster: Any, tmp_path: Path) -> None:
    fleets.write_files(tmp_path / "logs", fleets.units(8, n=60))
    (tmp_path / "logs" / "bad.parquet").write_bytes(b"PAR1")
    runs = [
        fleets.fit_files(str(tmp_path / "logs"), str(tmp_path / name), workers, progress=False)
        for name, workers in (("serial", "1"), ("dask", cluster.scheduler_address))
    ]
    assert runs[0].rows().height == 9
    assert fleets.same(runs[0].rows(), runs[1].rows())
    here, there = (run.together() for run in runs)
    np.testing.assert_allclose(there.theta, here.theta, rtol=1e-10)
    np.testing.assert_allclose(there.cov, here.cov, rtol=1e-8)
    assert there.n_units == 8
    assert list(there.left_out) == ["bad.parquet"]


@pytest.mark.slow
def test_killed_workers_cost_nothing(processes: Any, tmp_path: Path) -> None:
    fleets.write_files(tmp_path / "logs", fleets.units(60, n=60))
    serial = fleets.fit_files(str(tmp_path / "logs"), str(tmp_path / "a"), "1", progress=False)
    told: list[int] = []

    def kill(done: int, total: int | None) -> None:
        told.append(done)
        if len(told) in (2, 5):
            os.kill(pids(processes)[0], signal.SIGKILL)

    run = fleets.fit_files(
        str(tmp_path / "logs"), str(tmp_path / "b"), processes.scheduler_address, progress=kill
    )
    assert told[-1] == 60
    assert fleets.same(run.rows(), serial.rows())


@pytest.mark.slow
def test_no_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("tridentify.fleet.workers.engines.CONNECT", "1s")
    with pytest.raises(TridentifyError, match=r"found no scheduler at 'tcp://127\.0\.0\.1:9'"):
        fleet.fit(
            fleets.units(1), (2, 0), out=tmp_path, workers="tcp://127.0.0.1:9", progress=False
        )


@pytest.mark.parametrize("address", ["x", "host", "tcp://", "a b:1"])
def test_what_is_no_address_is_refused_before_it_is_tried(address: str, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="expected an address such as 'tcp://host:8786'"):
        fleet.fit(fleets.units(1), (2, 0), out=tmp_path, workers=address, progress=False)
