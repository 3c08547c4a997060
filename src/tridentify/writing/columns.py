"""Signals over time as CSV: a column a channel, its unit in brackets behind its name."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence

from tridentify.numerics.arrays import Array


def columns_over_time(
    t: Array, values: Array, names: Sequence[str], units: Mapping[str, str]
) -> str:
    r"""The text of a table of signals.

    Parameters
    ----------
    t : (n_samples,) array
        [s]; rounded to 12 digits: 0.3, not 0.30000000000000004.
    values : (n_samples, n_channels) array
    names : sequence of str
    units : mapping of str to str
        By name, where they are known.

    Examples
    --------
    >>> import numpy as np
    >>> columns_over_time(np.array([0.0, 0.1]), np.array([[1.0], [2.5]]), ["q"], {"q": "rad/s"})
    't [s],q [rad/s]\n0,1.0\n0.1,2.5\n'
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    heads = [f"{name} [{units[name]}]" if units.get(name) else name for name in names]
    writer.writerow(["t [s]", *heads])
    for time, row in zip(t.tolist(), values.tolist(), strict=True):
        writer.writerow([f"{time:.12g}", *map(repr, row)])
    return text.getvalue()
