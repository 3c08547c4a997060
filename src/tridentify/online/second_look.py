"""Standard errors of few samples that are still kept, with a model of their noise.

Blocks of scores (`online.scatter`) are of what the model so far did not expect. Where the noise is
slow beside the samples, this is little: least squares has bent the coefficients after it, now and
then into another valley, whose errors look small. But as long as the samples are kept they can be
asked once more: the coefficients are taken to the minimum for an autoregression of what they leave
(`online.residual.refined`). No estimate for white noise is better than that one (Gauss and Markov),
and the truth is near it: so a standard error is at least that of these coefficients, and at least
the distance to them.
"""

from __future__ import annotations

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.numerics.arrays import Array
from tridentify.numerics.slices import drain
from tridentify.online.layout import Setting
from tridentify.online.residual import refined
from tridentify.online.search import record_of

CLEARLY = 1.25
"""Ratio of standard errors below which nothing is said: a noise model of few samples of white noise
makes them a few per cent larger."""


def doubted(setting: Setting, samples: Array, theta: Array, cov: Array) -> Array:
    """The covariance, with standard errors that what the samples say with a noise model allows.

    Parameters
    ----------
    setting : Setting
    samples : (k, n_inputs + n_outputs + 1) array
    theta : (n,) array
        Coefficients for white noise.
    cov : (n, n) array
        Their covariance so far.

    Returns
    -------
    (n, n) array
        ``cov`` itself where the samples say nothing, or hardly anything else.
    """
    std = np.sqrt(np.diagonal(cov))
    if not np.all(std > 0.0):
        return cov
    try:
        found = drain(refined(setting, record_of(setting, samples), theta, std))
    except (TridentifyError, np.linalg.LinAlgError):
        return cov
    if found is None:
        return cov
    least = np.maximum(np.sqrt(np.diagonal(found.cov)), np.abs(found.theta - theta))
    ratio = np.maximum(least / std, 1.0)
    return cov if np.all(ratio < CLEARLY) else ratio[:, None] * cov * ratio
