"""What a method can do beyond the plain case, and its refusal of what it cannot.

The plain case is uniform sampling, one denominator shared by all channels, no delay, every
coefficient free. All else is a flag that a method raises when it keeps the promise; the contract
tests then run the corresponding cases on it.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence

import numpy as np

from tridentify.errors import NonUniformTimeError, UnsupportedError, shown
from tridentify.record.record import Record
from tridentify.structure import Structure


class Capability(enum.Flag):
    """What a method can do.

    Examples
    --------
    >>> Capability.DELAY in Capability.DELAY | Capability.FREE_DELAY
    True
    """

    NONE = 0
    SEPARATE_DENOMINATORS = enum.auto()
    DELAY = enum.auto()
    FREE_DELAY = enum.auto()
    NON_UNIFORM_TIME = enum.auto()
    BAND_LIMITED = enum.auto()
    CONSTRAINTS = enum.auto()


EVERYTHING = ~Capability.NONE
"""Of a method that refuses nothing."""


def refuse_unsupported(
    records: Sequence[Record], structure: Structure, method: str, can: Capability
) -> None:
    """Refuse what a method cannot do, in one clear line.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
    method : str
        Its name.
    can : Capability

    Raises
    ------
    NonUniformTimeError
        Time is not uniform.
    UnsupportedError
        About the structure.
    """
    for record in records:
        if record.dt is None and Capability.NON_UNIFORM_TIME not in can:
            steps = np.diff(record.t)
            raise NonUniformTimeError(
                f"found time steps between {steps.min():.6g} and {steps.max():.6g} s; {method} "
                "expects a uniform step; use ThreeModel() or OutputError(), or resample the record"
            )
        if record.behaviour == "band-limited" and Capability.BAND_LIMITED not in can:
            raise UnsupportedError(
                f"found intersample='band-limited'; {method} expects 'zoh' (held) or 'foh' "
                "(straight lines); use ThreeModel() or OutputError(), or state one of these"
            )
    if not structure.shared and Capability.SEPARATE_DENOMINATORS not in can:
        raise UnsupportedError(
            f"found separate denominators; {method} estimates one denominator shared by all "
            "channels; give poles as one number, or identify the channels one by one"
        )
    if structure.delay == "free" and Capability.FREE_DELAY not in can:
        raise UnsupportedError(
            f"found delay='free'; {method} estimates no delay; give the delay in seconds"
            if Capability.DELAY in can
            else f"found delay='free'; {method} estimates models without delay; shift the input by "
            "whole samples first"
        )
    if structure.delay != "free" and np.any(structure.delay) and Capability.DELAY not in can:
        raise UnsupportedError(
            f"found delay={structure.delay!r}; {method} estimates models without delay; shift the "
            "input by whole samples first"
        )
    for what in ("fixed", "bounds", "equalities", "priors", "static_gain"):
        known = getattr(structure, what) or (what == "static_gain" and structure.static_gain == 0)
        if known and Capability.CONSTRAINTS not in can:
            raise UnsupportedError(
                f"found {what}={shown(structure.to_dict()[what])}; {method} estimates all "
                f"coefficients freely; leave {what} out"
            )


def refuse_missing(records: Sequence[Record], method: str) -> None:
    """Refuse missing output samples: a filter on ``y`` needs all of them.

    Raises
    ------
    UnsupportedError
    """
    for record in records:
        missing = int(np.isnan(record.y).sum())
        if missing:
            raise UnsupportedError(
                f"found {missing} missing output samples; {method} filters the output and expects "
                "all of them; cut the record into pieces without gaps, or use ThreeModel()"
            )
