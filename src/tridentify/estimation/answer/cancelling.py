"""Whether a pole of an estimate lies on a zero: then the record needs neither of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array

CANCELS = "a pole and a zero cancel within their errors"
"""Said by a covariance; the likelihood may refute it."""

LASTING = 3.0
"""Decay over the record [nepers] below which a swing is not over at its end: 5 percent are left."""

WITHIN = 2.0
"""Standard errors of the distance between a pole and a zero within which they cancel."""


def cancelling(estimate: Estimate, longest: float) -> list[str]:
    """What says that a pole lies on a zero of every channel, in words; empty where none does."""
    within, close = [], []
    for i in range(len(estimate.output_names)):
        for j in range(len(estimate.input_names)):
            num, den, cov = estimate.channel(i, j)
            if np.trim_zeros(num, "f").size < 2:
                return []
            within.append(covered(num, den, cov))
            close.append(_close(num, den, longest))
    shared = estimate.structure.shared
    if in_all(within, shared):
        return [CANCELS]
    if not estimate.structure.constrained and in_all(close, shared):
        return ["a pole and a zero lie closer together than a record of this length tells apart"]
    return []


def in_all(on: Sequence[NDArray[np.bool_]], shared: bool) -> bool:
    """Whether one pole is meant in all channels; in any, where each has poles of its own."""
    if shared:
        return bool(np.any(np.all(np.array(on), axis=0)))
    return any(bool(np.any(one)) for one in on)


def _close(num: Array, den: Array, longest: float) -> NDArray[np.bool_]:
    """(n_poles,) whether a slowly decaying pole lies near a zero.

    The response to both together differs from none by ``exp`` of their distance times the length:
    what they do is a slow swing, begun once and not yet over.
    """
    poles, zeros = np.roots(den), np.roots(np.trim_zeros(num, "f"))
    found = np.zeros(poles.size, dtype=bool)
    if not zeros.size:
        return found
    apart = np.min(np.abs(zeros[None, :] - poles[:, None]), axis=1)
    return np.asarray((apart * longest < 1.0) & (np.abs(poles.real) * longest < LASTING))


def covered(num: Array, den: Array, cov: Array) -> NDArray[np.bool_]:
    """(n_poles,) whether a zero lies on a pole within the errors of their distance.

    Parameters
    ----------
    num, den : arrays
        Descending powers, ``den`` monic.
    cov : (n + m + 2, n + m + 2) array
        As of `Estimate.channel`.
    """
    poles, zeros = np.roots(den), np.roots(num)
    if zeros.size != num.size - 1:
        return np.zeros(poles.size, dtype=bool)
    cov = cov[:-1, :-1]
    n = den.size - 1
    found = np.zeros(n, dtype=bool)
    with np.errstate(all="ignore"):
        da = -_powers(poles, n) / np.polyval(np.polyder(den), poles)[:, None]
        db = -_powers(zeros, num.size) / np.polyval(np.polyder(num), zeros)[:, None]
    for k, pole in enumerate(poles):
        nearest = int(np.argmin(np.abs(zeros - pole)))
        row = np.concatenate([da[k], -db[nearest]])
        if not np.all(np.isfinite(row)):
            continue
        spread = float(np.real(row @ cov @ row.conj()))
        found[k] = abs(pole - zeros[nearest]) < WITHIN * np.sqrt(max(spread, 0.0))
    return found


def _powers(roots: NDArray[Any], count: int) -> NDArray[np.complex128]:
    """(n_roots, count) powers, the highest first."""
    return np.asarray(np.power.outer(np.asarray(roots, complex), np.arange(count - 1, -1, -1)))
