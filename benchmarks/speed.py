"""Time and memory of `identify` next to a rival written by hand (`rival.py`).

Both get the same records in the same process, in turn; ``ours, auto`` decides everything itself
(``Structure(2, 0)``), ``ours, told`` knows what the rival knows (rest, no offset). Costs are
residual mean squares; that of ``ours, told`` is recomputed with the rival's simulation. Several
records a size, because the number of iterations depends on the draw. Every thread setting is a
fresh process, every memory figure too.

A second contest goes through orders and sizes (Rao and Garnier's plant for order 4, 10 dB of white
noise): `ThreeModel` told of rest and no offset, with white noise and with its noise test, against
the rival by Levenberg-Marquardt and by its trust region, the faster of the two being *the* rival,
and against refined instrumental variables on short records. Every cost there is recomputed from the
coefficients by the rival's simulation. A record's time is the least of its repeats, in which the
contenders alternate; ratios are medians over records. Then the same `ThreeModel` runs with its
steps timed from outside.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import pkgutil
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import rival
from machine import keep
from numpy.typing import NDArray

Array = NDArray[np.float64]

DT = 0.05
SIZES = {250: (20, 5), 10_000: (5, 5), 1_000_000: (1, 5)}  # samples: (records, repeats)
AIMS = {250: 2.0, 10_000: 1.0, 1_000_000: 1.0 / 3.0}
MOST_MEMORY = 200.0
WHO = ("rival", "rival, plain", "ours, told", "ours, auto")
THREADS = {"1 BLAS thread": "1", "default BLAS threads": None}
DECIBEL = 10.0
PLANTS = {2: rival.SECOND_ORDER, 4: rival.RAO_GARNIER}
LADDER = {250: (10, 5), 10_000: (6, 3), 100_000: (3, 4), 1_000_000: (2, 4)}  # records, repeats
BY_HAND = ("rival, lm", "rival, trf")
WHITE, AUTO, REFINED = "ThreeModel(noise='white')", "ThreeModel()", "refined IV (SRIVC)"
MOST_REFINED = 10_000
REFINED_AIM = {250: 1.5}
LADDER_AIMS = {(4, 100_000): 1.0 / 3.0, (4, 1_000_000): 1.0 / 5.0}
SAME = 1e-6
STEPS = {
    "candidates": (
        "estimation.likelihood.question.candidates", "estimation.likelihood.question.build_base",
    ),
    "stand-ins": ("estimation.search.search.window", "estimation.search.search.averaged"),
    "starts": (
        "estimation.search.starts._starts", "estimation.search.following.discrete_poles",
        "estimation.search.starts.ParallelStart.filtered_poles",
        "estimation.search.starts.ParallelStart.reduced_poles",
    ),
    "adapted passes": ("estimation.search.following.Search._adapted",),
    "moves": ("estimation.search.following.Search.move",),
    "choice of seeds": ("estimation.search.search.RecordSearch._choose",),
    "decide, finish": ("estimation.methods.around_maximum.maximum.decide",),
    "noise test": ("estimation.methods.three_model.with_noise_model",),
    "check of end": ("estimation.methods.three_model.certify",),
    "rivals' scan": ("estimation.posterior.maximum_or_mean.has_rivals",),
    "posterior": ("estimation.posterior.maximum_or_mean.posterior",),
    "posterior or not": ("estimation.methods.three_model.weigh",),
    "result": ("estimation.methods.three_model.estimate_from",),
}  # fmt: skip
REST = "all else"
LIMITS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def contestants() -> dict[str, Callable[[Array, Array], tuple[Array, float]]]:
    """Name -> (u, y) to (theta, cost), reading the record into its own form included."""
    from tridentify import Record, Structure, identify

    told = Structure(2, 0, offset=False, initial_state="rest")

    def ours(structure: Structure) -> Callable[[Array, Array], tuple[Array, float]]:
        def run(u: Array, y: Array) -> tuple[Array, float]:
            estimate = identify(Record(u, y, dt=DT), structure)
            return estimate.theta, estimate.cost

        return run

    def by_hand(**options: Any) -> Callable[[Array, Array], tuple[Array, float]]:
        def run(u: Array, y: Array) -> tuple[Array, float]:
            found = rival.fit(u, y, DT, **options)
            return found.theta, found.cost

        return run

    plain = by_hand(method="trf", held=rival.held_exponential)
    return dict(zip(WHO, (by_hand(), plain, ours(told), ours(Structure(2, 0))), strict=True))


def race(n_samples: int) -> dict[str, Any]:
    """Times [s], costs and largest differences of all contestants at one size."""
    records, repeats = SIZES[n_samples]
    data = [rival.held_binary(n_samples, seed, DT) for seed in range(records)]
    runners = contestants()
    first: dict[str, float] = {}
    for who, run in runners.items():
        before = time.perf_counter()
        run(*data[0])
        first[who] = time.perf_counter() - before
    wall: dict[str, list[float]] = {who: [] for who in WHO}
    cpu: dict[str, list[float]] = {who: [] for who in WHO}
    costs: dict[str, list[float]] = {who: [] for who in WHO}
    moved = []
    for turn in range(repeats):
        for u, y in data:
            for who, run in runners.items():
                before, spent = time.perf_counter(), time.process_time()
                theta, cost = run(u, y)
                cpu[who].append(time.process_time() - spent)
                wall[who].append(time.perf_counter() - before)
                if turn == 0:
                    if who == "ours, told":
                        own = float(np.mean((rival.simulate(theta, u, DT) - y) ** 2))
                        moved.append(abs(own / cost - 1.0))
                        cost = own
                    costs[who].append(cost)
    return {
        "first": first, "wall": wall, "cpu": cpu, "costs": costs, "recomputed": max(moved),
    }  # fmt: skip


def ladder() -> dict[str, Any]:
    """The second contest: ``[order][samples]``."""
    return {
        str(order): {str(n): ladder_race(order, n) for n in LADDER} for order in PLANTS
    }  # fmt: skip


def entrants(order: int, n_samples: int) -> dict[str, Callable[[Array, Array], tuple[Array, str]]]:
    """Name -> (u, y) to (theta, remark on the end where it is another kind of end)."""
    from tridentify import Record, RefinedInstrumentalVariable, Structure, ThreeModel, identify
    from tridentify.estimation.answer.estimate import Status
    from tridentify.estimation.methods.base import Method

    plant = PLANTS[order]
    told = Structure(order, len(plant.b) - 1, offset=False, initial_state="rest")

    def ours(method: Method) -> Callable[[Array, Array], tuple[Array, str]]:
        def run(u: Array, y: Array) -> tuple[Array, str]:
            found = identify(Record(u, y, dt=DT), told, method, throw=False)
            coloured = any(a.size for a in found.noise_model)
            usual = found.status is Status.CONVERGED
            remark = "coloured" if coloured else "" if usual else found.status.value
            return found.theta, remark

        return run

    def by_hand(method: str) -> Callable[[Array, Array], tuple[Array, str]]:
        return lambda u, y: (rival.fit_any(u, y, DT, plant, method=method).theta, "")

    found = {who: by_hand(who.split()[-1]) for who in BY_HAND}
    found |= {WHITE: ours(ThreeModel(noise="white")), AUTO: ours(ThreeModel())}
    if n_samples <= MOST_REFINED:
        found[REFINED] = ours(RefinedInstrumentalVariable())
    return found


def ladder_race(order: int, n_samples: int) -> dict[str, Any]:
    """Least times [s] of each record, costs by the rival's simulation, remarks, and the steps."""
    records, repeats = LADDER[n_samples]
    plant, runners = PLANTS[order], entrants(order, n_samples)
    data = [rival.noisy(plant, n_samples, seed, DT, DECIBEL) for seed in range(records)]
    for run in runners.values():
        run(*rival.noisy(plant, 250, records, DT, DECIBEL))
    wall = {who: [float("inf")] * records for who in runners}
    cost: dict[str, list[float]] = {who: [] for who in runners}
    remarks: dict[str, list[str]] = {who: [] for who in runners}
    for turn in range(repeats):
        for k, (u, y) in enumerate(data):
            for who, run in runners.items():
                before = time.perf_counter()
                theta, remark = run(u, y)
                wall[who][k] = min(wall[who][k], time.perf_counter() - before)
                if turn == 0:
                    left = rival.simulate_any(theta, order, u, DT) - y
                    cost[who].append(float(np.mean(left**2)))
                    remarks[who].append(remark)
    parts = []
    for u, y in data:
        with timed_steps() as spent:
            runners[AUTO](u, y)
        parts.append(dict(spent))
    steps = {name: [part.get(name, 0.0) for part in parts] for name in (*STEPS, REST)}
    return {"wall": wall, "cost": cost, "remarks": remarks, "steps": steps}


@contextlib.contextmanager
def timed_steps() -> Iterator[dict[str, float]]:
    """Seconds in the functions of each of ``STEPS``, those of steps within them taken off."""
    spent: dict[str, float] = defaultdict(float)
    under_way, since = [REST], time.perf_counter()

    def switch() -> None:
        nonlocal since
        now = time.perf_counter()
        spent[under_way[-1]] += now - since
        since = now

    def wrapped(step: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **options: Any) -> Any:
            switch()
            under_way.append(step)
            try:
                return function(*arguments, **options)
            finally:
                switch()
                under_way.pop()

        return run

    with contextlib.ExitStack() as stack:
        for step, paths in STEPS.items():
            for path in paths:
                target = f"tridentify.{path}"
                function = pkgutil.resolve_name(target)
                stack.enter_context(mock.patch(target, wrapped(step, function)))
        since = time.perf_counter()
        yield spent
        switch()


def worker() -> None:
    """Run all sizes in this process and print JSON."""
    print(json.dumps({str(n): race(n) for n in SIZES}))


def memory(folder: str, who: str, warm: bool) -> None:
    """Print how far [MB] the process grows above the record at 1e6 samples.

    ``above`` is the peak less that after creating the record, ``resident`` the peak less what the
    process held then (larger when creating the record had a peak of its own).
    """
    runners = contestants()
    if warm:
        runners[who](*rival.held_binary(250, 0, DT))
    u, y = np.load(Path(folder, "u.npy")), np.load(Path(folder, "y.npy"))
    if who.startswith("ours"):
        from tridentify import Record, Structure, identify

        record = Record(u, y, dt=DT)
        auto = who == "ours, auto"
        structure = Structure(2, 0) if auto else Structure(2, 0, offset=False, initial_state="rest")
        peak, held = _peak(), _resident()
        identify(record, structure)
    else:
        peak, held = _peak(), _resident()
        runners[who](u, y)
    print(json.dumps({"above": _peak() - peak, "resident": _peak() - held}))


def _peak() -> float:
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _resident() -> float:
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return float("nan")
    return pages * resource.getpagesize() / 1e6


def in_fresh_process(arguments: list[str], threads: str | None) -> dict[str, Any]:
    """What this script prints when it is started anew with a limit on BLAS threads."""
    environment = {k: v for k, v in os.environ.items() if k not in LIMITS}
    if threads is not None:
        environment |= dict.fromkeys(LIMITS, threads)
    answer = subprocess.run(
        [sys.executable, __file__, *arguments],
        capture_output=True, text=True, env=environment, check=False,
    )  # fmt: skip
    if answer.returncode:
        raise SystemExit(answer.stderr)
    found: dict[str, Any] = json.loads(answer.stdout)
    return found


def time_table(result: dict[str, Any]) -> list[str]:
    """Lines of one thread setting."""
    lines = [
        f"{'samples':>9s}  {'':13s}{'first call':>11s}{'wall median':>12s}{'wall min':>10s}"
        f"{'CPU median':>12s}{'/ rival':>9s}{'aim':>7s}   largest cost difference to rival"
    ]
    for n in SIZES:
        race_ = result[str(n)]
        reference = np.median(race_["wall"]["rival"])
        base = np.array(race_["costs"]["rival"])
        for who in WHO:
            wall, cpu = np.array(race_["wall"][who]), np.array(race_["cpu"][who])
            change = np.array(race_["costs"][who]) / base - 1.0
            extreme = change[np.argmax(np.abs(change))]
            aim = f"{AIMS[n]:7.2f}" if who == "ours, auto" else " " * 7
            first = 1e3 * race_["first"][who]
            lines.append(
                f"{n:9d}  {who:13s}{first:8.1f} ms{1e3 * np.median(wall):9.2f} ms"
                f"{1e3 * wall.min():7.2f} ms{1e3 * np.median(cpu):9.2f} ms"
                f"{np.median(wall) / reference:9.2f}{aim}   {extreme:+.1e}"
                + (f"  (cost {base[0]:.10g})" if who == "rival" else "")
            )
    worst = max(result[str(n)]["recomputed"] for n in SIZES)
    lines.append(f"cost of 'ours, told' recomputed by the rival's simulation: within {worst:.0e}")
    return lines


def ladder_table(result: dict[str, Any]) -> list[str]:
    """Lines of the second contest."""
    lines = [
        f"orders and sizes, 1 BLAS thread, {DECIBEL:g} dB; a record's time is the least of its "
        "repeats; medians over records",
        f"{'order':>5s}{'samples':>9s}  {'':26s}{'time':>11s}{'/ rival':>9s}{'/ SRIVC':>9s}"
        f"{'aim':>14s}  same cost as the rival (within {SAME:.0e}; largest difference)",
    ]
    for order in PLANTS:
        for n in LADDER:
            lines += _rungs(order, n, result[str(order)][str(n)])
    return [*lines, "", *growth_table(result), "", *step_table(result)]


def _rungs(order: int, n: int, one: dict[str, Any]) -> list[str]:
    wall = {who: np.array(times) for who, times in one["wall"].items()}
    best = min(BY_HAND, key=lambda who: float(np.median(wall[who])))
    lines = []
    for who, times in wall.items():
        change = np.array(one["cost"][who]) / np.array(one["cost"][best]) - 1.0
        same = int(np.sum(np.abs(change) <= SAME))
        extreme = change[np.argmax(np.abs(change))]
        refined = f"{np.median(times / wall[REFINED]):9.2f}" if REFINED in wall else " " * 9
        aims = []
        if who in (WHITE, AUTO):
            aims += [f"< {LADDER_AIMS[order, n]:.2f} rival"] if (order, n) in LADDER_AIMS else []
            aims += [f"< {REFINED_AIM[n]:.1f} SRIVC"] if n in REFINED_AIM else []
        told = [remark for remark in one["remarks"][who] if remark]
        verdict = f"{'yes' if same == change.size else 'no'}, {same} of {change.size}"
        lines.append(
            f"{order:5d}{n:9d}  {who + ' *' * (who == best):26s}{1e3 * np.median(times):8.2f} ms"
            f"{np.median(times / wall[best]):9.2f}{refined}{', '.join(aims):>14s}  "
            f"{verdict:13s} {extreme:+.0e}{' (' + ', '.join(told) + ')' if told else ''}"
        )
    return lines


def growth_table(result: dict[str, Any]) -> list[str]:
    """Slopes of the logarithm of time over that of samples."""
    sizes = list(LADDER)
    head = "".join(f"{f'{a} to {b}':>19s}" for a, b in itertools.pairwise(sizes))
    lines = [f"growth: time is proportional to samples to the power of{'':9s}{head}"]
    for order in PLANTS:
        for who in (*BY_HAND, WHITE, AUTO):
            times = [np.median(result[str(order)][str(n)]["wall"][who]) for n in sizes]
            slopes = np.diff(np.log(times)) / np.diff(np.log(sizes))
            lines.append(f"  order {order}  {who:53s}" + "".join(f"{s:19.2f}" for s in slopes))
    return lines


def step_table(result: dict[str, Any]) -> list[str]:
    """Where the time of `ThreeModel()` goes."""
    rows = [(order, n) for order in PLANTS for n in LADDER]
    spent = {row: result[str(row[0])][str(row[1])]["steps"] for row in rows}
    lines = [
        "steps of ThreeModel() [ms], means over records, each without the steps inside it",
        f"  {'order':16s}" + "".join(f"{order:9d}" for order, _ in rows),
        f"  {'samples':16s}" + "".join(f"{n:9d}" for _, n in rows),
    ]
    for step in (*STEPS, REST):
        values = "".join(f"{1e3 * np.mean(spent[row][step]):9.2f}" for row in rows)
        lines.append(f"  {step:16s}" + values)
    whole = [1e3 * sum(np.mean(part) for part in spent[row].values()) for row in rows]
    return [*lines, f"  {'sum':16s}" + "".join(f"{value:9.2f}" for value in whole)]


def memory_table() -> tuple[list[str], dict[str, Any]]:
    """Growth of the process above the record at 1e6 samples."""
    lines = [
        f"memory above the record, 1,000,000 samples [MB], aim {MOST_MEMORY:.0f}",
        f"{'':14s}{'first call of the process':>27s}{'after a small one':>20s}",
    ]
    stored: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, signal in zip("uy", rival.held_binary(1_000_000, 0, DT), strict=True):
            np.save(Path(folder, f"{name}.npy"), signal)
        for who in WHO:
            cold, warm = (
                in_fresh_process(["--memory", folder, who, state], None)
                for state in ("cold", "warm")
            )
            stored[who] = {"cold": cold, "warm": warm}
            lines.append(f"{who:14s}{cold['resident']:27.0f}{warm['resident']:20.0f}")
    lines.append(
        "(peak less resident memory once the record exists, libraries loaded on the way in)"
    )
    return lines, stored


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    parser.add_argument(
        "--orders", action="store_true", help="only the contest of orders and sizes"
    )
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--ladder", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--memory", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        return worker()
    if options.ladder:
        print(json.dumps(ladder()))
        return None
    if options.memory:
        folder, who, state = options.memory
        return memory(folder, who, state == "warm")
    data: dict[str, Any] = {"orders": in_fresh_process(["--ladder"], "1")}
    lines = [*ladder_table(data["orders"]), ""]
    print("\n".join(lines), flush=True)
    if options.orders:
        return None
    for label, threads in THREADS.items():
        data[label] = in_fresh_process(["--worker"], threads)
        lines += [label, *time_table(data[label]), ""]
        print("\n".join(lines[lines.index(label) :]), flush=True)
    more, data["memory"] = memory_table()
    print("\n".join(more))
    if options.save:
        keep("speed", "\n".join(lines + more), data)
    return None


if __name__ == "__main__":
    main()
