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
hundredth of their decay rate, the bank moves after them. As long as the first samples are still
kept (``samples``) they are run through the new bank, which is exact. Later the triangle and the
states go over to the new bank without a jump (`online.summary.transfer`); what is lost is of
third order in the distance.

*The beginning* is a search: the first samples are kept, and the off-line method looks for the model
in them, at first early and again with half as many samples more until it is certain of its poles.
``start`` gives a model instead; its bank stays until the samples tell the poles, since a bank on
poles that are mostly noise would miss part of the output. After an alarm (`online.kernels.intake`)
the same is done again, as the coefficients are others: ``on_change="flag"`` only raises the flag.

*Standard errors* are those of the minimum (`output_error.result`). With forgetting, the weights
``w`` of the samples make them larger by the square root of ``sum w^2 / sum w``, and the noise is
that of the samples remembered. Where the scores say that the noise is not white, their scatter
takes the place of the formula (`online.scatter`). They are right for coefficients that stand still
over the memory; for those that move, the lag comes on top.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import OptionError, TridentifyError, shown
from tridentify.estimate import Estimate
from tridentify.numerics.realization import Complex
from tridentify.numerics.threads import one_blas_thread
from tridentify.online.blueprint import (
    Blueprint,
    Nuisance,
    Setting,
    collecting,
    constants_for,
    fresh,
    parallel,
    watch_of,
    with_directions,
)
from tridentify.online.equation_plan import from_directions
from tridentify.online.kernels import slots
from tridentify.online.kernels.slots import DIRECTIONAL, EXPONENTIAL
from tridentify.online.scatter import (
    FEWEST,
    expect_scatter,
    keep_expected,
    scatter_of,
    take_scatter,
    turn_scatter,
)
from tridentify.online.seam import (
    Estimator,
    Kernels,
    check_choice,
    check_forgetting,
    check_owner,
    check_state,
    is_number,
    kept_samples,
    not_ready,
)
from tridentify.online.search import (
    Found,
    checked_start,
    far_off,
    first_try,
    judged_poles,
    next_try,
    poles_of_start,
    search,
)
from tridentify.online.starting import admissible, calm, run_kept, shortened, take_clocks, without
from tridentify.online.state import Stage, State
from tridentify.online.steps import (
    Solution,
    coefficients_of_directions,
    directions_of,
    estimate_of,
    solve_steps,
)
from tridentify.online.summary import carried, moved
from tridentify.transfer_function import TransferFunction

Array = NDArray[np.float64]

REPEATS = 3
ROUNDS = 3
CLEARLY = 10.0  # of -2 log L
NEAR = 0.01
SHARE = 0.5
QUARTER = 0.25
SHORTEST_TICK = 50
LEAST_SAMPLES = 100
ALARM_LASTS = 200
KINDS = {"exponential": EXPONENTIAL, "directional": DIRECTIONAL}


@dataclass(frozen=True)
class ThreeModel(Estimator):
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
    def kernels() -> Kernels:
        """The compiled sample loop."""
        from tridentify.online.kernels.parallel import parallel_step

        return Kernels(parallel_step, block_of_step_1)

    def __post_init__(self) -> None:
        check_forgetting(self.forgetting)
        check_choice("forget", self.forget, tuple(KINDS))
        check_choice("on_change", self.on_change, ("restart", "flag"))
        object.__setattr__(self, "start", checked_start(self.start))
        whole = isinstance(self.samples, int) and not isinstance(self.samples, bool)
        if not whole or self.samples < LEAST_SAMPLES:
            raise OptionError(
                f"found samples={shown(self.samples)}; expected a whole number of at least "
                f"{LEAST_SAMPLES}; leave it out or correct it"
            )
        if self.clock is not None and not (is_number(self.clock) and 0.0 < self.clock < np.inf):
            raise OptionError(
                f"found clock={shown(self.clock)}; expected a time above zero, in seconds; leave "
                "it out or correct it"
            )

    def begin(self, setting: Setting) -> State:
        """The state before the first sample."""
        if self.start is None:
            blueprint = collecting(setting)
            x = fresh(blueprint)
            x[slots.TICK] = first_try(setting)
            return State(x, Stage(self, setting, blueprint, blueprint.poles))
        poles = poles_of_start(self.start, setting)
        blueprint = self._plan(setting, poles, Nuisance.of(setting.structure, False), True)
        x = fresh(blueprint)
        x[slots.TICK] = first_try(setting)
        return State(x, Stage(self, setting, blueprint, poles, searching=False))

    def rebuilt(self, setting: Setting, blueprint: Blueprint) -> Blueprint:
        """The plan of a blueprint from a file, made again."""
        if not blueprint.poles.size:
            return collecting(setting)
        poles = blueprint.poles[: setting.n_poles]
        if not np.array_equal(blueprint.poles, np.tile(poles, REPEATS)):
            raise ValueError(f"a bank that is not {setting.n_poles} poles {REPEATS} times")
        nuisance = Nuisance.of(setting.structure, blueprint.nuisance.free)
        return self._plan(setting, poles, nuisance, bool(blueprint.ints[slots.CHUNK]))

    def is_ready(self, state: State) -> bool:
        """Whether a model has been found."""
        return not state.stage.searching

    def constants_for(self, blueprint: Blueprint, setting: Setting, intervals: Array) -> Array:
        """``c`` for samples that come after other intervals."""
        return constants_for(blueprint, setting, intervals)

    def tick(self, state: State) -> State:
        """Search, or follow the poles with filter and basis."""
        with one_blas_thread():
            return self._search(state) if state.stage.searching else self._follow(state)

    def alarmed(self, state: State) -> State:
        """Note the change; begin anew if so told."""
        x, stage = state
        here = int(x[slots.COUNT])
        changed = stage.but(changes=(*stage.changes, here - 1))
        x[slots.ALARM] = here + ALARM_LASTS
        x[slots.FLAGS] = float(int(x[slots.FLAGS]) | slots.CHANGED)
        if self.on_change == "flag":
            calm(x, stage)
            return State(x, changed)
        nuisance = Nuisance.of(stage.setting.structure, True)
        blueprint = self._plan(stage.setting, stage.poles, nuisance, True)
        anew = carried(stage.blueprint, x, blueprint)
        calm(anew, changed.but(blueprint=blueprint))
        anew[slots.FILLED] = 0.0
        anew[slots.SINCE] = 0.0
        anew[slots.FIRST] = 0.0
        anew[slots.BORN] = x[slots.TIME] + stage.setting.dt
        anew[slots.TICK] = here + first_try(stage.setting)
        return State(anew, changed.but(blueprint=blueprint, past=(), searching=True))

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
        check_state(state)
        check_owner(self, state.method)
        x, stage = state
        count = int(x[slots.COUNT])
        if stage.searching:
            raise not_ready(count, "are still searched for a model")
        try:
            with one_blas_thread():
                solution = solve_steps(
                    stage.setting, stage.blueprint, x, stage.poles,
                    choose=self.forgetting == 1.0, passes=1,
                )  # fmt: skip
                return estimate_of(
                    stage.setting, stage.blueprint, x, solution, self.name, stage.poles
                )
        except (TridentifyError, np.linalg.LinAlgError) as error:
            raise not_ready(count, "do not determine the coefficients") from error

    # ---------------------------------------------------------------------------- the slow clock
    def _plan(self, setting: Setting, poles: Complex, nuisance: Nuisance, keep: bool) -> Blueprint:
        return parallel(
            setting, np.tile(poles, REPEATS), nuisance, keep, self.forgetting, KINDS[self.forget]
        )

    def _next(self, x: Array, setting: Setting) -> float:
        """Sample at which the clock ticks next."""
        if self.clock is not None:
            return float(x[slots.COUNT] + max(round(self.clock / setting.dt), 1))
        wait = SHARE * float(x[slots.SINCE])
        if self.forgetting < 1.0:
            wait = min(wait, max(QUARTER / (1.0 - self.forgetting), SHORTEST_TICK))
        return float(x[slots.COUNT] + max(np.ceil(wait), SHORTEST_TICK // 2))

    def _search(self, state: State) -> State:
        x, stage = state
        setting = stage.setting
        samples = far_off(setting, kept_samples(state))
        begun_anew = x[slots.COUNT] > len(samples)
        found = search(setting, samples, begun_anew)
        full = len(samples) >= self.samples
        if found is None or not (found.certain or full):
            x[slots.TICK] = x[slots.COUNT] + next_try(len(samples)) - len(samples)
            if full:
                return shortened(state, samples)
            return state
        for i in range(setting.n_outputs):
            x[watch_of(stage.blueprint, i) + slots.SCALE] = found.noise_std[i]
        nuisance = Nuisance.of(setting.structure, begun_anew)
        x[slots.FILLED] = 0.0
        state = State(x, stage.but(past=(samples,)))
        launched, flags = self._run_again(state, found.poles, nuisance, samples)
        for _ in range(ROUNDS):
            kept = without(samples, flags, setting.n_inputs)
            found = None if kept is None else search(setting, kept, begun_anew)
            if kept is None or found is None:
                break
            samples = kept
            cleaned = x.copy()
            cleaned[slots.FILLED] = 0.0
            for i in range(setting.n_outputs):
                cleaned[watch_of(stage.blueprint, i) + slots.SCALE] = found.noise_std[i]
            again = State(cleaned, stage.but(past=(samples,)))
            launched, flags = self._run_again(again, found.poles, nuisance, samples)
        return launched

    def _run_again(
        self, state: State, poles: Complex, nuisance: Nuisance, samples: Array
    ) -> tuple[State, NDArray[np.int64]]:
        """The samples that were kept, through the bank of other poles; and their flags."""
        old, stage = state
        setting = stage.setting
        near = admissible(setting, poles, samples)
        blueprint = self._plan(setting, near, nuisance, True)
        x = fresh(blueprint)
        for i in range(setting.n_outputs):
            was = watch_of(stage.blueprint, i)
            x[watch_of(blueprint, i) + slots.SCALE] = old[was + slots.SCALE]
        equilibrium = blueprint.ints[slots.EQUILIBRIUM]
        if equilibrium and nuisance.free:
            at, m = int(blueprint.ints[slots.AT_REFERENCE]), setting.n_inputs
            x[at : at + m] = old[at : at + m]
            x[slots.COUNT] = 1.0
        flags = run_kept(self, setting, blueprint, x, samples)
        take_clocks(old, stage.blueprint, x, blueprint, len(samples))
        head, width = int(blueprint.ints[slots.AT_CHUNK]), samples.shape[1]
        count = int(old[slots.FILLED]) * width
        was = int(stage.blueprint.ints[slots.AT_CHUNK])
        x[head : head + count] = old[was : was + count]
        calm(x, stage.but(blueprint=blueprint))
        x[slots.TICK] = self._next(x, setting)
        try:
            solution = solve_steps(setting, blueprint, x, near, choose=False)
        except (TridentifyError, np.linalg.LinAlgError):
            return State(x, stage.but(blueprint=blueprint, poles=near, searching=False)), flags
        found = with_directions(blueprint, directions_of(setting, blueprint, solution))
        poles = solution.point.poles
        again = fresh(found)
        for i in range(setting.n_outputs):
            w = watch_of(found, i)
            again[w + slots.SCALE] = x[w + slots.SCALE]
        run_kept(self, setting, found, again, samples)
        take_scatter(found, again, found, x)
        if self._is_certain(stage.but(blueprint=found, poles=poles), x, solution):
            # later, a change among the kept samples would pass for what is usual
            late = scatter_of(found, x, 0).blocks[0] > FEWEST and not stage.searching
            if late:
                keep_expected(stage.blueprint, old, found, x)
            else:
                expect_scatter(found, x)
        return State(x, stage.but(blueprint=found, poles=poles, searching=False)), flags

    def _is_certain(self, stage: Stage, x: Array, solution: Solution) -> bool:
        """Whether the samples tell the poles; a bank on poles that are mostly noise loses more."""
        try:
            found = estimate_of(stage.setting, stage.blueprint, x, solution, self.name, stage.poles)
        except (TridentifyError, np.linalg.LinAlgError):
            return False
        judged = judged_poles(found, stage.setting)
        return judged is not None and judged.certain

    def _found_better(self, state: State, solution: Solution) -> Found | None:
        """What a search of the kept samples finds, if it explains them clearly better.

        The poles of an early search or of ``start`` can lie in a valley of their own, which steps
        downhill do not leave: the samples are searched once more before they are dropped, and as
        long as they do not tell the poles.
        """
        x, stage = state
        samples = far_off(stage.setting, kept_samples(state))
        found = search(stage.setting, samples, x[slots.COUNT] > len(samples))
        if found is None or not found.certain:
            return None
        point = solution.point
        gain = np.log(point.rss / point.counts) - 2.0 * np.log(found.noise_std)
        return found if float(point.counts @ gain) > CLEARLY else None

    def _follow(self, state: State) -> State:
        x, stage = state
        setting = stage.setting
        x[slots.TICK] = self._next(x, setting)
        try:
            solution = solve_steps(setting, stage.blueprint, x, stage.poles, choose=False, passes=1)
        except (TridentifyError, np.linalg.LinAlgError):
            return state
        poles = solution.point.poles
        if not np.all(np.isfinite(poles)):
            return state
        bank = stage.blueprint.poles[: poles.size]
        distance = _distance(poles, bank)
        nuisance = stage.blueprint.nuisance
        kept = bool(stage.blueprint.ints[slots.CHUNK])
        early = kept and x[slots.SINCE] <= self.samples
        certain = not kept or self._is_certain(stage, x, solution)
        if kept and not (early and certain):
            better = self._found_better(state, solution)
            if better is not None:
                return self._run_again(state, better.poles, nuisance, kept_samples(state))[0]
        if early and not certain:
            return state
        if early and distance > NEAR:
            return self._run_again(state, poles, nuisance, kept_samples(state))[0]
        own = coefficients_of_directions(setting)
        now, before = (from_directions(setting, one) for one in (poles, stage.poles))
        turn_scatter(
            stage.blueprint, x, own, np.asarray(np.linalg.solve(before, now), dtype=np.float64)
        )
        if distance <= NEAR and (early or not kept):
            judged = directions_of(setting, stage.blueprint, solution)
            blueprint = with_directions(stage.blueprint, judged)
            return State(x, stage.but(blueprint=blueprint, poles=poles))
        base = poles if distance > NEAR else bank
        blueprint = self._plan(setting, base, nuisance, False)
        if distance > NEAR:
            x = moved(stage.blueprint, x, blueprint)
        else:
            x = without_chunk(stage.blueprint, x, blueprint)
        blueprint = with_directions(blueprint, directions_of(setting, blueprint, solution))
        return State(x, stage.but(blueprint=blueprint, poles=poles, past=()))


def block_of_step_1() -> Callable[..., int]:
    """The compiled block; compiled, or read from disk, at the first call."""
    from tridentify.online.kernels.parallel_block import parallel_block

    return parallel_block


def without_chunk(old: Blueprint, x: Array, new: Blueprint) -> Array:
    """The same estimator with no room for samples any more."""
    found = carried(old, x, new)
    begin, to = int(old.ints[slots.AT_WATCH]), int(new.ints[slots.AT_WATCH])
    found[to:] = x[begin:]
    return found


def _distance(poles: Complex, bank: Complex) -> float:
    """Largest move of a pole over its decay rate."""
    rates = np.maximum(-bank.real, 1e-6 * np.abs(bank))
    return float(np.max(np.abs(poles - bank) / rates))
