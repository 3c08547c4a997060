"""``tridentify warm``: compile what is compiled once per machine, before it is needed."""

from __future__ import annotations

from tridentify.cli.terminal import Activity, paragraph, show


def warm() -> None:
    """Compile the loops that are machine code, and keep them on disk.

    Every command does this when it needs them, once per machine; several processes that start at
    the same time would each wait for it.
    """
    from tridentify.estimation.machine_code import load_kernels

    with Activity() as activity:
        loaded = load_kernels(lambda what: activity.stage(f"compiling: {what}"))
        activity.stage("compiling: on-line estimators")
        from tridentify.online.kernels import blocks, equation, gradient, run

        loaded = *loaded, blocks, equation, gradient, run
    show(
        paragraph(f"Compiled functions are ready ({len(loaded)} files): later commands load them.")
    )
