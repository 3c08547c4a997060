"""MATLAB files of version 5 to 7, by scipy; `matlab_tree` says what is found in them.

scipy unpacks all variables at once, so what they declare to unpack to is added up before.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tridentify.record.formats.apart.isolation import check_size
from tridentify.record.formats.matlab.matlab_tree import (
    DEEPEST,
    MOST_ELEMENTS,
    MatlabFile,
    Node,
    Numbers,
    Opaque,
)

HEADER = 128
"""Bytes before the first variable; the last two tell the order of bytes."""

TAG = 8
"""Bytes that say what follows, and its length."""

COMPRESSED = 15
"""Kind of a variable that is packed by zlib; its own tag is the beginning of what is packed."""


def open_file(path: Path) -> MatlabFile:
    """Open a MATLAB file of version 5 to 7.

    Parameters
    ----------
    path : Path

    Returns
    -------
    MatlabFile

    Raises
    ------
    FileTooLargeError
    """
    check_size(declared_size(path), path)
    from scipy.io import loadmat

    variables = loadmat(path, squeeze_me=False, chars_as_strings=True, struct_as_record=True)
    return MatlabFile(
        path, {name: _node(value, 0) for name, value in variables.items() if name[:2] != "__"}
    )


def declared_size(path: Path) -> int:
    """Add up the bytes that the variables unpack to, by what the file says.

    Parameters
    ----------
    path : Path

    Returns
    -------
    int
        What a packed variable declares, what another one takes in the file [bytes].
    """
    with path.open("rb") as stream:
        return sum(_sizes(stream, os.fstat(stream.fileno()).st_size))


def _sizes(stream: BinaryIO, end: int) -> Iterator[int]:
    order = "big" if stream.read(HEADER)[-2:] == b"MI" else "little"
    place = HEADER
    while place + TAG < end:
        stream.seek(place)
        kind, size = _tag(stream.read(TAG), order)
        if kind != COMPRESSED:
            yield min(size, end - place)
        else:
            try:
                # a packed tag is longer than the tag by a few bytes at most
                opening = zlib.decompressobj().decompress(stream.read(64), TAG)
            except zlib.error:
                return  # the reader meets it too
            yield _tag(opening, order)[1]
        place += TAG + size


def _tag(data: bytes, order: Any) -> tuple[int, int]:
    return int.from_bytes(data[:4], order), int.from_bytes(data[4:TAG], order)


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
