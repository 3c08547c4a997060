"""Models for other programs: MATLAB and Octave, C, python-control, spreadsheets, JSON.

python-control and SciPy are served within Python by `TransferFunction.to_control`, `from_control`,
`to_scipy` and `from_scipy`.
"""

from __future__ import annotations

from tridentify.export.c_header import write_c_header
from tridentify.export.content import to_bytes
from tridentify.export.control_script import write_control_script
from tridentify.export.matlab import write_matlab
from tridentify.export.plain_json import read_json, write_json
from tridentify.export.table import write_table

__all__ = [
    "read_json",
    "to_bytes",
    "write_c_header",
    "write_control_script",
    "write_json",
    "write_matlab",
    "write_table",
]
