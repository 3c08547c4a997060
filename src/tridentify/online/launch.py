"""A model found in samples that were kept becomes an estimator that goes on from them.

What the slow clock does once there is a model: filter and basis follow its poles.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.choose_nuisance import Finished
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.slices import Slices
from tridentify.online import layout, scatter, steps
from tridentify.online.equation_plan import from_directions
from tridentify.online.estimator import Estimator
from tridentify.online.kernels import slots
from tridentify.online.residual import is_driven
from tridentify.online.saved.state import State
from tridentify.online.search import FoundPoles, far_off, judged_poles, record_of, searching
from tridentify.online.starting import admissible, calm, rearranged, run_kept, take_clocks, without
from tridentify.online.summary import moved
from tridentify.online.unexplained import doubting

MOVE_ROUNDS = 3
"""Times that the search is repeated without the samples that its model finds doubtful."""


class Planner(Estimator):
    """An estimator that is launched, followed and suspected: what is asked of it."""

    samples: int

    @abstractmethod
    def plan(
        self, setting: layout.Setting, poles: Complex, nuisance: layout.NuisanceColumns, keep: bool
    ) -> layout.Blueprint:
        """Step 1 on poles, each as often as a move of them asks for; ``keep``: with the samples."""

    @abstractmethod
    def next_tick(self, x: Array, setting: layout.Setting) -> float:
        """Sample at which the clock ticks next."""


@dataclass(frozen=True, eq=False)
class Launch:
    """How to go on from kept samples.

    Attributes
    ----------
    blueprint : Blueprint
    poles : (n,) complex array
        Of the model.
    noise_std : (n_outputs,) array
    samples : (k, n_inputs + n_outputs + 1) array
        The kept samples, without those that were found doubtful.
    certain : bool
        Whether they tell the poles.
    """

    blueprint: layout.Blueprint
    poles: Complex
    noise_std: Array
    samples: Array
    certain: bool


def searching_launch(
    method: Planner,
    setting: layout.Setting,
    samples: Array,
    begun_anew: bool,
    full: bool,
    reference: Array,
) -> Slices[Launch | None]:
    """Search kept samples for a model, without those that it finds doubtful; None if unsure.

    Parameters
    ----------
    method : Planner
    setting : Setting
    samples : (k, n_inputs + n_outputs + 1) array
    begun_anew : bool
        Whether they begin in the middle, from any state.
    full : bool
        Whether there will be no more of them, so that any model will do.
    reference : (n_inputs,) array
        Trim input.
    """
    samples = yield from far_off(setting, samples)
    found = yield from searching(setting, samples, begun_anew)
    if found is None or not (found.certain or full):
        return None
    yield
    if not is_driven(setting, record_of(setting, samples), found.estimate.theta):
        return None
    nuisance = layout.NuisanceColumns.of(setting.structure, begun_anew)
    launch, flags = yield from launching(
        method, setting, found.poles, nuisance, samples, found.noise_std, reference
    )
    for _ in range(MOVE_ROUNDS):
        kept = without(samples, flags, setting.n_inputs)
        if kept is None:
            break
        found = yield from searching(setting, kept, begun_anew)
        if found is None:
            break
        samples = kept
        launch, flags = yield from launching(
            method, setting, found.poles, nuisance, samples, found.noise_std, reference
        )
    return launch


def launching(
    method: Planner,
    setting: layout.Setting,
    poles: Complex,
    nuisance: layout.NuisanceColumns,
    samples: Array,
    noise_std: Array,
    reference: Array,
) -> Slices[tuple[Launch, Indices]]:
    """The kept samples through the bank of other poles; and their flags."""
    near = admissible(setting, poles, samples)
    blueprint = method.plan(setting, near, nuisance, True)
    x = begun(blueprint, noise_std, reference)
    yield
    flags = run_kept(method, setting, blueprint, x, samples)
    try:
        solution = yield from steps.solving(setting, blueprint, x, near, choose=False)
    except (TridentifyError, np.linalg.LinAlgError):
        return Launch(blueprint, near, noise_std, samples, False), flags
    poles = solution.point.poles
    found = layout.with_directions(blueprint, steps.directions_of(setting, blueprint, solution))
    yield
    x = begun(found, noise_std, reference)
    run_kept(method, setting, found, x, samples)
    yield
    certain = is_certain(setting, found, x, solution, poles)
    return Launch(found, poles, noise_std, samples, certain), flags


def begun(blueprint: layout.Blueprint, noise_std: Array, reference: Array) -> Array:
    """The vector before the first kept sample."""
    x = layout.fresh(blueprint)
    for i, one in enumerate(noise_std.tolist()):
        x[layout.watch_of(blueprint, i) + slots.SCALE] = one
    if blueprint.ints[slots.EQUILIBRIUM] and blueprint.nuisance.free:
        at = int(blueprint.ints[slots.AT_REFERENCE])
        x[at : at + reference.size] = reference
        x[slots.COUNT] = 1.0
    return x


def launched(method: Planner, state: State, launch: Launch, rest: Array) -> State:
    """The estimator that goes on from the kept samples, and those that came meanwhile.

    Parameters
    ----------
    method : Planner
    state : State
        As it is now.
    launch : Launch
    rest : (k, n_inputs + n_outputs + 1) array
        Samples since those of the launch.
    """
    old, stage = state
    setting, blueprint = stage.setting, launch.blueprint
    samples = np.vstack([launch.samples, rest])
    x = begun(blueprint, launch.noise_std, reference_of(state))
    run_kept(method, setting, blueprint, x, samples)
    take_clocks(old, stage.blueprint, x, blueprint, len(samples))
    x[slots.FILLED] = 0.0
    new = stage.but(
        blueprint=blueprint, poles=launch.poles, past=(samples,), searching=False, task=None,
        extra=(),
    )  # fmt: skip
    calm(x, new)
    x[slots.TICK] = method.next_tick(x, setting)
    if launch.certain:
        # later, a change among the kept samples would pass for what is usual
        late = (
            scatter.scatter_of(blueprint, x, 0).blocks[0] > scatter.FEWEST and not stage.searching
        )
        if late or old[slots.SUSPECT] > 0.0:
            scatter.keep_expected(stage.blueprint, old, blueprint, x)
        else:
            scatter.expect_scatter(blueprint, x)
    return State(x, new)


def reference_of(state: State) -> Array:
    """(n_inputs,) trim input of a state."""
    x, stage = state
    at = int(stage.blueprint.ints[slots.AT_REFERENCE])
    return x[at : at + stage.setting.n_inputs].copy()


def noise_std_of(blueprint: layout.Blueprint, x: Array) -> Array:
    """(n_outputs,) scale of the noise in a vector."""
    count = int(blueprint.ints[slots.OUTPUTS])
    return np.array([x[layout.watch_of(blueprint, i) + slots.SCALE] for i in range(count)])


def is_certain(
    setting: layout.Setting,
    blueprint: layout.Blueprint,
    x: Array,
    solution: Finished,
    poles: Complex,
) -> bool:
    """Whether the samples tell the poles; a bank on poles that are mostly noise loses more."""
    try:
        found = steps.estimate_of(setting, blueprint, x, solution, "", poles)
    except (TridentifyError, np.linalg.LinAlgError):
        return False
    judged = judged_poles(found, setting)
    return judged is not None and judged.certain


NEAR = 0.01
"""Relative distance of poles up to which they stay where they are: the bank holds them three times,
so that the model is right to its square."""
CLEARLY = 10.0  # of -2 log L
TAKEN = 0.8  # of the samples, for a model that explains them
MEMORIES = 5  # of forgetting: older samples have less than a hundredth of the newest's weight


@dataclass(frozen=True, eq=False)
class Turn:
    """The same samples seen with new sensitivities, and perhaps on another bank.

    Attributes
    ----------
    poles : (n,) complex array
        Of the model.
    blueprint : Blueprint
        With the new sensitivities.
    move : bool
        Whether the bank is another.
    """

    poles: Complex
    blueprint: layout.Blueprint
    move: bool


class Followed(NamedTuple):
    """What the slow clock has come to.

    Attributes
    ----------
    to : Launch, Turn or None
        How to go on; None leaves all as it is.
    doubt : Doubt or None
        What speaks against the model in samples that are about to be dropped.
    """

    to: Launch | Turn | None
    doubt: layout.Doubt | None


def following(
    method: Planner,
    setting: layout.Setting,
    blueprint: layout.Blueprint,
    before: Complex,
    x: Array,
    samples: Array,
    reference: Array,
    begun_anew: bool,
) -> Slices[Followed]:
    """Look where the poles are, and say how to go on.

    Parameters
    ----------
    method : Planner
    setting : Setting
    blueprint : Blueprint
    before : (n,) complex array
        Poles of the model so far.
    x : array
        Of the estimator.
    samples : (k, n_inputs + n_outputs + 1) array
        Those that are kept; none where they were dropped.
    reference : (n_inputs,) array
        Trim input.
    begun_anew : bool
        Whether the samples begin in the middle.
    """
    try:
        solution = yield from steps.solving(setting, blueprint, x, before, choose=False, passes=1)
    except (TridentifyError, np.linalg.LinAlgError):
        return Followed(None, None)
    if not np.all(np.isfinite(solution.point.poles)):
        return Followed(None, None)
    to, better = yield from _where_to(
        method, setting, blueprint, before, x, samples, reference, begun_anew, solution
    )
    if not blueprint.ints[slots.CHUNK] or x[slots.SINCE] <= method.samples:
        return Followed(to, None)
    yield
    try:
        model = better or steps.estimate_of(setting, blueprint, x, solution, "", before)
    except (TridentifyError, np.linalg.LinAlgError):
        return Followed(to, None)
    newest = remembered(samples, float(blueprint.constants[slots.FORGETTING]))
    return Followed(to, (yield from doubting(setting, newest, model.theta, model.std)))


def _where_to(
    method: Planner,
    setting: layout.Setting,
    blueprint: layout.Blueprint,
    before: Complex,
    x: Array,
    samples: Array,
    reference: Array,
    begun_anew: bool,
    solution: Finished,
) -> Slices[tuple[Launch | Turn | None, Estimate | None]]:
    """Launch, turn or None to leave all as it is; and a better model, where it is one's launch."""
    poles = solution.point.poles
    bank = blueprint.poles[: poles.size]
    distance, nuisance = steps.distance_of(poles, bank), blueprint.nuisance
    kept = bool(blueprint.ints[slots.CHUNK])
    early = kept and x[slots.SINCE] <= method.samples
    yield
    certain = not kept or is_certain(setting, blueprint, x, solution, before)
    to, begin, better = None, nuisance, None
    if kept and not (early and certain):
        factor = float(blueprint.constants[slots.FORGETTING])
        newest = remembered(samples, factor)
        if len(newest) < len(samples):
            samples, begun_anew = newest, True
            begin = layout.NuisanceColumns.of(setting.structure, True)
        better = yield from _found_better(setting, samples, begun_anew, solution, factor)
        to = None if better is None else better.poles
    if to is None and early and not certain:
        return None, None
    if to is None and early and distance > NEAR:
        to = poles
    if to is not None:
        scale = noise_std_of(blueprint, x)
        launched = yield from launching(method, setting, to, begin, samples, scale, reference)
        return launched[0], None if better is None else better.estimate
    yield
    if distance <= NEAR and (early or not kept):
        turned = layout.with_directions(
            blueprint, steps.directions_of(setting, blueprint, solution)
        )
        return Turn(poles, turned, False), None
    base = poles if distance > NEAR else bank
    other = method.plan(setting, base, nuisance, False)
    turned = layout.with_directions(other, steps.directions_of(setting, other, solution))
    return Turn(poles, turned, distance > NEAR), None


def turned(state: State, turn: Turn) -> State:
    """The estimator after a turn."""
    x, stage = state
    setting, old = stage.setting, stage.blueprint
    own = steps.coefficients_of_directions(setting)
    now, before = (from_directions(setting, one) for one in (turn.poles, stage.poles))
    move = np.asarray(np.linalg.solve(before, now), dtype=np.float64)
    scatter.turn_scatter(old, x, own, move)
    past = stage.past
    if turn.move:
        x, past = moved(old, x, turn.blueprint), ()
    elif old.ints[slots.CHUNK] and not turn.blueprint.ints[slots.CHUNK]:
        x, past = rearranged(old, x, turn.blueprint), ()
    return State(x, stage.but(blueprint=turn.blueprint, poles=turn.poles, past=past))


def remembered(samples: Array, factor: float) -> Array:
    """The newest samples, which an estimator that forgets still heeds."""
    return samples if factor == 1.0 else samples[-int(np.ceil(MEMORIES / (1.0 - factor))) :]


def _found_better(
    setting: layout.Setting, samples: Array, begun_anew: bool, solution: Finished, factor: float
) -> Slices[FoundPoles | None]:
    """What a search of the kept samples finds, if it explains them clearly better.

    The poles of an early search or of ``start`` can lie in a valley of their own, which steps
    downhill do not leave: the samples are searched once more before they are dropped, and as long
    as they do not tell the poles. A model that most samples seem far from has no say: it left them
    out. Samples count less by ``factor`` with every one that came after them, as in the estimator.
    """
    samples = yield from far_off(setting, samples)
    found = yield from searching(setting, samples, begun_anew, thorough=True)
    if found is None or not found.certain:
        return None
    point = solution.point
    weights = factor ** np.arange(len(samples) - 1, -1, -1.0)
    given = weights @ np.isfinite(samples[:, 1 + setting.n_inputs :])
    if np.any(point.counts < TAKEN * given):
        return found
    gain = np.log(point.rss / point.counts) - 2.0 * np.log(found.noise_std)
    return found if float(point.counts @ gain) > CLEARLY else None
