"""Pictures of a study's result, as files."""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import Any

from tridentify.plots.study_fig5 import plot_step_responses
from tridentify.plots.study_fig6 import plot_noise_levels
from tridentify.studies.aircraft_result import AircraftResult
from tridentify.studies.base import StudyResult
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
        (after its Fig. 6); none for a result that has no pictures.

    Raises
    ------
    OutputPathError
        The folder or a file cannot be written.
    """
    if not isinstance(result, AircraftResult):
        return ()
    pictures = {
        "aircraft-step-response": plot_step_responses(result)[0],
        "aircraft-noise-levels": plot_noise_levels(result)[0],
    }
    written = []
    for stem, ax in pictures.items():
        buffer = io.BytesIO()
        figure: Any = ax.figure
        figure.savefig(buffer, format="svg")
        written.append(write_atomically(Path(folder) / f"{stem}.svg", buffer.getvalue()))
    return tuple(written)
