"""Reference from docstrings: the directive `public-names`, and docstrings as Sphinx wants them.

`public-names` gives a table of names with the first line of what they say, then each in full. Its
argument is a module; its content the names, or nothing for all of the module's `__all__`. So a new
public name of a room is in the reference as soon as the room exports it.
"""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

OPTIONS = {
    "autoclass": "   :members:",
    "autoexception": "   :members:",
    "autodata": "   :no-value:",
}
IN_SEVERAL_FILES = ("Estimate", "Record", "Structure")
"""Classes whose members stand in several files of their room: those count as their own."""
_REFERENCE = re.compile(r"\s*\.\. \[(\d+)\] (.+)")
_RAISED = re.compile(r"(:Raises: (?:\* )?|\s*\* )\*\*((?:[A-Z]\w+(?:Error|Warning)(?:, )?)+)\*\*")
_ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")
_FIRST_LINES: dict[str, str] = {}


def directive_of(thing: object) -> str:
    """Name of the autodoc directive for a public object."""
    if inspect.isclass(thing):
        return "autoexception" if issubclass(thing, BaseException) else "autoclass"
    return "autofunction" if inspect.isroutine(thing) else "autodata"


def others(kind: type) -> list[str]:
    """Ancestors of a class that do not stand in its room."""
    room = kind.__module__.rpartition(".")[0]
    return [one.__name__ for one in kind.__mro__ if one.__module__.rpartition(".")[0] != room]


class PublicNames(SphinxDirective):
    """A table of the names, then each of them from its docstring."""

    has_content = True
    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        name = self.arguments[0]
        module = import_module(name)
        listed = " ".join(self.content).split()
        names = listed or [found for found in module.__all__ if not found.startswith("_")]
        missing = [found for found in names if not hasattr(module, found)]
        if missing:
            raise self.error(f"found no {', '.join(missing)} in {name}")
        lines = ["```{eval-rst}", f".. currentmodule:: {name}", "", ".. autosummary::"]
        lines += ["   :nosignatures:", "", *(f"   {found}" for found in names)]
        for found in names:
            kind = directive_of(getattr(module, found))
            lines += ["", f".. {kind}:: {found}"]
            lines += [OPTIONS[kind]] if kind in OPTIONS else []
            if found in IN_SEVERAL_FILES:
                lines.append(f"   :inherited-members: {', '.join(others(getattr(module, found)))}")
        return self.parse_text_to_nodes("\n".join([*lines, "```"]))


def number_references(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Make a numbered list of what would be footnotes with the same numbers all over the page."""
    inside = False
    for k, line in enumerate(lines):
        found = _REFERENCE.match(line)
        inside = bool(found) or (inside and line.startswith(" "))
        if found:
            lines[k] = f"{found[1]}. {found[2]}"
        elif inside:
            lines[k] = f"   {line.strip()}"


def link_errors(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Make links of the classes that "Raises" names, several at a time."""
    for k, line in enumerate(lines):
        found = _RAISED.match(line)
        if found:
            names = ", ".join(f":py:obj:`~.{error}`" for error in found[2].split(", "))
            lines[k] = f"{found[1]}{names}{line[found.end() :]}"


def plain_signature(
    app: Sphinx,
    what: str,
    name: str,
    thing: object,
    options: object,
    given: str | None,
    returned: str | None,
) -> tuple[str, str] | None:
    """Show an alias of a type by its name, and a default that is made anew as three dots."""
    if _ALIAS.search(f"{given}{returned}") is None and "<factory>" not in f"{given}":
        return None
    plain = [_ALIAS.sub(r"\1", text or "") for text in (given, returned)]
    return plain[0].replace("<factory>", "..."), plain[1]


def hide_first_line(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Keep the first line of a property from being read as "type: description"."""
    if what in ("property", "attribute", "data") and lines and ":" in lines[0]:
        _FIRST_LINES[name], lines[0] = lines[0], "@"


def show_first_line(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Put back what `hide_first_line` took."""
    if name in _FIRST_LINES and lines and lines[0] == "@":
        lines[0] = _FIRST_LINES.pop(name)


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("public-names", PublicNames)
    # napoleon (priority 500) turns sections into fields
    app.connect("autodoc-process-signature", plain_signature)
    app.connect("autodoc-process-docstring", number_references, priority=100)
    app.connect("autodoc-process-docstring", hide_first_line, priority=100)
    app.connect("autodoc-process-docstring", link_errors, priority=900)
    app.connect("autodoc-process-docstring", show_first_line, priority=900)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
