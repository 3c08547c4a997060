"""Estimates and models as JSON."""

from __future__ import annotations

import json
import os
from pathlib import Path

from tridentify.estimate import Estimate
from tridentify.files import write_atomically
from tridentify.transfer_function import TransferFunction

SCHEMA = 1


def write_json(model: TransferFunction | Estimate, path: str | os.PathLike[str]) -> Path:
    """Write an estimate as `Estimate.save` does, or the coefficients of a model.

    Parameters
    ----------
    model : TransferFunction or Estimate
    path : path-like

    Returns
    -------
    Path

    Raises
    ------
    OutputPathError
        The file cannot be written; nothing is left behind.

    Notes
    -----
    A model's file holds ``num``, ``den`` ``[output][input]`` in descending powers, ``delay`` [s]
    and the names of the channels: what `TransferFunction.from_dict` takes, and ``model_schema``.

    Examples
    --------
    >>> import tempfile
    >>> model = TransferFunction([2.0], [1.0, 2.0])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     content = json.loads(write_json(model, Path(folder) / "model.json").read_text())
    >>> content["den"]
    [[[1.0, 2.0]]]
    """
    if isinstance(model, Estimate):
        return model.save(path)
    content = {"model_schema": SCHEMA, **model.to_dict()}
    return write_atomically(path, json.dumps(content, indent=1, allow_nan=False) + "\n")
