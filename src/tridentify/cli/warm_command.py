"""``tridentify warm``: compile what is compiled once per machine, before it is needed."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from tridentify.cli.terminal import Activity, paragraph, show


def warm() -> None:
    """Compile the loops that are machine code, and keep them on disk.

    Every command does this when it needs them, once per machine; several processes that start at
    the same time would each wait for it.
    """
    from tridentify.estimation.machine_code import load_kernels
    from tridentify.online import kernels

    with Activity() as activity:
        load_kernels(lambda what: activity.stage(f"compiling: {what}"))
        activity.stage("compiling: on-line estimators")
        for module in iter_modules(kernels.__path__, f"{kernels.__name__}."):
            import_module(module.name)
    show(paragraph("Compiled functions are ready: later commands load them from disk."))
