"""What the writers of this folder write, as bytes: for an archive, a data base or a web answer."""

from __future__ import annotations

from pathlib import Path

from tridentify.errors import OptionError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.export.c_header import c_header, identifier
from tridentify.export.control_script import control_script
from tridentify.export.matlab import matlab_file, matlab_script
from tridentify.export.plain_json import json_text
from tridentify.export.table import table
from tridentify.transfer_function import TransferFunction

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
