"""What is known of the coefficients, as it is written on the command line."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from tridentify.errors import ChannelCountError, OptionError, shown
from tridentify.options import NUMBER, read_knowledge

_NAME = r"\s*([^\s=]+)\s*=\s*"


def known_from(
    fixed: Sequence[str], bounds: Sequence[str], priors: Sequence[str], gains: Sequence[str]
) -> dict[str, Any]:
    """Read ``--fix``, ``--bound``, ``--prior`` and ``--gain`` into options of `Structure`.

    Parameters
    ----------
    fixed : sequence of str
        ``a0=3``.
    bounds : sequence of str
        ``b0=0:5``, a side left empty for no limit.
    priors : sequence of str
        ``a0=3+-0.1``: mean and standard deviation.
    gains : sequence of str
        One number for all channels, or one text for each output with a number for each input and
        commas between, ``?`` where it is unknown.

    Returns
    -------
    dict
        ``fixed``, ``bounds``, ``priors`` and ``static_gain``.

    Raises
    ------
    OptionError
        A text is none of these, or a coefficient is named twice by one option.
    ChannelCountError
        The gains of several outputs are for different numbers of inputs.

    Examples
    --------
    >>> known_from(["a0=3"], ["b0=0:"], ["a1=1+-0.1"], ["2"])
    {'fixed': {'a0': 3.0}, 'bounds': {'b0': (0.0, None)}, 'priors': {'a1': (1.0, 0.1)}, \
'static_gain': 2.0}
    """
    given = {
        "bounds": ("--bound", bounds, "b0=0: or b0=0:5"),
        "priors": ("--prior", priors, "a0=3+-0.1"),
        "fixed": ("--fix", fixed, "a0=3"),
    }
    found = read_knowledge(lambda kind, value: _by_name(*given[kind], value))
    return {**found, "static_gain": _gain(gains)}


def _by_name(
    option: str, given: Sequence[str], example: str, value: str
) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for text in given:
        match = re.fullmatch(_NAME + value + r"\s*", text)
        if match is None:
            raise OptionError.found(
                f"{option} ", text, f"a coefficient and its value such as {example}"
            )
        name, *parts = match.groups()
        if name in found:
            raise OptionError.found(f"{option} twice for ", name, "it once", "drop one of the two")
        found[name] = tuple(parts)
    return found


def _gain(given: Sequence[str]) -> float | list[list[float | None]] | None:
    rows: list[list[float | None]] = []
    for text in given:
        cells = [cell.strip() for cell in text.split(",")]
        if not all(cell == "?" or re.fullmatch(NUMBER, cell) for cell in cells):
            raise OptionError(
                f"found --gain {shown(text)}; expected a number, or one for each input such as "
                "1.5,? where the second is unknown; correct it"
            )
        rows.append([None if cell == "?" else float(cell) for cell in cells])
    if not rows:
        return None
    if len({len(row) for row in rows}) > 1:
        raise ChannelCountError(
            f"found --gain {' --gain '.join(given)}; expected the same number of inputs for each "
            "output; write ? where a gain is unknown"
        )
    return rows[0][0] if len(rows) == 1 and len(rows[0]) == 1 else rows
