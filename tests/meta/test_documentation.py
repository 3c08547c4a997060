"""The documentation: no code on a page that is not run, and no public name that is missing.

That every cell and every command succeeds, and that every link leads somewhere, is for the build
to say (`make docs`, where a warning is an error); here is what the build cannot see.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

RUN = ("{code-cell}", "{command}")
TEXT = ("{toctree}", "{include}", "{public-names}", "{note}", "{tip}", "{warning}", "{math}")
ROOMS = (
    *("online", "physical", "plots", "report", "studies", "fleet", "uncertainty", "errors"),
    *("data", "excitation", "export"),
)
JUDGEMENT = (
    "judgement.advice",
    "judgement.selection",
    "judgement.validation",
    "judgement.comparison",
)


def blocks(text: str) -> list[tuple[int, str]]:
    """Line and kind of every block of code on a page; of an indented one the kind is empty."""
    tokens = MarkdownIt("commonmark").parse(text)
    return [
        (token.map[0] + 1 if token.map else 0, token.info.split(" ")[0])
        for token in tokens
        if token.type in ("fence", "code_block")
    ]


def dead(text: str) -> list[tuple[int, str]]:
    """Blocks of a page that are neither run nor markup."""
    return [(line, kind) for line, kind in blocks(text) if kind not in (*RUN, *TEXT)]


def listed(folder: Path) -> set[str]:
    """Full names of what the reference documents."""
    found: set[str] = set()
    for page in sorted((folder / "reference").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        for module, content in re.findall(
            r"^```\{public-names\} (\S+)\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL
        ):
            names = content.split() or import_module(module).__all__
            found |= {f"{module}.{name}" for name in names}
    return found


def rooms() -> list[str]:
    """Modules with public names."""
    return ["tridentify", *(f"tridentify.{room}" for room in (*ROOMS, *JUDGEMENT))]


@pytest.fixture(scope="module")
def pages(repository: Path) -> list[Path]:
    found = sorted((repository / "docs").rglob("*.md"))
    assert len(found) > 15
    return found


def test_every_block_of_code_is_run(pages: list[Path]) -> None:
    found = {page.name: dead(page.read_text(encoding="utf-8")) for page in pages}
    assert {name: lines for name, lines in found.items() if lines} == {}


def test_a_dead_block_would_be_found() -> None:
    page = "```{code-cell}\n1\n```\n\n```python\n2\n```\n\n    indented\n\n```\nplain\n```\n"
    assert dead(page) == [(5, "python"), (9, ""), (11, "")]


def test_pages_with_cells_are_notebooks(pages: list[Path]) -> None:
    for page in pages:
        text = page.read_text(encoding="utf-8")
        if "```{code-cell}" in text:
            assert text.startswith("---\nfile_format: mystnb\n"), f"{page.name} would not be run"


def test_the_build_fails_where_a_cell_fails(repository: Path) -> None:
    settings = (repository / "docs" / "conf.py").read_text(encoding="utf-8")
    assert 'nb_execution_mode = "force"' in settings
    assert "nb_execution_raise_on_error = True" in settings
    makefile = (repository / "Makefile").read_text(encoding="utf-8")
    (build,) = re.findall(r"-m sphinx (.*?)docs build/docs", makefile, flags=re.DOTALL)
    assert {"-W", "-n", "-E"} <= set(build.split())
    checks = (repository / ".ci" / "run").read_text(encoding="utf-8")
    assert re.search(r"^[^#\n]*\bmake\b.* ci$", checks, flags=re.MULTILINE)
    needs = dict(re.findall(r"^(ci|check): ([a-z ]+?)\s*(?:##.*)?$", makefile, flags=re.MULTILINE))
    assert needs["ci"] == "check"
    assert "docs" in needs["check"].split()


def test_nothing_is_fetched_from_elsewhere(repository: Path) -> None:
    settings = (repository / "docs" / "conf.py").read_text(encoding="utf-8")
    assert "intersphinx" not in settings
    assert "http" not in settings
    assert "mathjax" not in settings


def test_the_reference_has_every_public_name(repository: Path) -> None:
    found = listed(repository / "docs")
    shown = {id(getattr(import_module(module), name)) for module, _, name in map(split, found)}
    missing = [
        f"{room}.{name}"
        for room in rooms()
        for name in import_module(room).__all__
        if not name.startswith("__")
        and f"{room}.{name}" not in found
        and id(getattr(import_module(room), name)) not in shown
        and f"{room}.{name}" not in rooms()
    ]
    assert missing == []


def split(name: str) -> tuple[str, str, str]:
    """Module, dot, name."""
    return name.rpartition(".")
