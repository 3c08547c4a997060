"""Compiled functions, loaded before they are needed."""

from __future__ import annotations

from pathlib import Path

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
