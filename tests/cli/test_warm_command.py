"""Compiled functions, loaded before they are needed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import tridentify
from tridentify.estimation.machine_code import load_kernels
from tridentify.numerics.compiled import KERNELS


def test_warm_says_when_all_is_ready(run):
    outcome = run("warm")
    assert outcome.code == 0
    assert "ready" in outcome.out
    assert "on-line" in outcome.err


def test_every_file_with_machine_code_of_an_identification_is_loaded():
    package = Path(tridentify.__file__).parent
    loaded = {Path(str(module.__file__)) for module in load_kernels()}
    for pattern in KERNELS:
        for path in package.glob(pattern):
            if path.parent.parent.name == "online" or path.name in ("__init__.py", "recursive.py"):
                continue
            assert path in loaded


@pytest.mark.slow
def test_every_file_with_machine_code_of_the_on_line_estimators_is_loaded(run, monkeypatch):
    import tridentify.online.kernels as room

    for name in [name for name in sys.modules if name.startswith(f"{room.__name__}.")]:
        monkeypatch.delitem(sys.modules, name)
        monkeypatch.delattr(room, name.rpartition(".")[2])
    run("warm")
    for path in Path(str(room.__file__)).parent.glob("*.py"):
        if "@compiled(" in path.read_text(encoding="utf-8"):
            assert f"{room.__name__}.{path.stem}" in sys.modules


COUNTED = """
import json
from tridentify.estimation import machine_code
begun = []
start = machine_code._started
machine_code._started = lambda modules: begun.append(start(modules)) or begun[-1]
machine_code.load_kernels()
from tridentify.models import compiled_regression, compiled_steps
count = lambda m: [sum(f.stats.cache_misses.values()) for f in vars(m).values()
                   if hasattr(f, "stats") and f.__module__ == m.__name__]
there = count(compiled_regression)
print(json.dumps({"here": sum(count(compiled_steps)), "there": sum(there), "all": len(there),
                  "beside": bool(begun)}))
"""


@pytest.mark.slow
def test_who_compiles_has_half_of_it_done_by_another_process(tmp_path):
    """Told apart from who finds all on disk; what both made is of use to a third."""
    found = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", COUNTED],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        found.append(json.loads(done.stdout))
    assert found[0]["here"] > 0
    assert found[0]["there"] == (0 if found[0]["beside"] else found[0]["all"])
    assert found[1] == found[0] | {"here": 0, "there": 0, "beside": False}
