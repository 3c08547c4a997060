"""Sums of scores over blocks in machine code: whether `likelihood.scores` need look closer."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.compiled import compiled


@compiled("void(float64[::1], float64[:,::1], float64[::1])", inner=True)
def _close(sums: Array, held: Array, found: Array) -> None:
    """A block ends: its part of all, and zeros for the next one."""
    square = 0.0
    for i in range(sums.size):
        found[0] += sums[i] * sums[i]
        found[1] += held[i, i]
        for j in range(sums.size):
            square += held[i, j] * held[i, j]
            held[i, j] = 0.0
        sums[i] = 0.0
    found[1] -= square
    found[2] += 2.0 * square
    found[3] += 1.0


@compiled("float64[:,::1](float64[:,:,:], float64[:,:], int64[::1])", free=True)
def scatter_at(g: Array, innovations: Array, counts: Indices) -> Array:
    """What the scores of blocks of equal weight scatter, and what white noise makes of it.

    Parameters
    ----------
    g : (n_samples, n_outputs, k) array
    innovations : (n_samples, n_outputs) array
    counts : (m,) int array
        Numbers of blocks.

    Returns
    -------
    (m, 4) array
        For each: the sum of squares of the blocks' scores, its mean and variance where the noise is
        white, and the number of blocks that there are.
    """
    n, width, k = g.shape
    weight, scores, total = np.zeros(n), np.zeros((n, k)), 0.0
    for t in range(n):
        for o in range(width):
            for i in range(k):
                weight[t] += g[t, o, i] * g[t, o, i]
                scores[t, i] += g[t, o, i] * innovations[t, o]
        total += weight[t]
    found = np.zeros((counts.size, 4))
    sums, held = np.zeros(k), np.zeros((k, k))
    for m in range(counts.size):
        block, before = 0, 0.0
        for t in range(n):
            # of the share up to this sample, how many blocks it fills
            share = (before + 0.5 * weight[t]) / total * counts[m]
            before += weight[t]
            if share >= block + 1 and block + 1 < counts[m]:
                if t:
                    _close(sums, held, found[m])
                block = min(int(np.floor(share)), counts[m] - 1)
            for i in range(k):
                sums[i] += scores[t, i]
            for o in range(width):
                for i in range(k):
                    for j in range(k):
                        held[i, j] += g[t, o, i] * g[t, o, j]
        _close(sums, held, found[m])
    return found
