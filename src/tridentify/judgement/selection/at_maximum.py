"""Rows that nobody is going to recommend end on the likelihood's maximum.

Where a record leaves coefficients open, `identify` goes on to the mean over the posterior:
thousands of denominators, most of the time of a table, nearly all for candidates with more poles
than the record can tell. By its own rule the mean explains the record as well as the maximum does
(`posterior.maximum_or_mean`): fit and held-out fit say the same. What it says besides is how well
the coefficients are known, and that is asked only of a row that could be recommended. An end at a
limit, which is not kept either, is searched for once more only then, too. Of one pole or two the
mean costs little, and is always asked for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.answer import Ending
from tridentify.estimation.methods.base import Method, Progress
from tridentify.estimation.methods.maximum import Reached
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.estimation.posterior.first_draws import SEVERAL
from tridentify.estimation.posterior.maximum_or_mean import kept_maximum
from tridentify.judgement.selection.result import SelectionRow
from tridentify.structure import Structure

OPEN = (
    "the likelihood's maximum: the record leaves coefficients open, and the posterior mean was not "
    "asked for as the candidate is out of the question"
)
"""What stands in the trace of such a row."""

SUPPOSED = ((), ("not sound",))
"""What the mean may say against such a row, beside that its coefficients are badly known: nothing,
or more. Where the recommendation is the same whatever it says, the row is out of the question."""


@dataclass(frozen=True)
class AtMaximum(ThreeModel):
    """`ThreeModel`, ended on the maximum where the mean would be asked for."""

    again: bool = False
    """Whether ends at a limit are searched for once more, of however many poles."""

    def insists(self, structure: Structure) -> bool:
        """Of few poles, or where it is asked for."""
        return self.again or not structure.shared or structure.common_poles < SEVERAL

    def weighed(self, reached: Reached, say: Progress) -> Ending:
        """The maximum, with a word where it is not what `ThreeModel` ends with."""
        if reached.point.problem.n_poles < SEVERAL:
            return super().weighed(reached, say)
        kept = kept_maximum(self.finish, reached, reached.scan)
        return reached.told(OPEN) if kept is None else kept


def at_maximum(method: Method, *, again: bool = False) -> Method:
    """The method for rows, any of which may turn out to be of no interest."""
    if type(method) is not ThreeModel or method.finish != "auto":
        return method
    options = {one.name: getattr(method, one.name) for one in fields(method)}
    return AtMaximum(**options, again=again)


def is_open(estimate: Estimate | None) -> bool:
    """Whether an estimate ended where `identify` would go on."""
    return estimate is not None and OPEN in estimate.trace.decisions


def supposing(rows: Sequence[SelectionRow], doubts: tuple[str, ...] | None) -> list[SelectionRow]:
    """The rows, with what the mean may say against the open ones; as they are for None."""
    if doubts is None:
        return list(rows)
    return [replace(row, doubts=doubts) if is_open(row.estimate) else row for row in rows]
