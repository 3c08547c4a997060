"""The house: imports point downward, without a circle, and only the command line speaks.

import-linter checks the contracts of pyproject.toml; a graph of our own, read from the sources
alone, checks the same thing by another route.
"""

from __future__ import annotations

import ast
import gc
import graphlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

PACKAGE = "tridentify"
MAY_SPEAK = ("tridentify.cli", "tridentify.__main__")
EXITS = {
    "print",
    "exit",
    "quit",
    "sys.exit",
    "os._exit",
    "sys.stdout.write",
    "sys.stderr.write",
    "SystemExit",
}


# ------------------------------------------------------------------------------ our own graph
Nodes = list[ast.AST]
"""What a source says that counts here, found in one walk through all of its nodes."""


def nodes_of(source: str) -> Nodes:
    """Imports, calls and what is raised, inside functions too."""
    counting = (ast.Import, ast.ImportFrom, ast.Call, ast.Raise)
    return [node for node in ast.walk(ast.parse(source)) if isinstance(node, counting)]


def read_modules(source: Path) -> dict[str, tuple[bool, Nodes]]:
    """Module name -> (is a package, its nodes), for every module below `source`."""
    modules = {}
    for path in sorted((source / PACKAGE).rglob("*.py")):
        parts = path.relative_to(source).with_suffix("").parts
        is_package = parts[-1] == "__init__"
        name = ".".join(parts[:-1] if is_package else parts)
        modules[name] = (is_package, nodes_of(path.read_text(encoding="utf-8")))
    return modules


def imported_names(name: str, is_package: bool, nodes: Nodes) -> Iterator[tuple[str, str]]:
    """(module, name in it or "") of every import statement."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = name.split(".")
                keep = len(parts) - node.level + (1 if is_package else 0)
                base = ".".join([*parts[:keep], *([node.module] if node.module else [])])
            yield from ((base, alias.name) for alias in node.names)


def import_graph(modules: Mapping[str, tuple[bool, Nodes]]) -> dict[str, set[str]]:
    """Module -> the modules of the package it imports."""
    graph: dict[str, set[str]] = {}
    for name, (is_package, nodes) in modules.items():
        targets = set()
        for base, inner in imported_names(name, is_package, nodes):
            submodule = f"{base}.{inner}"
            target = submodule if submodule in modules else base
            if target in modules and target != name:
                targets.add(target)
        graph[name] = targets
    return graph


def find_circle(graph: Mapping[str, set[str]]) -> list[str]:
    """The modules of one import circle, or nothing."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return list(error.args[1])
    return []


def written(node: ast.expr) -> str:
    """A name with its dots, as `ast.unparse` gives it in a tenth of the time; else nothing."""
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    return ".".join([node.id, *reversed(parts)]) if isinstance(node, ast.Name) else ""


def find_speech(name: str, nodes: Nodes) -> list[str]:
    """`module:line name` of every print and exit."""
    found = []
    for node in nodes:
        called = ""
        if isinstance(node, ast.Call):
            called = written(node.func)
        elif isinstance(node, ast.Raise) and isinstance(node.exc, ast.Name):
            called = node.exc.id
        if called in EXITS:
            found.append(f"{name}:{node.lineno} {called}")
    return found


@pytest.fixture(scope="module")
def modules(repository: Path) -> Iterator[dict[str, tuple[bool, Nodes]]]:
    gc.disable()  # it would go through the millions of nodes again and again
    try:
        yield read_modules(repository / "src")
    finally:
        gc.enable()


def test_no_module_is_in_an_import_circle(modules: dict[str, tuple[bool, Nodes]]) -> None:
    graph = import_graph(modules)
    assert sum(map(len, graph.values())) > len(graph) / 2, "the graph lost its imports"
    assert find_circle(graph) == []


def test_only_the_command_line_prints_or_exits(
    modules: dict[str, tuple[bool, Nodes]],
) -> None:
    found = [
        speech
        for name, (_, nodes) in modules.items()
        if not name.startswith(MAY_SPEAK)
        for speech in find_speech(name, nodes)
    ]
    assert found == []


def test_a_circle_and_a_print_would_be_found(tmp_path: Path) -> None:
    folder = tmp_path / PACKAGE / "room"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").write_text("")
    (folder / "__init__.py").write_text("")
    (folder / "a.py").write_text("def f():\n    from . import b\n")
    (folder / "b.py").write_text("from ..c import x\nprint(x)\nraise SystemExit\n")
    (folder.parent / "c.py").write_text("import tridentify.room.a\nx = 1\n")
    modules = read_modules(tmp_path)
    assert set(find_circle(import_graph(modules))) == {
        "tridentify.room.a",
        "tridentify.room.b",
        "tridentify.c",
    }
    _, nodes = modules["tridentify.room.b"]
    assert sorted(find_speech("b", nodes)) == ["b:2 print", "b:3 SystemExit"]


# --------------------------------------------------------------------------- the contracts
def lint_imports(folder: Path) -> subprocess.CompletedProcess[str]:
    """Run import-linter on the package below `folder`/src, with the contracts beside it."""
    command = (
        "import sys; from importlinter.cli import lint_imports; "
        "sys.exit(lint_imports('pyproject.toml', no_cache=True))"
    )
    return subprocess.run(
        [sys.executable, "-c", command],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder / "src")},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_contracts_are_kept(repository: Path) -> None:
    done = lint_imports(repository)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("module", "statement", "contract"),
    [
        ("errors.py", "from tridentify import record", "An import never points upward"),
        ("simulate.py", "def f():\n    import tridentify.cli", "An import never points upward"),
        ("unheard_of.py", "", "An import never points upward"),
        ("identify.py", "def f():\n    import matplotlib.pyplot", "plotting library"),
        ("record.py", "import rich.table", "Only the command line knows the terminal"),
    ],
)
@pytest.mark.fast("simulate.py*")
def test_a_broken_contract_would_be_found(
    repository: Path, tmp_path: Path, module: str, statement: str, contract: str
) -> None:
    shutil.copy(repository / "pyproject.toml", tmp_path)
    shutil.copytree(
        repository / "src" / PACKAGE,
        tmp_path / "src" / PACKAGE,
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    with (tmp_path / "src" / PACKAGE / module).open("a", encoding="utf-8") as file:
        file.write(f"\n{statement}\n")
    done = lint_imports(tmp_path)
    broken = [line for line in done.stdout.splitlines() if " BROKEN" in line]
    assert done.returncode != 0
    assert any(contract in line for line in broken), done.stdout + done.stderr


# --------------------------------------------------------------------------- imports by name
BY_NAME = {"import_module", "__import__", "importlib.import_module", "importlib.__import__"}
MAY_IMPORT_BY_NAME = {
    "tridentify",  # the names of the front door, when they are first used
    "tridentify.cli.app",  # the command that is asked for, of its own room
    "tridentify.record.formats.apart.isolated",  # a reader of its own room
    "tridentify.writing.views",  # what an estimate shows of itself: the one way up
}
MAY_IMPORT_THE_DOOR = ("tridentify.cli", "tridentify.report.settings", "tridentify.__main__")
"""For the version, and for the code that does it again."""


def imports_by_name(nodes: Nodes) -> bool:
    """Whether a module loads another one by its name in a string."""
    calls = {written(node.func) for node in nodes if isinstance(node, ast.Call)}
    return bool(calls & BY_NAME)


def test_nothing_else_reaches_a_room_by_name(
    modules: dict[str, tuple[bool, Nodes]],
) -> None:
    """An import by name is seen by no contract; the front door leads into every room."""
    found = {name for name, (_, nodes) in modules.items() if imports_by_name(nodes)}
    assert found == MAY_IMPORT_BY_NAME
    rooms = {name.split(".")[1] for name in modules if name.count(".")} - {"errors"}
    through_the_door = [
        name
        for name, (is_package, nodes) in modules.items()
        if not name.startswith(MAY_IMPORT_THE_DOOR) and name != PACKAGE
        for base, inner in imported_names(name, is_package, nodes)
        if base == PACKAGE and inner not in {"errors"} and (not inner or inner not in rooms)
    ]
    assert through_the_door == []


def test_an_import_by_name_would_be_found() -> None:
    for statement in (
        "import importlib\nimportlib.import_module('tridentify.plots')",
        "from importlib import import_module\ndef f():\n    return import_module('x')",
        "__import__('tridentify.plots')",
    ):
        assert imports_by_name(nodes_of(statement))
