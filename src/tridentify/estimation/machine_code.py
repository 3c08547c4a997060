"""The compiled functions of an identification, loaded before they are needed.

The first time on a machine they are compiled, which takes seconds; whoever shows progress, or
starts several processes, does that beforehand. The compiler works on one function at a time and
keeps what it made on disk, so that where nothing is there yet another process compiles half of
them meanwhile.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import cache
from types import ModuleType

BESIDE = (
    "tridentify.models.compiled_regression",
    "tridentify.models.compiled_whitening",
    "tridentify.estimation.posterior.compiled_triangles",
    "tridentify.numerics.kernels.added_columns",
    "tridentify.numerics.kernels.crossing",
    "tridentify.numerics.kernels.long_recursions",
)
"""What the other process compiles: as much as is left, and of no use to that."""


@cache
def ready() -> None:
    """`load_kernels`, once."""
    load_kernels()


def load_kernels(say: Callable[[str], None] | None = None) -> tuple[ModuleType, ...]:
    """Compile what has not been compiled on this machine yet, and load it.

    Parameters
    ----------
    say : callable, optional
        Is told what comes next.

    Returns
    -------
    tuple of modules
        Whose functions were compiled when they were imported.
    """
    tell = say or (lambda what: None)
    tell("filters")
    from tridentify.numerics.kernels import recursions

    with _beside(_is_new(recursions)):
        from tridentify.numerics import incomplete_kernels
        from tridentify.numerics.kernels import driven, polynomials, small_least_squares

        tell("models")
        from tridentify.models import compiled_columns, compiled_steps

        tell("cost")
        from tridentify.estimation.likelihood import compiled_cost, compiled_scatter

        tell("banks")
    from tridentify.models import compiled_regression, compiled_whitening
    from tridentify.numerics.kernels import (
        added_columns,
        cascades,
        crossing,
        exponentials,
        long_recursions,
        triangles,
        whitening,
    )

    tell("steps")
    from tridentify.estimation.likelihood import compiled_descent

    tell("starts")
    from tridentify.estimation.search import compiled_starts

    tell("posterior")
    from tridentify.estimation.posterior import compiled_triangles

    numerics = (
        added_columns,
        crossing,
        driven,
        recursions,
        long_recursions,
        incomplete_kernels,
        small_least_squares,
    )
    banks = cascades, exponentials, triangles, whitening, polynomials
    models = compiled_columns, compiled_regression, compiled_steps, compiled_whitening
    likelihood = compiled_cost, compiled_scatter, compiled_descent
    return *numerics, *banks, *models, *likelihood, compiled_starts, compiled_triangles


def _is_new(module: ModuleType) -> bool:
    """Whether a module's functions were compiled just now, and not found on disk."""
    made = (getattr(one, "stats", None) for one in vars(module).values())
    return any(sum(getattr(one, "cache_misses", {}).values()) for one in made)


@contextlib.contextmanager
def _beside(needed: bool) -> Iterator[None]:
    """Another process compiles `BESIDE`, and is waited for. Where it cannot, nothing is lost."""
    process = _started() if needed and _processors() > 1 else None
    try:
        yield
        if process is not None:
            process.wait()
    finally:
        if process is not None and process.poll() is None:
            process.kill()


def _started() -> subprocess.Popen[bytes] | None:
    if getattr(sys, "frozen", False) or not sys.executable:
        return None
    quiet = subprocess.DEVNULL
    with contextlib.suppress(OSError):
        command = [sys.executable, "-c", f"import {', '.join(BESIDE)}"]
        return subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)
    return None


def _processors() -> int:
    with contextlib.suppress(AttributeError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
