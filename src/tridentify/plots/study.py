"""Pictures of a study's result, as files."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tridentify.plots.study_cells import plot_study_cells, shown_cells
from tridentify.plots.study_fig5 import plot_step_responses
from tridentify.plots.study_fig6 import plot_noise_levels
from tridentify.plots.style import Panels
from tridentify.studies.aircraft_result import AircraftResult
from tridentify.studies.base import StudyResult
from tridentify.studies.declared.result import DeclaredResult
from tridentify.writing.files import write_atomically
from tridentify.writing.views import unseen


@unseen()
def save_study_figures(result: StudyResult, folder: str | os.PathLike[str]) -> tuple[Path, ...]:
    """Draw what a study found, and write every picture to a file.

    Parameters
    ----------
    result : StudyResult
    folder : path-like
        Made if it does not exist.

    Returns
    -------
    tuple of Path
        ``aircraft-step-response.svg`` (after the paper's Fig. 5) and ``aircraft-noise-levels.svg``
        (after its Fig. 6) of the aircraft; ``cells.svg`` of a declared study that has noise; none
        for a result that has no pictures.

    Raises
    ------
    OutputPathError
        The folder or a file cannot be written.
    """
    written = []
    for stem, drawn in _pictures(result).items():
        buffer = io.BytesIO()
        figure: Any = drawn.figure
        figure.savefig(buffer, format="svg")
        written.append(write_atomically(Path(folder) / f"{stem}.svg", buffer.getvalue()))
    return tuple(written)


def _pictures(result: StudyResult) -> Mapping[str, Panels]:
    if isinstance(result, AircraftResult):
        return {
            "aircraft-step-response": plot_step_responses(result),
            "aircraft-noise-levels": plot_noise_levels(result),
        }
    if isinstance(result, DeclaredResult) and shown_cells(result):
        return {"cells": plot_study_cells(result)}
    return {}
