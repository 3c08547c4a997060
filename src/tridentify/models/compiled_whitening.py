"""Triangles of columns in coloured noise, in machine code: of their innovations."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.compiled import compiled
from tridentify.numerics.kernels.triangles import triangularise
from tridentify.numerics.kernels.whitening import innovate


@compiled(
    "float64[:,:,::1](float64[:,:,::1], float64[:,::1], float64[::1], boolean[::1],"
    " float64[:,::1], float64[::1])",
    free=True,
)
def whitened_triangles(
    columns: Array, y: Array, noise: Array, seen: Flags, gain: Array, scale: Array
) -> Array:
    """The triangles of some outputs of one experiment on several banks.

    Parameters
    ----------
    columns : (n_banks, n_columns, n_samples) array
        From `compiled_regression.triangles_of` without outputs.
    y : (n_outputs, n_samples) array
    noise, seen, gain, scale : arrays
        As of `numerics.kernels.whitening.innovate`.

    Returns
    -------
    (n_banks, n_columns + n_outputs, n_columns + n_outputs) array
    """
    count, states, n = columns.shape
    width = states + y.shape[0]
    found, rows = np.empty((count, width, width)), np.empty((width, n))
    outputs = np.empty((y.shape[0], n))
    past = np.zeros((width, noise.size))
    innovate(noise, seen, gain, scale, y, past, outputs)
    for k in range(count):
        past[:] = 0.0
        innovate(noise, seen, gain, scale, columns[k], past, rows)
        for i in range(y.shape[0]):
            for t in range(n):
                rows[states + i, t] = outputs[i, t]
        triangularise(rows, n, 0, n, found[k])
    return found
