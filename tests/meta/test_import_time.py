"""`import tridentify` stays light: what is heavy is loaded by the call that needs it.

A list of modules, not a stopwatch: it gives the same answer on every machine.
"""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

HEAVY = (
    "asammdf",
    "control",
    "h5py",
    "jinja2",
    "jsbsim",
    "matplotlib",
    "narwhals",
    "numba",
    "pandas",
    "polars",
    "pyarrow",
    "pyulog",
    "rich",
    "scipy.integrate",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "typer",
)


def loaded_after(statement: str) -> set[str]:
    """The modules that a fresh interpreter holds after `statement`."""
    program = f"{statement}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize(
    "statement",
    ["import tridentify", "from tridentify import Record, Structure, TransferFunction"],
)
def test_nothing_heavy_is_loaded(statement: str) -> None:
    loaded = loaded_after(statement)
    assert "tridentify" in loaded
    assert sorted(loaded.intersection(HEAVY)) == []


def test_a_reader_of_files_waits_for_no_mathematics() -> None:
    """Every file of a binary format is read in a process of its own, which loads this."""
    loaded = loaded_after("import tridentify.record.formats.arrow, tridentify.record.formats.mdf")
    assert "tridentify.record.record" in loaded
    assert sorted(one for one in loaded if one.split(".")[0] in ("scipy", "numba")) == []


def test_the_command_line_starts_without_what_few_commands_need() -> None:
    loaded = loaded_after("from tridentify.cli.app import program; program()")
    assert "tridentify.cli.identify_command" in loaded
    slow = {"scipy.signal", "scipy.stats", "scipy.integrate", "matplotlib", "jinja2", "numba"}
    assert sorted(loaded & slow) == []


def test_what_fits_no_model_waits_for_no_mathematics() -> None:
    """`tridentify --version` and `tridentify channels` took a second before their first line."""
    loaded = loaded_after(
        "from tridentify.cli.app import program, run; run(['--version']); program(('channels',))"
    )
    assert "tridentify.cli.channels_command" in loaded
    assert sorted(one for one in loaded if one.split(".")[0] in ("scipy", "numba")) == []


JUDGED = """
import numpy as np
from tridentify import Record, Structure, identify
y = np.random.default_rng(0).standard_normal(40).cumsum()
found = identify(Record(np.sign(np.sin(np.arange(40) ** 1.3)), y, dt=0.1), Structure(1, 0),
                 throw=False)
assert found.findings
"""


def test_a_judgement_waits_for_no_package_that_it_hardly_needs() -> None:
    """`scipy.signal` takes half a second, more than many a judgement."""
    loaded = loaded_after(JUDGED)
    assert "tridentify.judgement.causes.sensors.lost" in loaded
    assert not loaded & {"scipy.signal", "scipy.stats", "matplotlib"}
