"""One BLAS thread while the matrices are small.

Every matrix here is a few dozen columns wide. A second BLAS thread cannot help with those, and
on a busy machine its spinning costs many times the work itself.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import Any

THREADS = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Variables that linear algebra reads once, when it is loaded: they must stand before a process
starts."""


@cache
def _controller() -> Any:
    import scipy.linalg  # noqa: F401 - its BLAS must be loaded to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """Context in which BLAS runs on one thread; the user's setting comes back afterwards.

    Examples
    --------
    >>> with one_blas_thread():
    ...     pass
    """
    found = _controller()
    if all(one.num_threads == 1 for one in found.lib_controllers if one.user_api == "blas"):
        return nullcontext()
    limit: AbstractContextManager[Any] = found.limit(limits=1, user_api="blas")
    return limit
