"""Speed, latency and memory of the on-line methods, for `online.py`.

Times are processor time of this process, but for single steps, which are taken with the wall clock
one by one (its own cost, some 50 ns, included) with Python's garbage collector on.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import scipy.signal
from changing import held
from numpy.typing import NDArray
from peers.peer import NotInstalledError, environment
from plants import RAO_GARNIER, SECOND

from tridentify import Record, Structure, TransferFunction, online

Array = NDArray[np.float64]
HERE = Path(__file__).resolve().parent
DT = {SECOND.name: 0.05, RAO_GARNIER.name: 0.01}
HOLD, DECIBEL = 8, 10.0
PLANTS = {2: SECOND, 4: RAO_GARNIER}
ROUNDS = 2
SIZES = (500_000, 2_000_000)
ONCE = 1e9  # s: one estimate, at the end
AIMS = {"RecursiveLeastSquares, order 2": 10e6, "ThreeModel, order 2": 2e6}
AIM_STEP, WARM, STEPS = 5.0, 20_000, 300_000
FOLD, MARKS = 10_000_000, (1_000_000, 2_000_000, 5_000_000, 10_000_000)
TRACED = (50_000, 250_000)
BLOCK = 100_000
LIMITS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}


def structure(order: int) -> Structure:
    plant = PLANTS[order]
    return Structure(order, len(plant.b) - 1, offset=False, initial_state="rest")


def methods(order: int) -> dict[str, Any]:
    """All methods, told where to begin, so that no search is in their time."""
    plant = PLANTS[order]
    begin = TransferFunction(list(plant.b), [1.0, *plant.a])
    own_filter = tuple(np.poly([-plant.corner] * order).tolist())
    return {
        "RecursiveLeastSquares": online.RecursiveLeastSquares(filter=own_filter),
        "Kalman": online.Kalman(filter=own_filter),
        "Gradient": online.Gradient(filter=own_filter),
        "ThreeModel": online.ThreeModel(start=begin),
    }


def blocks(order: int, n_samples: int, size: int = BLOCK) -> Iterator[tuple[Array, Array]]:
    """A long record, piece by piece: binary input, white noise at 10 dB."""
    plant = PLANTS[order]
    transition, column, direct = held(np.array(plant.a), np.array(plant.b), DT[plant.name])
    row = np.eye(1, len(plant.a))
    num, den = scipy.signal.ss2tf(transition, column[:, None], row, np.array([[direct]]))
    rng = np.random.default_rng(order)
    state, std = np.zeros(len(plant.a)), 0.0
    for first in range(0, n_samples, size):
        count = min(size, n_samples - first)
        u = rng.choice([-1.0, 1.0], -(-count // HOLD)).repeat(HOLD)[:count]
        clean, state = scipy.signal.lfilter(num[0], den, u, zi=state)
        std = std or float(np.std(clean)) * 10 ** (-DECIBEL / 20)
        yield u, clean + std * rng.standard_normal(count)


def record(order: int, n_samples: int) -> Record:
    pieces = list(blocks(order, n_samples))
    u, y = (np.concatenate(one) for one in zip(*pieces, strict=True))
    return Record(u, y, dt=DT[PLANTS[order].name])


def regressors(one: Record, order: int) -> tuple[Array, Array]:
    """What plain least squares gets: outputs of the state-variable filters, already run."""
    n = order
    a = np.poly([-PLANTS[order].corner] * n)[1:]
    rates = np.vstack([-a, np.eye(n - 1, n)])
    chain = (rates, np.eye(n, 1), np.eye(n), np.zeros((n, 1)))
    f, g, *_ = scipy.signal.cont2discrete(chain, one.dt)
    filtered = []
    for signal in (one.y[:, 0], one.u[:, 0]):
        poles = np.poly(np.linalg.eigvals(f)).real
        num = scipy.signal.ss2tf(f, g, np.eye(n), np.zeros((n, 1)))[0]
        filtered.append(np.column_stack([scipy.signal.lfilter(row, poles, signal) for row in num]))
    y, u = filtered
    n_zeros = len(PLANTS[order].b) - 1
    return np.hstack([-y, u[:, n - 1 - n_zeros :]]), one.y[:, 0] - y @ a


def rates(quick: bool) -> dict[str, Any]:
    """Samples per second over stored records; the libraries in turn with ours."""
    sizes = tuple(n // 100 for n in SIZES) if quick else SIZES
    data = {order: [record(order, n) for n in sizes] for order in PLANTS}
    spent: dict[str, list[list[float]]] = {}
    others: list[dict[str, Any]] = []
    entrants = {
        f"{name}, order {order}": (method, order)
        for order in PLANTS
        for name, method in methods(order).items()
    }
    entrants |= {
        f"ThreeModel with its search, order {order}": (online.ThreeModel(), order)
        for order in PLANTS
    }
    for method, order in entrants.values():
        online.run(method, record(order, 20_000), structure(order), every=ONCE)
    for turn in range(ROUNDS):
        for name, (method, order) in entrants.items():
            times = []
            for one in data[order]:
                gc.collect()
                before = time.process_time()
                online.run(method, one, structure(order), every=ONCE)
                times.append(time.process_time() - before)
            spent.setdefault(name, []).append(times)
        others.append(libraries(data[2][0]))
        print(f"rates: round {turn + 1} of {ROUNDS}", file=sys.stderr, flush=True)
    return {"sizes": sizes, "spent": spent, "libraries": others}


def libraries(one: Record) -> dict[str, Any]:
    """Plain recursive least squares of the libraries on the same samples, in their own process."""
    try:
        python = environment("streaming")
    except NotInstalledError as error:
        return {"skipped": str(error)}
    phi, target = regressors(one, 2)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "regressors.npz")
        np.savez(file, phi=phi, target=target)
        script = HERE / "peers" / "streaming" / "rls.py"
        answer = subprocess.run(
            [str(python), str(script), str(file)],
            capture_output=True, text=True, env=os.environ | LIMITS, check=False,
        )  # fmt: skip
    if answer.returncode:
        return {"skipped": answer.stderr.strip().splitlines()[-1][:160]}
    found: dict[str, Any] = json.loads(answer.stdout)
    return found


def steps(quick: bool) -> dict[str, Any]:
    """Time of single steps [us]."""
    count = STEPS // 50 if quick else STEPS
    found = {}
    for order in PLANTS:
        u, y = next(blocks(order, WARM + count, WARM + count))
        inputs, outputs = u.tolist(), y.tolist()
        for name, method in methods(order).items():
            times, ticks = _one_by_one(method, order, inputs, outputs)
            found[f"{name}, order {order}"] = _latency(times, ticks)
    return found


def _one_by_one(
    method: Any, order: int, u: list[float], y: list[float]
) -> tuple[Array, NDArray[np.bool_]]:
    """Times of the steps after the warm-up [us], and which of them had a tick of the slow clock."""
    state = method.init(structure(order), DT[PLANTS[order].name])
    step, clock = method.step, time.perf_counter_ns
    times, ticks = np.zeros(len(u)), np.zeros(len(u), dtype=bool)
    for k, (one, other) in enumerate(zip(u, y, strict=True)):
        before = clock()
        after, _ = step(state, one, other)
        times[k] = clock() - before
        ticks[k] = ticked(state, after)
        state = after
    return times[WARM:] / 1e3, ticks[WARM:]


def ticked(before: Any, after: Any) -> bool:
    """Whether the slow clock struck at this step, or another event that is not of every sample."""
    return after.stage is not before.stage


def _latency(times: Array, ticks: NDArray[np.bool_]) -> dict[str, Any]:
    def figures(some: Array) -> dict[str, float] | None:
        if not some.size:
            return None
        median, p99, p999 = np.quantile(some, (0.5, 0.99, 0.999)).tolist()
        return {"median": median, "p99": p99, "p999": p999, "worst": float(some.max())}

    return {
        "count": times.size, "n_ticks": int(ticks.sum()),
        "plain": figures(times[~ticks]), "ticks": figures(times[ticks]),
    }  # fmt: skip


def memory(quick: bool) -> dict[str, Any]:
    """Resident memory along 1e7 samples folded, and what is allocated along the way."""
    return {name: _child(["--fold", name, *(["--quick"] if quick else [])]) for name in methods(2)}


def fold(name: str, quick: bool) -> dict[str, Any]:
    """In a fresh process: step through the samples one by one."""
    method = methods(2)[name]
    state = method.init(structure(2), DT[SECOND.name])
    total = FOLD // 100 if quick else FOLD
    marks = {n // 100 if quick else n for n in MARKS}
    resident, done = {}, 0
    for u, y in blocks(2, total):
        for one, other in zip(u.tolist(), y.tolist(), strict=True):
            state, _ = method.step(state, one, other)
        done += u.size
        if done in marks:
            gc.collect()
            resident[str(done)] = _resident()
    finite = bool(np.all(np.isfinite(method.estimate(state).theta)))
    return {
        "resident": resident, "finite": finite, "changes": len(state.changes),
        "traced": _traced(method),
    }  # fmt: skip


def _traced(method: Any) -> float:
    """Growth [bytes] of what Python has allocated, between two marks of the fold."""
    state = method.init(structure(2), DT[SECOND.name])
    u, y = next(blocks(2, TRACED[1], TRACED[1]))
    marks = []
    for k in range(TRACED[1]):
        if k == TRACED[0]:
            gc.collect()
            tracemalloc.start()
            marks.append(tracemalloc.get_traced_memory()[0])
        state, _ = method.step(state, float(u[k]), float(y[k]))
    gc.collect()
    marks.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    return float(marks[1] - marks[0])


def _resident() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _child(arguments: list[str]) -> dict[str, Any]:
    answer = subprocess.run(
        [sys.executable, str(HERE / "online.py"), *arguments],
        capture_output=True, text=True, env=os.environ | LIMITS, check=False,
    )  # fmt: skip
    if answer.returncode:
        raise SystemExit(answer.stderr)
    found: dict[str, Any] = json.loads(answer.stdout)
    return found


def rates_table(data: dict[str, Any]) -> list[str]:
    """Samples per second."""
    first, last = data["sizes"]
    lines = [
        "samples per second over a stored record, one core, processor time; least of "
        f"{ROUNDS} rounds",
        f"{'':42s}{'samples':>9s}{'M samples/s':>13s}{'past start':>12s}{'aim':>7s}"
        f"{'times padasip':>15s}",
    ]
    given = [one["rivals"] for one in data["libraries"] if "rivals" in one]
    best = {name: max(one[name]["rate"] for one in given) for name in (given[0] if given else {})}
    yard = best.get("padasip FilterRLS", float("nan"))
    for name, rounds in data["spent"].items():
        short, long = np.min(rounds, axis=0)
        rate, slope = last / long, (last - first) / (long - short)
        aim = f"{AIMS[name] / 1e6:7.0f}" if name in AIMS else " " * 7
        lines.append(
            f"{name:42s}{last:9d}{rate / 1e6:13.3g}{slope / 1e6:12.3g}{aim}{rate / yard:15.0f}"
        )
    for name, rate in best.items():
        counted = given[0][name]["n"]
        lines.append(
            f"{name + ', order 2, no filters':42s}{counted:9d}{rate / 1e6:13.3g}{'':19s}"
            f"{rate / yard:15.1f}"
        )
    if given:
        worst = max(entry["distance"] for one in given for entry in one.values())
        versions = data["libraries"][0]["versions"]
        lines.append(
            ", ".join(f"{name} {version}" for name, version in versions.items())
            + f"; all end within {worst:.0e} of numpy's least squares"
        )
    else:
        lines.append(f"libraries left out: {data['libraries'][0]['skipped']}")
    return lines


def steps_table(data: dict[str, Any], libraries_: list[dict[str, Any]]) -> list[str]:
    """Latencies."""
    head = f"{'median':>9s}{'p99':>9s}{'p99.9':>9s}{'worst':>10s}"
    lines = [
        f"time of one step from Python [us], wall clock; aim: median under {AIM_STEP:g}",
        f"{'':38s}{head}   ticks{head}",
    ]

    def cells(one: dict[str, float] | None) -> str:
        if one is None:
            return f"{'-':>9s}{'-':>9s}{'-':>9s}{'-':>10s}"
        return (
            f"{one['median']:9.2f}{one['p99']:9.2f}{one.get('p999', np.nan):9.1f}"
            f"{one['worst']:10.0f}"
        )

    for name, one in data.items():
        ticks = cells(one["ticks"]) if one["n_ticks"] else ""
        share = f"{one['n_ticks']:8d}"
        lines.append(f"{name:38s}{cells(one['plain'])}{share}{ticks}".rstrip())
    given = [one["rivals"] for one in libraries_ if "rivals" in one]
    for name in given[0] if given else ():
        turns = [one[name]["step"] for one in given]
        if turns[0] is not None:
            low = min(turns, key=lambda one: one["median"])
            lines.append(f"{name + ', no filters':38s}{cells(low)}")
    return lines


def memory_table(data: dict[str, Any]) -> list[str]:
    """Resident memory and allocation growth."""
    marks = next(iter(data.values()))["resident"]
    lines = [
        "memory of a fold sample by sample, order 2: resident [MB] after so many samples",
        f"{'':26s}" + "".join(f"{int(mark):>12,d}" for mark in marks)
        + f"{'growth [kB]':>13s}{'traced growth [B]':>19s}",
    ]  # fmt: skip
    for name, one in data.items():
        held_ = list(one["resident"].values())
        lines.append(
            f"{name:26s}" + "".join(f"{value:12.2f}" for value in held_)
            + f"{1e3 * (held_[-1] - held_[0]):13.0f}{one['traced']:19.0f}"
            + ("" if one["finite"] else "  estimate not finite")
        )  # fmt: skip
    lines.append(f"traced growth: by tracemalloc between {TRACED[0]:,d} and {TRACED[1]:,d} samples")
    return lines
