"""The compiled functions of an identification, loaded before they are needed.

The first time on a machine they are compiled, which takes seconds; whoever shows progress, or
starts several processes, does that beforehand.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

KERNELS = {
    "filters": (
        "tridentify.numerics.kernels.recursions",
        "tridentify.numerics.kernels.crossing",
        "tridentify.numerics.kernels.driven",
    ),
    "noise": ("tridentify.numerics.incomplete_kernels",),
    "models": (
        "tridentify.numerics.kernels.cascades",
        "tridentify.numerics.kernels.polynomials",
        "tridentify.models.compiled_steps",
    ),
    "cost": ("tridentify.estimation.likelihood.compiled_cost",),
}
"""Modules whose functions are compiled when they are imported, by what they are for."""


def load_kernels(say: Callable[[str], None] | None = None) -> None:
    """Compile what has not been compiled on this machine yet, and load it.

    Parameters
    ----------
    say : callable, optional
        Is told what comes next.
    """
    for name, modules in KERNELS.items():
        if say is not None:
            say(name)
        for module in modules:
            import_module(module)
