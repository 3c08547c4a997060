"""Estimators that look into their alarms before they believe them, with a witness.

What `online.suspecting` says is done here beside the stream: samples are kept since the alarm, the
look at them takes a slice a sample (`online.task`), and the method goes on meanwhile as if there
had been no alarm, its own clock included. If the plant has changed the method begins anew on the
samples since, or, with ``on_change="flag"``, the flag is raised and no more. If after three looks
at ever more samples it has not, the suspicion is dropped and the next alarm must be stronger. While
there are too few first samples to make a witness of, an alarm is passed over.

A suspected change, judged by a witness: where a method's own answer cannot be the measure.

A model of the samples since an alarm (`online.suspicion`) would nearly always explain them better
than the coefficients of an equation error, which noise has biased, or those of a gradient rule that
is still on its way, although nothing has changed. So these methods keep their first samples, and
when the first alarm comes they are searched for a *witness*: the coefficients at the minimum for
coloured noise, and their covariance. The plant has changed only if the model of the samples since
the alarm explains them clearly better than the witness does, by likelihood and by both
covariances, *and* better than the present answer: a method that follows coefficients that drift has
nothing to be told. Where there is no witness the present answer stands alone.

The witness learns: from each suspicion that was dropped it takes the new coefficients, weighted by
the two covariances, or in its own place where the plant has drifted and the method has followed.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array
from tridentify.numerics.slices import Slices
from tridentify.numerics.threads import one_blas_thread
from tridentify.online.asked import NotReadyError
from tridentify.online.estimator import Estimator, kept_samples
from tridentify.online.kernels import slots
from tridentify.online.layout import Doubt, Setting, Stage
from tridentify.online.residual import Refined, is_driven, refined
from tridentify.online.saved.state import State
from tridentify.online.scatter import wonted
from tridentify.online.search import DOUBTED, TRIED, FoundPoles, clean_search, first_try, record_of
from tridentify.online.starting import advanced, again, calm, idle, roomed, shortened, told_changed
from tridentify.online.suspicion import (
    LARGER,
    Old,
    differ,
    explains_better,
    is_determined,
    packed,
    still_old,
    together,
    unpacked,
)
from tridentify.online.task import Task
from tridentify.online.unexplained import doubting
from tridentify.record.record import Record


class WitnessVerdict(NamedTuple):
    """What a look at the samples since an alarm has come to.

    Attributes
    ----------
    changed : bool
        Whether they are of another plant.
    witness : Old or None
        Before they are counted in.
    after : Old or None
        With them.
    found : FoundPoles or None
        The model of the samples.
    samples : (k, n_inputs + n_outputs + 1) array
        Of the plant that was found, without those that are far off.
    begin : int
        Samples since the alarm that are still of the old plant.
    """

    changed: bool
    witness: Old | None
    after: Old | None
    found: FoundPoles | None
    samples: Array
    begin: int = 0


class _Model(NamedTuple):
    """A model of kept samples, also for coloured noise."""

    found: FoundPoles
    new: Refined
    record: Record
    samples: Array


def looking(
    setting: Setting,
    beginning: Array,
    begun_anew: bool,
    samples: Array,
    witness: Old | None,
    present: Old | None,
) -> Slices[WitnessVerdict]:
    """Whether the samples since an alarm are of another plant.

    Parameters
    ----------
    setting : Setting
    beginning : (l, n_inputs + n_outputs + 1) array
        The first samples, of which a witness is made where there is none.
    begun_anew : bool
        Whether these begin in the middle, from any state.
    samples : (k, n_inputs + n_outputs + 1) array
        Since the alarm.
    witness : Old or None
    present : Old or None
        The answer at the alarm.
    """
    if witness is None and len(beginning) >= first_try(setting):
        first = yield from _model_of(setting, beginning, begun_anew)
        if first is not None:
            witness = Old(first.new.theta, LARGER * first.new.cov)
    now = yield from _model_of(setting, samples, True)
    if now is None:
        return WitnessVerdict(False, witness, witness, None, samples)
    taken = Old(now.new.theta, LARGER * now.new.cov)
    changed, others = True, [one for one in (witness, present) if one is not None]
    for old in others:
        yield
        changed = changed and explains_better(setting, now.record, old, now.new)
    if not others:
        return WitnessVerdict(False, None, taken, now.found, now.samples)
    moved = differ(others[0], now.new)
    after = taken if moved or witness is None else together(witness, taken)
    if not (changed and moved):
        return WitnessVerdict(False, witness, after, now.found, now.samples)
    yield
    begin = yield from still_old(setting, now.record, others[0], now.new)
    return WitnessVerdict(True, witness, after, now.found, now.samples[begin:], begin)


def _model_of(setting: Setting, samples: Array, begun_anew: bool) -> Slices[_Model | None]:
    """A model that samples determine, for white and for coloured noise; None if they do not."""
    try:
        found, left = yield from clean_search(setting, samples, begun_anew)
        if found is None or not found.certain:
            return None
        record = record_of(setting, left)
        yield
        if not is_driven(setting, record, found.estimate.theta):
            return None
        new = yield from refined(setting, record, found.estimate.theta, found.estimate.std)
    except (TridentifyError, np.linalg.LinAlgError):
        return None
    if new is None or not is_determined(setting, new):
        return None
    return _Model(found, new, record, left)


MOST_KEPT = 2000  # samples: what a search of bounded slices can take


def asking(setting: Setting, samples: Array, begun_anew: bool) -> Slices[Doubt | None]:
    """What speaks against any model of the structure in the first samples; None where nothing does.

    Parameters
    ----------
    setting : Setting
    samples : (k, n_inputs + n_outputs + 1) array
    begun_anew : bool
        Whether they begin in the middle, from any state.
    """
    try:
        found, left = yield from clean_search(setting, samples, begun_anew)
    except (TridentifyError, np.linalg.LinAlgError):
        return None
    if found is None:
        return None
    yield
    return (yield from doubting(setting, left, found.estimate.theta, found.estimate.std))


class Suspecting(Estimator):
    """What recursive least squares, the Kalman filter and the gradient rule do about alarms."""

    on_change: str

    own_arrays: ClassVar[int] = 0
    """How many arrays of the stage's ``extra`` are the method's own."""
    asks: ClassVar[bool] = False
    """Whether the first samples are asked what speaks against the structure: where nothing else of
    the method would tell."""

    @abstractmethod
    def adapt(self, state: State) -> State:
        """What the method's own clock asks for, the search of the first samples included."""

    @abstractmethod
    def begun_again(self, state: State, found: FoundPoles, samples: Array) -> State:
        """The estimator that goes on from the samples since a change, without a witness."""

    @abstractmethod
    def _searching_task(self, state: State, samples: Array, begun_anew: bool, full: bool) -> Task:
        """The search for a model among the first samples."""

    @abstractmethod
    def from_search(
        self, state: State, found: Any, newest: Array, begun_anew: bool, full: bool
    ) -> State | None:
        """The estimator that begins at what was found; None if that is not sure enough."""

    def search(self, state: State) -> State:
        """A slice of the search for a model."""
        x, kept = state.values, kept_samples(state)
        begun_anew = bool(x[slots.COUNT] > len(kept))
        if not x[slots.WORK_DONE]:
            x[slots.WORK_AT] = float(len(kept))
        count = int(x[slots.WORK_AT])
        full = count >= MOST_KEPT
        task = state.stage.task or self._searching_task(state, kept[:count], begun_anew, full)
        further = advanced(state, task)
        if further is not None:
            return further
        found, state = task.result(), idle(state)
        begun = self.from_search(state, found, kept[count:], begun_anew, full)
        if begun is not None:
            return begun
        again(x, len(kept), len(kept) - count)
        return shortened(state, kept) if full else state

    def tick(self, state: State) -> State:
        """A slice of the look at a suspicion, or what the method's own clock asks for."""
        with one_blas_thread():
            return self._ticked(state)

    def _ticked(self, state: State) -> State:
        x, asked = state.values, _is_asked(state)
        if not x[slots.SUSPECT] and not asked:
            return self.adapt(state)
        if x[slots.OWN_TICK] == x[slots.COUNT]:
            state = self.adapt(state)
            x = state.values
            x[slots.OWN_TICK] = x[slots.TICK] if x[slots.TICK] > x[slots.COUNT] else 0.0
        if x[slots.DUE] == x[slots.COUNT]:
            state = self._ask(state) if asked else self._look(state)
        _set_tick(state)
        return state

    def alarmed(self, state: State) -> State:
        """Suspect a change: keep the samples from here on."""
        x, stage = state
        calm(x, stage)
        # the first samples have to make a witness that can be relied on
        early = x[slots.SINCE] < DOUBTED * first_try(stage.setting)
        if x[slots.SUSPECT] or stage.searching or early or _is_asked(state):
            return state
        here = x[slots.COUNT]
        present, witness = self._answer(state), self._witness(stage)
        if not stage.blueprint.ints[slots.CHUNK]:
            x, stage = roomed(state, True, stage.past)
        x[slots.OWN_TICK] = x[slots.TICK] if x[slots.TICK] >= here else 0.0
        x[slots.SUSPECT], x[slots.DUE] = here, here + TRIED * first_try(stage.setting)
        arrays = (*stage.extra[: self.own_arrays], *packed(present), *packed(witness))
        state = State(x, stage.but(extra=arrays, task=None))
        _set_tick(state)
        return state

    def full(self, state: State) -> State:
        """No more samples are kept once the witness can be made of those that are.

        Where the method asks them what speaks against the structure, that comes first.
        """
        x, stage = state
        room = stage.blueprint.poles.size and stage.blueprint.ints[slots.CHUNK]
        if not room or x[slots.SUSPECT] or stage.searching or _is_asked(state):
            return state
        kept = len(kept_samples(state))
        if kept < MOST_KEPT:
            return state
        if not self.asks:
            return roomed(state, False, (kept_samples(state),))
        x[slots.OWN_TICK] = x[slots.TICK] if x[slots.TICK] >= x[slots.COUNT] else 0.0
        x[slots.WORK_AT], x[slots.DUE] = float(kept), x[slots.COUNT] + 1.0
        _set_tick(state)
        return state

    def _ask(self, state: State) -> State:
        """A slice of what the first samples are asked; at its end no more are kept."""
        x, stage = state
        samples = kept_samples(state)[: int(x[slots.WORK_AT])]
        begun_anew = bool(stage.blueprint.nuisance.free)
        task = stage.task or Task(asking, stage.setting, samples, begun_anew)
        further = advanced(state, task)
        if further is not None:
            further.values[slots.DUE] = x[slots.COUNT] + 1.0
            return further
        doubt, state = task.result(), idle(state)
        x = state.values
        x[slots.TICK], x[slots.OWN_TICK], x[slots.DUE] = x[slots.OWN_TICK], 0.0, 0.0
        state = State(x, state.stage.but(doubt=doubt))
        return roomed(state, False, (kept_samples(state),))

    # -------------------------------------------------------------------------- the suspicion
    def _answer(self, state: State) -> Old | None:
        try:
            found = self._bare(state)
        except NotReadyError:
            return None
        return Old(found.theta, found.cov)

    def _bare(self, state: State) -> Estimate:
        """The estimate as it can be had within one step."""
        return self.estimate(state)

    def _witness(self, stage: Stage) -> Old | None:
        """Where no change is suspected."""
        arrays = stage.extra[self.own_arrays :]
        return unpacked(arrays) if arrays else None

    def _parts(self, state: State) -> tuple[Array, Array]:
        """The first samples, and those since the alarm."""
        x, kept = state.values, kept_samples(state)
        begin = len(kept) - int(x[slots.COUNT] - x[slots.SUSPECT])
        return kept[:begin], kept[begin:]

    def _look(self, state: State) -> State:
        """A slice of the look at the samples since the alarm; at its end, what follows."""
        x, stage = state
        if not x[slots.WORK_DONE]:
            x[slots.WORK_AT] = float(len(self._parts(state)[1]))
        task = stage.task or self._task(state)
        further = advanced(state, task)
        if further is not None:
            further.values[slots.DUE] = x[slots.COUNT] + 1.0
            return further
        return self._judged(state, task.result())

    def _task(self, state: State) -> Task:
        x, stage = state
        beginning, since = self._parts(state)
        begun_anew = bool(stage.blueprint.nuisance.free)
        present, witness = stage.extra[self.own_arrays :][:2], stage.extra[self.own_arrays + 2 :]
        return Task(
            looking, stage.setting, beginning, begun_anew, since[: int(x[slots.WORK_AT])],
            unpacked(witness), unpacked(present),
        )  # fmt: skip

    def _judged(self, state: State, verdict: WitnessVerdict) -> State:
        x, stage = state
        since, count = self._parts(state)[1], int(x[slots.WORK_AT])
        state = idle(state)
        own = stage.extra[: self.own_arrays]
        if not verdict.changed and count < DOUBTED * first_try(stage.setting):
            x[slots.DUE] = x[slots.COUNT] + max(2 * count - len(since), 1)
            arrays = (*own, *stage.extra[self.own_arrays :][:2], *packed(verdict.witness))
            return State(x, state.stage.but(extra=arrays))
        if not verdict.changed:
            wonted(stage.blueprint, x)
            return self._dropped(state, verdict.after)
        changes = (*stage.changes, int(x[slots.SUSPECT]) - 1 + verdict.begin)
        state = State(x, state.stage.but(changes=changes, doubt=None))
        if self.on_change == "flag":
            state = self._dropped(state, verdict.after)
        else:
            assert verdict.found is not None
            samples = np.vstack([verdict.samples, since[count:]])
            state = self.begun_again(state, verdict.found, samples)
            arrays = (*state.stage.extra[: self.own_arrays], *packed(verdict.after))
            state = State(state.values, state.stage.but(extra=arrays))
        told_changed(state.values)
        return state

    def _dropped(self, state: State, witness: Old | None) -> State:
        """No suspicion any more; what was kept for it goes, but where all samples are kept."""
        x, stage = state
        beginning, since = self._parts(state)
        all_kept = x[slots.SINCE] <= len(beginning) + len(since) < MOST_KEPT
        x[slots.SUSPECT] = x[slots.DUE] = 0.0
        x[slots.TICK], x[slots.OWN_TICK] = x[slots.OWN_TICK], 0.0
        calm(x, stage)
        if not all_kept:
            x, stage = roomed(state, False, (beginning,) if len(beginning) else ())
        arrays = (*stage.extra[: self.own_arrays], *(() if witness is None else packed(witness)))
        return State(x, stage.but(extra=arrays))


def _is_asked(state: State) -> bool:
    """Whether the first samples are being asked: work of its own, with no change suspected."""
    x, stage = state
    return bool(x[slots.WORK_AT] and not x[slots.SUSPECT] and not stage.searching)


def _set_tick(state: State) -> None:
    """The estimator ticks when the method or the work beside it is due, whichever is first."""
    x = state.values
    if x[slots.SUSPECT] or _is_asked(state):
        due = [x[slot] for slot in (slots.OWN_TICK, slots.DUE) if x[slot] >= x[slots.COUNT]]
        x[slots.TICK] = min(due, default=0.0)
