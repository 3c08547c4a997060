"""What the slow clock does once there is a model: filter and basis follow its poles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.slices import Slices
from tridentify.online.equation_plan import from_directions
from tridentify.online.kernels import slots
from tridentify.online.launch import Launch, Planner, is_certain, launching, noise_std_of
from tridentify.online.layout import Blueprint, NuisanceColumns, Setting, with_directions
from tridentify.online.scatter import turn_scatter
from tridentify.online.search import FoundPoles, far_off, searching
from tridentify.online.starting import rearranged
from tridentify.online.state import State
from tridentify.online.steps import StepsEnd, coefficients_of_directions, directions_of, solving
from tridentify.online.summary import moved

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
    blueprint: Blueprint
    move: bool


def following(
    method: Planner,
    setting: Setting,
    blueprint: Blueprint,
    before: Complex,
    x: Array,
    samples: Array,
    reference: Array,
    begun_anew: bool,
) -> Slices[Launch | Turn | None]:
    """Look where the poles are, and say how to go on; None to leave all as it is.

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
        solution = yield from solving(setting, blueprint, x, before, choose=False, passes=1)
    except (TridentifyError, np.linalg.LinAlgError):
        return None
    poles = solution.point.poles
    if not np.all(np.isfinite(poles)):
        return None
    bank = blueprint.poles[: poles.size]
    distance, nuisance = _distance(poles, bank), blueprint.nuisance
    kept = bool(blueprint.ints[slots.CHUNK])
    early = kept and x[slots.SINCE] <= method.samples
    yield
    certain = not kept or is_certain(setting, blueprint, x, solution, before)
    to, begin = None, nuisance
    if kept and not (early and certain):
        factor = float(blueprint.constants[slots.FORGETTING])
        newest = _remembered(samples, factor)
        if len(newest) < len(samples):
            samples, begun_anew = newest, True
            begin = NuisanceColumns.of(setting.structure, True)
        better = yield from _found_better(setting, samples, begun_anew, solution, factor)
        to = None if better is None else better.poles
    if to is None and early and not certain:
        return None
    if to is None and early and distance > NEAR:
        to = poles
    if to is not None:
        scale = noise_std_of(blueprint, x)
        return (yield from launching(method, setting, to, begin, samples, scale, reference))[0]
    yield
    if distance <= NEAR and (early or not kept):
        turned = with_directions(blueprint, directions_of(setting, blueprint, solution))
        return Turn(poles, turned, False)
    base = poles if distance > NEAR else bank
    other = method.plan(setting, base, nuisance, False)
    turned = with_directions(other, directions_of(setting, other, solution))
    return Turn(poles, turned, distance > NEAR)


def turned(state: State, turn: Turn) -> State:
    """The estimator after a turn."""
    x, stage = state
    setting, old = stage.setting, stage.blueprint
    own = coefficients_of_directions(setting)
    now, before = (from_directions(setting, one) for one in (turn.poles, stage.poles))
    move = np.asarray(np.linalg.solve(before, now), dtype=np.float64)
    turn_scatter(old, x, own, move)
    past = stage.past
    if turn.move:
        x, past = moved(old, x, turn.blueprint), ()
    elif old.ints[slots.CHUNK] and not turn.blueprint.ints[slots.CHUNK]:
        x, past = rearranged(old, x, turn.blueprint), ()
    return State(x, stage.but(blueprint=turn.blueprint, poles=turn.poles, past=past))


def _remembered(samples: Array, factor: float) -> Array:
    """The newest samples, which an estimator that forgets still heeds."""
    return samples if factor == 1.0 else samples[-int(np.ceil(MEMORIES / (1.0 - factor))) :]


def _found_better(
    setting: Setting, samples: Array, begun_anew: bool, solution: StepsEnd, factor: float
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


def _distance(poles: Complex, bank: Complex) -> float:
    """Largest move of a pole over its decay rate."""
    rates = np.maximum(-bank.real, 1e-6 * np.abs(bank))
    return float(np.max(np.abs(poles - bank) / rates))
