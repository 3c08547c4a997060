"""Fleets: records a second, what a task costs, resume, memory, poison, beside joblib by hand.

Records of 250 samples of ``0.5 / (s^2 + s + 3)``, 5 % spread of the coefficients, 10 % noise, in
one Parquet file with a key column. Rates by the clock depend on what else the machine does; the
processor time of a record hardly does, and a core gives one over it. The rival is the best a user
would write by hand (`rival.py`), told that the record starts at rest without offset, under joblib
where it is installed (else `concurrent.futures`); it reads nothing, writes nothing, judges nothing,
and one bad record ends it.

On paper: what a million records a day and a billion need, by the processor time measured.

``--large`` makes one run in place of all that: told, not judged (``--judge``: judged), two workers,
from a folder of Parquet files in which every hundredth record is poisoned.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import shutil
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from machine import keep
from poison import MARKS, Nothing, Poisoned, fit_by_hand

from tridentify import Record, Structure, TransferFunction, fleet, simulate
from tridentify.fleet.job import Item
from tridentify.fleet.places import Given
from tridentify.fleet.store import Store
from tridentify.fleet.workers.job import Limits
from tridentify.fleet.workers.keeper import Keeper

TRUTH = np.array([1.0, 3.0, 0.5])
SAMPLES, DT, NOISE, SPREAD = 250, 0.1, 0.1, 0.05
TOLD = Structure(2, 0, offset=False, initial_state="rest")
READING: dict[str, Any] = {"key": "unit", "time": "t", "intersample": "zoh"}
POISON = ("nan", "constant input", "exception", "endless loop", "crash", "huge")
LIMIT = 2.0
"""Time limit of the poisoned run [s]."""
UNITS_A_FILE = 5_000
"""Of the data set of ``--large``: 1,250,000 rows."""
DAY, BILLION = 86_400.0, 1e9


def records(count: int, seed: int) -> dict[str, Record]:
    """Units of one kind."""
    rng = np.random.default_rng(seed)
    found = {}
    for k in range(count):
        a1, a0, b0 = TRUTH * np.exp(SPREAD * rng.standard_normal(3))
        u = np.repeat(np.sign(rng.standard_normal(SAMPLES // 5)), 5)
        y = simulate(TransferFunction([b0], [1.0, a1, a0]), Record(u, u, dt=DT))[:, 0]
        y = y + NOISE * y.std() * rng.standard_normal(SAMPLES)
        found[f"u{k:06d}"] = Record(u, y, dt=DT, intersample="zoh")
    return found


def frame_of(units: dict[str, Record]) -> pl.DataFrame:
    return pl.concat(
        pl.DataFrame({"unit": [k] * SAMPLES, "t": r.t, "u": r.u[:, 0], "y": r.y[:, 0]})
        for k, r in units.items()
    )


def family() -> list[int]:
    """The processes that this one has started, and those that they have; where /proc tells."""
    parents: dict[int, int] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
    found, grown = {os.getpid()}, True
    while grown:
        more = {pid for pid, parent in parents.items() if parent in found} - found
        found, grown = found | more, bool(more)
    return sorted(found - {os.getpid()})


def processor() -> float:
    """Processor time of this process and all below it, ended or not [s]."""
    found = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    total = sum(one.ru_utime + one.ru_stime for one in found)
    for pid in family():
        with contextlib.suppress(OSError):
            parts = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            total += sum(map(int, parts[11:15])) / os.sysconf("SC_CLK_TCK")
    return total


def child_peak() -> float:
    """The most memory that any process below this one has held, ended or not [MB]."""
    found = [resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3]
    for pid in family():
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/{pid}/status").read_text().splitlines():
                found += [int(line.split()[1]) / 1e3] if line.startswith("VmHWM") else []
    return max(found)


def measured(path: Path, out: Path, count: int, **options: Any) -> dict[str, float]:
    """One run: records a second, processor time a record, share of the workers' time on records."""
    shutil.rmtree(out, ignore_errors=True)
    workers = options.get("workers", 1)
    begin, used, first = time.perf_counter(), processor(), []

    def seen(done: int, total: int | None) -> None:
        if not first:
            first.append((done, time.perf_counter()))

    run = fleet.fit(path, out=out, progress=seen, **READING, **options)
    wall = time.perf_counter() - begin
    rows = run.rows(["seconds", "ok"])
    after, at = first[0]
    return {
        "workers": workers,
        "rate": (count - after) / (begin + wall - at),
        "cpu_ms": 1e3 * (processor() - used) / count,
        "median_ms": 1e3 * rows["seconds"].median(),
        "busy": rows["seconds"].sum() / (workers * wall),
        "ok": int(rows["ok"].sum()),
        "parts": len(run.store.files()),
        "bytes": sum(p.stat().st_size for p in run.store.files()) / count,
    }


def by_joblib(units: dict[str, Record], workers: int) -> dict[str, float]:
    """The rival on all records."""
    data = [(r.u[:, 0], r.y[:, 0], DT) for r in units.values()]
    used, begin = processor(), time.perf_counter()
    try:
        from joblib import Parallel, delayed
    except ImportError:
        with ProcessPoolExecutor(workers) as pool:
            list(pool.map(fit_by_hand, *zip(*data, strict=True), chunksize=50))
        name = "concurrent.futures"
    else:
        Parallel(n_jobs=workers)(delayed(fit_by_hand)(*one) for one in data)
        name = "joblib"
    wall = time.perf_counter() - begin
    alone = time.process_time()
    for one in data[:200]:
        fit_by_hand(*one)
    alone = (time.process_time() - alone) / min(len(data), 200)
    return {"name": name, "workers": workers, "rate": len(data) / wall, "cpu_ms": 1e3 * alone,  # type: ignore[dict-item]
            "with_pool_ms": 1e3 * (processor() - used) / len(data)}  # fmt: skip


def task_cost(units: dict[str, Record]) -> float:
    """Milliseconds a record that reading, handing over and accounting take, without any fit."""
    job = Nothing()
    items = [Item(key, Given((record,))) for key, record in units.items()]
    with Keeper(Limits(60.0, 1 << 32)) as keeper:
        list(keeper.outcomes(job, items[:10]))
        begin = time.perf_counter()
        list(keeper.outcomes(job, items))
        return 1e3 * (time.perf_counter() - begin) / len(items)


def resume_cost(path: Path, out: Path, count: int, **options: Any) -> float:
    """Milliseconds a record to see that all of a run is done."""
    begin = time.perf_counter()
    fleet.fit(path, out=out, progress=False, **READING, **options)
    return 1e3 * (time.perf_counter() - begin) / count


def poisoned(units: dict[str, Record], out: Path, folder: Path) -> dict[str, str]:
    """One per cent of poison among sound records: kind -> status of its rows."""
    source: dict[str, Any] = dict(units)
    count = max(len(units) // 100, len(POISON))
    kinds = {f"poison {k:04d}": POISON[k % len(POISON)] for k in range(count)}
    some = next(iter(units.values()))
    folder.mkdir()
    for key, kind in kinds.items():
        if kind == "nan":
            path = folder / f"{key}.csv"
            path.write_text("t,u,y\n" + "".join(f"{k * DT},nan,{k}\n" for k in range(50)))
            source[key] = str(path)
        elif kind == "constant input":
            source[key] = Record(np.ones(SAMPLES), some.y, dt=DT, intersample="zoh")
        else:
            source[key] = Record(some.u, some.y, dt=DT, intersample="zoh", name=kind)
    run = fleet.fit(
        source, Structure(2, 0, initial_state="free"), Poisoned(), out=out, workers=2,
        judge=False, time_limit=LIMIT, memory_limit=2 << 30, progress=False,
    )  # fmt: skip
    rows = dict(run.rows(["key", "status"]).iter_rows())
    if len(rows) != len(source) or any(rows[key] != "converged" for key in units):
        raise SystemExit("a sound record suffered from its neighbours")
    return {kind: "/".join(sorted({rows[k] for k in kinds if kinds[k] == kind})) for kind in POISON}


def write_large(folder: Path, count: int, seed: int) -> dict[str, str]:
    """Parquet files of so many units, every hundredth of them poisoned: key -> kind of poison."""
    kinds, marks = {}, {kind: mark for mark, kind in MARKS.items()}
    for number, first in enumerate(range(0, count, UNITS_A_FILE)):
        units = records(min(UNITS_A_FILE, count - first), seed + number)
        frame = frame_of({f"u{first + k:06d}": one for k, one in enumerate(units.values())})
        for unit in range(first - first % 100 + 99, first + len(units), 100):
            key, kind = f"u{unit:06d}", POISON[unit // 100 % len(POISON)]
            mine = pl.col("unit") == key
            new = {"nan": np.nan, "constant input": 1.0}.get(kind, marks.get(kind))
            at = mine if kind not in marks else mine & (pl.col("t") == 0.0)
            frame = frame.with_columns(pl.when(at).then(new).otherwise(pl.col("u")).alias("u"))
            kinds[key] = kind
        frame.write_parquet(folder / f"part-{number:04d}.parquet")
    return kinds


def large(count: int, seed: int, judge: bool) -> str:
    """One run over many records with poison among them."""
    structure = Structure(2, 0, offset=False, initial_state="free")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place, "units")
        folder.mkdir()
        kinds = write_large(folder, count, seed)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        found = measured(
            folder, Path(place, "out"), count, structure=structure, method=Poisoned(), judge=judge,
            workers=2, time_limit=LIMIT, memory_limit=2 << 30,
        )  # fmt: skip
        parent, child = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, child_peak()
        rows = Store(Path(place, "out")).rows(["key", "status", "ok", "seconds"])
    if rows.height != count or rows["key"].n_unique() != count:
        raise SystemExit(f"{rows.height} rows for {count} records")
    status = dict(rows.select("key", "status").iter_rows())
    sound = rows.filter(~pl.col("key").is_in(list(kinds)))
    lines = [
        f"{count} records, {len(kinds)} poisoned, {'judged' if judge else 'not judged'}, 2 workers",
        f"{found['rate']:.1f} records/s, CPU {found['cpu_ms']:.1f} ms a record, workers busy "
        f"{100 * found['busy']:.0f} %, a sound record {1e3 * sound['seconds'].median():.1f} ms",
        f"memory: parent {parent:.0f} MB ({before:.0f} before), a child {child:.0f} MB at most",
        f"sound records without an estimate: {int((~sound['ok']).sum())}",
    ]
    for kind in POISON:
        tally = Counter(status[key] for key, one in kinds.items() if one == kind)
        lines.append(f"{kind:15s}" + ", ".join(f"{name}: {n}" for name, n in tally.items()))
    return "\n".join(lines)


def report(data: dict[str, Any]) -> str:
    lines = [f"{data['count']} records of {SAMPLES} samples, order 2, from one Parquet file", ""]
    lines.append("                           workers  rec/s  CPU ms  1/CPU rec/s/core  busy")
    for label, one in data["runs"].items():
        lines.append(
            f"{label:27s}{one['workers']:7d}{one['rate']:7.1f}{one['cpu_ms']:8.1f}"
            f"{1e3 / one['cpu_ms']:18.0f}{100 * one['busy']:5.0f}%"
        )
    for one in data["rival"]:
        lines.append(
            f"{'by hand, ' + one['name']:27s}{one['workers']:7d}{one['rate']:7.1f}"
            f"{one['cpu_ms']:8.1f}{1e3 / one['cpu_ms']:18.0f}"
        )
    best = data["runs"]["told, not judged"]
    judged = data["runs"]["all open, judged"]
    lines += [
        "",
        f"handing over and accounting {data['task_ms']:.2f} ms a record "
        f"({100 * data['task_ms'] / best['median_ms']:.1f} % of a quick fit)",
        f"resume, all done            {data['resume_ms']:.3f} ms a record",
        f"rows                        {best['bytes']:.0f} bytes a record in {best['parts']} parts",
        f"memory                      parent {data['parent_mb']:.0f} MB, a worker's child "
        f"{data['child_mb']:.0f} MB at most",
        "poison: " + "; ".join(f"{kind}: {status}" for kind, status in data["poison"].items()),
        "",
        "on paper                    cores for 1e6 a day   core years for 1e9",
    ]
    for label, one in (("told, not judged", best), ("all open, judged", judged)):
        core_seconds = one["cpu_ms"] / 1e3
        lines.append(
            f"{label:27s}{1e6 * core_seconds / DAY:18.2f}"
            f"{BILLION * core_seconds / DAY / 365.25:21.2f}"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--large", action="store_true", help="one long run with poison, no more")
    parser.add_argument("--judge", action="store_true", help="with --large: look for findings too")
    given = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if given.large:
        print(large(given.count, given.seed, given.judge))
        return
    with tempfile.TemporaryDirectory() as place:
        folder, path = Path(place), Path(place, "all.parquet")
        units = records(given.count, given.seed)
        frame_of(units).write_parquet(path)
        few = dict(list(units.items())[: max(given.count // 4, 100)])
        part = folder / "part.parquet"
        frame_of(few).write_parquet(part)
        runs = {
            "told, not judged": measured(
                path, folder / "a", given.count, structure=TOLD, judge=False, workers=2
            ),
            "told, not judged, 1": measured(
                part, folder / "b", len(few), structure=TOLD, judge=False, workers=1
            ),
            "told, judged": measured(part, folder / "c", len(few), structure=TOLD, workers=2),
            "all open, judged": measured(
                part, folder / "d", len(few), structure=Structure(2, 0), workers=2
            ),
        }
        child = child_peak()
        parent = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        data: dict[str, Any] = {
            "count": given.count,
            "seed": given.seed,
            "runs": runs,
            "task_ms": task_cost(few),
            "resume_ms": resume_cost(
                path, folder / "a", given.count, structure=TOLD, judge=False, workers=2
            ),
            "parent_mb": parent,
            "child_mb": child,
            "poison": poisoned(few, folder / "e", folder / "poison"),
            "rival": [by_joblib(units, workers) for workers in (1, 2)],
        }
    text = report(data)
    print(text)
    if given.save:
        keep("fleet", text, data)


if __name__ == "__main__":
    main()
