r"""Noise that several outputs share: gusts that move all sensors, one vibrating bracket.

The likelihood weights outputs by their own noise and takes that of one for independent of
another's. The estimate stays consistent where it is not, its covariance does not stay right: with
derivatives ``g_t`` (outputs by directions, over the noise's standard deviations, whitened) in
coordinates with ``sum g_t' g_t = I`` the estimate moves by ``sum g_t' e_t``, so that with ``R`` the
correlation of the innovations ``e_t`` of one moment its covariance is

    S = sum g_t' R g_t

(Zellner 1962 for regressions that are seemingly unrelated, weighted by their own variances alone).
A column that is recorded twice has ``R`` of ones, and the errors of one column.

References
----------
A. Zellner, J. American Statistical Association 57 (1962), 348-368.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.numerics.arrays import Array

CHANCE = 4.0
"""Standard deviations of a correlation of independent noise from which it is none."""

MATTERS = 0.2
"""Correlation below which errors move by less than a tenth."""

FLOOR = 1e-9
"""Share of the largest variance that a direction has at least."""


def shared_covariance(
    directions: Sequence[Array], innovations: Sequence[Array]
) -> tuple[Array, float] | None:
    """The covariance of the scores, where outputs share their noise.

    Parameters
    ----------
    directions : sequence of (n_samples, n_outputs, k) arrays
        ``g`` of every experiment; ``sum g' g = I``.
    innovations : sequence of (n_samples, n_outputs) arrays
        ``e``, 0 where a sample is missing.

    Returns
    -------
    covariance : (k, k) array
    correlation : float
        The largest between two outputs.
        None where no two outputs share enough to matter.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> g = np.linalg.qr(rng.standard_normal((400, 2)))[0].reshape(200, 2, 2)
    >>> own, common = rng.standard_normal((200, 2)), rng.standard_normal((200, 1))
    >>> shared_covariance([g], [own]) is None
    True
    >>> covariance, correlation = shared_covariance([g], [0.3 * own + common])
    >>> covariance.shape, round(correlation, 1)
    ((2, 2), 0.9)
    """
    e = np.vstack(innovations)
    if e.shape[1] < 2:
        return None
    size = np.sqrt(np.einsum("ti,ti->i", e, e))
    found = (e.T @ e) / np.maximum(np.outer(size, size), 1e-300)
    seen = (e != 0.0).astype(np.float64)
    least = np.maximum(CHANCE / np.sqrt(np.maximum(seen.T @ seen, 1.0)), MATTERS)
    matter = np.abs(found) > least
    np.fill_diagonal(matter, False)
    if not matter.any():
        return None
    largest = float(found[matter][np.argmax(np.abs(found[matter]))])
    shared = np.where(matter, found, 0.0)
    np.fill_diagonal(shared, 1.0)
    values, vectors = np.linalg.eigh(shared)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rows = [np.einsum("oc,tok->tck", root, g).reshape(-1, g.shape[2]) for g in directions]
    return np.asarray(sum(one.T @ one for one in rows)), largest


def no_smaller(covariance: Array, than: Array) -> Array:
    """A covariance that is in no direction smaller than another.

    Examples
    --------
    >>> no_smaller(np.diag([1.0, 9.0]), np.diag([4.0, 4.0])).tolist()
    [[4.0, 0.0], [0.0, 9.0]]
    """
    values, vectors = np.linalg.eigh(than)
    root = vectors * np.sqrt(np.maximum(values, FLOOR * values[-1]))
    inner = np.linalg.solve(root, np.linalg.solve(root, covariance).T)
    size, axes = np.linalg.eigh(0.5 * (inner + inner.T))
    turn = root @ axes
    return np.asarray((turn * np.maximum(size, 1.0)) @ turn.T)
