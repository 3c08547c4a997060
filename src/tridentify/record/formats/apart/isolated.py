"""The child side of `record.formats.apart.isolation`: open one file, answer until the pipe ends."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from tridentify.errors import DataWarning, TridentifyError
from tridentify.numerics.arrays import Array
from tridentify.record.formats.channels import OpenFile


def serve() -> None:
    """Answer the requests on standard input, on what was standard output.

    Whatever a library prints goes to the null device.
    """
    requests = sys.stdin.buffer
    answers = silenced()
    warnings.simplefilter("ignore")
    warnings.simplefilter("always", DataWarning)
    first = json.loads(requests.readline())
    limit_memory(first["memory"])
    # a polars panic is no Exception, and nothing may leave this process but an answer
    try:
        path = Path(os.fsdecode(first["path"].encode("latin-1")))
        with warnings.catch_warnings(record=True) as caught:
            source = open_here(first["module"], path)
        listing = [dataclasses.asdict(channel) for channel in source.channels]
        _answer(answers, {"channels": listing, "said": _said(caught)}, ())
        for line in requests:
            with warnings.catch_warnings(record=True) as caught:
                arrays = _arrays(source, json.loads(line))
            _answer(answers, {"said": _said(caught)}, arrays)
    except BaseException as error:
        _answer(answers, _described(error), ())


def _said(caught: Sequence[warnings.WarningMessage]) -> list[str]:
    return [str(item.message) for item in caught if issubclass(item.category, DataWarning)]


def silenced() -> BinaryIO:
    """What was standard output; what libraries print goes to the null device from now on."""
    answers = os.fdopen(os.dup(1), "wb")
    null = os.open(os.devnull, os.O_RDWR)
    for number in (1, 2):
        os.dup2(null, number)
    return answers


def open_here(module: str, path: Path) -> OpenFile:
    """Open a file with the reader of a module, in this process."""
    source: OpenFile = import_module(module).open_file(path)
    return source


def _arrays(source: OpenFile, request: dict[str, Any]) -> Sequence[Array]:
    if "read" in request:
        return source.read(request["read"])
    times = source.instants(request["instants"])
    return [] if times is None else [times]


def _answer(stream: BinaryIO, header: dict[str, Any], arrays: Sequence[Array]) -> None:
    sound = [np.ascontiguousarray(values, dtype="<f8").ravel() for values in arrays]
    line = json.dumps({**header, "arrays": [len(values) for values in sound]})
    stream.write(line.encode() + b"\n")
    for values in sound:
        stream.write(values.data if len(values) else b"")
    stream.flush()


def _described(error: BaseException) -> dict[str, str]:
    known = isinstance(error, TridentifyError | MemoryError | ImportError)
    text = " ".join(str(error).split()) or type(error).__name__
    kind = "ImportError" if isinstance(error, ModuleNotFoundError) else type(error).__name__
    return {"error": kind if known else "", "message": text}


def limit_memory(size: int) -> None:
    """Let the data of this process grow to so many bytes and no further."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (size, size))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
