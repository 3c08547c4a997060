"""The answer: the table of candidates, the row that is recommended, and why."""

from __future__ import annotations

import math
import os
import textwrap
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tridentify.estimation.answer.encoding import encode, save_document
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.judgement.selection.hankel import Hankel
from tridentify.judgement.selection.numbers import percent, relative
from tridentify.judgement.selection.orders import order_label
from tridentify.numerics.arrays import Array
from tridentify.structure import Structure
from tridentify.writing.layout import format_table, html_table

SCHEMA = 1
"""Version of the file format."""
_WIDTH = 78
"""Characters a line: fits a terminal of 80."""
_HELD_OUT = "held-out [%]"
_TITLES = ("", "poles, zeros", "coefficients", "fit [%]", _HELD_OUT, "std/value", "remark")


AHEAD = "compared one sample ahead"
"""Why there is no held-out fit in a loop."""

UNFINISHED = "not finished"
"""What is said of a row whose estimate is a maximum of the likelihood at which the search was left:
whatever `identify` gives in its place, it would not be recommended."""


@dataclass(frozen=True, eq=False)
class SelectionRow:
    """One candidate.

    Attributes
    ----------
    structure : Structure
        As asked for.
    estimate : Estimate or None
        None where it failed.
    reason : str
        Why it failed, in one line; empty where it did not.
    aic, aicc, bic, yic : float
        `selection.criteria` of the likelihood's maximum; on the same samples, with the same
        nuisance terms and a noise model of the same order in every row, hence not always
        `Estimate.aicc`: they compare the rows of one table and depend on its other rows. nan where
        the candidate failed.
    fit, cross_fit : ndarray, shape (n_outputs,)
        NRMSE [percent] of ``estimate`` on the samples that were fitted, and on samples that were
        not (`selection.held_out`). They are those of the candidate alone, as is ``estimate``.
    held_out_reason : str
        Why there is no ``cross_fit``; empty where there is one.
    doubts : tuple of str
        What speaks against recommending it (`selection.soundness`).
    condition : float
        The worst of the steps of the last pass and of the score columns.
    relative_std : float
        The largest standard error over its coefficient; ``widest`` is whose.
    n_coefficients : int
        Coefficients that are not held, delays among them.
    n_unknowns : int
        Of the criteria: coefficients, nuisance terms, noise variances and coefficients of the
        noise model (in a loop without these: what they cost is in ``deviance``).
    deviance : float
        ``-2 log L`` without constants.
    identified : bool
        Whether ``estimate`` is what `identify` gives for ``structure``, to the last bit. A row that
        cannot be recommended whatever that is may be left at the likelihood's maximum.
    ok : bool
        Whether the estimate is usable.
    """

    structure: Structure
    estimate: Estimate | None
    reason: str = ""
    aic: float = math.nan
    aicc: float = math.nan
    bic: float = math.nan
    yic: float = math.nan
    fit: Array = field(default_factory=lambda: np.zeros(0))
    cross_fit: Array = field(default_factory=lambda: np.zeros(0))
    condition: float = math.nan
    relative_std: float = math.nan
    widest: str = ""
    held_out_reason: str = ""
    doubts: tuple[str, ...] = ()
    n_coefficients: int = 0
    n_unknowns: int = 0
    deviance: float = math.nan
    identified: bool = False
    ok: bool = False

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def label(self) -> str:
        """Poles and zeros, ``"2, 1"``."""
        return order_label(self.structure)

    @property
    def status(self) -> str:
        """How the estimation ended: one or two words, or the reason of the failure."""
        return self.reason if self.estimate is None else self.estimate.status.value

    def to_dict(self) -> dict[str, Any]:
        """Plain values, the estimate by its coefficients."""
        found = {
            name: encode(value)
            for name, value in vars(self).items()
            if name not in ("estimate", "structure")
        }
        coefficients = (
            None
            if self.estimate is None
            else {
                name: {"value": item.value, "std": item.std}
                for name, item in self.estimate.parameters.items()
            }
        )
        head = {"label": self.label, "structure": self.structure.to_dict(), "status": self.status}
        return head | {"coefficients": coefficients} | found


@dataclass(frozen=True, eq=False, repr=False)
class Selection:
    """Candidates side by side.

    Attributes
    ----------
    rows : tuple of SelectionRow
        In the order in which they were given.
    recommended : SelectionRow or None
        One of them; None where no candidate could be estimated.
    reason : str
        Why, in words.
    hankel : Hankel or None
        Hankel singular values of the parallel model; None where it could not be made.
    notes : tuple of str
        About the noise, the samples, and what the fits on unseen samples are.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, select_structure, simulate
    >>> u = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 30), 10)
    >>> y = simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=0.05))[:, 0]
    >>> record = Record(u, y + 0.05 * np.random.default_rng(2).standard_normal(300), dt=0.05)
    >>> select_structure(record, [Structure(1, 0), Structure(2, 0)]).recommended.label
    '1, 0'
    """

    rows: tuple[SelectionRow, ...]
    recommended: SelectionRow | None
    reason: str
    hankel: Hankel | None = None
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        which = "none" if self.recommended is None else self.recommended.label
        return f"Selection({len(self.rows)} candidates; recommended poles, zeros = {which})"

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What `identify` would say of the recommended candidate; its remedies were tried."""
        own = self.recommended
        return () if own is None or own.estimate is None else own.estimate.findings

    @property
    def cautions(self) -> tuple[str, ...]:
        """The findings that matter, in words: what was found, and what to do."""
        return tuple(finding.text for finding in self.findings if finding.matters)

    def table(self) -> list[tuple[str, ...]]:
        """Cells of the table, row by row."""
        return [self._cells(row) for row in self.rows]

    @property
    def titles(self) -> tuple[str, ...]:
        """Titles of `table`."""
        return tuple("AICc" if one == _HELD_OUT and self._ahead else one for one in _TITLES)

    @property
    def _ahead(self) -> bool:
        """Whether rows are compared one sample ahead: then there is no held-out fit to be shown."""
        return any(row.held_out_reason == AHEAD for row in self.rows)

    def _cells(self, row: SelectionRow) -> tuple[str, ...]:
        mark = "->" if row is self.recommended else ""
        if row.estimate is None:
            return (mark, row.label, *[""] * 4, _shortened(row.reason))
        remarks = list(row.doubts)
        if row.held_out_reason and not self._ahead:
            remarks.append(f"held-out: {row.held_out_reason}")
        if not (row.identified or self._ahead):
            remarks.append(UNFINISHED)
        return (
            mark,
            row.label,
            str(row.n_coefficients),
            percent(row.fit),
            f"{row.aicc:.1f}" if self._ahead else percent(row.cross_fit),
            relative(row.relative_std),
            "; ".join(remarks) or row.status,
        )

    def summary(self) -> str:
        """Text: the recommendation with its reason, the table, and notes."""
        which = "none" if self.recommended is None else self.recommended.label
        lines = ["=" * _WIDTH, f"recommended poles, zeros: {which}"]
        lines += textwrap.wrap(self.reason, _WIDTH, initial_indent="  ", subsequent_indent="  ")
        for text in self.cautions:
            said = f"caution: {text}"
            lines += textwrap.wrap(said, _WIDTH, initial_indent="  ", subsequent_indent="    ")
        lines += ["=" * _WIDTH, *format_table(self.titles, self.table(), width=_WIDTH), ""]
        for note in self.all_notes():
            lines += textwrap.wrap(note, _WIDTH, initial_indent="- ", subsequent_indent="  ")
        return "\n".join(line.rstrip() for line in (*lines, "=" * _WIDTH))

    def all_notes(self) -> tuple[str, ...]:
        """Notes, and what the Hankel singular values say."""
        told = ["std/value: the largest standard error over its coefficient"]
        told += self.notes
        if self.hankel is not None and self.hankel.order:
            h = self.hankel
            several = "value rises" if h.order == 1 else "values rise"
            told.append(
                f"parallel model ({h.operators}): {h.order} Hankel singular {several} above the "
                "noise, a lower bound of the number of poles"
            )
        return tuple(told)

    def _repr_html_(self) -> str:
        which = "none" if self.recommended is None else self.recommended.label
        caption = " ".join((f"recommended poles, zeros: {which}. {self.reason}", *self.cautions))
        return html_table(self.titles, self.table(), caption)

    def to_dict(self) -> dict[str, Any]:
        """Plain values: all rows, where the recommended one stands and what is found on it.

        Returns
        -------
        dict
        """
        place = next((k for k, row in enumerate(self.rows) if row is self.recommended), None)
        hankel = None
        if self.hankel is not None:
            hankel = encode(self.hankel) | {"order": self.hankel.order}
        return {
            "recommended": place,
            "reason": self.reason,
            "findings": [asdict(finding) for finding in self.findings],
            "rows": [row.to_dict() for row in self.rows],
            "hankel": hankel,
            "notes": list(self.notes),
        }

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write `to_dict` as JSON: to a temporary name first, then renamed.

        Raises
        ------
        OutputPathError
            The file cannot be written.
        """
        return save_document(path, "schema", SCHEMA, self.to_dict())


def _shortened(reason: str) -> str:
    """What was found, of a line "found ...; expected ...; do ..."."""
    return "failed: " + reason.partition(";")[0].removeprefix("found ")
