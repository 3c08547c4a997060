"""The candidates: a table of orders where none are given, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from tridentify.errors import CandidateError, OptionError, shown
from tridentify.judgement.causes.attempts.direct_part import has_direct_part
from tridentify.record.checks.orders import is_pair
from tridentify.record.record import Record
from tridentify.structure import Structure

MOST_POLES = 4
"""Most poles of the candidates that are tried unasked."""
PER_COEFFICIENT = 10
"""Samples for each coefficient of a candidate at least."""


def default_candidates(
    records: Sequence[Record], template: Structure | None = None, max_poles: int = MOST_POLES
) -> tuple[Structure, ...]:
    """Structures with 1 to ``max_poles`` poles and every number of zeros below that of the poles.

    Where an output follows an input in the same sample (`attempts.direct_part`), those with as many
    zeros as poles too; not beside a delay that is to be estimated, which has no such part.

    Parameters
    ----------
    records : sequence of Record
        Orders for which there are fewer than ten output samples a coefficient are left out.
    template : Structure, optional
        Offset, drift, initial state and delay are taken over from it; its orders are not.
    max_poles : int
        Most poles.

    Returns
    -------
    tuple of Structure
        Ten of them for a record that is long enough, without a direct part: (1, 0), (2, 0), (2, 1),
        ..., (4, 3). One denominator for all channels, and numerators of one degree.

    Raises
    ------
    CandidateError
        The template holds knowledge of single coefficients, which belong to its orders.

    Examples
    --------
    >>> import numpy as np
    >>> record = Record(np.ones(500), np.ones(500), dt=0.1)
    >>> [(s.poles, s.zeros) for s in default_candidates([record])][:4]
    [(1, 0), (2, 0), (2, 1), (3, 0)]
    >>> len(default_candidates([record], Structure(1, 0, delay="free")))
    10
    """
    if template is not None and not isinstance(template, Structure):
        raise OptionError(
            f"found template={type(template).__name__}; expected a Structure; write for example "
            "template=Structure(1, 0, offset=True)"
        )
    plain = Structure(1, 0) if template is None else template
    if plain.constrained:
        raise CandidateError(
            "found knowledge of coefficients in the template; expected offset, drift, initial "
            "state and delay alone, as a coefficient belongs to its order; list the candidates"
        )
    samples = min((record.n_samples for record in records), default=0)
    found = []
    direct = int(plain.delay != "free" and has_direct_part(records))
    for n in range(1, max_poles + 1):
        for m in range(n + direct):
            if n == 1 or PER_COEFFICIENT * (n + m + 1) <= samples:
                found.append(replace(plain, poles=n, zeros=m))
    return tuple(found)


def checked_candidates(given: Any) -> tuple[Structure, ...]:
    """Give the candidates as a tuple, each once.

    Raises
    ------
    CandidateError
        There are none, or one of them is not a Structure.
    """
    if isinstance(given, Structure):
        return (given,)
    if is_pair(given):
        return (Structure(*given),)
    try:
        listed = list(given)
    except TypeError:
        raise CandidateError(
            f"found candidates={shown(given)}; expected a list of Structure or of pairs (poles, "
            "zeros); write for example [(1, 0), (2, 1)]"
        ) from None
    if not listed:
        raise CandidateError(
            "found no candidate; expected at least one Structure; leave candidates out for a table "
            "of orders"
        )
    kept: list[Structure] = []
    for item in listed:
        if not isinstance(item, Structure) and not is_pair(item):
            raise CandidateError(
                f"found {shown(item)} among the candidates; expected a Structure or a pair (poles, "
                "zeros); write for example Structure(poles=2, zeros=1) or (2, 1)"
            )
        structure = item if isinstance(item, Structure) else Structure(*item)
        if structure not in kept:
            kept.append(structure)
    return tuple(kept)


INTEGRATOR = {"a0": 0.0}
"""What is held of a structure with a pole at zero."""


def order_label(structure: Structure) -> str:
    """Poles and zeros as text, ``"2, 1"``; nested ones with their brackets.

    Examples
    --------
    >>> order_label(Structure(2, 1)), order_label(Structure(2, [[1], [0]]))
    ('2, 1', '2, [[1], [0]]')
    >>> order_label(Structure(1, 0, delay="free"))
    '1, 0, free delay'
    >>> order_label(Structure(2, 2, delay=0.3))
    '2, 2, delay 0.3 s'
    >>> order_label(Structure(2, 0, fixed={"a0": 0}))
    '2, 0, integrator'
    """

    def plain(value: Any) -> str:
        return str([list(row) for row in value]) if isinstance(value, tuple) else str(value)

    label = f"{plain(structure.poles)}, {plain(structure.zeros)}"
    if structure.delay == "free":
        label += ", free delay"
    elif isinstance(structure.delay, float) and structure.delay > 0.0:
        label += f", delay {structure.delay:.4g} s"
    if structure.drift not in (False, "auto"):
        label += ", drift"
    if is_integrator(structure):
        return f"{label}, integrator"
    return label + (", constrained" if structure.constrained else "")


def is_integrator(structure: Structure) -> bool:
    """Whether all that is known of a structure is one pole at zero.

    Examples
    --------
    >>> is_integrator(Structure(2, 0, fixed={"a0": 0})), is_integrator(Structure(2, 0))
    (True, False)
    """
    more = structure.bounds or structure.equalities or structure.priors
    return dict(structure.fixed or {}) == INTEGRATOR and not more
