"""A model found in samples that were kept becomes an estimator that goes on from them."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.slices import Slices
from tridentify.online.estimator import Estimator
from tridentify.online.kernels import slots
from tridentify.online.layout import (
    Blueprint,
    NuisanceColumns,
    Setting,
    fresh,
    watch_of,
    with_directions,
)
from tridentify.online.residual import is_driven
from tridentify.online.scatter import FEWEST, expect_scatter, keep_expected, scatter_of
from tridentify.online.search import far_off, judged_poles, record_of, searching
from tridentify.online.starting import admissible, calm, run_kept, take_clocks, without
from tridentify.online.state import State
from tridentify.online.steps import StepsEnd, directions_of, estimate_of, solving

MOVE_ROUNDS = 3
"""Times that the search is repeated without the samples that its model finds doubtful."""


class Planner(Estimator):
    """An estimator that is launched, followed and suspected: what is asked of it."""

    samples: int

    @abstractmethod
    def plan(
        self, setting: Setting, poles: Complex, nuisance: NuisanceColumns, keep: bool
    ) -> Blueprint:
        """Step 1 on poles, each as often as a move of them asks for; ``keep``: with the samples."""

    @abstractmethod
    def next_tick(self, x: Array, setting: Setting) -> float:
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

    blueprint: Blueprint
    poles: Complex
    noise_std: Array
    samples: Array
    certain: bool


def searching_launch(
    method: Planner,
    setting: Setting,
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
    nuisance = NuisanceColumns.of(setting.structure, begun_anew)
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
    setting: Setting,
    poles: Complex,
    nuisance: NuisanceColumns,
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
        solution = yield from solving(setting, blueprint, x, near, choose=False)
    except (TridentifyError, np.linalg.LinAlgError):
        return Launch(blueprint, near, noise_std, samples, False), flags
    poles = solution.point.poles
    found = with_directions(blueprint, directions_of(setting, blueprint, solution))
    yield
    x = begun(found, noise_std, reference)
    run_kept(method, setting, found, x, samples)
    yield
    certain = is_certain(setting, found, x, solution, poles)
    return Launch(found, poles, noise_std, samples, certain), flags


def begun(blueprint: Blueprint, noise_std: Array, reference: Array) -> Array:
    """The vector before the first kept sample."""
    x = fresh(blueprint)
    for i, one in enumerate(noise_std.tolist()):
        x[watch_of(blueprint, i) + slots.SCALE] = one
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
        late = scatter_of(blueprint, x, 0).blocks[0] > FEWEST and not stage.searching
        if late or old[slots.SUSPECT] > 0.0:
            keep_expected(stage.blueprint, old, blueprint, x)
        else:
            expect_scatter(blueprint, x)
    return State(x, new)


def reference_of(state: State) -> Array:
    """(n_inputs,) trim input of a state."""
    x, stage = state
    at = int(stage.blueprint.ints[slots.AT_REFERENCE])
    return x[at : at + stage.setting.n_inputs].copy()


def noise_std_of(blueprint: Blueprint, x: Array) -> Array:
    """(n_outputs,) scale of the noise in a vector."""
    count = int(blueprint.ints[slots.OUTPUTS])
    return np.array([x[watch_of(blueprint, i) + slots.SCALE] for i in range(count)])


def is_certain(
    setting: Setting, blueprint: Blueprint, x: Array, solution: StepsEnd, poles: Complex
) -> bool:
    """Whether the samples tell the poles; a bank on poles that are mostly noise loses more."""
    try:
        found = estimate_of(setting, blueprint, x, solution, "", poles)
    except (TridentifyError, np.linalg.LinAlgError):
        return False
    judged = judged_poles(found, setting)
    return judged is not None and judged.certain
