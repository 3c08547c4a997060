"""Time of ``import tridentify`` in fresh processes, and what it loads. Aim: under 0.5 s."""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
from collections import Counter

from machine import keep

AIM = 0.5
PROBE = """
import json, sys, time
before, cpu = time.perf_counter(), time.process_time()
{statement}
wall, cpu = time.perf_counter() - before, time.process_time() - cpu
print(json.dumps([wall, cpu, sorted(sys.modules)]))
"""
STATEMENTS = (
    "import numpy",
    "import tridentify",
    "from tridentify import Record, Structure, identify",
)
HEAVY = ("scipy.signal", "scipy.linalg", "scipy.optimize", "numba", "matplotlib", "polars",
         "jinja2", "rich", "typer", "control", "pandas")  # fmt: skip


def probe(statement: str, repeats: int) -> tuple[list[float], list[float], list[str]]:
    """Wall and processor times [s] of an import, the first (cold files) left out; modules."""
    wall, cpu, modules = [], [], []
    for _ in range(repeats + 1):
        answer = subprocess.run(
            [sys.executable, "-c", PROBE.format(statement=statement)],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        w, c, modules = json.loads(answer.stdout)
        wall.append(w)
        cpu.append(c)
    return wall[1:], cpu[1:], modules


def slowest(statement: str, count: int) -> list[tuple[float, str]]:
    """Modules by their own import time [ms], from ``-X importtime``."""
    answer = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", statement],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    found = []
    for line in answer.stderr.splitlines():
        own, _, name = line.removeprefix("import time:").split("|")
        if own.strip().isdigit():
            found.append((int(own) / 1000.0, name.strip()))
    return sorted(found, reverse=True)[:count]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    options = parser.parse_args()
    lines = [
        f"{'statement':52s}{'wall median':>13s}{'wall min':>10s}{'CPU median':>12s}{'modules':>9s}"
    ]
    data: dict[str, object] = {}
    for statement in STATEMENTS:
        wall, cpu, modules = probe(statement, options.repeats)
        middle = statistics.median(wall)
        lines.append(
            f"{statement:52s}{middle:11.3f} s{min(wall):8.3f} s{statistics.median(cpu):10.3f} s"
            f"{len(modules):9d}"
        )
        data[statement] = {"wall": wall, "cpu": cpu, "modules": len(modules)}
    verdict = "met" if middle < AIM else "missed"
    packages = Counter(name.partition(".")[0] for name in modules)
    standard = set(sys.stdlib_module_names)
    third = {n: c for n, c in sorted(packages.items()) if n not in standard and c > 2}
    lines += [
        f"aim under {AIM} s: {verdict} (the last line loads what an estimation needs)",
        "packages (modules) then: " + ", ".join(f"{n} {c}" for n, c in third.items()),
        "heavy ones among them: " + (", ".join(n for n in HEAVY if n in modules) or "none"),
        "slowest by own time: "
        + ", ".join(f"{name} {own:.1f} ms" for own, name in slowest(STATEMENTS[-1], 6)),
    ]
    data |= {"packages": third, "aim": AIM}
    report = "\n".join(lines)
    print(report)
    if options.save:
        keep("import_time", report, data)


if __name__ == "__main__":
    main()
