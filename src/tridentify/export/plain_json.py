"""Estimates and models as JSON."""

from __future__ import annotations

import json
import os
from pathlib import Path

from tridentify.errors import DataError, StructureError, shown
from tridentify.estimation.answer.encoding import document_text, one_line, plain_model
from tridentify.estimation.answer.encoding import read_json as read_document
from tridentify.estimation.answer.estimate import SCHEMA as ESTIMATE_SCHEMA
from tridentify.estimation.answer.estimate import Estimate
from tridentify.transfer_function import TransferFunction
from tridentify.writing.files import write_atomically

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
    return (
        model.save(path)
        if isinstance(model, Estimate)
        else write_atomically(path, json_text(model))
    )


def json_text(model: TransferFunction | Estimate) -> str:
    """The text that `write_json` writes."""
    if isinstance(model, Estimate):
        return document_text("schema", ESTIMATE_SCHEMA, model)
    content = {"model_schema": SCHEMA, **model.to_dict()}
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def read_json(path: str | os.PathLike[str]) -> TransferFunction | Estimate:
    """Read what `write_json` or `Estimate.save` wrote.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    TransferFunction or Estimate

    Raises
    ------
    UnreadableFileError
        There is no such file, or it is not JSON.
    DataError
        It holds neither, is damaged, or of another schema version.
    """
    try:
        content = read_document(path)
    except (OSError, ValueError):
        return Estimate.load(path)  # which says what is the matter
    if not isinstance(content, dict) or "model_schema" not in content:
        return Estimate.load(path)
    schema = content.pop("model_schema")
    if type(schema) is not int or schema != SCHEMA:
        raise DataError(
            f"found model schema {shown(schema)} in {path}; expected {SCHEMA}; write the model "
            "again with this version"
        )
    try:
        return plain_model(content)
    except (StructureError, ValueError) as error:
        raise DataError(
            f"found a damaged model in {path} ({one_line(error)}); expected what write_json wrote; "
            "write it again"
        ) from error
