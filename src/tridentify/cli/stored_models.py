"""Where a stored model is: a file, or the folder of ``identify --out``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tridentify.errors import OptionError, shown

MODEL = "model.json"
"""What ``identify --out`` calls the model in its folder."""


def in_folder(place: Path) -> Path:
    """The model in a folder, or the file itself."""
    return place / MODEL if place.is_dir() else place


def model_file(place: Path, how: str, others: Sequence[Path] = ()) -> Path:
    """The file of a model that was named by itself or by its folder.

    Parameters
    ----------
    place : path
        What stands where the model belongs.
    how : str
        The order of the arguments, for the message.
    others : sequence of path
        What stands where records or results belong.

    Returns
    -------
    path

    Raises
    ------
    OptionError
        The folder holds no model, or something else stands in the model's place.
    """
    file = in_folder(place)
    if file != place and not file.is_file():
        raise OptionError(
            f"found no {MODEL} in the folder {shown(str(place))}; expected one that identify --out "
            f"wrote; write {how}"
        )
    if file.suffix.lower() == ".json" or (file.is_file() and _is_json(file)):
        return file
    swapped = any(in_folder(other).suffix.lower() == ".json" for other in others)
    if swapped or file.is_file():
        hint = " (FILE and MODEL are swapped)" if swapped else ""
        raise OptionError(
            f"found {shown(str(place))} where the model belongs{hint}; expected {MODEL} or the "
            f"folder of identify --out; write {how}"
        )
    return file


def _is_json(file: Path) -> bool:
    """Whether a file begins as a JSON object does, whatever its name."""
    try:
        with file.open("rb") as stream:
            return stream.read(64).lstrip().startswith(b"{")
    except OSError:
        return True  # whoever reads it says why it cannot be read
