"""The same draws here, beside a worker, and on a Dask cluster whose workers are killed."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from declared import document, numbers
from tridentify.errors import MissingDependencyError, OptionError, TridentifyError
from tridentify.fleet.workers.job import CRASHED, OVER_TIME, Outcome
from tridentify.studies import DeclaredStudy, run_study, study_from
from tridentify.studies.declared import working
from tridentify.studies.declared.draw import draw_row
from tridentify.studies.declared.nouns import draws_of, meetings

pytestmark = pytest.mark.filterwarnings("ignore")  # what Dask says of itself

NOWHERE = "tcp://127.0.0.1:9"


@pytest.fixture(scope="module")
def study() -> DeclaredStudy:
    return study_from(document(), "small")


@pytest.fixture(scope="module")
def here(study: DeclaredStudy) -> list[dict[str, Any]]:
    """The numbers without any worker."""
    return numbers(
        [
            draw_row(cell, method, study.seed, k)
            for cell, method in meetings(study)
            for k in range(draws_of(study, cell))
        ]
    )


def cluster(processes: bool) -> Any:
    """A scheduler and two workers, reached as those of other machines are."""
    distributed = pytest.importorskip("distributed", reason="needs tridentify[fleet]")
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
def threads() -> Iterator[Any]:
    with cluster(False) as made:
        yield made


@pytest.mark.slow
def test_a_process_beside_the_worker_has_the_numbers_of_this_one(
    study: DeclaredStudy, here: list[dict[str, Any]]
) -> None:
    assert numbers(run_study(study, workers=1).rows) == here


def test_a_dask_cluster_has_the_same_numbers(
    threads: Any, study: DeclaredStudy, here: list[dict[str, Any]], tmp_path: Path
) -> None:
    address = threads.scheduler_address
    run_study(study, draws=3, out=tmp_path, workers=1)
    counts: list[int] = []
    result = run_study(
        study, out=tmp_path, workers=address, progress=lambda done, _: counts.append(done)
    )
    assert numbers(result.rows) == here
    assert counts[0] == 24
    assert counts[-1] == len(here)


def worker_pids(made: Any) -> list[int]:
    import distributed

    with distributed.Client(made.scheduler_address, set_as_default=False) as client:
        return list(client.run(os.getpid).values())


@pytest.mark.skipif(os.name == "nt", reason="no SIGKILL there")
@pytest.mark.slow
def test_killed_workers_of_a_cluster_cost_nothing(
    study: DeclaredStudy, here: list[dict[str, Any]], tmp_path: Path
) -> None:
    killed: list[int] = []
    with cluster(True) as made:

        def kill(done: int, _: int) -> None:
            if done >= 16 * (1 + len(killed)) and len(killed) < 2:
                killed.append(worker_pids(made)[0])
                os.kill(killed[-1], signal.SIGKILL)

        result = run_study(study, out=tmp_path, workers=made.scheduler_address, progress=kill)
    assert len(killed) == 2
    assert numbers(result.rows) == here


@pytest.mark.slow
def test_a_scheduler_that_ends_is_one_line_and_gone_on_without(
    study: DeclaredStudy, here: list[dict[str, Any]], tmp_path: Path
) -> None:
    with cluster(True) as made:

        def end(done: int, _: int) -> None:
            if done:
                made.close()

        with pytest.raises(TridentifyError, match="found the scheduler gone") as error:
            run_study(study, out=tmp_path, workers=made.scheduler_address, progress=end)
    assert "\n" not in str(error.value)
    counts: list[int] = []
    result = run_study(study, out=tmp_path, workers=1, progress=lambda done, _: counts.append(done))
    assert 0 < counts[0] < len(here)
    assert numbers(result.rows) == here


def test_no_scheduler_is_one_line(monkeypatch: pytest.MonkeyPatch, study: DeclaredStudy) -> None:
    pytest.importorskip("distributed", reason="needs tridentify[fleet]")
    monkeypatch.setattr("tridentify.fleet.workers.engines.CONNECT", "1s")
    with pytest.raises(TridentifyError, match=r"found no scheduler at 'tcp://127\.0\.0\.1:9'"):
        run_study(study, workers=NOWHERE)


def test_without_dask_it_is_one_line(monkeypatch: pytest.MonkeyPatch, study: DeclaredStudy) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'tridentify\[fleet\]'"):
        run_study(study, workers=NOWHERE)


@pytest.mark.parametrize("workers", [2.0, "host", [2]])
def test_what_are_no_workers_is_refused(study: DeclaredStudy, workers: Any) -> None:
    with pytest.raises(OptionError, match="Dask scheduler"):
        run_study(study, workers=workers)


@pytest.mark.parametrize(("status", "why"), [(CRASHED, "ended, again"), (OVER_TIME, "3600 s")])
def test_a_draw_that_takes_its_process_along_is_a_row(
    study: DeclaredStudy, status: str, why: str
) -> None:
    cell, method = meetings(study)[0]
    draw = working.Draw(cell, method, 7)
    row = working._row(Outcome(draw, status=status, seconds=2.0))
    assert why in row["failure"]
    assert (row["cell"], row["draw"], row["theta"], row["ok"]) == (cell.name, 7, None, False)
    assert set(row) == set(draw_row(cell, method, 0, 0))


def test_a_draw_whose_process_is_ended_from_outside_is_tried_again(
    monkeypatch: pytest.MonkeyPatch, study: DeclaredStudy
) -> None:
    cell, method = meetings(study)[0]
    draws = tuple(working.Draw(cell, method, k) for k in range(3))
    asked: list[list[int]] = []

    class Keeper:
        """Ends with the second draw, as often as that is asked for."""

        def outcomes(self, job: Any, items: Any) -> Iterator[Outcome]:
            asked.append([item.number for item in items])
            for item in items:
                fallen = item.number == 1 and len(asked) < kills
                yield Outcome(item, {"draw": item.number}, CRASHED if fallen else "")

    monkeypatch.setattr(working.WORKERS, "keeper", lambda limits: nullcontext(Keeper()))
    kills = 3
    rows = [row for row, _ in working.work(working.Task(working.Drawing(0), draws))]
    assert rows == [{"draw": 0}, {"draw": 1}, {"draw": 2}]
    assert asked == [[0, 1, 2], [1], [1]]
    asked.clear()
    kills = 100
    rows = [row for row, _ in working.work(working.Task(working.Drawing(0), draws))]
    assert "again and again" in rows[1]["failure"]
    assert len(asked) == working.ROUNDS


def test_a_draw_that_cannot_be_made_ends_the_study(study: DeclaredStudy) -> None:
    cell, method = meetings(study)[0]
    told = working.Drawing(0).attempt(working.Draw(cell, method, -1), lambda mark: None)
    with pytest.raises(TridentifyError, match="ValueError"):
        working._row(Outcome(working.Draw(cell, method, -1), **told))
