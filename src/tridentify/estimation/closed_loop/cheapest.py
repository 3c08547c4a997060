"""How many operators describe signals best for their number: AICc over nested columns.

One triangle serves all numbers: what the first ``k`` columns explain is the sum of the first ``k``
squares of ``Q' s``, the last column of the triangle of columns and signal. The residual of each
signal counts as white, or as an autoregression that is given, by which columns and signal are
whitened alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten_columns

TOLD_APART = 1e-6
"""Of columns with unit length, what a column must add to those before it: below, weights would be
large, cancel at the samples, and run away between them."""


def cheapest(
    columns: Array,
    signals: Array,
    n_references: int,
    most: int,
    each: int = 1,
    colours: Sequence[Array] | None = None,
) -> tuple[float, int]:
    """Lowest AICc over the number of operators, a multiple of some, and that number.

    Parameters
    ----------
    columns : (n_samples, n_columns) array
        A constant, the references, the operators on each.
    signals : (n_samples, n_signals) array
        ``nan`` where one is missing.
    n_references : int
    most : int
        Operators on each reference.
    each : int
        That are taken together.
    colours : sequence of arrays, optional
        Autoregressive coefficients of what is left of each signal; white without them.
    """
    lead = 1 + n_references
    # operator by operator, those of all references together: nested from left to right
    nested = lead + np.arange(n_references * most).reshape(n_references, most).T.ravel()
    ordered = columns[:, np.concatenate([np.arange(lead), nested])]
    norms = np.linalg.norm(ordered, axis=0)
    ordered = ordered / np.where(norms > 0, norms, 1.0)
    counts, total = lead + n_references * np.arange(each, most + 1, each), np.zeros(most // each)
    for k, signal in enumerate(signals.T):
        seen = np.isfinite(signal)
        n = float(seen.sum())
        colour = np.zeros(0) if colours is None else colours[k]
        table = whiten_columns([np.column_stack([ordered, signal])], [seen], colour)
        r = np.asarray(np.linalg.qr(table, mode="r"))[: ordered.shape[1]]
        sound = np.abs(np.diag(r)) > TOLD_APART
        spent = np.cumsum(np.where(sound, r[:, -1], 0.0) ** 2)
        whole = float(table[:, -1] @ table[:, -1])
        rest, floor = np.maximum(whole - spent[counts - 1], 0.0), 1e-20 * whole + 1e-300
        price = 2.0 * counts * n / np.maximum(n - counts - 2.0, 1.0)
        total += n * np.log((rest + floor) / n) + price
    best = int(np.argmin(total))
    return float(total[best]), (best + 1) * each
