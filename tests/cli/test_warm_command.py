"""Compiled functions, loaded before they are needed."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import tridentify
from tridentify.estimation.machine_code import KERNELS
from tridentify.numerics.compiled import KERNELS as FILES


def test_warm_says_when_all_is_ready(run):
    outcome = run("warm")
    assert outcome.code == 0
    assert "ready" in outcome.out
    assert "on-line" in outcome.err


def test_every_file_with_machine_code_of_an_identification_is_loaded():
    package = Path(tridentify.__file__).parent
    named = {name for modules in KERNELS.values() for name in modules}
    reached = set(named)
    for name in named:  # what they are made of
        text = Path(str(import_module(name).__file__)).read_text()
        reached |= {
            line.split()[1] for line in text.splitlines() if line.startswith("from tridentify")
        }
    for pattern in FILES:
        for path in package.glob(pattern):
            dotted = "tridentify." + ".".join(path.relative_to(package).with_suffix("").parts)
            if "online" in dotted or path.name == "__init__.py" or "recursive" in dotted:
                continue
            assert dotted in reached
