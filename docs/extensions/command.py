"""The directive `command`: a line for the shell, run when the page is built, with what it printed.

All commands of a page run one after the other in a temporary folder of the page. `tridentify` is
the package that the page is built with. A command that ends otherwise than expected (option
`exit`, by default 0) fails the build. What went to standard error is shown where a failure is
expected. `first` shows only so many of the first lines.
"""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, ClassVar

import warm
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

WIDTH, LIMIT = 92, 120
SHIM = """#!{python}
import sys

from tridentify.cli import main

if __name__ == "__main__":
    sys.exit(main())
"""
WARM = """#!/bin/sh
exec {command} tridentify "$@"
"""
_FOLDERS: dict[str, tempfile.TemporaryDirectory[str]] = {}


def folder_of(page: str) -> Path:
    """The temporary folder in which the commands of a page run."""
    if page not in _FOLDERS:
        _FOLDERS[page] = tempfile.TemporaryDirectory(prefix="docs-")
        shim = Path(_FOLDERS[page].name) / ".bin" / "tridentify"
        shim.parent.mkdir()
        served = os.environ.get("DOCS_WARM", "")
        command = shlex.join([*warm.COMMAND, served])
        text = WARM.format(command=command) if served else SHIM.format(python=sys.executable)
        shim.write_text(text)
        shim.chmod(0o755)
    return Path(_FOLDERS[page].name)


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in the page's folder."""
    sources = Path(__file__).resolve().parents[2] / "src"
    environment = {
        **os.environ,
        "PATH": os.pathsep.join(
            [str(folder / ".bin"), str(Path(sys.executable).parent), os.environ["PATH"]]
        ),
        "PYTHONPATH": str(sources),
        "COLUMNS": str(WIDTH),
        "MPLBACKEND": "Agg",
        "NO_COLOR": "1",
    }
    return subprocess.run(
        ["bash", "-euo", "pipefail", "-c", command],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=False,
    )


class Command(SphinxDirective):
    """Run the content in a shell and show it with its output."""

    has_content = True
    option_spec: ClassVar[dict[str, Any]] = {
        "exit": directives.nonnegative_int,
        "first": directives.positive_int,
    }

    def run(self) -> list[nodes.Node]:
        command = "\n".join(self.content)
        done = run(command, folder_of(self.env.docname))
        expected = self.options.get("exit", 0)
        if done.returncode != expected:
            raise self.error(
                f"{command!r} ended with {done.returncode}, not {expected}:\n{done.stderr[-2000:]}"
            )
        printed = done.stdout + (done.stderr if expected else "")
        lines = [line.rstrip() for line in printed.rstrip().splitlines()]
        first = self.options.get("first", len(lines))
        if first < len(lines):
            lines = [*lines[:first], "..."]
        asked = nodes.literal_block(command, command, language="bash", classes=["command"])
        shown = "\n".join(lines).strip("\n")
        answer = nodes.literal_block(shown, shown, language="text", classes=["output"])
        return [asked, answer] if shown else [asked]


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("command", Command)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
