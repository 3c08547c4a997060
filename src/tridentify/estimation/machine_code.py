"""The compiled functions of an identification, loaded before they are needed.

The first time on a machine they are compiled, which takes seconds; whoever shows progress, or
starts several processes, does that beforehand.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType


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
    from tridentify.numerics.kernels import crossing, driven, long_recursions, recursions

    tell("noise")
    from tridentify.numerics import incomplete_kernels

    tell("models")
    from tridentify.models import (
        compiled_columns,
        compiled_regression,
        compiled_steps,
        compiled_whitening,
    )
    from tridentify.numerics.kernels import (
        cascades,
        exponentials,
        polynomials,
        small_least_squares,
        triangles,
        whitening,
    )

    tell("cost")
    from tridentify.estimation.likelihood import compiled_cost

    tell("starts")
    from tridentify.estimation.search import compiled_starts

    tell("posterior")
    from tridentify.estimation.posterior import compiled_triangles

    numerics = (
        crossing,
        driven,
        recursions,
        long_recursions,
        incomplete_kernels,
        small_least_squares,
    )
    banks = cascades, exponentials, triangles, whitening, polynomials
    models = compiled_columns, compiled_regression, compiled_steps, compiled_whitening
    return *numerics, *banks, *models, compiled_cost, compiled_starts, compiled_triangles
