"""Sampled or continuous: is the kind of a controller found that nobody states?

Random loops (`loops`) around stable plants, as many with controllers that work on the recorded
samples as with continuous ones, whose noise moves between the samples; ``u`` is recorded as "zoh",
the default. For each class: how often the kind was taken rightly, left open with a word
(`intersample` among the findings), or taken wrongly without one; and how many answers are more than
five stated errors off, told (any finding of the kind or a status that is not sound) or silent.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import loops
import numpy as np
from machine import keep

from tridentify import Record, Status, TridentifyError, identify

FAR = 5.0
"""Stated errors."""
SETTLED = -0.05
"""Real part of the rightmost pole of a plant."""
TOLD = ("intersample", "not-determined", "order-high", "noise-model", "contradiction")
"""Findings that warn of such an answer."""


def judged(seed: int, sampled: bool, first: int) -> dict[str, Any]:
    """One loop: what was taken, what was said, how far off."""
    drawn = loops.draw(
        first + seed,
        moving=True,
        keep=lambda one: one.sampled == sampled and bool(np.all(one.poles.real < SETTLED)),
    )
    moves = drawn.reference if np.ptp(drawn.reference) > 0 else drawn.dither
    u, y = drawn.record.u, drawn.record.y
    record = Record(u, y, dt=drawn.record.dt, reference=moves)
    row: dict[str, Any] = {"seed": first + seed, "kind": "sampled" if sampled else "continuous"}
    row["controller"] = "static" if drawn.controller == "P" else "with memory"
    try:
        found = identify(record, drawn.structure, throw=False)
    except TridentifyError as refused:
        return {**row, "taken": "refused", "said": type(refused).__name__, "far": False}
    said = [one for one in found.findings if one.code in TOLD]
    open_ = any(one.code == "intersample" for one in said)
    row["taken"] = found.loop.sampling if found.loop is not None else "open loop"
    row["said"] = "open" if open_ else "certain"
    row["told"] = any(one.matters for one in said) or found.status is not Status.CONVERGED
    row["far"] = bool(np.max(np.abs(found.theta - drawn.theta) / found.std) > FAR)
    return row


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """A line a class."""
    lines = [
        f"{'controller':28s}{'loops':>6s}{'right':>7s}{'wrong, told':>13s}{'silent':>8s}"
        f"{'far, told':>11s}{'silent':>8s}{'refused':>9s}"
    ]
    for kind in ("sampled", "continuous"):
        for memory in ("with memory", "static"):
            own = [one for one in rows if one["kind"] == kind and one["controller"] == memory]
            kept = [one for one in own if one["taken"] != "refused"]
            wrong = [one for one in kept if one["taken"] != kind]
            far = [one for one in kept if one["far"]]
            counts = (
                (len(kept) - len(wrong), 7),
                (sum(one["said"] == "open" for one in wrong), 13),
                (sum(one["said"] != "open" for one in wrong), 8),
                (sum(one["told"] for one in far), 11),
                (sum(not one["told"] for one in far), 8),
                (len(own) - len(kept), 9),
            )
            cells = "".join(f"{count:{width}d}" for count, width in counts)
            lines.append(f"{f'{kind}, {memory}':28s}{len(own):6d}{cells}")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--loops", type=int, default=60, help="of each kind")
    parser.add_argument("--seed", type=int, default=50_000, help="the first")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--save", action="store_true", help="store the table under results/")
    asked = parser.parse_args()
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(asked.workers) as pool:
        for sampled in (True, False):
            one = partial(judged, sampled=sampled, first=asked.seed)
            rows += pool.map(one, range(asked.loops))
    report = "\n".join(table(rows))
    print(report)
    if asked.save:
        keep("controller_kind", report, rows)


if __name__ == "__main__":
    main()
