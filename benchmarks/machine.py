"""Print machine, python and library versions; keep the results of the other scripts.

`keep` writes ``results/NAME.txt`` and ``results/NAME.json`` and puts the text between the markers
of that name in ``README.md``, so that the write-up is what was measured.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import json
import os
import platform
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
LIBRARIES = ("tridentify", "numpy", "scipy", "numba", "llvmlite")
THREAD_LIMITS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def memory() -> float:
    """Main memory [GB], nan where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    except (AttributeError, OSError, ValueError):
        return float("nan")


def blas() -> str:
    """Name and version of numpy's linear algebra library."""
    import numpy as np

    found: dict[str, Any] = np.show_config(mode="dicts").get("Build Dependencies", {})
    library = found.get("blas", {})
    return f"{library.get('name', 'unknown')} {library.get('version', '')}".strip()


def describe() -> dict[str, str]:
    """Everything that a time depends on."""
    cores = os.process_cpu_count() if hasattr(os, "process_cpu_count") else os.cpu_count()
    facts = {
        "processor": processor(),
        "cores": str(cores),
        "memory": f"{memory():.0f} GB",
        "system": platform.system(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
    }
    for name in LIBRARIES:
        try:
            facts[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            facts[name] = getattr(importlib.import_module(name), "__version__", "unknown")
    facts["blas"] = blas()
    for name in THREAD_LIMITS:
        if name in os.environ:
            facts[name] = os.environ[name]
    return facts


def text(facts: dict[str, str]) -> str:
    """One line a fact."""
    width = max(map(len, facts))
    return "\n".join(f"{name:{width}s}  {value}" for name, value in facts.items())


def keep(name: str, report: str, data: object) -> None:
    """Store a result and put its text into the write-up.

    Parameters
    ----------
    name : str
        ``results/NAME.txt`` and ``.json``; markers ``<!-- NAME -->`` and ``<!-- end NAME -->``.
    report : str
    data : object
        Anything JSON can hold.
    """
    folder = HERE / "results"
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.txt").write_text(report + "\n")
    stored = {"machine": describe(), "data": data}
    (folder / f"{name}.json").write_text(json.dumps(stored, indent=1) + "\n")
    readme = HERE / "README.md"
    first, last = f"<!-- {name} -->", f"<!-- end {name} -->"
    before, found, rest = readme.read_text().partition(first)
    if not found or last not in rest:
        raise SystemExit(f"found no markers for {name!r} in {readme.name}; expected {first}")
    after = rest.partition(last)[2]
    readme.write_text(f"{before}{first}\n```text\n{report}\n```\n{last}{after}")
    print(f"stored under results/{name} and in {readme.name}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--save", action="store_true", help="store the result and fill README.md")
    facts = describe()
    print(text(facts))
    if parser.parse_args().save:
        keep("machine", text(facts), facts)


if __name__ == "__main__":
    main()
