"""The examples that users read are executed.

pytest itself runs those of the docstrings (`--doctest-modules` over src); here it is checked that
it does and that the public names have one, and the README's Python is run as it stands there.
"""

from __future__ import annotations

import doctest
import inspect
import os
import re
import subprocess
import sys
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
    text = (repository / "README.md").read_text(encoding="utf-8")
    blocks = python_blocks(text)
    assert blocks, "the README lost its Python example"
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), names)
    estimate = names["estimate"]
    assert isinstance(estimate, tridentify.Estimate)
    # of the aircraft's linearised equations; see src/tridentify/data/README.md
    shown = re.search(r"```text\n(.*?)```", text, re.DOTALL)
    assert shown is not None
    printed = estimate.summary().splitlines()
    assert [line for line in shown.group(1).splitlines() if line not in printed] == []
    error = np.abs(estimate.theta - np.array([2.0423, 12.294, -11.972, -11.961])) / estimate.std
    assert np.all(error < 5.0)


def test_readme_is_short_and_links_every_page(repository: Path) -> None:
    text = (repository / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) < 150
    pages = {page.name for page in (repository / "docs").glob("*.md")}
    assert pages - set(re.findall(r"\(docs/([a-z_]+\.md)\)", text)) == set()


EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))
WRITES = {
    "first_model.py": ["first_model.html"],
    "physical_parameters.py": [],
    "changing_plant.py": ["changing_plant.png"],
    "jsbsim_amplitude.py": ["jsbsim_amplitude.json", "jsbsim_amplitude.png"],
    "jsbsim_loops.py": ["jsbsim_loops.json", "jsbsim_loops.png"],
    "jsbsim_short_period.py": ["short_period.csv", "short_period.json"],
    "result_picture.py": ["result.png"],
}
"""What each example leaves in the folder it is given."""
SMALLER = {
    "changing_plant.py": ["--seconds", "31"],
    "jsbsim_amplitude.py": ["--draws", "1", "--amplitudes", "1,4"],
    "jsbsim_loops.py": ["--seconds", "10"],
}
"""Arguments with which it does the same on fewer samples."""


@pytest.mark.parametrize("script", EXAMPLES, ids=lambda path: path.name)
@pytest.mark.fast("first_model.py")
def test_an_example_runs_from_the_root_and_makes_its_folder(
    repository: Path, tmp_path: Path, script: Path
) -> None:
    if "jsbsim" in script.name:
        pytest.importorskip("jsbsim", reason="needs jsbsim, of the extra tridentify[jsbsim]")
    folder = tmp_path / "a" / "new" / "folder"
    takes = "--out" in script.read_text(encoding="utf-8")
    given = ["--out", folder] if takes else [folder]
    given += SMALLER.get(script.name, [])
    before = set(repository.glob("[!.]*"))
    done = subprocess.run(
        [sys.executable, script.relative_to(repository), *given], cwd=repository,
        capture_output=True, text=True, timeout=250, check=False,
        env={**os.environ, "MPLBACKEND": "Agg"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert set(repository.glob("[!.]*")) - before == set()
    found = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    assert found == WRITES[script.name]


def test_the_examples_are_listed_the_simplest_one_first(repository: Path) -> None:
    text = (repository / "examples" / "README.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\w+\.py)` \|", text, flags=re.MULTILINE)
    assert listed[0] == "first_model.py"
    assert sorted(listed) == [path.name for path in EXAMPLES]
    first = (repository / "examples" / "first_model.py").read_text(encoding="utf-8")
    assert len([line for line in first.splitlines() if line.strip()]) <= 17
