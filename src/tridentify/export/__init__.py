"""Models for other programs: MATLAB and Octave, C, JSON.

python-control and SciPy are served by `TransferFunction.to_control`, `from_control`, `to_scipy` and
`from_scipy`.
"""

from __future__ import annotations

from tridentify.export.c_header import write_c_header
from tridentify.export.matlab import write_matlab
from tridentify.export.plain_json import read_json, write_json

__all__ = ["read_json", "write_c_header", "write_json", "write_matlab"]
