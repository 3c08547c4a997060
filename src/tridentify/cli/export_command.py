"""``tridentify export``: a saved model for MATLAB, C, or as plain JSON."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from tridentify.cli.stored_models import model_file
from tridentify.cli.terminal import show, show_json
from tridentify.errors import OptionError, shown


class Discretisation(StrEnum):
    """How a filter is discretised."""

    ZOH = "zoh"
    TUSTIN = "tustin"


class Digits(StrEnum):
    """Numbers of the C code."""

    DOUBLE = "double"
    FLOAT = "float"


def export(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="model.json, or the folder of identify --out.")
    ],
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="What to write: .mat or .m (MATLAB, Octave), .h (a filter in C99), .json.",
        ),
    ],
    dt: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Sampling interval of the filter; .h only."),
    ] = None,
    method: Annotated[
        Discretisation | None,
        typer.Option(help="Of discretisation; zoh is exact for a held input; .h only."),
    ] = None,
    prewarp: Annotated[
        float | None,
        typer.Option(metavar="RAD/S", help="Where tustin is exact; .h only."),
    ] = None,
    number: Annotated[Digits | None, typer.Option(help="Numbers in the C code; .h only.")] = None,
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What names in the C code begin with; .h only."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object instead of text.")
    ] = False,
) -> None:
    """Write a model that was identified for other programs.

    Example: tridentify export result/model.json short_period.h --dt 0.01
    """
    from tridentify.export import read_json, write_c_header, write_json, write_matlab

    model = model_file(model, "tridentify export result/model.json short_period.h", [file])
    suffix = file.suffix.lower()
    if suffix not in (".mat", ".m", ".h", ".json"):
        raise OptionError(
            f"found the file name {shown(file.name)}; expected one that ends in .mat, .m, .h or "
            ".json; rename it"
        )
    given = {"dt": dt, "method": method, "prewarp": prewarp, "number": number, "name": name}
    if suffix != ".h":
        idle = [f"--{key}" for key, value in given.items() if value is not None]
        if idle:
            them = "it" if len(idle) == 1 else "them"
            raise OptionError(
                f"found {', '.join(idle)} with {shown(file.name)}; expected {them} with a C header "
                f"only; leave {them} out, or write a file that ends in .h"
            )
        found = read_json(model)
        write_json(found, file) if suffix == ".json" else write_matlab(found, file)
    else:
        if dt is None:
            raise OptionError(
                "found no --dt; expected the sampling interval at which the filter will run; write "
                "for example --dt 0.01"
            )
        write_c_header(
            read_json(model),
            dt,
            file,
            method="zoh" if method is None else method.value,
            prewarp=prewarp,
            number="double" if number is None else number.value,
            name=name,
        )
    if as_json:
        show_json({"files": [str(file)]})
    else:
        show(f"wrote {file}")
