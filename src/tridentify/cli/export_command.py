"""``tridentify export``: a saved model for MATLAB, C, python-control, a spreadsheet, or as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from tridentify.cli.stored_models import model_file
from tridentify.cli.terminal import show, show_json
from tridentify.errors import OptionError, shown
from tridentify.writing.files import write_atomically


def export(
    model: Annotated[Path, typer.Argument(metavar="MODEL")],
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    dt: Annotated[float | None, typer.Option(metavar="SECONDS")] = None,
    method: Annotated[Literal["zoh", "tustin"] | None, typer.Option()] = None,
    prewarp: Annotated[float | None, typer.Option(metavar="RAD/S")] = None,
    number: Annotated[Literal["double", "float"] | None, typer.Option()] = None,
    name: Annotated[str | None, typer.Option(metavar="NAME")] = None,
    as_json: Annotated[bool, typer.Option("--json")] = False,
) -> None:
    """Write a model that was identified for other programs.

    Example: tridentify export result/model.json short_period.h --dt 0.01

    Parameters
    ----------
    model
        model.json, or the folder of identify --out.
    file
        What to write: .mat or .m (MATLAB, Octave), .h (a filter in C99), .py (python-control), .csv
        (coefficients with their errors), .json.
    dt
        Sampling interval of the filter; .h only.
    method
        Of discretisation; zoh is exact for a held input; .h only.
    prewarp
        Where tustin is exact; .h only.
    number
        Numbers in the C code; .h only.
    name
        What names in the C code begin with; .h only.
    as_json
        Print one JSON object instead of text.
    """
    from tridentify.export import read_json, to_bytes

    model = model_file(model, "tridentify export result/model.json short_period.h", [file])
    suffix = file.suffix.lower()
    if suffix not in (".mat", ".m", ".h", ".py", ".csv", ".json"):
        raise OptionError(
            f"found the file name {shown(file.name)}; expected one that ends in .mat, .m, .h, .py, "
            ".csv or .json; rename it"
        )
    given = {"dt": dt, "method": method, "prewarp": prewarp, "number": number, "name": name}
    if suffix == ".h":
        _write_filter(model, file, given)
    else:
        _check_idle(file, given)
        write_atomically(file, to_bytes(read_json(model), suffix))
    if as_json:
        show_json({"files": [str(file)]})
    else:
        show(f"wrote {file}")


def _check_idle(file: Path, given: Mapping[str, object]) -> None:
    """Refuse what concerns a filter in C where another file is written."""
    idle = [f"--{key}" for key, value in given.items() if value is not None]
    if idle:
        them = "it" if len(idle) == 1 else "them"
        raise OptionError(
            f"found {', '.join(idle)} with {shown(file.name)}; expected {them} with a C header "
            f"only; leave {them} out, or write a file that ends in .h"
        )


def _write_filter(model: Path, file: Path, given: Mapping[str, Any]) -> None:
    from tridentify.export import read_json, write_c_header

    if given["dt"] is None:
        raise OptionError(
            "found no --dt; expected the sampling interval at which the filter will run; write "
            "for example --dt 0.01"
        )
    options = {key: value for key, value in given.items() if value is not None and key != "dt"}
    write_c_header(read_json(model), given["dt"], file, **options)
