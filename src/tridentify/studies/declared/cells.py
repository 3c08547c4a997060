"""The cells of a study, and who takes part in each."""

from __future__ import annotations

from tridentify.studies.declared.nouns import DeclaredMethod, DeclaredStudy, StudyCell

Meeting = tuple[StudyCell, DeclaredMethod]


def meetings(study: DeclaredStudy) -> tuple[Meeting, ...]:
    """Every cell with every method that takes part in it, each pair once.

    Parameters
    ----------
    study : DeclaredStudy

    Returns
    -------
    tuple of (StudyCell, DeclaredMethod)
        Cells in the order in which the grids name them, the methods of a cell together.
    """
    found: dict[StudyCell, dict[DeclaredMethod, None]] = {}
    systems = {one.name: one for one in study.systems}
    inputs = {one.name: one for one in study.inputs}
    noises = {one.name: one for one in study.noises}
    methods = {one.name: one for one in study.methods}
    for grid in study.grids:
        for system in grid.systems:
            for signal in grid.inputs:
                for noise in grid.noises:
                    cell = StudyCell(systems[system], inputs[signal], noises[noise])
                    own = found.setdefault(cell, {})
                    own.update(dict.fromkeys(methods[name] for name in grid.methods))
    return tuple((cell, method) for cell, own in found.items() for method in own)


def cells(study: DeclaredStudy) -> tuple[StudyCell, ...]:
    """Every cell once.

    Parameters
    ----------
    study : DeclaredStudy
    """
    return tuple(dict.fromkeys(cell for cell, _ in meetings(study)))


def draws_of(study: DeclaredStudy, cell: StudyCell) -> int:
    """How many noise draws a cell has: one where there is no noise."""
    return 1 if cell.noise.none else study.draws
