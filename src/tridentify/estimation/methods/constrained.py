"""What is known of the coefficients: the method without it is the search, the end lies within it.

Where bounds are all that is known and the free estimate lies within them, that is the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.answer.estimate import Estimate, Trace
from tridentify.estimation.knowledge.solve import Seeds, constrain, resolve, seen, unmoved
from tridentify.estimation.likelihood.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.noise_model import NoiseChoice
from tridentify.estimation.methods.base import Progress
from tridentify.estimation.methods.maximum import Maximiser
from tridentify.record.record import Record
from tridentify.structure import Structure


def within_constraints(
    method: Maximiser,
    records: Sequence[Record],
    structure: Structure,
    say: Progress,
    most: int,
    noise: NoiseChoice,
) -> Estimate:
    """The maximum of the likelihood, and of the priors, within what is known.

    Parameters
    ----------
    method : Maximiser
        Looks for the maximum without the constraints.
    records : sequence of Record
    structure : Structure
        With its constraints.
    say : callable
        Is told what is going on.
    most : int
        Most steps.
    noise : {"white", "ar", "auto"}
        What the noise is taken for.
    """
    known = resolve(records, structure)
    looked_at = seen(records, structure, known)
    seeds = Seeds((), (), Trace(()))
    if looked_at is not None:
        free = method.maximise(*looked_at, say)
        if known.only_bounds:
            with suppress(UnsupportedOrderError):
                kept = unmoved(structure, method.answer(free, *looked_at, say))
                if kept is not None:
                    return kept
        point = free.end.point
        tried = [one.theta for one in sorted(free.trace.starts, key=lambda start: start.cost)]
        seeds = Seeds((coefficients(point), *tried), point.problem.noise, free.trace)
    return constrain(records, structure, known, seeds, method.name, say, most, noise)
