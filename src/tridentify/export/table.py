"""Coefficients as a table for a spreadsheet."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

from tridentify.estimation.answer.estimate import Estimate
from tridentify.writing.files import write_atomically

LEVEL = 0.95
TITLES = ("name", "value", "standard error", "95 % from", "95 % to", "unit")


def write_table(estimate: Estimate, path: str | os.PathLike[str]) -> Path:
    """Write coefficients, standard errors and 95 percent intervals as CSV, all digits of each.

    Parameters
    ----------
    estimate : Estimate
    path : path-like

    Returns
    -------
    Path

    Raises
    ------
    OutputPathError
        The file cannot be written; nothing is left behind.

    Examples
    --------
    >>> import tempfile
    >>> from tridentify import data, identify
    >>> estimate = identify(data.short_period(), (2, 1))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     text = write_table(estimate, Path(folder) / "short_period.csv").read_text()
    >>> text.splitlines()[0]
    'name,value,standard error,95 % from,95 % to,unit'
    """
    return write_atomically(path, table(estimate))


def table(estimate: Estimate) -> str:
    """The text of `write_table`."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(TITLES)
    for one in estimate.parameters.values():
        rows.writerow([one.name, one.value, one.std, *one.interval(LEVEL), one.unit])
    return text.getvalue()
