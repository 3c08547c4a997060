"""MATLAB files of version 5 to 7, by scipy; `matlab_tree` says what is found in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tridentify.formats.matlab_tree import DEEPEST, MOST_ELEMENTS, MatlabFile, Node, Numbers, Opaque

__all__ = ["open_file"]


def open_file(path: Path) -> MatlabFile:
    """Open a MATLAB file of version 5 to 7.

    Parameters
    ----------
    path : Path

    Returns
    -------
    MatlabFile
    """
    from scipy.io import loadmat

    variables = loadmat(path, squeeze_me=False, chars_as_strings=True, struct_as_record=True)
    return MatlabFile(
        path, {name: _node(value, 0) for name, value in variables.items() if name[:2] != "__"}
    )


def _node(value: Any, depth: int) -> Node:
    from scipy.io.matlab import MatlabFunction, MatlabOpaque

    if depth > DEEPEST or isinstance(value, MatlabFunction):
        return Opaque("function" if depth <= DEEPEST else "nested too deeply")
    if isinstance(value, MatlabOpaque):
        names = value.dtype.names or ()
        kind = value["s2"].ravel()[0] if "s2" in names and value.size else b"object"
        return Opaque(kind.decode("latin-1") if isinstance(kind, bytes) else str(kind))
    if not isinstance(value, np.ndarray):
        return Opaque(type(value).__name__)
    if value.dtype.names:
        structs = [_struct(element, depth) for element in value.ravel("F")[:MOST_ELEMENTS]]
        return structs[0] if value.size == 1 else structs
    if value.dtype.kind == "O":
        return [_node(element, depth + 1) for element in value.ravel("F")[:MOST_ELEMENTS]]
    if value.dtype.kind in "US":
        return "".join(str(text) for text in value.ravel()[:1])
    return Numbers(value.shape, lambda: value)


def _struct(element: Any, depth: int) -> Node:
    return {str(name): _node(element[name], depth + 1) for name in element.dtype.names}
