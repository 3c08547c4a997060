"""The whole search of a candidate without what takes longest and may never be looked at.

Where a record hardly sees a coefficient, the likelihood's maximum is no answer, and the posterior
mean that takes its place (`posterior.mean`) costs as much as the search and more. Candidates with
needless poles are of that kind, all of them, and what the likelihood says of them is known at the
maximum. So the search stops there, and goes on from there where the answer is asked for
(`unfinished`): to what `identify` gives, to the last bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.likelihood.answer import Ending
from tridentify.estimation.methods.around_maximum.maximum import Reached
from tridentify.estimation.methods.base import Method, Progress
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.estimation.posterior.maximum_or_mean import SOUND, kept_maximum
from tridentify.estimation.search.delays import Located
from tridentify.numerics.arrays import Complex
from tridentify.record.record import Record
from tridentify.structure import Structure


@dataclass(frozen=True)
class Halfway(ThreeModel):
    """A method up to the likelihood's maximum, or on from there.

    Attributes
    ----------
    reached : tuple of Reached
        Where it was left before; empty for the search.
    left : list of Reached
        Where it is left now: maxima in whose place a posterior mean may be the answer.
    """

    reached: tuple[Reached, ...] = ()
    left: list[Reached] = field(default_factory=list, compare=False)

    @classmethod
    def of(cls, method: ThreeModel, reached: tuple[Reached, ...] = ()) -> Halfway:
        """With the options of a method."""
        known = {one.name: getattr(method, one.name) for one in fields(ThreeModel)}
        return cls(**known, reached=reached)

    def maximise(
        self,
        records: Sequence[Record],
        structure: Structure,
        say: Progress,
        located: Located | None = None,
        *,
        near: Complex | None = None,
    ) -> Reached:
        """As that of the method, or where it was left."""
        if self.reached:
            return self.reached[0]
        return super().maximise(records, structure, say, located, near=near)

    def weighed(self, reached: Reached, say: Progress) -> Ending:
        """The maximum, left for later where it is an end that may not be the answer."""
        if self.reached or not _is_end(reached):
            return super().weighed(reached, say)
        kept = kept_maximum(self.finish, reached, reached.scan)
        if kept is None:
            self.left.append(reached)
        return reached if kept is None else kept


def can_stop(method: Method, records: Sequence[Record], structure: Structure) -> bool:
    """Whether a search may stop halfway: experiments of different noise are searched in turns."""
    plain = type(method) is ThreeModel and not structure.constrained
    return plain and len(records) == 1 and structure.delay != "free"


def _is_end(reached: Reached) -> bool:
    """Whether the maximum is a usable end by itself."""
    try:
        reached.curvature.refuse_undetermined()
    except UnsupportedOrderError:
        return False
    return reached.status in SOUND
