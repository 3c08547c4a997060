"""Optional packages: present, or missed in one line that says how to get them."""

from __future__ import annotations

from importlib.util import find_spec

from tridentify.errors import MissingDependencyError


def require(module: str, install: str, purpose: str) -> None:
    """Refuse if a module is not installed, without importing it.

    Parameters
    ----------
    module : str
        Name to import.
    install : str
        What pip should install.
    purpose : str
        What it is needed for.

    Raises
    ------
    MissingDependencyError

    Examples
    --------
    >>> require("no_such_module", "tridentify[ulog]", "an ULog file")
    Traceback (most recent call last):
    ...
    tridentify.errors.MissingDependencyError: found no module 'no_such_module'; expected it for
    an ULog file; pip install 'tridentify[ulog]'
    """
    try:
        found = find_spec(module) is not None
    except (ImportError, ValueError):
        found = False
    if not found:
        raise MissingDependencyError(
            f"found no module {module!r}; expected it for {purpose}; pip install '{install}'"
        )
