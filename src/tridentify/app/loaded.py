"""What every worker needs, loaded once where workers are copies of one process.

One thread for linear algebra, which is said before that is loaded: a process uses one processor.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from tridentify.app import tasks  # noqa: E402

__all__ = ["tasks"]
