"""The examples that users read are executed.

pytest itself runs those of the docstrings (`--doctest-modules` over src); here it is checked that
it does and that the public names have one, and the README's Python is run as it stands there.
"""

from __future__ import annotations

import doctest
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

import tridentify

NAMES = [
    name
    for name in sorted(tridentify.__all__)
    if name == "OutputError" or not (name.startswith("__") or name.endswith(("Error", "Warning")))
]


def python_blocks(text: str) -> list[str]:
    """The fenced Python blocks of a Markdown text."""
    return re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def test_pytest_collects_the_docstring_examples(pytestconfig: pytest.Config) -> None:
    assert pytestconfig.option.doctestmodules
    assert "src" in pytestconfig.getini("testpaths")


@pytest.mark.parametrize("name", NAMES)
def test_public_name_has_an_example(name: str) -> None:
    thing = getattr(tridentify, name)
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        pytest.skip("a value, not a class or a function")
    examples = [
        example
        for test in doctest.DocTestFinder(recurse=True).find(thing, name)
        for example in test.examples
    ]
    # An example checks itself by what it shows.
    assert any(example.want.strip() for example in examples)


def test_readme_examples_run(
    repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = python_blocks((repository / "README.md").read_text(encoding="utf-8"))
    assert blocks, "the README lost its Python example"
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), names)
    estimate = names["estimate"]
    assert isinstance(estimate, tridentify.Estimate)
    # of the aircraft's linearised equations; see src/tridentify/data/README.md
    error = np.abs(estimate.theta - np.array([2.0423, 12.294, -11.972, -11.961])) / estimate.std
    assert np.all(error < 5.0)
