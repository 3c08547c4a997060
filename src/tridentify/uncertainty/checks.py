"""What the questions about an estimate's uncertainty have in common: levels and time axes."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from tridentify.errors import OptionError, UnsupportedError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.parameter import checked_level
from tridentify.numerics.arrays import Array


def factor_of(level: float) -> float:
    """Half width of a Gaussian interval in standard deviations.

    Examples
    --------
    >>> round(factor_of(0.95), 4)
    1.96
    """
    return NormalDist().inv_cdf((1 + checked_level(level)) / 2)


def checked_times(t: npt.ArrayLike) -> Array:
    """Times [s] in one dimension, finite and rising.

    Raises
    ------
    OptionError

    Examples
    --------
    >>> checked_times([0, 1])
    array([0., 1.])
    """
    times = np.atleast_1d(np.asarray(t, dtype=np.float64))
    if times.ndim != 1 or not np.all(np.isfinite(times)) or np.any(np.diff(times) < 0):
        raise OptionError.found("t=", t, "finite times [s] in rising order", "sort them")
    return times


def need_covariance(estimate: Estimate) -> None:
    """Refuse an estimate without standard errors.

    Raises
    ------
    UnsupportedError
    """
    if not np.all(np.isfinite(estimate.cov)):
        raise UnsupportedError(
            f"found an estimate of {estimate.method} without a finite covariance; expected "
            "standard errors to draw from; use bootstrap(estimate, records) instead"
        )


def checked_count(what: str, value: object, least: int) -> int:
    """A whole number that is not too small.

    Raises
    ------
    OptionError

    Examples
    --------
    >>> checked_count("n_draws", 200, 1)
    200
    """
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise OptionError.found(f"{what}=", value, f"a whole number of at least {least}")
    return int(value)
