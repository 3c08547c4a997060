"""Stretches of time on the command line: experiments of one file, and what does not count."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tridentify.errors import OptionError, shown
from tridentify.options import NUMBER
from tridentify.record.checks.times import time_slack
from tridentify.record.record import Record

_STRETCH = re.compile(rf"\s*({NUMBER})?\s*:\s*({NUMBER})?\s*")


class Stretch(NamedTuple):
    """From one time to another [s, on the clock of the file]; both ends belong to it."""

    start: float
    stop: float


def stretches_from(option: str, given: Sequence[str]) -> tuple[Stretch, ...]:
    """Read what ``--range`` and ``--mask`` say.

    Parameters
    ----------
    option : str
        Which of them, for what is said of it.
    given : sequence of str
        ``FROM:TO`` [s]; an end that is left out is the end of the record.

    Returns
    -------
    tuple of Stretch

    Raises
    ------
    OptionError
        A text is nothing of that kind, or ends before it begins.

    Examples
    --------
    >>> stretches_from("--range", ["2:14.5", "20:"])
    (Stretch(start=2.0, stop=14.5), Stretch(start=20.0, stop=inf))
    """
    return tuple(_stretch(option, text) for text in given)


def _stretch(option: str, text: str) -> Stretch:
    match = _STRETCH.fullmatch(text)
    start, stop = match.groups() if match else (None, None)
    found = Stretch(
        -math.inf if start is None else float(start), math.inf if stop is None else float(stop)
    )
    if match is None or (start is None and stop is None) or not found.start < found.stop:
        raise OptionError(
            f"found {option} {shown(text)}; expected two times in seconds, the later one last, "
            "such as 2:14.5 (20: is all from there on); correct it"
        )
    return found


def masked(record: Record, left_out: Sequence[Stretch]) -> Record:
    """The record without the output samples of some stretches.

    Parameters
    ----------
    record : Record
    left_out : sequence of Stretch

    Raises
    ------
    EmptyChannelError
        No sample of an output is left.
    """
    for one in left_out:
        record = record.mask((record.t >= one.start) & (record.t <= one.stop))
    return record


def pieces(record: Record, ranges: Sequence[Stretch]) -> list[Record]:
    """Ranges of a record as experiments; all of it where there are none.

    A sample at either end belongs to a range, but where another begins at that end: then to that.

    Parameters
    ----------
    record : Record
    ranges : sequence of Stretch

    Raises
    ------
    EmptyRangeError
        One of them holds no sample.
    """
    begun = np.array([one.start for one in ranges])
    slack = time_slack(record.t)
    found = []
    for one in ranges:
        piece = record.slice(one.start, one.stop)
        if np.any(np.abs(begun - one.stop) <= slack) and piece.t[-1] >= one.stop - slack:
            piece = piece.slice(None, float(piece.t[-2]))
        found.append(piece)
    return found or [record]
