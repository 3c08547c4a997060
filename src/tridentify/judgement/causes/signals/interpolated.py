"""Records that were interpolated, and the samples of them that were recorded."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.joined_by_lines import Joined, between_follows, joined_by_lines
from tridentify.record.record import Record


def interpolated(record: Record) -> list[tuple[int, Joined]]:
    """Outputs that lie on lines between every k-th sample, and between which.

    Parameters
    ----------
    record : Record
    """
    if record.dt is None:
        return []
    found = ((i, joined_by_lines(y, record.u)) for i, y in enumerate(record.y.T))
    return [(i, joined) for i, joined in found if joined is not None]


def in_rows(record: Record, found: list[tuple[int, Joined]]) -> bool:
    """Whether all that was recorded stands in every k-th row.

    Parameters
    ----------
    record : Record
    found : list of (output, Joined)
        Of its outputs.
    """
    every = {joined for _, joined in found}
    whole = len(found) == record.n_outputs and len(every) == 1
    return whole and between_follows(record.u, every.pop())


def without_lines(record: Record) -> Record:
    """The recorded samples of a record that was interpolated.

    Every k-th row where the inputs in between follow from theirs, else all inputs and those outputs
    alone that were recorded.

    Parameters
    ----------
    record : Record
    """
    found = interpolated(record)
    if not found:
        return record
    if in_rows(record, found):
        joined = found[0][1]
        kept = record._part(joined.first, record.n_samples)
        return kept._thinned(kept.u, kept.y, joined.every, kept.intersample, kept._loop)
    y = np.array(record.y)
    for i, one in found:
        y[one.between(record.n_samples), i] = np.nan
    return record._derive(y=y)
