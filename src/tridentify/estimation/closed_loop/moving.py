"""Whether references move, and whether they move inputs apart.

A controller that holds a constant set point is moved by the noise alone: such a reference drives
nothing, and the record is one without a reference. Where several inputs are driven by references
that are proportional to each other, what tells the inputs apart is the dynamics of the controllers
alone, which are not known: the coefficients are told, if at all, by shapes of the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import ConstantReferenceError
from tridentify.estimation.answer.finding import Finding, ranked
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

CODE = "loop-not-excited"

MOVE = (
    "Move the set point (steps, PRBS) and record it as reference, or give a test signal that was "
    "added to the input as one"
)
"""What to do where no reference moves."""

APART = 1e-3
"""Movement that does not follow another reference, of all movement, from which it is one."""


def any_moves(records: Sequence[Record]) -> bool:
    """Whether any reference of any record changes within it.

    Examples
    --------
    >>> still, moved = ([1.0, 1.0, 1.0], [1.0, 1.0, 2.0])
    >>> [any_moves([Record(moved, moved, dt=1.0, reference=r)]) for r in (still, moved)]
    [False, True]
    """
    return any(np.any(_movement(one) != 0.0) for one in records)


def refuse_still(asked: str, records: Sequence[Record], instead: str) -> None:
    """Refuse records in which no reference moves.

    Parameters
    ----------
    asked : str
        What needs one that does.
    records : sequence of Record
        With references.
    instead : str
        What else to do.

    Raises
    ------
    ConstantReferenceError
    """
    if any_moves(records):
        return
    names = sorted({name for one in records for name in one.reference_names})
    raise ConstantReferenceError(
        f"found {asked} and no reference that moves ({', '.join(names)}); expected steps of the "
        f"set point or a test signal; record one, or {instead}"
    )


def still_names(records: Sequence[Record]) -> str:
    """Names of the references, where all records have some and none moves; empty otherwise.

    Parameters
    ----------
    records : sequence of Record
    """
    if any(one.reference is None for one in records) or any_moves(records):
        return ""
    return ", ".join(sorted({name for one in records for name in one.reference_names}))


def with_still(
    findings: Sequence[Finding], records: Sequence[Record], route: str
) -> tuple[Finding, ...]:
    """Findings, with the word that no reference moves, and what the record tells then.

    Parameters
    ----------
    findings : sequence of Finding
    records : sequence of Record
    route : str
        Of the estimate.
    """
    names = still_names(records)
    if not names:
        return tuple(findings)
    still = f"The reference stands still ({names}), drives nothing and counts as none"
    if any(one.code == CODE for one in findings):
        return tuple(
            replace(one, message=f"{still}: {one.message}") if one.code == CODE else one
            for one in findings
        )
    loop = route == "direct"
    what = (
        "what moves the input beside the controller was not recorded"
        if loop
        else "no feedback was found"
    )
    remedy = f"{MOVE}." if loop else ""
    said = Finding(CODE, "warning" if loop else "note", f"{still}: {what}.", remedy)
    return ranked([*findings, said])


def together_findings(records: Sequence[Record]) -> tuple[Finding, ...]:
    """What is to be said of fewer independent references than inputs.

    Parameters
    ----------
    records : sequence of Record
        With references.
    """
    names, few = records[0].input_names, min(_independent(records), records[0].n_inputs)
    if few == len(names):
        return ()
    moving = "one independent reference" if few == 1 else f"{few} independent references"
    return (
        Finding(
            CODE,
            "warning",
            f"{len(names)} inputs ({', '.join(names)}) are driven by {moving}: what tells one "
            "input's effect from another's is the unknown dynamics of the controllers alone.",
            "Move the set points at different times, in one record or in several.",
        ),
    )


def _independent(records: Sequence[Record]) -> int:
    """Movements of references, over all records, that are not sums of each other's multiples."""
    rows = [_movement(one) for one in records]
    widest = max(row.shape[1] for row in rows)
    moved = np.vstack([np.pad(row, ((0, 0), (0, widest - row.shape[1]))) for row in rows])
    lengths = np.linalg.norm(moved, axis=0)
    scaled = moved[:, lengths > 0.0] / lengths[lengths > 0.0]
    values = np.linalg.svd(scaled, compute_uv=False)
    return int(np.sum(values > APART * values[0])) if values.size else 0


def _movement(record: Record) -> Array:
    """(n_samples, n_references) references less their means; zero where one stands still."""
    reference = np.asarray(record.reference, dtype=np.float64)
    still = np.nanmax(reference, axis=0) == np.nanmin(reference, axis=0)
    return np.where(still, 0.0, np.nan_to_num(reference - np.nanmean(reference, axis=0)))
