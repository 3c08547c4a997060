"""Methods on the same noisy records: who takes part, and the runs in two processes.

Whoever stands in `tridentify.identify.METHODS` takes part with its default options, besides
``ThreeModel()`` and ``ThreeModel.paper(...)``. Three are told what a user does not know exactly:
output error started at the truth, and the paper's strategy and its Step 2 alone on the recorded
output, whose operators and filter are scaled to the plant's corner frequency.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import as_completed
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from plants import AIRCRAFT, RAO_GARNIER, Cell

from tridentify import Structure, ThreeModel, TransferFunction, identify
from tridentify.identify import METHODS
from tridentify.studies.processes import process_pool
from tridentify.studies.step_2_alone import step_2_alone

Array = NDArray[np.float64]
OURS, OURS_AUTO, PAPER = "ThreeModel()", "ThreeModel() auto", "ThreeModel.paper"
AT_TRUTH, RAW = "OutputError(truth)", "Step 2 on raw y"
BATCH = 25
PAPER_FILTER = (1.0, 5.0, 6.0, 7.0)


class Task(NamedTuple):
    """Draws ``first .. last - 1`` of a cell, by one method."""

    cell: Cell
    label: str
    seed: int
    first: int
    last: int


class Outcome(NamedTuple):
    """Coefficients (n_draws, n_parameters), nan without an answer; status; CPU seconds of each."""

    theta: Array
    status: list[str]
    seconds: Array


def labels(auto: bool = False) -> list[str]:
    """Everyone who takes part, ours first, those who are told something last."""
    rivals = [key for key in METHODS if key != "three-model"]
    told = [RAW, PAPER, *([AT_TRUTH] if "output-error" in METHODS else [])]
    return [OURS, *([OURS_AUTO] if auto else []), *rivals, *told]


def paper_options(cell: Cell) -> dict[str, Any]:
    """gamma, number of operators and filter of the paper's strategy for a plant.

    The paper's filter has the corner 7^(1/3) = 1.91 rad/s where its plant has 3^(1/2) = 1.73: gamma
    is 1.1 times the plant's corner. Two poles: the paper's filter, scaled in time, and three
    operators; one or three poles: ``(p + gamma)^(n + 1)`` and 3 or 6 operators. Four poles (Rao and
    Garnier's, which spread over a decade): gamma 1.58 times the corner, 10 rad/s, and 20 Laguerre
    functions; 30 gave about the same errors in three to four times the time.
    """
    n, corner = len(cell.plant.a), cell.plant.corner
    gamma = 10 / RAO_GARNIER.corner * corner if n > 3 else 7 ** (1 / 3) / AIRCRAFT.corner * corner
    filter_ = tuple(float(c) for c in np.poly(np.full(n + 1, -gamma)))
    if n == 2:
        filter_ = tuple(c * (corner / AIRCRAFT.corner) ** k for k, c in enumerate(PAPER_FILTER))
    kind = {"operators": "laguerre"} if n > 3 else {}
    return {"gamma": gamma, "n_operators": {1: 3, 2: 3, 3: 6}.get(n, 20), "filter": filter_, **kind}


def answer(label: str, cell: Cell, seed: int, draw: int) -> tuple[Array, str]:
    """Coefficients and status of one method on one record."""
    record = cell.record(seed, draw)
    n, m = len(cell.plant.a), len(cell.plant.b) - 1
    if label == RAW:
        theta = step_2_alone(record, n, m, paper_options(cell)["filter"])
        return theta, "CONVERGED"
    structure = Structure(n, m, offset=False, initial_state="rest")
    if label == OURS_AUTO:
        structure = Structure(n, m)
    estimate = identify(record, structure, _method(label, cell), throw=False)
    told = "" if estimate.status.ok else " (not ok)"
    return np.asarray(estimate.theta), estimate.status.name + told


def _method(label: str, cell: Cell) -> Any:
    if label in (OURS, OURS_AUTO):
        return ThreeModel()
    if label == PAPER:
        return ThreeModel.paper(**paper_options(cell))
    if label == AT_TRUTH:
        make: Callable[..., Any] = METHODS["output-error"]
        return make(start=TransferFunction(list(cell.plant.b), [1.0, *cell.plant.a]))
    return METHODS[label]()


def run(task: Task) -> Outcome:
    """All draws of a task; an exception is a status, and no answer."""
    count = task.last - task.first
    theta = np.full((count, task.cell.plant.theta.size), np.nan)
    status, seconds = [], np.zeros(count)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        _warm(task.label, task.cell.plant.name)
        for k in range(count):
            found, told, seconds[k] = _timed(task.label, task.cell, task.seed, task.first + k)
            status.append(told)
            if found is not None and np.all(np.isfinite(found)):
                theta[k] = found
    return Outcome(theta, status, seconds)


def _timed(label: str, cell: Cell, seed: int, draw: int) -> tuple[Array | None, str, float]:
    before = time.process_time()
    try:
        found, told = answer(label, cell, seed, draw)
    except Exception as error:
        return None, f"{type(error).__name__} (exception)", time.process_time() - before
    return found, told, time.process_time() - before


@cache
def _warm(label: str, plant: str) -> None:
    """Compile and load before the first time is taken; once a process, method and plant."""
    cell = Cell("warm", AIRCRAFT, np.ones(100), 0.05, ("ratio", 0.1))
    _timed(label, cell, 0, 0)


def contest(
    cells: Sequence[Cell],
    draws: Callable[[Cell, str], int],
    *,
    names: Sequence[str],
    seed: int,
    workers: int,
    say: Callable[[str], None] = print,
) -> dict[tuple[str, str], Outcome]:
    """Outcomes by (cell, label), the draws in order.

    Parameters
    ----------
    draws : callable
        How many for a cell and a label; zero to leave the label out.
    names : labels that take part.
    """
    tasks = [
        Task(cell, label, seed, first, min(first + BATCH, draws(cell, label)))
        for cell in cells
        for label in names
        for first in range(0, draws(cell, label), BATCH)
    ]
    left = {(cell.name): 0 for cell in cells}
    for task in tasks:
        left[task.cell.name] += 1
    begin = time.perf_counter()

    def finished(number: int) -> None:
        name = tasks[number].cell.name
        left[name] -= 1
        if not left[name]:
            say(f"{time.perf_counter() - begin:7.0f} s  {name}")

    with process_pool(workers) as pool:
        numbers = {pool.submit(run, task): k for k, task in enumerate(tasks)}
        for future in as_completed(numbers):
            finished(numbers[future])
    parts = [future.result() for future in numbers]
    for label in names:
        mine = [part for task, part in zip(tasks, parts, strict=True) if task.label == label]
        spent = sum(float(part.seconds.sum()) for part in mine)
        say(f"{spent:7.0f} s  CPU time of {label}, {sum(len(p.status) for p in mine)} records")
    found: dict[tuple[str, str], Outcome] = {}
    for task, part in zip(tasks, parts, strict=True):
        key = (task.cell.name, task.label)
        before = found.get(key)
        if before is None:
            found[key] = part
            continue
        found[key] = Outcome(
            np.vstack([before.theta, part.theta]),
            before.status + part.status,
            np.concatenate([before.seconds, part.seconds]),
        )
    return found
