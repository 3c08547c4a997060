"""The page on how it works inside names files and what stands in them: both are there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

NAMED = re.compile(r"`(\w+)`\s\(`([\w/]+\.py)`\)")
FILE = re.compile(r"`((?:\w+/)*\w+\.py)`")
MOST_LINES = 150


@pytest.fixture(scope="module")
def page(repository: Path) -> str:
    return (repository / "docs" / "inside.md").read_text(encoding="utf-8")


def defined(path: Path) -> set[str]:
    """Functions and classes of a module, and what it takes from others by name."""
    found = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
    return found


@pytest.mark.slow
def test_every_name_stands_in_its_file(repository: Path, page: str) -> None:
    pairs = NAMED.findall(page)
    assert len(pairs) > 30, "the page lost its names"
    source = repository / "src" / "tridentify"
    wrong = [
        f"{name} in {file}"
        for name, file in pairs
        if not (source / file).is_file() or name not in defined(source / file)
    ]
    assert wrong == []


def test_every_file_and_room_is_there(repository: Path, page: str) -> None:
    source = repository / "src" / "tridentify"
    files = set(FILE.findall(page)) | set(re.findall(r"`((?:\w+/)+)`", page))
    files -= {"src/tridentify/"}
    assert [file for file in sorted(files) if not (source / file).exists()] == []


def test_the_readme_is_short_and_its_house_stands(repository: Path) -> None:
    text = (repository / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) < MOST_LINES
    house = text.partition("## The house")[2].partition("## ")[0]
    source = repository / "src" / "tridentify"
    rows = [line.partition("|")[2].partition("|")[0] for line in house.splitlines() if "`" in line]
    named = {name for row in rows for name in re.findall(r"`([\w.]+)/?`", row)}
    there = {
        entry.name
        for entry in source.iterdir()
        if not entry.name.startswith("_")
        and entry.name not in {"py.typed", "data"}
        # folders of an earlier house may keep what was compiled there
        and (entry.is_file() or any(entry.glob("*.py")))
    }
    assert named == there


def test_links_of_the_readme_lead_somewhere(repository: Path) -> None:
    text = (repository / "README.md").read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#]+)\)", text)
    assert targets
    assert [t for t in targets if not (repository / t).exists()] == []
