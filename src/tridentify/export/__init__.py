"""Models for other programs: MATLAB and Octave, C, python-control, spreadsheets, JSON.

python-control and SciPy are served within Python by `TransferFunction.to_control`, `from_control`,
`to_scipy` and `from_scipy`.
"""

from __future__ import annotations

from tridentify.export.c_header import write_c_header
from tridentify.export.content import (
    read_json,
    to_bytes,
    write_control_script,
    write_json,
    write_table,
)
from tridentify.export.matlab import write_matlab

__all__ = [
    "read_json",
    "to_bytes",
    "write_c_header",
    "write_control_script",
    "write_json",
    "write_matlab",
    "write_table",
]
