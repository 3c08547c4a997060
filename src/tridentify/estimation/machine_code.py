"""The compiled functions of an identification, loaded before they are needed.

The first time on a machine they are compiled, which takes seconds; whoever shows progress, or
starts several processes, does that beforehand. The compiler works on one function at a time and
keeps what it made on disk, so that where nothing is there yet another process compiles half of
them meanwhile: first what neither needs of the other, then what is made of both.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from types import ModuleType

BESIDE = (
    "tridentify.models.compiled_whitening",
    "tridentify.models.compiled_regression",
    "tridentify.estimation.likelihood.compiled.roots",
    "tridentify.estimation.likelihood.compiled.scatter",
    "tridentify.numerics.kernels.added_columns",
)
"""What another process compiles of `load_first` while this one comes to the cost, which needs none
of it; the fit needs both."""
THEN_BESIDE = ("tridentify.estimation.search.compiled_reduction",)
"""What another one compiles, as long, while this one makes the fit and what is made of it."""
OTHERS_BESIDE = (
    "tridentify.estimation.posterior.compiled_triangles",
    "tridentify.numerics.kernels.crossing",
    "tridentify.numerics.kernels.long_recursions",
    "tridentify.numerics.kernels.robust_fit",
)
"""The same of what only some fits need."""


@cache
def ready() -> None:
    """`load_first`, once."""
    load_first()


def load_first(
    say: Callable[[str], None] = lambda what: None, *, and_all: bool = False
) -> tuple[ModuleType, ...]:
    """Compile and load what every fit of uniform samples needs.

    Parameters
    ----------
    say : callable, optional
        Is told what comes next.
    and_all : bool
        Whether the other process goes on with what `load_kernels` needs besides.

    Returns
    -------
    tuple of modules
        Whose functions were compiled when they were imported.
    """
    say("filters")
    from tridentify.numerics.kernels import recursions

    new = _is_new(recursions)
    with _beside(BESIDE, new):
        from tridentify.numerics.kernels import polynomials, small_least_squares

        say("models")
        from tridentify.models import compiled_columns, compiled_steps

        say("cost")
        from tridentify.estimation.likelihood.compiled import cost as compiled_cost

        if and_all:
            from tridentify.numerics import incomplete_kernels  # noqa: F401
        say("banks")
    with _beside((*THEN_BESIDE, *(OTHERS_BESIDE if and_all else ())), new):
        from tridentify.estimation.likelihood.compiled import fit as compiled_fit

        say("starts")
        from tridentify.estimation.likelihood.compiled import curvature as compiled_curvature
        from tridentify.estimation.search import compiled_passes, compiled_starts
        from tridentify.numerics.kernels import hats

        say("steps")
        from tridentify.estimation.likelihood.compiled import descent as compiled_descent
        from tridentify.estimation.likelihood.compiled import proposal as compiled_proposal

    from tridentify.estimation.likelihood.compiled import roots as compiled_roots
    from tridentify.estimation.likelihood.compiled import scatter as compiled_scatter
    from tridentify.estimation.search import compiled_beginning, compiled_reduction
    from tridentify.models import compiled_regression, compiled_whitening
    from tridentify.numerics.kernels import (
        added_columns,
        cascades,
        exponentials,
        small_eigenvalues,
        triangles,
    )

    small = polynomials, small_least_squares, small_eigenvalues
    numerics = recursions, *small, cascades, exponentials, triangles
    regression = compiled_regression, compiled_whitening
    models = added_columns, hats, compiled_columns, compiled_steps, *regression
    cost = compiled_cost, compiled_scatter, compiled_fit, compiled_roots, compiled_curvature
    starts = compiled_starts, compiled_reduction, compiled_passes, compiled_beginning
    return *numerics, *models, *cost, *starts, compiled_proposal, compiled_descent


def load_kernels(say: Callable[[str], None] = lambda what: None) -> tuple[ModuleType, ...]:
    """Compile what has not been compiled on this machine yet, and load it.

    That is `load_first` and what only some fits need: coloured noise, missing samples, uneven time,
    inputs that know of the disturbance, a posterior.

    Parameters
    ----------
    say : callable, optional
        Is told what comes next.

    Returns
    -------
    tuple of modules
        Whose functions were compiled when they were imported.
    """
    first = load_first(say, and_all=True)
    from tridentify.numerics import incomplete_kernels
    from tridentify.numerics.kernels import (
        crossing,
        driven,
        long_recursions,
        robust_fit,
        whitening,
    )

    say("posterior")
    from tridentify.estimation.posterior import compiled_triangles

    numerics = incomplete_kernels, crossing, driven, long_recursions, robust_fit, whitening
    return *first, *numerics, compiled_triangles


def _is_new(module: ModuleType) -> bool:
    """Whether a module's functions were compiled just now, and not found on disk."""
    made = (getattr(one, "stats", None) for one in vars(module).values())
    return any(sum(getattr(one, "cache_misses", {}).values()) for one in made)


@contextlib.contextmanager
def _beside(modules: Sequence[str], needed: bool) -> Iterator[None]:
    """Another process compiles modules, and is waited for. Where it cannot, nothing is lost."""
    process = _started(modules) if needed and _processors() > 1 else None
    try:
        yield
        if process is not None:
            process.wait()
    finally:
        if process is not None and process.poll() is None:
            process.kill()


def _started(modules: Sequence[str]) -> subprocess.Popen[bytes] | None:
    if getattr(sys, "frozen", False) or not sys.executable:
        return None
    quiet = subprocess.DEVNULL
    with contextlib.suppress(OSError):
        command = [sys.executable, "-c", f"import {', '.join(modules)}"]
        return subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet)
    return None


def _processors() -> int:
    with contextlib.suppress(AttributeError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
