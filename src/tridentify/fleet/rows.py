"""One row a record, whatever came of it: the columns, and how they are filled.

A row has the same columns for every structure: what depends on it (coefficients, covariance) is a
list. Tables for people have a column a coefficient instead (`fleet.table`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

import numpy as np

from tridentify.errors import ConstantInputError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import Method
from tridentify.fleet.attempt import RecordJob
from tridentify.fleet.job import Item
from tridentify.fleet.workers.job import Outcome
from tridentify.identify import search
from tridentify.numerics.arrays import Array
from tridentify.record.formats.assemble import Wanted
from tridentify.record.record import Record
from tridentify.structure import AutoStructure, Structure
from tridentify.writing.layout import as_call

COLUMNS: Mapping[str, str] = MappingProxyType(
    {
        "key": "text",
        "status": "text",
        "ok": "flag",
        "message": "text",
        "exception": "text",
        "cautions": "texts",
        "seconds": "number",
        "names": "texts",
        "coefficients": "numbers",
        "standard_errors": "numbers",
        "covariance": "numbers",
        "fit": "numbers",
        "noise_variance": "numbers",
        "n_samples": "count",
        "fingerprint": "text",
        "version": "text",
        "place": "text",
        "attempt": "count",
    }
)
"""Column -> kind. ``covariance`` is the lower triangle, row by row; ``cautions`` are codes of the
findings that matter, ``place`` the file, ``attempt`` how often it was tried before."""

STILL = "constant-input"
"""Caution of a unit whose inputs never change; an error where nothing answers them either."""


@dataclass(frozen=True)
class Fit(RecordJob):
    """The job of a fleet: identify every unit.

    Attributes
    ----------
    structure : Structure or AutoStructure
    method : Method, optional
    judge : bool
        Whether findings are looked for; without, a row has no cautions, unless no input changes.
    wanted : Wanted
        How files and frames are read.
    """

    structure: Structure | AutoStructure
    method: Method | None
    judge: bool
    wanted: Wanted

    def run(self, item: Item, records: Sequence[Record]) -> dict[str, Any]:
        """The columns that an estimate fills.

        Raises
        ------
        ConstantInputError
            No input ever changes, and no output answers their being switched on.
        """
        estimate = self.estimate(records)
        if any(one.code == STILL and one.severity == "error" for one in estimate.findings):
            raise ConstantInputError(
                f"found inputs that never change ({', '.join(estimate.input_names)}) and no "
                "response to their being switched on at the first sample; expected an input that "
                "changes; record a change of it"
            )
        return row_of(estimate)

    def estimate(self, records: Sequence[Record]) -> Estimate:
        """The estimate, judged if that is asked for or no input ever changes; never thrown."""
        found = search(records, self.structure, self.method)
        still = not any(np.ptp(record.u, axis=0).any() for record in found.records)
        return found.judged() if self.judge or still else found.estimate

    def in_words(self) -> dict[str, Any]:
        """What decides about the numbers, for the manifest."""
        method = "ThreeModel()" if self.method is None else as_call(self.method)
        reading = plain(dataclasses.asdict(self.wanted))
        structure = as_call(self.structure)
        return {"structure": structure, "method": method, "judge": self.judge, "reading": reading}


@cache
def own_version() -> str:
    """Version of this package, as it is installed."""
    return version("tridentify")


def plain(value: Any) -> Any:
    """Options as JSON holds them."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value if value is None or isinstance(value, str | int | float | bool) else repr(value)


def row_of(estimate: Estimate) -> dict[str, Any]:
    """The columns that an estimate fills.

    Parameters
    ----------
    estimate : Estimate
    """
    status = estimate.status
    return {
        "status": status.value,
        "ok": status.ok,
        "message": status.message if not status.ok or status.remedy else "",
        "cautions": list(dict.fromkeys(f.code for f in estimate.findings if f.matters)),
        "names": list(estimate.names),
        "coefficients": estimate.theta.tolist(),
        "standard_errors": estimate.std.tolist(),
        "covariance": packed(estimate.cov).tolist(),
        "fit": estimate.fit.tolist(),
        "noise_variance": estimate.noise_variance.tolist(),
        "n_samples": estimate.n_samples,
    }


def fit_row(outcome: Outcome) -> dict[str, Any]:
    """The row of an item: of its estimate, or of what stood in the way.

    Parameters
    ----------
    outcome : Outcome
        Of `Fit`.
    """
    blank: dict[str, Any] = {"text": "", "texts": [], "numbers": [], "count": 0, "flag": False}
    row = {name: blank.get(kind) for name, kind in COLUMNS.items()}
    if outcome.failed:
        row |= {name: getattr(outcome, name) for name in ("status", "message", "exception")}
    return (
        row
        | outcome.value
        | {
            "key": outcome.item.key,
            "seconds": outcome.seconds,
            "fingerprint": outcome.fingerprint,
            "version": own_version(),
            "place": outcome.item.place.label,
            "attempt": outcome.item.attempt,
        }
    )


def packed(matrix: Array) -> Array:
    """The lower triangle of a symmetric matrix, row by row.

    Examples
    --------
    >>> packed(np.array([[1.0, 2.0], [2.0, 3.0]])).tolist()
    [1.0, 2.0, 3.0]
    """
    return np.asarray(matrix[np.tril_indices(len(matrix))])


def unpacked(triangle: Sequence[float] | Array) -> Array:
    """The symmetric matrix of `packed`.

    Examples
    --------
    >>> unpacked([1.0, 2.0, 3.0]).tolist()
    [[1.0, 2.0], [2.0, 3.0]]
    """
    values = np.asarray(triangle, dtype=np.float64)
    n = int((np.sqrt(8.0 * values.size + 1.0) - 1.0) / 2.0)
    matrix = np.zeros((n, n))
    matrix[np.tril_indices(n)] = values
    return np.asarray(matrix + np.tril(matrix, -1).T)


def schema() -> dict[str, Any]:
    """Name -> type of polars, of all columns."""
    import polars as pl

    kinds = {
        "text": pl.String(),
        "texts": pl.List(pl.String()),
        "number": pl.Float64(),
        "numbers": pl.List(pl.Float64()),
        "count": pl.Int64(),
        "flag": pl.Boolean(),
    }
    return {name: kinds[kind] for name, kind in COLUMNS.items()}


def to_frame(rows: Iterable[Mapping[str, Any]]) -> Any:
    """Rows as a frame of polars.

    Examples
    --------
    >>> to_frame([]).columns[:3]
    ['key', 'status', 'ok']
    """
    import polars as pl

    return pl.DataFrame(list(rows), schema=schema(), orient="row")
