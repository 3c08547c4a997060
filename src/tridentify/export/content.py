"""What the writers of this folder write, as bytes: for an archive, a data base or a web answer.

With them the short formats: coefficients as a table for a spreadsheet, estimates and models as
JSON, a model as a script for python-control (nothing but numbers, so that it can be read and
changed; in Python itself `TransferFunction.to_control` gives the same object without a file).
"""

from __future__ import annotations

import csv
import io
import json
import os
from pathlib import Path

import numpy as np

from tridentify.errors import DataError, OptionError, StructureError, shown
from tridentify.estimation.answer.encoding import document_text, one_line, plain_model
from tridentify.estimation.answer.encoding import read_json as read_document
from tridentify.estimation.answer.estimate import SCHEMA as ESTIMATE_SCHEMA
from tridentify.estimation.answer.estimate import Estimate
from tridentify.export.c_header import c_header, identifier
from tridentify.export.matlab import matlab_file, matlab_script
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


ENDINGS = (".json", ".mat", ".m", ".h", ".py", ".csv")


def to_bytes(
    model: TransferFunction | Estimate,
    ending: str,
    *,
    dt: float | None = None,
    name: str = "model",
) -> bytes:
    """A model as the content of a file for another program.

    Parameters
    ----------
    model : TransferFunction or Estimate
    ending : {".json", ".mat", ".m", ".h", ".py", ".csv"}
        As of `write_json`, `write_matlab` (two), `write_c_header`, `write_control_script` and
        `write_table`, the last of an estimate only.
    dt : float, optional
        Sampling interval of the filter in C [s].
    name : str
        What names in the C header begin with, made an identifier.

    Returns
    -------
    bytes
        Text is UTF-8.

    Raises
    ------
    OptionError
        There is no such ending, or no `dt` for a filter in C, or no estimate for a table.

    Examples
    --------
    >>> to_bytes(TransferFunction([2.0], [1.0, 2.0]), ".h", dt=0.01).splitlines()[-1]
    b'#endif /* MODEL_H */'
    """
    if ending == ".mat":
        return matlab_file(model)
    if ending == ".m":
        return matlab_script(model).encode()
    if ending == ".json":
        return json_text(model).encode()
    if ending == ".py":
        return control_script(model).encode()
    if ending == ".h":
        if dt is None:
            raise OptionError(
                "found no dt for a filter in C; expected the sampling interval at which it will "
                "run; give for example dt=0.01"
            )
        return c_header(model, dt, identifier(None, Path(name))).encode()
    if ending == ".csv":
        if not isinstance(model, Estimate):
            raise OptionError(
                "found a model without standard errors for a table; expected an estimate; write "
                ".json instead"
            )
        return table(model).encode()
    raise OptionError.found("the ending ", ending, f"one of {', '.join(ENDINGS)}", "choose one")
