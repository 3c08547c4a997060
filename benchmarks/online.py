"""On-line estimation: speed, latency, memory, tracking, bias, changes that are noticed.

    python benchmarks/online.py --save
    python benchmarks/online.py --parts tracking,bias

Parts that are not asked for keep the figures of the last time. What each part does stands in
`online_time.py`, `online_errors.py` and `online_gusts.py`, the plants that change in `changing.py`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable
from typing import Any

LIMITS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
for _name in LIMITS:
    os.environ.setdefault(_name, "1")

import online_errors as errors  # noqa: E402
import online_gusts as gusts  # noqa: E402
import online_time as times  # noqa: E402
from machine import HERE, keep  # noqa: E402

RUN: dict[str, Callable[[bool], dict[str, Any]]] = {
    "rates": times.rates,
    "steps": times.steps,
    "memory": times.memory,
    "tracking": errors.tracking,
    "bias": errors.bias,
    "changes": errors.changes,
    "gusts": gusts.gusts,
    "recorded": gusts.recorded,
}


def text(data: dict[str, Any]) -> str:
    """All tables of the parts that have figures."""
    libraries = data.get("rates", {}).get("libraries", [])
    tables: dict[str, Callable[[dict[str, Any]], list[str]]] = {
        "rates": times.rates_table,
        "steps": lambda one: times.steps_table(one, libraries),
        "memory": times.memory_table,
        "tracking": errors.tracking_table,
        "bias": errors.bias_table,
        "changes": errors.changes_table,
        "gusts": gusts.gusts_table,
        "recorded": gusts.recorded_table,
    }
    return "\n\n".join("\n".join(table(data[k])) for k, table in tables.items() if k in data)


def options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    parser.add_argument("--parts", default=",".join(RUN), help="of " + ", ".join(RUN))
    parser.add_argument("--quick", action="store_true", help="a hundredth of the work, to try it")
    parser.add_argument("--fold", default="", help=argparse.SUPPRESS)
    return parser.parse_args()


def main() -> None:
    given = options()
    if given.fold:
        print(json.dumps(times.fold(given.fold, given.quick)))
        return
    file = HERE / "results" / "online.json"
    data: dict[str, Any] = {}
    for part in given.parts.split(","):
        if part not in RUN:
            raise SystemExit(f"found part {part!r}; expected some of {', '.join(RUN)}")
        print(f"{part}", file=sys.stderr, flush=True)
        data[part] = RUN[part](given.quick)
    if given.save and file.exists():
        # several processes may each do a part
        data = {**json.loads(file.read_text())["data"], **data}
    report = text(data)
    print("\n" + report)
    if given.save:
        (HERE / "results").mkdir(exist_ok=True)
        if "tracking" in data:
            errors.picture(data["tracking"]).savefig(HERE / "results" / "online.png", dpi=130)
        keep("online", report, data)


if __name__ == "__main__":
    main()
