"""The three models on-line: Step 1 with every sample, Steps 2 to 4 on all that it has gathered.

*Step 1* runs with the samples (`online.kernels.parallel`): a bank of operators on the poles of the
present model, each three times, driven by the input alone. The triangle of its least-squares
problem is brought up to date by Givens rotations, with a forgetting factor if one is given. Its
regressors hold no noise, so it is unbiased, and the rotations make it the exact solution at every
sample.

*Steps 2 to 4* are convex problems on the output of Step 1, which is a combination of the states
of the bank. They are solved from its triangle (`online.summary`) when the slow clock ticks and
when an estimate is asked for: Step 2 with the filter ``c = a_hat``, Step 1 again on the new
poles, and so on to the minimum of the output error; Step 3 checks it. They see all samples that
the triangle remembers, with the present filter and basis, as if these had been there from the
beginning. A cascade that adapts each model with every sample instead (`online.Gradient`) carries
what its early stages got wrong. With no forgetting the estimate is that of the off-line method.

*The slow clock* ticks after half as many samples again as there were, or, with forgetting, after
a quarter of what is remembered. Where the poles have moved from those of the bank by more than a
hundredth of their decay rate, the bank moves after them (`online.launch`). As long as the first
samples are still kept (``samples``) they are run through the new bank, which is exact. Later the
triangle and the states go over to the new bank without a jump (`online.summary.transfer`); what is
lost is of third order in the distance.

*The beginning* is a search: the first samples are kept, and the off-line method looks for the model
in them, at first early and again with a third more samples until it is certain of its poles
and the input explains what coloured noise does not (`online.launch`). ``start`` gives a model
instead; its bank stays until the samples tell the poles, since a bank on poles that are mostly
noise would miss part of the output.

*Beside the stream.* Searches and what the clock asks for are done in slices, one a sample
(`online.task`), so that no sample waits for them. An estimate that is asked for during the first
search waits for its end.

*A change.* An alarm (`online.kernels.intake`) is a suspicion. The model goes on with all samples
until another one, found in those since the alarm, explains them clearly better
(`online.suspicion`); then that takes its place, or, with ``on_change="flag"``, the flag is raised
and no more. Where nothing is forgotten the slow clock asks for such a look too, without an alarm:
noise that comes and goes hides a change from the alarm, and the more so the longer it has lasted.

*Standard errors* are those of the minimum (`likelihood.answer`). With forgetting, the weights
``w`` of the samples make them larger by the square root of ``sum w^2 / sum w``, and the noise is
that of the samples remembered. Where the scores say that the noise is not white, their scatter
takes the place of the formula (`online.scatter`); as long as all samples are kept they are no
smaller than what these say with a model of the noise (`online.second_look`). They are right for
coefficients that stand still over the memory; for those that move, the lag comes on top.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.methods.base import check_count
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.slices import drain
from tridentify.numerics.threads import one_blas_thread
from tridentify.online import launch, layout
from tridentify.online.asked import (
    check_above_zero,
    check_choice,
    check_forgetting,
    not_ready,
    still_searched,
)
from tridentify.online.estimator import CompiledKernels, check_asked, kept_samples
from tridentify.online.findings import with_findings
from tridentify.online.kernels import slots
from tridentify.online.kernels.slots import DIRECTIONAL, EXPONENTIAL
from tridentify.online.saved.state import State
from tridentify.online.scatter import wonted
from tridentify.online.search import DOUBTED, TRIED, checked_start, first_try, poles_of_start
from tridentify.online.starting import (
    advanced,
    again,
    calm,
    idle,
    roomed,
    shortened,
    told_changed,
    waiting,
)
from tridentify.online.steps import estimate_of, solve_steps
from tridentify.online.suspicion import Look, Old, packed, trying, unpacked
from tridentify.online.task import Task
from tridentify.online.unexplained import doubt_finding, doubting
from tridentify.transfer_function import TransferFunction

REPEATS = 3
"""How often each pole stands in the bank: twice for the model and its slopes, and once for a move
of them."""
SHARE = 0.5
"""Samples to the next tick over those so far: the work grows with their logarithm."""
QUARTER = 0.25
"""The same over the memory, where old samples are forgotten."""
SHORTEST_TICK = 50
"""Samples between two ticks at least."""
LEAST_SAMPLES = 100
"""Samples that are kept for the first search at least."""
LOOKS = 3
"""Looks that the slow clock asks for one after the other: one alone may fall into a burst of
noise."""
KINDS = {"exponential": EXPONENTIAL, "directional": DIRECTIONAL}


@dataclass(frozen=True)
class ThreeModel(launch.Planner):
    """The three-model strategy, one sample at a time.

    Parameters
    ----------
    forgetting : float
        Factor by which the past counts less with every sample; 1 forgets nothing, ``1 / (1 -
        forgetting)`` samples are remembered.
    forget : {"exponential", "directional"}
        Whether all of the past fades (as long as the input renews it), or only what the new sample
        speaks of: one direction in the space of the unknowns, so that the same factor remembers as
        many times longer as there are unknowns.
    start : TransferFunction or Estimate, optional
        Model to begin with; without it the first samples are searched.
    samples : int
        How many of the first samples are kept for the search and for the first moves of the bank.
    on_change : {"restart", "flag"}
        Whether a change of the coefficients makes the estimator begin anew, or is only flagged.
    clock : float, optional
        Time between two adaptations of filter and basis [s]; without it, as the module says.

    Raises
    ------
    OptionError
        An option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, online, simulate
    >>> u = np.sign(np.sin(np.arange(300) ** 1.5))
    >>> y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.02))[:, 0]
    >>> method = online.ThreeModel()
    >>> state = method.init(Structure(1, 0), dt=0.02)
    >>> for u_k, y_k in zip(u.tolist(), y.tolist()):
    ...     state, innovation = method.step(state, u_k, y_k)
    >>> round(method.estimate(state).parameters["a0"].value, 6)
    4.0
    """

    forgetting: float = 1.0
    forget: str = "exponential"
    start: TransferFunction | None = None
    samples: int = 2000
    on_change: str = "restart"
    clock: float | None = None

    name: ClassVar[str] = "three-model"

    @staticmethod
    @cache
    def kernels() -> CompiledKernels:
        """The compiled sample loop."""
        from tridentify.online.kernels.parallel import parallel_step

        return CompiledKernels(parallel_step, in_blocks=True)

    def __post_init__(self) -> None:
        check_forgetting(self.forgetting)
        check_choice("forget", self.forget, tuple(KINDS))
        check_choice("on_change", self.on_change, ("restart", "flag"))
        object.__setattr__(self, "start", checked_start(self.start))
        check_count("samples", self.samples, LEAST_SAMPLES)
        check_above_zero("clock", self.clock, "seconds")

    def begin(self, setting: layout.Setting) -> State:
        """The state before the first sample."""
        if self.start is None:
            return waiting(self, setting)
        poles = poles_of_start(self.start, setting)
        blueprint = self.plan(
            setting, poles, layout.NuisanceColumns.of(setting.structure, False), True
        )
        x = layout.fresh(blueprint)
        x[slots.TICK] = first_try(setting)
        return State(x, layout.Stage(self, setting, blueprint, poles, searching=False))

    def rebuilt(self, setting: layout.Setting, blueprint: layout.Blueprint) -> layout.Blueprint:
        """The plan of a blueprint from a file, made again."""
        if not blueprint.poles.size:
            return layout.collecting(setting)
        poles = blueprint.poles[: setting.n_poles]
        if not np.array_equal(blueprint.poles, np.tile(poles, REPEATS)):
            raise ValueError(f"a bank that is not {setting.n_poles} poles {REPEATS} times")
        nuisance = layout.NuisanceColumns.of(setting.structure, blueprint.nuisance.free)
        return self.plan(setting, poles, nuisance, bool(blueprint.ints[slots.CHUNK]))

    def is_ready(self, state: State) -> bool:
        """Whether a model has been found."""
        return not state.stage.searching

    def tick(self, state: State) -> State:
        """A slice of the search, or of the look at where the poles have moved."""
        x, stage = state
        begin = not x[slots.WORK_DONE]
        if begin:
            x[slots.WORK_AT] = float(len(self._samples(state)))
            if not stage.searching and not x[slots.SUSPECT]:
                state = State(x, stage.but(extra=(x.copy(), *_witness(stage))))
        task = state.stage.task or self._task(state)
        further = advanced(state, task)
        if further is not None:
            return further
        with one_blas_thread():
            return self._gone_on(state, task.result())

    def _samples(self, state: State) -> Array:
        """The kept samples that the work is about: of a suspicion, those since."""
        x, kept = state.values, kept_samples(state)
        if not x[slots.SUSPECT]:
            return kept
        return kept[len(kept) - int(x[slots.COUNT] - x[slots.SUSPECT]) :]

    def _before(self, state: State) -> Array:
        """The samples before those of a suspicion, where all of them are kept."""
        kept, since = kept_samples(state), len(self._samples(state))
        whole = state.values[slots.SINCE] <= len(kept)
        return kept[: len(kept) - since if whole else 0]

    def _task(self, state: State) -> Task:
        """The work that is under way, from its beginning."""
        x, stage = state
        setting, reference = stage.setting, launch.reference_of(state)
        count, begun_anew = int(x[slots.WORK_AT]), x[slots.COUNT] > len(kept_samples(state))
        samples = self._samples(state)[:count]
        if stage.searching:
            full = count >= self.samples
            return Task(
                launch.searching_launch, self, setting, samples, begun_anew, full, reference
            )
        plan = (self, setting, stage.blueprint, stage.poles, stage.extra[0])
        if x[slots.SUSPECT]:
            witness = _witness(stage)
            old = unpacked(witness) if witness else None
            before = self._before(state)
            return Task(trying, *plan, before, samples, reference, old, not x[slots.LOOK])
        return Task(launch.following, *plan, samples, reference, begun_anew)

    def _gone_on(self, state: State, found: launch.Launch | launch.Followed | Look | None) -> State:
        """What the work has come to."""
        x, stage = state
        samples = self._samples(state)
        rest = samples[int(x[slots.WORK_AT]) :]
        state = idle(state)
        if x[slots.SUSPECT]:
            assert isinstance(found, Look)
            return self._judged(state, found, samples, rest)
        if isinstance(found, launch.Followed) and found.doubt is not None:
            state = State(state.values, state.stage.but(doubt=found.doubt))
        to = found.to if isinstance(found, launch.Followed) else found
        if isinstance(to, launch.Launch):
            x, new = launch.launched(self, state, to, rest)
            if stage.searching:
                return State(x, new)
            return self._looking(State(x, new.but(extra=_witness(stage))), to.certain)
        if stage.searching:
            if len(samples) - len(rest) >= self.samples:
                return shortened(state, samples)
            again(x, len(samples), len(rest))
            return state
        x[slots.TICK], x[slots.OWN_TICK] = self.next_tick(x, stage.setting), 0.0
        state = State(x, state.stage.but(extra=_witness(stage)))
        return self._looking(
            launch.turned(state, to) if isinstance(to, launch.Turn) else state, True
        )

    # ------------------------------------------------------------------------------- a change
    def _looking(self, state: State, certain: bool) -> State:
        """Look for a change without an alarm, if there are samples enough before it."""
        since = state.values[slots.SINCE]
        if certain and since > self.samples and state.stage.blueprint.ints[slots.CHUNK]:
            state = roomed(state, False, ())
        own_pace = self.forgetting == 1.0 and self.clock is None
        enough = since >= DOUBTED * first_try(state.stage.setting)
        return self._suspecting(state, False) if own_pace and enough else state

    def alarmed(self, state: State) -> State:
        """Suspect a change: keep the samples from here on (`online.suspicion`)."""
        x, stage = state
        calm(x, stage)
        if stage.searching or (x[slots.SUSPECT] and not x[slots.LOOK]):
            return state
        # what a suspicion has held up is not held up once more
        if x[slots.OWN_TICK] and not x[slots.SUSPECT]:
            return state
        state = idle(state)
        if x[slots.SUSPECT]:
            pair = _witness(stage)
            state = self._dropped(state, unpacked(pair) if pair else None)
        return self._suspecting(state, True)

    def _suspecting(self, state: State, alarm: bool) -> State:
        """Samples are kept from here on, for a look at them."""
        if not state.stage.blueprint.ints[slots.CHUNK]:
            state = roomed(state, True, ())
        x, stage = state
        here = x[slots.COUNT]
        wait = (TRIED if alarm else DOUBTED) * first_try(stage.setting)
        x[slots.LOOK] = 0.0 if alarm else here
        # of an alarm: when the clock was due, which it will be as soon as the suspicion is over
        x[slots.OWN_TICK if alarm else slots.FIRST_LOOK] = x[slots.TICK] if alarm else here
        x[slots.SUSPECT], x[slots.TICK] = here, here + wait
        extra = (x.copy(), *_witness(stage))
        return State(x, stage.but(extra=extra, task=None))

    def _judged(self, state: State, found: Look, samples: Array, rest: Array) -> State:
        """A suspicion that was looked into: a change, none, or not known yet."""
        x, stage = state
        count = int(x[slots.COUNT])
        if found.launch is not None:
            at = int(x[slots.SUSPECT]) - 1 + found.begin
            changed = stage.but(changes=(*stage.changes, at), doubt=None)
            if self.on_change == "restart":
                state = launch.launched(self, State(x, changed), found.launch, rest)
            else:
                state = self._dropped(State(x, changed), found.after)
            x = state.values
            told_changed(x)
            return state
        if found.doubt is not None:
            state = State(x, stage := stage.but(doubt=found.doubt))
        if len(samples) >= DOUBTED * first_try(stage.setting):
            looked = count - x[slots.FIRST_LOOK]
            if not x[slots.LOOK]:
                wonted(stage.blueprint, x)
            elif looked < LOOKS * DOUBTED * first_try(stage.setting):
                first = x[slots.FIRST_LOOK]
                state = self._suspecting(self._dropped(state, found.after), False)
                state.values[slots.FIRST_LOOK] = first
                return state
            return self._dropped(state, found.after)
        x[slots.TICK] = count + max(len(samples) - 2 * len(rest), 1)
        return state

    def _dropped(self, state: State, witness: Old | None) -> State:
        """No suspicion any more; samples are kept only where all of them are."""
        x, stage = state
        asked = bool(x[slots.LOOK])
        looked = x[slots.COUNT] - x[slots.FIRST_LOOK] if asked else 0.0
        waiting = np.inf if asked else x[slots.OWN_TICK]
        if not looked:
            calm(x, stage)
        x[slots.SUSPECT] = x[slots.LOOK] = x[slots.FIRST_LOOK] = 0.0
        if x[slots.SINCE] > len(kept_samples(state)):
            x, stage = roomed(state, False, ())
        # a look does not hold the clock up: alarm after alarm would keep the poles where they are
        due = min(self.next_tick(x, stage.setting) - (1.0 + SHARE) * looked, waiting)
        x[slots.OWN_TICK] = waiting if waiting <= x[slots.COUNT] else 0.0
        x[slots.TICK] = max(np.ceil(due), x[slots.COUNT] + SHORTEST_TICK // 2)
        return State(x, stage.but(extra=() if witness is None else packed(witness)))

    def estimate(self, state: State) -> Estimate:
        """The coefficients with their standard errors.

        Parameters
        ----------
        state : State

        Returns
        -------
        Estimate

        Raises
        ------
        NotReadyError
            The samples so far do not determine them.
        """
        check_asked(self, state)
        count = int(state.values[slots.COUNT])
        if state.stage.searching:
            state = self._found_already(state)
        x, stage = state
        try:
            with one_blas_thread():
                solution = solve_steps(
                    stage.setting, stage.blueprint, x, stage.poles,
                    choose=self.forgetting == 1.0, passes=1,
                )  # fmt: skip
                samples = self._again(state)
                found = estimate_of(
                    stage.setting, stage.blueprint, x, solution, self.name, stage.poles, samples
                )
                if samples is None:
                    found = self._asked(state, found)
        except (TridentifyError, np.linalg.LinAlgError) as error:
            raise not_ready(count, "do not determine the coefficients") from error
        return with_findings(state, found)

    def _again(self, state: State) -> Array | None:
        """All samples of the model, if they are kept and count alike."""
        since, kept = int(state.values[slots.SINCE]), kept_samples(state)
        if since > len(kept) or since * (1.0 - self.forgetting) > 1.0:
            return None
        return kept[len(kept) - since :]

    def _asked(self, state: State, found: Estimate) -> Estimate:
        """With what the newest samples say against it, if all are kept but do not count alike."""
        since, kept = int(state.values[slots.SINCE]), kept_samples(state)
        if since > len(kept):
            return found
        newest = launch.remembered(kept[len(kept) - since :], self.forgetting)
        doubt = drain(doubting(state.stage.setting, newest, found.theta, found.std))
        told = () if doubt is None else (doubt_finding(doubt),)
        return replace(found, findings=(*told, *found.findings))

    def _found_already(self, state: State) -> State:
        """What the search under way comes to, if it is asked for before its time."""
        x, stage = state
        if x[slots.WORK_DONE]:
            found = (stage.task or self._task(state)).result()
            if isinstance(found, launch.Launch):
                rest = kept_samples(state)[len(found.samples) :]
                with one_blas_thread():
                    return launch.launched(self, State(x.copy(), stage), found, rest)
        raise still_searched(int(x[slots.COUNT]), len(stage.setting.structure.names()))

    # ---------------------------------------------------------------------------- the slow clock
    def plan(
        self, setting: layout.Setting, poles: Complex, nuisance: layout.NuisanceColumns, keep: bool
    ) -> layout.Blueprint:
        """Step 1 on poles, each as often as a move of them asks for; ``keep``: with the samples."""
        return layout.parallel(
            setting, np.tile(poles, REPEATS), nuisance, keep, self.forgetting, KINDS[self.forget]
        )

    def next_tick(self, x: Array, setting: layout.Setting) -> float:
        """Sample at which the clock ticks next."""
        if self.clock is not None:
            return float(x[slots.COUNT] + max(round(self.clock / setting.dt), 1))
        wait = SHARE * float(x[slots.SINCE])
        if self.forgetting < 1.0:
            wait = min(wait, max(QUARTER / (1.0 - self.forgetting), SHORTEST_TICK))
        return float(x[slots.COUNT] + max(np.ceil(wait), SHORTEST_TICK // 2))


def _witness(stage: layout.Stage) -> tuple[Array, ...]:
    """What earlier looks at changes have come to, packed; none before the first."""
    return stage.extra[len(stage.extra) % 2 :]
