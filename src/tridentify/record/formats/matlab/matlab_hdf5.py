"""MATLAB files of version 7.3, which are HDF5, and plain HDF5 files, by h5py.

Only what lies in the file itself is followed: a link to another file, samples stored in another
file and virtual data sets are refused, since a forged file could read others through them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tridentify.record.formats.matlab.matlab_tree import (
    DEEPEST,
    MOST_ELEMENTS,
    MatlabFile,
    Node,
    Numbers,
    Opaque,
)

NUMERIC = frozenset({"double", "single", "logical", "int8", "int16", "int32", "int64"}) | {
    *("uint8", "uint16", "uint32", "uint64")
}


def open_file(path: Path) -> MatlabFile:
    """Open a MATLAB file of version 7.3.

    Parameters
    ----------
    path : Path

    Returns
    -------
    MatlabFile
    """
    import h5py

    file = h5py.File(path, "r")
    return MatlabFile(path, _group(file, file, 0))


def _group(file: Any, group: Any, depth: int) -> dict[str, Node]:
    import h5py

    nodes: dict[str, Node] = {}
    for name in group:
        if name.startswith("#"):
            continue
        if isinstance(group.get(name, getlink=True), h5py.HardLink):
            nodes[name] = _node(file, group[name], depth + 1)
        else:
            nodes[name] = Opaque("link to elsewhere")
    return nodes


def _node(file: Any, item: Any, depth: int) -> Node:
    import h5py

    if depth > DEEPEST:
        return Opaque("nested too deeply")
    kind = item.attrs.get("MATLAB_class", b"")
    kind = kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)
    if isinstance(item, h5py.Group):
        return _structs(_group(file, item, depth)) if kind in ("", "struct") else Opaque(kind)
    if not isinstance(item, h5py.Dataset) or item.shape is None:
        return Opaque("no data")
    if item.external or item.is_virtual:
        return Opaque("data stored elsewhere")
    if item.attrs.get("MATLAB_empty", 0):
        return "" if kind == "char" else []
    if kind == "char":
        return _characters(item)
    if item.dtype.kind == "O" and h5py.check_ref_dtype(item.dtype) is h5py.Reference:
        if kind not in ("", "cell", "struct"):
            return Opaque(kind)
        chosen = item[()].ravel()[:MOST_ELEMENTS] if item.size <= MOST_ELEMENTS else []
        return [_node(file, file[reference], depth + 1) for reference in chosen if reference]
    if (kind and kind not in NUMERIC) or item.dtype.kind not in "fiub":
        return Opaque(kind or str(item.dtype))
    if not kind:
        return Numbers(tuple(item.shape), lambda: np.asarray(item[()]))
    return Numbers(tuple(reversed(item.shape)), lambda: np.asarray(item[()]).T)


def _structs(fields: dict[str, Node]) -> Node:
    """Turn a group whose fields are all lists of one length, an array of structs, inside out."""
    lengths = {len(value) if isinstance(value, list) else -1 for value in fields.values()}
    if len(lengths) != 1 or min(lengths) < 2:
        return fields
    count = lengths.pop()
    return [
        {name: value[k] for name, value in fields.items() if isinstance(value, list)}
        for k in range(count)
    ]


def _characters(item: Any) -> str:
    if item.size > 10_000 or item.dtype.kind != "u":
        return ""
    return "".join(map(chr, np.asarray(item[()]).ravel()))
