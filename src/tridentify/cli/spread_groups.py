"""Groups of options (`groups`) spread out into the parameters of a command, with their help."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from typing import Annotated, Any, get_args, get_type_hints


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command with every group of options spread out, each with its help.

    Parameters
    ----------
    command : callable
        Parameters annotated with a dataclass of options are groups. What its docstring says of a
        parameter, or that of a group of an attribute, is the help where the option states none.

    Examples
    --------
    >>> from tridentify.cli.groups import Way
    >>> def fit(file: str, way: Way, out: str | None = None) -> None:
    ...     print(way.method, out)
    >>> list(inspect.signature(with_groups(fit)).parameters)
    ['file', 'method', 'noise', 'route', 'controller', 'out']
    >>> with_groups(fit)(file="a.csv", out="b", **vars(Way("output-error")))
    output-error b
    """
    hints = _hints(command)
    groups: dict[str, type[Any]] = {}
    spread: list[inspect.Parameter] = []
    for name, own in inspect.signature(command).parameters.items():
        kind = hints[name]
        if not is_dataclass(kind):
            spread.append(own.replace(annotation=kind, kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        groups[name] = kind  # type: ignore[assignment]
        inner = _hints(kind)
        spread += [
            inspect.Parameter(
                one.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if one.default is MISSING else one.default,
                annotation=inner[one.name],
            )
            for one in fields(kind)
        ]

    @wraps(command)
    def run(**given: Any) -> None:
        made = {
            name: group(**{one.name: given.pop(one.name) for one in fields(group)})
            for name, group in groups.items()
        }
        command(**given, **made)

    run.__signature__ = inspect.Signature(spread)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in spread}
    run.__doc__ = re.split(SECTION, inspect.getdoc(command) or "")[0]
    del run.__wrapped__
    return run


def _hints(documented: Any) -> dict[str, Any]:
    """Annotations of a command or a group, its options with what the docstring says of them."""
    hints = get_type_hints(documented, include_extras=True)
    for one in getattr(documented, "__mro__", (documented,)):
        for name, text in described(one.__doc__ or "").items():
            kind, option = get_args(hints[name])
            if option.help is None:
                option = copy(option)
                option.help = text
                hints[name] = Annotated[kind, option]
    return hints


SECTION = r"\n *(?:Parameters|Attributes)\n *-{10}\n"


def described(docstring: str) -> Mapping[str, str]:
    """What a docstring says of each parameter or attribute.

    Examples
    --------
    >>> from tridentify.cli.groups import ReadingMany
    >>> described(ReadingMany.__doc__)["start"]
    'Leave out what is before.'
    """
    _, *sections = re.split(SECTION, inspect.cleandoc(docstring))
    entries = re.findall(r"^(\w+)\n((?: +.*\n?)+)", "".join(sections), re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}
