"""Public names load when used, and a function keeps its name beside a module of the same name."""

from __future__ import annotations

import subprocess
import sys

import pytest

import tridentify


def run(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=120
    )


@pytest.mark.parametrize("name", tridentify.__all__)
def test_every_name_can_be_had(name: str) -> None:
    assert getattr(tridentify, name) is getattr(tridentify, name)
    assert name in dir(tridentify)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(AttributeError, match="no_such_thing"):
        _ = tridentify.no_such_thing


IMPORTS = [
    "import tridentify.{name}",
    "from tridentify import {name}",
    "from tridentify.{name} import {name}",
    "import tridentify.estimation.methods.three_model",
    "import importlib; importlib.import_module('tridentify.{name}')",
    "import tridentify; tridentify.{name}; import tridentify.{name}",
    "import tridentify.{name}, importlib, sys; importlib.reload(sys.modules['tridentify.{name}'])",
]


@pytest.mark.parametrize(
    "statement", [*IMPORTS[:3], *(pytest.param(s, marks=pytest.mark.slow) for s in IMPORTS[3:])]
)
@pytest.mark.parametrize("name", ["identify"])
@pytest.mark.fast("identify-from tridentify.{name} import {name}")
def test_the_function_wins_over_the_module_of_its_name(name: str, statement: str) -> None:
    program = f"""
{statement.format(name=name)}
import pickle, sys, types
import tridentify
from tridentify import {name} as first
import tridentify.{name}
from tridentify import {name} as second
assert isinstance(first, types.FunctionType), first
assert isinstance(tridentify.{name}, types.FunctionType)
assert first is second is tridentify.{name}
assert isinstance(sys.modules["tridentify.{name}"], types.ModuleType)
from tridentify.{name} import {name} as third
assert third.__name__ == {name!r}
if "reload" not in {statement!r}:
    assert third is first
    assert pickle.loads(pickle.dumps(first)) is first
"""
    done = run(program)
    assert done.returncode == 0, done.stderr


def test_a_name_can_still_be_replaced_in_a_test(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tridentify, "identify", len)
    assert tridentify.identify is len


def test_the_import_alone_loads_next_to_nothing() -> None:
    done = run("import sys, tridentify; assert 'numpy' not in sys.modules")
    assert done.returncode == 0, done.stderr
