"""Which column of a record is which channel of a physical model, by their names."""

from __future__ import annotations

import re
from collections.abc import Sequence


def match_channels(channels: Sequence[str], columns: Sequence[str]) -> dict[str, str]:
    """Say which column is which channel.

    A column with the name of a channel is that channel; then one that has a channel's name among
    its words (``y_alpha``, ``alpha [deg]``), where no other column and no other channel claims it;
    those that are left follow in their order.

    Parameters
    ----------
    channels, columns : sequence of str
        Of the model and of the record, all inputs or all outputs.

    Returns
    -------
    dict
        Channel -> column; channels for which there is no column are left out.

    Examples
    --------
    >>> match_channels(("alpha", "q"), ("y_q", "y_alpha"))
    {'alpha': 'y_alpha', 'q': 'y_q'}
    >>> match_channels(("elevator",), ("u1",))
    {'elevator': 'u1'}
    """
    found = {name: name for name in channels if name in columns}
    open_channels = [name for name in channels if name not in found]
    claims = {
        name: [one for one in columns if one not in found and _is_named_in(name, one)]
        for name in open_channels
    }
    for name, some in claims.items():
        others = [one for other, one in claims.items() if other != name]
        if len(some) == 1 and not any(some[0] in one for one in others):
            found[name] = some[0]
    rest = iter([one for one in columns if one not in found.values()])
    for name in open_channels:
        column = found.get(name) or next(rest, None)
        if column is not None:
            found[name] = column
    return {name: found[name] for name in channels if name in found}


def _is_named_in(channel: str, column: str) -> bool:
    """Whether a channel's words stand in a column's name, side by side."""
    ours, theirs = _words(channel), _words(column)
    return any(theirs[k : k + len(ours)] == ours for k in range(len(theirs) - len(ours) + 1))


def _words(name: str) -> list[str]:
    return re.findall(r"[a-z]+|\d+", name.lower())
