"""Names of channels and units as text that is safe to print, to draw and to write into files.

A name stands in tables, pictures, HTML, comments of exported code and on terminals. What is not
printable has no place there: a line break would begin a line of its own, a control character moves
the cursor, a bidirectional mark shows the text in another order than it has. `str.isprintable`
refuses all of these (Unicode categories C and Z, save the plain space).
"""

from __future__ import annotations

import operator
import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches

from tridentify.errors import ChannelNameError, ChannelNumberError, UnitError, shown

LONGEST_NAME = 200
"""Longest name of a channel [characters]: twice the longest paths of buses and topics that loggers
write; beyond it a table has no column and a picture no room for anything else."""

LONGEST_UNIT = 100
"""Longest unit of a channel [characters]: one in words fits, a paragraph does not."""

_UNIT = re.compile(r"(?P<name>.*\S)\s*(\[(?P<square>[^][]*)\]|\((?P<round>[^()]*)\))")
_OTHER_SPACES = re.compile("[\u00a0\u1680\u2000-\u200a\u202f\u205f\u3000]")


def is_plain(text: object, longest: int) -> bool:
    """Whether this is text of printable characters, not longer than so many.

    Examples
    --------
    >>> is_plain("rad/s", 10), is_plain("rad" + chr(10), 10), is_plain("rad/s", 4), is_plain(1, 4)
    (True, False, False, False)
    """
    return isinstance(text, str) and len(text) <= longest and text.isprintable()


def check_names(names: Iterable[object]) -> None:
    """Refuse names of channels that are no text, blank, not printable or too long.

    Raises
    ------
    ChannelNameError

    Examples
    --------
    >>> check_names(("alpha", "pitch rate"))
    """
    for name in names:
        if not is_plain(name, LONGEST_NAME) or not str(name).strip():
            length = f" of {len(name)} characters" if isinstance(name, str) else ""
            raise ChannelNameError(
                f"found the channel name {shown(name)}{length}; expected printable text that is "
                f"not blank, of at most {LONGEST_NAME} characters; rename the channel"
            )


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """A name like the one that was not found, as an addition to a message; empty without one.

    Parameters
    ----------
    name : object
        What was asked for.
    known : iterable of str
        Names that there are, with or without a unit in brackets.

    Examples
    --------
    >>> did_you_mean("u_elev", ["t", "u_elevator", "q"])
    " (did you mean 'u_elevator'?)"
    >>> did_you_mean("elevator", ["Elevator [deg]"]), did_you_mean("x", ["t", "q"])
    (" (did you mean 'Elevator [deg]'?)", '')
    """
    alike: dict[str, str] = {}
    for each in known:
        for form in (each, split_unit(each)[0]):
            alike.setdefault(form.casefold(), each)
    near = get_close_matches(str(name).strip().casefold(), alike, n=1)
    return f" (did you mean {shown(alike[near[0]])}?)" if near else ""


def split_unit(header: str) -> tuple[str, str]:
    """Take the unit out of the header of a column.

    Parameters
    ----------
    header : str
        Such as ``alpha [deg]``, ``alpha (deg)`` or ``alpha``. An index, ``x[0]``, is no unit.

    Returns
    -------
    name, unit : str
        The unit is empty where the header has none.

    Examples
    --------
    >>> split_unit("alpha [deg]"), split_unit("x[0]")
    (('alpha', 'deg'), ('x[0]', ''))
    """
    match = _UNIT.fullmatch(header)
    unit = (match["square"] or match["round"] or "").strip() if match else ""
    return (header, "") if match is None or unit.isdigit() else (match["name"].strip(), unit)


def labels_of(samples: object, n_channels: int) -> tuple[tuple[str, str], ...] | None:
    """Names and units that an array of pandas, polars, pyarrow or xarray carries.

    Parameters
    ----------
    samples : object
    n_channels : int

    Returns
    -------
    tuple of (str, str) or None
        None unless there is a sound name, all different, for each of the channels.

    Examples
    --------
    >>> import polars as pl
    >>> labels_of(pl.Series("q [deg/s]", [0.0]), 1), labels_of([0.0], 1)
    ((('q', 'deg/s'),), None)
    """
    found = getattr(samples, "column_names", None) or getattr(samples, "columns", None)
    if found is None and hasattr(samples, "to_numpy"):
        found = [getattr(samples, "name", None)]
    headers = [] if found is None else list(found)
    if len(headers) != n_channels or not all(isinstance(header, str) for header in headers):
        return None
    labels = tuple(split_unit(header) for header in headers)
    sound = all(
        is_plain(n, LONGEST_NAME) and n.strip() and is_plain(u, LONGEST_UNIT) for n, u in labels
    )
    return labels if sound and len({name for name, _ in labels}) == n_channels else None


def check_units(units: Mapping[str, object], advice: str = "correct it") -> None:
    """Refuse units that are no text, not printable or too long.

    Parameters
    ----------
    units : mapping of str to object
        Channel to unit.
    advice : str
        What to do about a unit that is refused.

    Raises
    ------
    UnitError

    Examples
    --------
    >>> check_units({"alpha": "deg", "q": "°/s"})
    """
    for name, unit in units.items():
        if not isinstance(unit, str):
            raise UnitError.found(
                f"the unit {shown(unit)} for ", name, "text such as 'rad/s'", "put it in quotes"
            )
        if not is_plain(unit, LONGEST_UNIT):
            raise UnitError(
                f"found the unit {shown(unit)} of {len(unit)} characters for {shown(name)}; "
                f"expected printable text of at most {LONGEST_UNIT} characters, such as 'rad/s'; "
                f"{advice}"
            )


def file_units(units: Mapping[str, str]) -> dict[str, str]:
    """Units as they stand in a file, by channel: spaces of every kind become plain ones.

    Raises
    ------
    UnitError
        A unit is not printable or too long; the message names the channel.

    Examples
    --------
    >>> file_units({"T": "deg" + chr(160) + "C"})
    {'T': 'deg C'}
    """
    found = {name: _OTHER_SPACES.sub(" ", unit) for name, unit in units.items()}
    check_units(found, "correct it in the file, or state the unit of this channel yourself")
    return found


def check_channel(
    output: object, source: object, output_names: Sequence[str], input_names: Sequence[str]
) -> None:
    """Refuse numbers that are not those of an output and of an input, counted from zero.

    Raises
    ------
    ChannelNumberError

    Examples
    --------
    >>> check_channel(0, 1, ["q"], ["elevator", "thrust"])
    """
    for what, number, names in (("output", output, output_names), ("input", source, input_names)):
        if not (
            hasattr(number, "__index__") and -len(names) <= operator.index(number) < len(names)
        ):
            raise ChannelNumberError.found(
                f"the {what} ",
                number,
                f"a number from 0 to {len(names) - 1} ({', '.join(names)})",
                "count from zero",
            )
