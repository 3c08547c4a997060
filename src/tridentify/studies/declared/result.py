"""What a declared study found."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

from tridentify.studies.declared.draw import Row
from tridentify.studies.declared.nouns import DeclaredStudy
from tridentify.studies.declared.results import key_of
from tridentify.studies.declared.statistics import CoefficientStatistics, statistics_of
from tridentify.studies.declared.tables import write_table
from tridentify.writing.views import pandas_frame


@dataclass(frozen=True, eq=False)
class DeclaredResult:
    """Draws of a declared study, and what they say.

    Attributes
    ----------
    study : DeclaredStudy
    rows : tuple of mapping
        One a cell, method and draw, sorted by these: ``theta``, ``low`` and ``high`` (ends of the
        95 % intervals), ``status``, ``ok``, ``failure`` and ``seconds``.
    statistics : tuple of CoefficientStatistics
        One a cell, method and coefficient, in the order of the study.
    """

    study: DeclaredStudy
    rows: tuple[Row, ...]
    statistics: tuple[CoefficientStatistics, ...]

    @classmethod
    def of(cls, study: DeclaredStudy, rows: Sequence[Row]) -> DeclaredResult:
        """Sum up draws.

        Parameters
        ----------
        study : DeclaredStudy
        rows : sequence of mapping
            In any order; draws beyond those of the study are left out.
        """
        own = tuple(sorted((row for row in rows if row["draw"] < study.draws), key=key_of))
        return cls(study, own, statistics_of(study, own))

    @property
    def failures(self) -> Mapping[str, int]:
        """Reasons of draws without an answer, with their numbers."""
        return Counter(row["failure"] for row in self.rows if row["failure"])

    def table(self) -> str:
        """Text for people, ASCII, a block for each cell."""
        return write_table(self.study, self.statistics, self.failures)

    def to_frame(self) -> Any:
        """Statistics as a pandas data frame.

        Returns
        -------
        pandas.DataFrame
            A row for each cell, method and coefficient; columns as in `statistics`.

        Raises
        ------
        MissingDependencyError
            pandas is not installed.
        """
        names = [field.name for field in fields(CoefficientStatistics)]
        return pandas_frame({n: [getattr(row, n) for row in self.statistics] for n in names})

    def to_dict(self) -> dict[str, Any]:
        """Numbers for machines; None where there is no number."""
        return {
            "study": self.study.name,
            "draws": self.study.draws,
            "settings": dict(self.study.settings()),
            "statistics": [_plain(asdict(row)) for row in self.statistics],
            "failures": dict(self.failures),
        }


def _plain(row: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in row.items()
    }
