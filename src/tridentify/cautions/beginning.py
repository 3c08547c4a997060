"""The stretch of a long record that cautions look at."""

from __future__ import annotations

import numpy as np

from tridentify.record import Record


def beginning(record: Record, most: int) -> Record:
    """The first samples of a record, or all where an output has none among them.

    Parameters
    ----------
    record : Record
    most : int
        How many.

    Examples
    --------
    >>> beginning(Record(np.ones(5), np.ones(5), dt=1.0), 3).n_samples
    3
    """
    seen = np.isfinite(record.y[:most]).any(axis=0).all()
    if record.n_samples > most and seen:
        return record.slice(None, float(record.t[most - 1]))
    return record
