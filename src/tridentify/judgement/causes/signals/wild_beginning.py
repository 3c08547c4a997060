"""First samples that are no measurements yet: of a filter that starts, or a converter that wakes.

They are judged by the record alone. A fit takes a few of them for the response of a fast pole to an
initial state, and all else of the model is then wrong; a robust loss sees them as far off, a test
of the residual does not. A response does not look like that unless it falls by more than to a third
between two samples, where it is not sampled well enough to be identified.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.answer.finding import Finding
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

MOST_FIRST = 10
"""Samples at the beginning that are looked at."""
SHARE_FIRST = 0.05
"""The same, in all samples: the others say what is usual."""
APART = 2.0
"""Distance from the range of all later samples, in that range, from which a first one is wild."""


def without_wild_beginning(records: Sequence[Record]) -> tuple[list[Record], list[Finding]]:
    """The records with wild first samples missing, and what is to be said of them.

    Parameters
    ----------
    records : sequence of Record

    Examples
    --------
    >>> u = np.sin(np.arange(100.0))
    >>> y = u.copy()
    >>> y[:2] = 900.0, -70.0
    >>> [record], [found] = without_wild_beginning([Record(u, y, dt=0.1)])
    >>> bool(np.isnan(record.y[:2]).all()), found.code, found.times
    (True, 'bad-samples', (0.0, 0.1))
    """
    kept, told = [], []
    for e, record in enumerate(records):
        where = np.zeros(record.y.shape, dtype=bool)
        struck = any(_far(record.u[:, j]) for j in range(record.n_inputs))
        number = e if len(records) > 1 else None
        for i in range(record.n_outputs):
            own = record.y[:, i]
            n = 0 if struck else _far(own)
            if n and not np.nanmax(own[n:]) > np.nanmin(own[n:]):
                n = 0  # it rests behind them, and has no size
            where[:n, i] = True
            if n:
                told.append(_finding(record, i, n, number))
        kept.append(record.mask(where) if where.any() else record)
    return kept, told


def _finding(record: Record, output: int, n: int, experiment: int | None) -> Finding:
    name = record.output_names[output]
    first = f"{n} samples of {name} lie" if n > 1 else f"sample of {name} lies"
    beside = "" if experiment is None else f" in experiment {experiment + 1}"
    return Finding(
        "bad-samples",
        "warning",
        f"The first {first} far outside all later ones{beside}: no measurements yet. They were "
        "left out.",
        "Start the record behind them.",
        (name,),
        experiment,
        tuple(float(t) for t in record.t[:n]),
    )


def _far(y: Array) -> int:
    """How many first samples lie far outside all later ones."""
    most = min(MOST_FIRST, int(SHARE_FIRST * y.size))
    # where none is far from what comes behind all of them, none is from more
    low, high = np.fmin.reduce(y[most:]), np.fmax.reduce(y[most:])
    beyond = np.fmax.reduce(np.maximum(low - y[:most], y[:most] - high), initial=-np.inf)
    if beyond <= APART * (high - low):
        return 0
    for n in range(most, 0, -1):
        later = y[n:][np.isfinite(y[n:])]
        low, high = (later.min(), later.max()) if later.size else (0.0, 0.0)
        far = np.fmax(low - y[:n], y[:n] - high)
        if later.size and np.isfinite(far[-1]) and np.nanmin(far) > APART * (high - low):
            return n
    return 0
