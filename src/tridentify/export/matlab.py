"""Models and estimates for MATLAB and Octave: a version 5 file, or a script that can be read.

Both hold one structure ``model`` with the fields

    num, den      cell arrays {output, input} of row vectors, descending powers of s
    ioDelay       delays [s], outputs by inputs
    Ts            0: continuous time
    InputName, OutputName, InputUnit, OutputUnit
    names, theta, cov, std, NoiseVariance     of an estimate: coefficients and what is known of them

which is what ``tf(model.num, model.den)`` takes. The script names every coefficient of an estimate
and builds the polynomials of these names, so that it can be read and changed; where the function
``tf`` exists it makes ``sys`` as well. It is written for both languages and needs no toolbox.
"""

from __future__ import annotations

import io
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
from numpy.typing import NDArray

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.export.words import in_matlab_comment, matlab_string
from tridentify.numerics.arrays import Array
from tridentify.transfer_function import TransferFunction
from tridentify.writing.files import write_atomically
from tridentify.writing.layout import format_std

HEADER = b"MATLAB 5.0 MAT-file, made by tridentify"
LONGEST_NAME = 63
"""`namelengthmax` of MATLAB."""


def write_matlab(model: TransferFunction | Estimate, path: str | os.PathLike[str]) -> Path:
    """Write a model or an estimate for MATLAB or Octave.

    Parameters
    ----------
    model : TransferFunction or Estimate
    path : path-like
        ``.mat`` for a version 5 file, ``.m`` for a script.

    Returns
    -------
    Path

    Raises
    ------
    OptionError
        The name ends in neither, or that of a script cannot be called from MATLAB.
    OutputPathError
        The file cannot be written; nothing is left behind.

    Examples
    --------
    >>> import tempfile
    >>> from scipy.io import loadmat
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = write_matlab(TransferFunction([2.0], [1.0, 2.0]), Path(folder) / "model.mat")
    ...     loadmat(path)["model"]["den"][0, 0][0, 0]
    array([[1., 2.]])
    """
    target = Path(path)
    if target.suffix.lower() == ".mat":
        return write_atomically(target, matlab_file(model))
    if target.suffix.lower() == ".m":
        if not re.fullmatch(r"[A-Za-z]\w*", target.stem, flags=re.ASCII):
            raise OptionError(
                f"found a script called {shown(target.name)}; expected letters, digits and "
                "underscores, a letter first, since MATLAB runs it by this name; rename it"
            )
        return write_atomically(target, matlab_script(model))
    raise OptionError(
        f"found the file name {shown(target.name)}; expected one that ends in .mat or .m; rename it"
    )


def matlab_file(model: TransferFunction | Estimate) -> bytes:
    """The content of a version 5 file; the same model gives the same bytes."""
    stream = io.BytesIO()
    writer: Any = scipy.io.savemat  # its stubs know paths only
    writer(stream, {"model": _fields(model)}, format="5", long_field_names=True)
    content = stream.getvalue()
    # in place of 116 bytes of text with the date, so that the same model gives the same bytes
    return HEADER.ljust(116) + content[116:]


def _fields(model: TransferFunction | Estimate) -> dict[str, Any]:
    plant = model.model if isinstance(model, Estimate) else model
    units = dict(model.units) if isinstance(model, Estimate) else {}
    fields: dict[str, Any] = {
        "num": _cells(plant.num),
        "den": _cells(plant.den),
        "ioDelay": plant.delay,
        "Ts": 0.0,
        "InputName": _texts(plant.input_names),
        "OutputName": _texts(plant.output_names),
        "InputUnit": _texts(tuple(units.get(name, "") for name in plant.input_names)),
        "OutputUnit": _texts(tuple(units.get(name, "") for name in plant.output_names)),
    }
    if isinstance(model, Estimate):
        fields |= {
            "names": _texts(model.names),
            "theta": model.theta[:, None],
            "cov": model.cov,
            "std": model.std[:, None],
            "NoiseVariance": model.noise_variance[:, None],
        }
    return fields


def _cells(polynomials: tuple[tuple[Array, ...], ...]) -> NDArray[np.object_]:
    found = np.empty((len(polynomials), len(polynomials[0])), dtype=object)
    for i, row in enumerate(polynomials):
        for j, item in enumerate(row):
            found[i, j] = np.atleast_2d(item)
    return found


def _texts(names: tuple[str, ...]) -> NDArray[np.object_]:
    found = np.empty((len(names), 1), dtype=object)
    found[:, 0] = [in_matlab_comment(name) for name in names]  # a lone surrogate cannot be encoded
    return found


def matlab_script(model: TransferFunction | Estimate) -> str:
    """The text of a script that makes ``model``."""
    plant = model.model if isinstance(model, Estimate) else model
    lines = ["% A continuous-time model, made by tridentify; powers of s descend.", ""]
    if isinstance(model, Estimate):
        named = _named(model)
        lines += _coefficients(model, named)
        num, den = _by_name(model, named)
    else:
        num = [[_numbers(item) for item in row] for row in plant.num]
        den = [[_numbers(item) for item in row] for row in plant.den]
    fields = _fields(model)
    lines += [
        "model = struct();",
        f"model.num = {_cell_text(num)};",
        f"model.den = {_cell_text(den)};",
        f"model.ioDelay = {_matrix(plant.delay)}; % [s], outputs by inputs",
        "model.Ts = 0; % continuous time",
    ]
    for key in ("InputName", "OutputName", "InputUnit", "OutputUnit"):
        lines += [f"model.{key} = {_text_column(fields[key])};"]
    if isinstance(model, Estimate):
        lines += [
            f"model.names = {_text_column(fields['names'])};",
            f"model.theta = [{'; '.join(named)}];",
            f"model.cov = {_matrix(model.cov)};",
            "model.std = sqrt(diag(model.cov));",
            f"model.NoiseVariance = {_matrix(model.noise_variance[:, None])};",
        ]
    return "\n".join([*lines, "", *_SYSTEM, ""])


_SYSTEM = (
    "if exist('tf') % the control toolbox or package is there",
    "  sys = tf(model.num, model.den);",
    "  sys.InputName = model.InputName;",
    "  sys.OutputName = model.OutputName;",
    "  if any(model.ioDelay(:))",
    "    try",
    "      sys.IODelay = model.ioDelay;",
    "    catch",
    "      warning('sys is without the delays of model.ioDelay: tf cannot hold them here');",
    "    end",
    "  end",
    "end",
)


def _named(estimate: Estimate) -> list[str]:
    """A variable for each coefficient, all different."""
    found: list[str] = []
    for name in estimate.names:
        made = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")[: LONGEST_NAME - 4]
        other, k = made, 2
        while other in found:
            other, k = f"{made}_{k}", k + 1
        found.append(other)
    return found


def _coefficients(estimate: Estimate, named: list[str]) -> list[str]:
    lines = []
    for name, p in zip(named, estimate.parameters.values(), strict=True):
        std = f"+- {format_std(p.std)}" if np.isfinite(p.std) else "+- unknown"
        unit = f" {p.unit}" if p.unit else ""
        remark = in_matlab_comment(f"{std}{unit} ({p.name})")
        lines.append(f"{name} = {p.value:.17g}; % {remark}")
    return [*lines, ""]


def _by_name(estimate: Estimate, named: list[str]) -> tuple[list[list[str]], list[list[str]]]:
    """Polynomials in terms of the variables."""
    plant = estimate.model
    positions = np.arange(1.0, len(named) + 1.0)
    num, den = estimate.structure.split(positions, plant.n_outputs, plant.n_inputs)

    def text(places: Array, first: str = "") -> str:
        words = [named[int(place) - 1] for place in places]
        return "[" + " ".join([first, *words] if first else words) + "]"

    return (
        [[text(item) for item in row] for row in num],
        [[text(item[1:], "1") for item in row] for row in den],
    )


def _numbers(values: Array) -> str:
    return "[" + " ".join(f"{value:.17g}" for value in values) + "]"


def _matrix(values: Array) -> str:
    rows = (" ".join(_number(value) for value in row) for row in values)
    return "[" + "; ".join(rows) + "]"


def _number(value: float) -> str:
    return f"{value:.17g}" if np.isfinite(value) else "NaN"


def _cell_text(rows: list[list[str]]) -> str:
    return "{" + "; ".join(", ".join(row) for row in rows) + "}"


def _text_column(texts: NDArray[np.object_]) -> str:
    return "{" + "; ".join(matlab_string(str(text)) for text in texts[:, 0]) + "}"
