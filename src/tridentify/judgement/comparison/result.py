"""What `compare` gives back: fits and responses of every model on every record, and tables."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tridentify.estimation.answer.parameter import Parameter
from tridentify.judgement.comparison.entries import Entry
from tridentify.judgement.comparison.quantities import Quantity
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.writing.layout import format_std, format_table, format_value, html_table, short
from tridentify.writing.views import pandas_frame, room

_WIDTH = 78
"""Characters a line: fits a terminal of 80."""
_LONGEST = 24
"""Name of a model, a record or an output in a table, in characters."""
_LONGER = 32
"""Name of a quantity with its channel."""
HELD = (
    "The models are held. Initial state and offset are fitted to each record, and a drift where "
    "the model was identified with one or integrates."
)


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Models side by side on records.

    Attributes
    ----------
    fits : ndarray, shape (n_models, n_records, n_outputs)
        Normalised fit (NRMSE) [percent]: 100 for a response that is the record, 0 for one no better
        than its mean. ``nan`` where a model or a record lacks the output, or ``notes`` says why.
    responses : tuple of tuple of ndarray, ``[model][record]``, shape (n_samples, n_outputs)
        Simulated outputs with what was fitted to the record [output units]; ``nan`` before the last
        delayed input has arrived.
    names : tuple of str
        Of the models.
    record_names, output_names : tuple of str
    records : tuple of Record
    entries : tuple of Entry
        The models with their names.
    quantities : tuple of Quantity
        Poles and gains, those of one mode beside each other.
    notes : tuple of str
        Why a fit is missing.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, TransferFunction, compare
    >>> record = Record(np.zeros(4), np.exp(-np.arange(4.0)), dt=1.0, name="decay")
    >>> compare({"fast": TransferFunction([1.0], [1.0, 1.0])}, record)
    Comparison(1 record: fast 100.00 %)
    """

    fits: Array
    responses: tuple[tuple[Array, ...], ...]
    names: tuple[str, ...]
    record_names: tuple[str, ...]
    output_names: tuple[str, ...]
    records: tuple[Record, ...]
    entries: tuple[Entry, ...]
    quantities: tuple[Quantity, ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.fits, *(one for row in self.responses for one in row)):
            array.setflags(write=False)

    def __repr__(self) -> str:
        parts = ", ".join(
            f"{name} {_percent(float(fit))} %"
            for name, fit in zip(self.names, self.mean_fits, strict=True)
        )
        many = len(self.records)
        return f"Comparison({many} record{'' if many == 1 else 's'}: {parts})"

    @property
    def mean_fits(self) -> Array:
        """Mean of the fits of each model [percent], shape (n_models,); nan where it has none."""
        known = np.isfinite(self.fits)
        count = known.sum(axis=(1, 2))
        total = np.where(known, self.fits, 0.0).sum(axis=(1, 2))
        return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))

    @property
    def units(self) -> Mapping[str, str]:
        """Channel to unit, as the records and the estimates know them."""
        found: dict[str, str] = {}
        for units in (*(one.units for one in self.entries), *(one.units for one in self.records)):
            found |= dict(units)
        return found

    def measured(self, record: int, output: str) -> Array | None:
        """Samples of an output in a record, shape (n_samples,); None where it has no such output.

        Parameters
        ----------
        record : int
        output : str
            One of ``output_names``.
        """
        one = self.records[record]
        if output in one.output_names:
            return np.asarray(one.y[:, one.output_names.index(output)])
        return None

    def summary(self) -> str:
        """Fixed-width text: fits, then poles and gains."""
        lines = ["=" * _WIDTH, *textwrap.wrap(HELD, _WIDTH), "=" * _WIDTH]
        lines += _left_table(_FIT_TITLES, _blanked(self._fit_rows(), 2))
        lines += ["", *_left_table(_QUANTITY_TITLES, _blanked(self._quantity_rows(), 1))]
        for note in self.notes:
            lines += textwrap.wrap(note, _WIDTH, initial_indent="- ", subsequent_indent="  ")
        return "\n".join((*lines, "=" * _WIDTH))

    def _repr_html_(self) -> str:
        fits = html_table(_FIT_TITLES, _blanked(self._fit_rows(), 2), HELD)
        rows = _blanked(self._quantity_rows(), 1)
        return fits + html_table(_QUANTITY_TITLES, rows, " ".join(self.notes))

    def _fit_rows(self) -> list[tuple[str, ...]]:
        return [
            (
                short(output, _LONGEST),
                short(record, _LONGEST),
                short(name, _LONGEST),
                _percent(float(self.fits[k, r, i])),
            )
            for i, output in enumerate(self.output_names)
            for r, record in enumerate(self.record_names)
            for k, name in enumerate(self.names)
        ]

    def _quantity_rows(self) -> list[tuple[str, ...]]:
        return [
            (short(row.name, _LONGER), short(name, _LONGEST), *_cells(value), row.unit)
            for row in self.quantities
            for name, value in zip(self.names, row.values, strict=True)
            if value is not None
        ]

    def to_frame(self) -> Any:
        """One row a model, record and output, as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            Columns ``model``, ``record``, ``output``, ``fit`` [percent].

        Raises
        ------
        MissingDependencyError
            pandas is not installed.
        """
        places = [
            (k, r, i)
            for k in range(len(self.names))
            for r in range(len(self.records))
            for i in range(len(self.output_names))
        ]
        return pandas_frame(
            {
                "model": [self.names[k] for k, _, _ in places],
                "record": [self.record_names[r] for _, r, _ in places],
                "output": [self.output_names[i] for _, _, i in places],
                "fit": [float(self.fits[place]) for place in places],
            }
        )

    def to_dict(self) -> dict[str, Any]:
        """Give plain numbers, text and lists, ready for JSON; None stands for a missing number."""
        return {
            "models": list(self.names),
            "records": list(self.record_names),
            "outputs": list(self.output_names),
            "fits": [[[_plain(float(fit)) for fit in row] for row in block] for block in self.fits],
            "quantities": [
                {
                    "name": row.name,
                    "unit": row.unit,
                    "values": [None if v is None else _plain(v.value) for v in row.values],
                    "std": [None if v is None else _plain(v.std) for v in row.values],
                }
                for row in self.quantities
            ],
            "notes": list(self.notes),
        }

    def plot(self, **options: Any) -> Any:
        """Draw every model over every record: `tridentify.plots.plot_compared`."""
        return room("plots").plot_compared(self, **options)


_FIT_TITLES = ("output", "record", "model", "fit [%]")
_QUANTITY_TITLES = ("", "model", "value", "std error", "unit")


def _percent(fit: float) -> str:
    return f"{fit:.2f}" if np.isfinite(fit) else "-"


def _plain(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _cells(value: Parameter) -> tuple[str, str]:
    known = np.isfinite(value.std) and value.std > 0
    return format_value(value.value, value.told_to if known else 0.0), (
        format_std(value.std) if known else ""
    )


def _blanked(rows: Sequence[tuple[str, ...]], columns: int) -> list[tuple[str, ...]]:
    """Rows without what stands above already, in the first columns."""
    found, before = [], ("",) * columns
    for row in rows:
        same = 0
        while same < columns and row[same] == before[same]:
            same += 1
        found.append(("",) * same + row[same:])
        before = row[:columns]
    return found


def _left_table(titles: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    """A table whose names stand to the left, also in inner columns."""
    names = titles.index("model") + 1
    sizes = [max(len(row[k]) for row in (titles, *rows)) for k in range(names)]
    joined = [
        (
            "  ".join(cell.ljust(size) for cell, size in zip(row[:names], sizes, strict=True)),
            *row[names:],
        )
        for row in (titles, *rows)
    ]
    return format_table(joined[0], joined[1:])
