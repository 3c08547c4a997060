"""The size of the noise from stretch to stretch."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.special import fdtrc

from tridentify.judgement.validation.residuals import Output
from tridentify.numerics.arrays import Array
from tridentify.numerics.quantiles import median

PER_STRETCH = 25
"""Samples of a stretch whose scale is compared with the others'."""
MOST_STRETCHES = 8
"""Most stretches of a record."""
FARTHEST = 4.0
"""Standard deviations at which samples are cut for that, so that one outlier is no stretch."""


def size_of_stretches(
    output: Output, plain: Sequence[Array], own: Array
) -> tuple[float, Array, Array]:
    """Whether the size of the noise changes from stretch to stretch (Brown & Forsythe 1974).

    The absolute values about the middle of each stretch are compared by their analysis of
    variance, gross outliers cut off: a slow disturbance that stays makes no noise larger.

    Parameters
    ----------
    output : Output
    plain : sequence of (n_samples,) arrays
        Residuals over their size, beside what was found.
    own : (n,) array
        Innovations of all experiments, one after the other.

    Returns
    -------
    p_value : float
    edges, scales : array
        Of the stretches.
    """
    joined = np.concatenate(plain)
    count = int(np.clip(output.count // PER_STRETCH, 2, MOST_STRETCHES))
    edges = np.linspace(0, joined.size, count + 1).round().astype(int)
    parts, scales = [], []
    for a, b in pairwise(edges.tolist()):
        one = joined[a:b]
        seen = one[np.isfinite(one)]
        scales.append(float(np.sqrt(np.mean(own[a:b] ** 2))) if seen.size else np.nan)
        if seen.size > 2:
            parts.append(np.minimum(np.abs(seen - median(seen)), FARTHEST))
    n, k = sum(one.size for one in parts), len(parts)
    if k < 2 or n <= k:
        return 1.0, edges.astype(np.float64), np.array(scales)
    # the square root brings the absolute value of a Gaussian near a Gaussian
    parts = [np.sqrt(one) for one in parts]
    mean = sum(float(one.sum()) for one in parts) / n
    between = sum(one.size * (float(one.mean()) - mean) ** 2 for one in parts) / (k - 1)
    within = sum(float(np.sum((one - one.mean()) ** 2)) for one in parts) / (n - k)
    p_value = float(fdtrc(k - 1, n - k, between / within)) if within > 0 else 1.0
    return p_value, edges.astype(np.float64), np.array(scales)
