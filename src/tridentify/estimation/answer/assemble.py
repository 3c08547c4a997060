"""The one place where an estimate is put together: of what was asked, and of what was found."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.parameter import Nuisance
from tridentify.estimation.answer.trace import Status, Trace
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction


@dataclass(frozen=True, eq=False)
class Request:
    """What an estimate answers.

    Attributes
    ----------
    records : tuple of Record
        As they are fitted.
    structure : Structure
    method : str
        Its name.
    n_samples : int
        Of the records as they were given.
    dt : float or None
        Step of the first of them [s].
    fingerprint : str
        Theirs; empty where the samples are not kept.
    told : tuple of str
        What was done to them before they were fitted.
    route : {"open-loop", "reference", "direct"}
        As `Estimate.route`.
    """

    records: tuple[Record, ...]
    structure: Structure
    method: str
    n_samples: int
    dt: float | None
    fingerprint: str
    told: tuple[str, ...] = ()
    route: str = "open-loop"

    @classmethod
    def of(
        cls,
        records: Sequence[Record],
        structure: Structure,
        method: str,
        fitted: Sequence[Record] | None = None,
        route: str = "open-loop",
    ) -> Request:
        """Records and structure, given to a method.

        Parameters
        ----------
        records : sequence of Record
            As they were given.
        structure : Structure
        method : str
        fitted : sequence of Record, optional
            The same with the rows put back that are missing from a uniform raster.
        route : {"open-loop", "reference", "direct"}
        """
        used = tuple(records if fitted is None else fitted)
        seen = sum(record.n_samples for record in records)
        lost = sum(record.n_samples for record in used) - seen
        told = f"{lost} rows missing from a uniform raster: taken for samples without an output"
        return cls(
            used, structure, method, seen, records[0].dt, fingerprint(records),
            (told,) if lost else (), route,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Solved:
    """What was found: the fields of `Estimate` that no record and no option says.

    Attributes
    ----------
    structure : Structure
        With the nuisance terms that were decided on.
    """

    structure: Structure
    model: TransferFunction
    theta: Array
    cov: Array
    noise_variance: Array
    fit: Array
    status: Status
    trace: Trace
    nuisance: tuple[Nuisance, ...]
    degrees_of_freedom: int
    cost: float
    aicc: float
    condition: float
    gradient: float
    noise_model: tuple[Array, ...] = ()
    noise_levels: tuple[Array, ...] = ()
    findings: tuple[Finding, ...] = ()
    errors: str = "likelihood"
    draws: Array = field(default_factory=lambda: np.zeros((0, 0)))


def assemble(asked: Request, solved: Solved) -> Estimate:
    """The estimate.

    Parameters
    ----------
    asked : Request
    solved : Solved
    """
    first = asked.records[0]
    found = {**vars(solved), "trace": solved.trace.told(*asked.told)}
    return Estimate(
        **found,
        names=asked.structure.names(first.input_names, first.output_names),
        method=asked.method,
        n_samples=asked.n_samples,
        input_names=first.input_names,
        output_names=first.output_names,
        units=first._units_of_a_model,
        intersample=first.behaviour,
        dt=asked.dt,
        record_fingerprint=asked.fingerprint,
        route=asked.route,
    )


def fingerprint(records: Sequence[Record]) -> str:
    """SHA-256 of the samples, those of references too, and their times, in hexadecimal."""
    digest = hashlib.sha256()
    for record in records:
        digest.update(np.array([record.t[0], record.dt or 0.0]).tobytes())
        if record.dt is None:
            digest.update(record.t)  # type: ignore[arg-type]
        digest.update(record.u)  # type: ignore[arg-type]
        digest.update(record.y)  # type: ignore[arg-type]
        if record.reference is not None:
            digest.update(record.reference)  # type: ignore[arg-type]
    return digest.hexdigest()
