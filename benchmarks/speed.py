"""Time and memory of `identify` next to a rival written by hand (`rival.py`).

Both get the same records in the same process, in turn; ``ours, auto`` decides everything itself
(``Structure(2, 0)``), ``ours, told`` knows what the rival knows (rest, no offset). Costs are
residual mean squares; that of ``ours, told`` is recomputed with the rival's simulation. Several
records a size, because the number of iterations depends on the draw. Every thread setting is a
fresh process, every memory figure too.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--memory", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        return worker()
    if options.memory:
        folder, who, state = options.memory
        return memory(folder, who, state == "warm")
    data: dict[str, Any] = {}
    lines: list[str] = []
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
