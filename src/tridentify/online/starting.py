"""The first samples, kept and run again: what the estimators share of their beginning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.online.estimator import Estimator
from tridentify.online.kernels import gradient_slots, slots
from tridentify.online.layout import CHUNK, Blueprint, Setting, Stage, collecting, fresh, watch_of
from tridentify.online.saved.number_rules import ALARM_LASTS
from tridentify.online.saved.state import State
from tridentify.online.search import first_try, next_try, record_of
from tridentify.online.task import Task

SLICES = 1  # of a task, for every sample
PLACES = (
    slots.AT_WATCH, slots.AT_ROW, slots.AT_WORK, slots.AT_FACTOR, slots.AT_IMPULSE,
    slots.AT_INPUTS, slots.AT_OUTPUTS, slots.AT_BEFORE, slots.AT_THETA, slots.AT_GAIN,
    slots.AT_COVARIANCE, slots.AT_SCATTER, gradient_slots.X_FITS, gradient_slots.X_SECOND,
    gradient_slots.X_MOMENTS, gradient_slots.X_ROOM,
)  # fmt: skip
"""In ``ints``: what may stand in the vector behind the room for samples."""


def waiting(method: Estimator, setting: Setting) -> State:
    """The state before the first sample, where the first samples are to be searched for a model."""
    blueprint = collecting(setting)
    x = fresh(blueprint)
    x[slots.TICK] = first_try(setting)
    return State(x, Stage(method, setting, blueprint, blueprint.poles))


def run_kept(
    method: Estimator, setting: Setting, blueprint: Blueprint, x: Array, samples: Array,
    rows: Array | None = None,
) -> Indices:  # fmt: skip
    """Run kept samples through the kernel of a method, events passed over; gives the flags.

    ``rows``: where the row of each sample is put.
    """
    m = setting.n_inputs
    u = np.ascontiguousarray(samples[:, 1 : 1 + m])
    y = np.ascontiguousarray(samples[:, 1 + m :])
    innovations, flags = np.empty(y.shape), np.zeros(len(y), dtype=np.int64)
    regular = np.abs(samples[:, 0] - setting.dt) <= 1e-9 * setting.dt
    regular[:1] = True
    if np.all(regular) and rows is None:
        k = 0
        while k < len(y):
            k = method.kernels().run(
                blueprint.ints, blueprint.constants, x, u, y, k, len(y), innovations, flags
            )
            x[slots.FILLED] = 0.0
            # or an alarm would stop the loop again at every sample that follows
            for i in range(setting.n_outputs):
                x[watch_of(blueprint, i) + slots.MOVED] = 0.0
        return flags
    at = slots.INBOX
    each = method.constants_for(blueprint, setting, np.where(regular, setting.dt, samples[:, 0]))
    for k, after in enumerate(samples[:, 0].tolist()):
        x[at : at + m], x[at + m : at + samples.shape[1] - 1] = u[k], y[k]
        constants = blueprint.constants if regular[k] else each[k]
        method.kernels().step(blueprint.ints, constants, x, after)
        x[slots.FILLED], flags[k] = 0.0, int(x[slots.FLAGS])
        if rows is not None and not (blueprint.nuisance.free and k < setting.late):
            first, row = int(x[slots.FIRST]), int(blueprint.ints[slots.AT_ROW])
            rows[k, first:] = x[row + first : row + blueprint.n_columns]
    return flags


def without(samples: Array, flags: Indices, n_inputs: int) -> Array | None:
    """The samples without the outputs that were found doubtful; None where none was."""
    doubted = (flags & slots.DOUBTED) > 0
    doubted &= np.any(np.isfinite(samples[:, 1 + n_inputs :]), axis=1)
    if not doubted.any():
        return None
    kept = samples.copy()
    kept[doubted, 1 + n_inputs :] = np.nan
    return kept


def calm(x: Array, stage: Stage) -> None:
    """Forget what led to an alarm."""
    for i in range(stage.setting.n_outputs):
        w = watch_of(stage.blueprint, i)
        # what is usual of the excitation and of the scores stays, and of how many blocks it is
        ints, k = stage.blueprint.ints, int(stage.blueprint.ints[slots.DIRECTIONS])
        end = w + int(ints[slots.WATCH]) - k
        first, each = w + slots.SCORES + k, k + k * (k + 1) // 2 + slots.SUMS
        stay = [slice(first + each - slots.SUMS + place, end, each) for place in (1, 3)]
        usual = [x[one].copy() for one in stay]
        x[w + slots.SCORES : end] = 0.0
        for one, value in zip(stay, usual, strict=True):
            x[one] = value
        x[int(ints[slots.AT_SCATTER] + i * ints[slots.SCATTER]) + slots.UNDER_WAY] = 0.0
        x[w + slots.INSIDE] = 0.0
        x[w + slots.MOVED] = 0.0
        x[w + slots.REFUSED] = 0.0


def with_room(blueprint: Blueprint, keep: bool) -> Blueprint:
    """The same plan with, or without, room for samples."""
    ints = blueprint.ints.copy()
    wide = int(ints[slots.INPUTS] + ints[slots.OUTPUTS] + 1)
    more = (CHUNK if keep else 0) - int(ints[slots.CHUNK])
    # a place that is not used stands at zero
    behind = [place for place in PLACES if ints[place] >= ints[slots.AT_CHUNK]]
    ints[behind] += more * wide
    ints[slots.CHUNK] += more
    return replace(blueprint, ints=ints, size=blueprint.size + more * wide)


def rearranged(old: Blueprint, x: Array, new: Blueprint) -> Array:
    """The same estimator with, or without, room for samples.

    Parameters
    ----------
    old : Blueprint
    x : array
    new : Blueprint
        The same but for the room.
    """
    found = np.zeros(new.size)
    head = int(old.ints[slots.AT_CHUNK])
    found[:head] = x[:head]
    found[int(new.ints[slots.AT_WATCH]) :] = x[int(old.ints[slots.AT_WATCH]) :]
    found[slots.FILLED] = 0.0
    return found


def roomed(state: State, keep: bool, past: tuple[Array, ...]) -> State:
    """The same estimator with, or without, room for samples; ``past`` are those that are kept."""
    x, stage = state
    room = with_room(stage.blueprint, keep)
    x = rearranged(stage.blueprint, x, room)
    return State(x, stage.but(blueprint=room, past=past))


def told_changed(x: Array) -> None:
    """The coefficients have moved: it is told for `ALARM_LASTS` samples."""
    x[slots.ALARM] = x[slots.COUNT] + ALARM_LASTS
    x[slots.FLAGS] = float(int(x[slots.FLAGS]) | slots.CHANGED)


def shortened(state: State, samples: Array) -> State:
    """The older half of the kept samples is dropped: nothing was found in it."""
    x, stage = state
    x[slots.FILLED] = 0.0
    kept = samples[len(samples) // 2 :]
    x[slots.TICK] = x[slots.COUNT] + max(next_try(len(kept)) - len(kept), 1)
    return State(x, stage.but(past=(kept,)))


def advanced(state: State, task: Task) -> State | None:
    """A slice further with a task; None once it is over.

    Parameters
    ----------
    state : State
        Its values are its own.
    task : Task
    """
    x, stage = state
    done = int(x[slots.WORK_DONE]) + 1
    if task.over_after(SLICES * done):
        return None
    x[slots.WORK_DONE] = done
    x[slots.TICK] = x[slots.COUNT] + 1.0
    return State(x, stage.but(task=task))


def idle(state: State) -> State:
    """No task is under way."""
    x, stage = state
    x[slots.WORK_DONE] = x[slots.WORK_AT] = 0.0
    return State(x, stage.but(task=None))


def again(x: Array, kept: int, since: int) -> None:
    """The next search is due when there are a third more samples than for the last.

    Parameters
    ----------
    x : array
        Is written to.
    kept : int
        Samples that there are now.
    since : int
        Those of them that came during the last search.
    """
    x[slots.TICK] = x[slots.COUNT] + max(next_try(kept - since) - kept, 1)


def admissible(setting: Setting, poles: Complex, samples: Array) -> Complex:
    """Poles in the left half plane, where samples like these can see them."""
    record = record_of(setting, samples)
    problem = build([record], setting.structure, Nuisances("free", False, False))
    return problem.admissible(poles)[0]


def take_clocks(old: Array, was: Blueprint, x: Array, blueprint: Blueprint, kept: int) -> None:
    """After kept samples were run again: the clocks go on from where they stood.

    Parameters
    ----------
    old : array
        Before.
    was : Blueprint
        Its plan.
    x : array
        After; is written to.
    blueprint : Blueprint
        Its plan.
    kept : int
        Samples that were run.
    """
    for slot in (slots.COUNT, slots.SEEN, slots.FILLED, slots.ALARM, slots.FLAGS, slots.EXTRA):
        x[slot] = old[slot]
    x[slots.BORN] = old[slots.TIME] - x[slots.TIME]
    x[slots.TIME] = old[slots.TIME]
    x[slots.SINCE], x[slots.EVENT] = float(kept), 0.0
    first, last = int(was.ints[slots.AT_LARGEST]), int(was.ints[slots.AT_CHUNK])
    to = int(blueprint.ints[slots.AT_LARGEST])
    x[to : to + last - first] = old[first:last]
