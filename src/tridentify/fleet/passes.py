"""Passes over a fleet: the workers look at every unit near a point, and give back sums or pieces.

A pass is handed out as the fits are (`workers.dispatch`). Where the pieces of a batch are added up,
the worker does that (`add_batch`), and the parent adds up what the batches give.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any

from tridentify.errors import IdentifiabilityError
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.fleet.job import Item
from tridentify.fleet.local import Local, Piece
from tridentify.fleet.work import Task
from tridentify.fleet.workers.children import WORKERS
from tridentify.fleet.workers.dispatch import Batches, Lost, dispatch
from tridentify.fleet.workers.engines import Engine
from tridentify.fleet.workers.job import Limits


@dataclass(frozen=True, eq=False)
class Sums:
    """What a pass gives.

    Attributes
    ----------
    names : tuple of str
        Of the coefficients.
    pieces : mapping of Nuisances to Piece
        Sums over the units.
    units : mapping of Nuisances to int
        How many units allow a choice.
    left_out : mapping of str to str
        Key -> why a unit is not in the sums.
    """

    names: tuple[str, ...]
    pieces: Mapping[Nuisances, Piece]
    units: Mapping[Nuisances, int]
    left_out: Mapping[str, str]

    def __add__(self, other: Sums) -> Sums:
        keys = dict.fromkeys((*self.pieces, *other.pieces))
        pieces = {
            key: self.pieces[key] + other.pieces[key]
            if key in self.pieces and key in other.pieces
            else self.pieces.get(key) or other.pieces[key]
            for key in keys
        }
        units = {key: self.units.get(key, 0) + other.units.get(key, 0) for key in keys}
        return Sums(self.names or other.names, pieces, units, {**self.left_out, **other.left_out})


NOTHING = Sums((), {}, {}, {})


def add_batch(task: Task) -> tuple[Sums, float]:
    """The sums of a batch, and what one of its units took [s]."""
    total, seconds = NOTHING, []
    with WORKERS.keeper(task.limits) as keeper:
        for one in keeper.outcomes(task.job, task.items):
            seconds.append(one.seconds)
            if one.failed:
                total += Sums((), {}, {}, {one.item.key: f"{one.status}: {one.message}"})
                continue
            pieces = _pieces(one.value)
            units = dict.fromkeys(pieces, 1)
            total += Sums(tuple(one.value["names"]), pieces, units, {})
    return total, median(seconds)


def piece_batch(task: Task) -> tuple[list[tuple[str, Any]], float]:
    """Key and pieces of each unit of a batch, None of one that failed; and what one took [s]."""
    found, seconds = [], []
    with WORKERS.keeper(task.limits) as keeper:
        for one in keeper.outcomes(task.job, task.items):
            seconds.append(one.seconds)
            found.append((one.item.key, None if one.failed else _pieces(one.value)))
    return found, median(seconds)


def _pieces(value: Mapping[str, Any]) -> dict[Nuisances, Piece]:
    pairs = zip(value["choices"], value["pieces"], strict=True)
    return {Nuisances(*choice): Piece.of(piece) for choice, piece in pairs}


def summed(engine: Engine, items: Iterable[Item], job: Local, limits: Limits) -> Sums:
    """One pass: the sums over all units.

    Raises
    ------
    IdentifiabilityError
        No unit can be used.
    """
    total = NOTHING
    for batch, result in _over(engine, items, job, limits, add_batch):
        if isinstance(result, Lost):
            total += Sums((), {}, {}, {batch[0].key: result.reason})
        else:
            total += result
    if not total.pieces:
        raise IdentifiabilityError(
            f"found no usable record among {len(total.left_out)}; expected some to add up; "
            f"first of them: {next(iter(total.left_out.values()), 'none')}"
        )
    return total


def pieces_of(
    engine: Engine, items: Iterable[Item], job: Local, limits: Limits
) -> dict[str, Piece]:
    """One pass: what each unit says, for the only choice of the job; those that fail are left out.

    A unit is a few dozen numbers, whatever the length of its records.
    """
    found = {}
    for _, result in _over(engine, items, job, limits, piece_batch):
        if not isinstance(result, Lost):
            for key, pieces in result:
                if pieces:
                    found[key] = next(iter(pieces.values()))
    return found


def _over(
    engine: Engine,
    items: Iterable[Item],
    job: Local,
    limits: Limits,
    function: Callable[[Task], tuple[Any, float]],
) -> Iterator[tuple[tuple[Item, ...], Any]]:
    def task(name: str, batch: tuple[Item, ...]) -> Task:
        return Task(name, job, batch, limits)

    batches = Batches()
    for batch, result in dispatch(iter(items), engine, function, task, batches):
        if isinstance(result, Lost):
            yield batch, result
            continue
        value, seconds = result
        batches.measured(len(batch), seconds * len(batch))
        yield batch, value
