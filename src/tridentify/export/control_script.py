"""A model as a script for python-control: nothing but numbers, so that it can be read and changed.

In Python itself `TransferFunction.to_control` gives the same object without a file.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.transfer_function import TransferFunction
from tridentify.writing.files import write_atomically


def write_control_script(model: TransferFunction | Estimate, path: str | os.PathLike[str]) -> Path:
    """Write a Python script that makes ``model``, a `control.TransferFunction`.

    Parameters
    ----------
    model : TransferFunction or Estimate
        Dead times are no part of a transfer function there; the script holds them [s] in
        ``delay[output][input]``.
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
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "plant.py"
    ...     text = write_control_script(TransferFunction([2.0], [1.0, 2.0]), path).read_text()
    >>> [line for line in text.splitlines() if line.startswith("den")]
    ['den = [[[1.0, 2.0]]]']
    """
    return write_atomically(path, control_script(model))


def control_script(model: TransferFunction | Estimate) -> str:
    """The text of `write_control_script`."""
    plant = model.model if isinstance(model, Estimate) else model
    num, den = (
        [[list(map(float, cell)) for cell in row] for row in of] for of in (plant.num, plant.den)
    )
    lines = [
        '"""A continuous-time model for python-control; powers of s descend."""',
        "",
        "import control",
        "",
        f"num = {num!r}",
        f"den = {den!r}",
        f"delay = {np.asarray(plant.delay, dtype=float).tolist()!r}  # seconds, not in the model",
        "model = control.TransferFunction(num, den)",
        f"model.input_labels = {list(plant.input_names)!a}",
        f"model.output_labels = {list(plant.output_names)!a}",
        "",
    ]
    return "\n".join(lines)
