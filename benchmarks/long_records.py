"""Memory and time of records of growing length, read in parts and held in memory.

Every case runs in a process of its own, whose peak of resident memory the operating system knows.
The library itself takes some 0.15 GB of it, which is measured by a process that only loads it.

    python benchmarks/long_records.py                 # 1e5 to 1e7 samples
    python benchmarks/long_records.py 1e8             # one length, read in parts only from 1e8 on

Files of 16 bytes a sample are made in a temporary folder (``TMPDIR``) and deleted.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

DT = 1e-3
NUM, DEN = [2.0, 30.0], [1.0, 1.2, 90.0]
NOISE = 0.05
PIECE = 1_000_000
"""Samples that are made at once."""
LARGEST_HELD = 10_000_000
"""Samples up to which the record is held in memory too."""


def make(path: Path, n: int, kind: str) -> None:
    """A held random input of 20 samples a step and the response with white noise, piece by piece.

    The response is that of the exact discretisation, its state carried from piece to piece.
    """
    from scipy.signal import cont2discrete, lfilter, lfilter_zi

    b, a, _ = cont2discrete((NUM, DEN), DT)
    state = 0.0 * lfilter_zi(b.ravel(), a)
    rng = np.random.default_rng(1)
    writer = None
    if kind == "npy":
        np.lib.format.open_memmap(path, "w+", np.float64, (n, 2)).flush()
    for start in range(0, n, PIECE):
        count = min(PIECE, n - start)
        u = np.repeat(rng.standard_normal(-(-count // 20)), 20)[:count]
        y, state = lfilter(b.ravel(), a, u, zi=state)
        y = y + NOISE * rng.standard_normal(count)
        if kind == "npy":
            there = np.lib.format.open_memmap(path, "r+")
            there[start : start + count] = np.column_stack([u, y])
            del there
            continue
        import pyarrow
        import pyarrow.parquet

        table = pyarrow.table({"u": u, "y": y})
        writer = writer or pyarrow.parquet.ParquetWriter(path, table.schema)
        writer.write_table(table)
    if writer is not None:
        writer.close()


MEASURED = """
import json, resource, sys, time
path, how, kind = sys.argv[1:]
import tridentify as tri
from tridentify.estimation.machine_code import load_kernels
load_kernels()
found = {}
inputs, outputs = (["x[0]"], ["x[1]"]) if kind == "npy" else (["u"], ["y"])
named = dict(inputs=inputs, outputs=outputs, dt=%r, intersample="zoh")
began, used = time.perf_counter(), time.process_time()
if how != "nothing":
    record = tri.open_record(path, **named)
    if how == "held":
        record = record.part(0, record.n_samples)
    estimate = tri.identify(record, (2, 1))
    said = [one for one in estimate.trace.decisions if "readings" in one]
    found = {"theta": estimate.theta.tolist(), "std": estimate.std.tolist(), "said": said,
             "fit": float(estimate.fit[0])}
found["seconds"] = time.perf_counter() - began
found["processor"] = time.process_time() - used
found["peak"] = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps(found))
"""


def measured(path: Path, how: str, kind: str) -> dict[str, object]:
    """One estimate in a process of its own: coefficients, time [s], peak of memory [bytes]."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", MEASURED % DT, str(path), how, kind]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    found: dict[str, object] = json.loads(run.stdout)
    return found


def main(lengths: list[int], kinds: list[str]) -> None:
    """Print one row for each length and file."""
    bare = measured(Path("."), "nothing", "npy")["peak"]
    print(f"library alone: {bare / 1e6:.0f} MB")  # type: ignore[operator]
    print(f"{'samples':>12} {'file':>8} {'how':>8} {'peak MB':>8} {'wall s':>8} {'cpu s':>8}")
    with tempfile.TemporaryDirectory() as folder:
        for n in lengths:
            for kind in kinds:
                path = Path(folder, f"run.{kind}")
                began = time.perf_counter()
                make(path, n, kind)
                made = time.perf_counter() - began
                ways = ("parts", "held") if n <= LARGEST_HELD else ("parts",)
                rows = {how: measured(path, how, kind) for how in ways}
                for how, row in rows.items():
                    print(
                        f"{n:>12,} {kind:>8} {how:>8} {row['peak'] / 1e6:>8.0f} "
                        f"{row['seconds']:>8.1f} {row['processor']:>8.1f}"
                    )
                tell(rows, made)
                path.unlink()


def tell(rows: dict[str, dict[str, object]], made: float) -> None:
    """How the two ways differ, and from the truth, in standard errors."""
    own = rows["parts"]
    theta, std = np.array(own["theta"]), np.array(own["std"])
    off = np.abs((theta - [*DEN[1:], *NUM]) / std).max()
    words = [f"{own['said']}", f"largest departure from the truth {off:.2f} standard errors"]
    if "held" in rows:
        apart = np.abs((theta - np.array(rows["held"]["theta"])) / std).max()
        words.append(f"from the estimate in memory {apart:.1e} standard errors")
    print("    " + "; ".join(words) + f"; made in {made:.0f} s", flush=True)


if __name__ == "__main__":
    given = [one for one in sys.argv[1:] if one not in ("npy", "parquet")]
    files = [one for one in sys.argv[1:] if one in ("npy", "parquet")] or ["npy", "parquet"]
    main([round(float(one)) for one in given] or [100_000, 1_000_000, 10_000_000], files)
