"""The slow clock of the gradient rule: periods end, averages move on, the model follows Step 2.

The gradient rule begins on kept samples: the model found in them, and their replay.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.realization import denominator
from tridentify.online import layout
from tridentify.online.gradient_rule.periods import (
    PERIODS_TO_BE_SURE,
    as_expected,
    average,
    begin_period,
    columns_between,
    expected_covariance,
    first_rate,
    fits,
    fitted_to,
    mean_of,
    models_of,
    moments_of,
    near_enough,
    noise_of,
    outputs_of,
    put_parallel,
    put_unknowns,
    samples_of_period,
    signals_of,
    stable_poles,
    write_moments,
)
from tridentify.online.gradient_rule.plan import Basis, plan, with_tables
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.launch import begun, reference_of
from tridentify.online.saved.state import State
from tridentify.online.search import FoundPoles
from tridentify.online.starting import admissible, calm, run_kept, take_clocks
from tridentify.online.summary import carried
from tridentify.online.suspecting import MOST_KEPT, Suspecting

MOST_PERIODS, FIXED_PERIODS = 16, 8
"""Periods that are kept before neighbours are joined and the clock slows down; those that are
averaged where the rate is fixed."""
SETTLING = 2
"""Periods on a first basis before the poles are moved: the first one still forgets where it
began."""
OWN_ARRAYS = 2
"""Of the rule among what a stage keeps: its periods, and where it stands."""


class GradientRule(Suspecting):
    """What the steps of the gradient rule ask of it (`online.gradient_rule.gradient`)."""

    rate: float | None
    orthogonal: bool

    own_arrays: ClassVar[int] = OWN_ARRAYS
    asks: ClassVar[bool] = True


def followed(method: GradientRule, state: State) -> State:
    """At the end of a period: averages, and the model follows Step 2."""
    x, stage = state
    setting, blueprint = stage.setting, stage.blueprint
    batches, rate, periods = periods_of(stage)
    basis = Basis.of(setting, blueprint)
    if not blueprint.constants[places.KNOWN]:
        begin_period(x, setting, rate, rested=False)
        return _again(method, State(x, stage), basis, batches, rate, 0)
    if x[places.FROM] == np.inf:
        begin_period(x, setting, rate, rested=True)
        return _again(method, State(x, stage), basis, batches, rate, periods)
    if x[places.SUMMED] < 0.5 * samples_of_period(setting, rate):
        x[slots.TICK] = x[slots.COUNT] + np.ceil(0.5 * samples_of_period(setting, rate))
        return state
    theta, _ = mean_of(basis, blueprint, x)
    if not basis.adapted and periods + 1 < SETTLING:
        begin_period(x, setting, rate, rested=False)
        return _again(method, state, basis, batches, rate, periods + 1)
    if basis.adapted:
        row = np.concatenate([[x[places.SUMMED]], theta])[None, :]
        batches = np.vstack([batches.reshape(-1, row.size), row])
        batches, rate = _joined(batches, rate, method.rate)
    target = theta if len(batches) < 2 * PERIODS_TO_BE_SURE else average(batches)
    if not np.all(np.isfinite(target)):
        target = theta
    poles = stable_poles(target[: setting.n_poles], setting)
    if poles is None or (basis.adapted and near_enough(poles, basis, batches)):
        begin_period(x, setting, rate, rested=True)
        return _again(method, state, basis, batches, rate, periods + 1)
    new = Basis.on_model(setting, blueprint.nuisance, poles)
    target = np.concatenate([denominator(poles)[1:], target[setting.n_poles :]])
    return _moved(method, state, basis, new, target, (batches, rate, periods + 1))


def _joined(batches: Array, rate: float, held: float | None) -> tuple[Array, float]:
    """Not too many periods; the clock slows down where it may."""
    if held is not None:
        return batches[-FIXED_PERIODS:], rate
    if len(batches) < MOST_PERIODS:
        return batches, rate
    pairs = batches.reshape(-1, 2, batches.shape[1])
    weights = pairs[:, :, :1]
    total = weights.sum(axis=1)
    return np.hstack([total, (weights * pairs[:, :, 1:]).sum(axis=1) / total]), 0.5 * rate


def _again(
    method: GradientRule, state: State, basis: Basis, batches: Array, rate: float, periods: int
) -> State:
    """The same model; the step lengths are brought up to date."""
    x, stage = state
    blueprint = stage.blueprint
    found = with_tables(
        basis, blueprint, models_of(blueprint), signals_of(basis, blueprint, x)[1],
        moments_of(blueprint, x), noise_of(blueprint, x), orthogonal=method.orthogonal, rate=rate,
        ready=_readiness(basis, blueprint, batches),
    )  # fmt: skip
    as_expected(blueprint, x)
    return State(x, stage.but(blueprint=found, extra=_kept(stage, batches, rate, periods)))


def _moved(
    method: GradientRule, state: State, old: Basis, new: Basis, theta: Array,
    extra: tuple[Array, float, int],
) -> State:  # fmt: skip
    """The models on the bank of another denominator."""
    x, stage = state
    batches, rate, periods = extra
    setting, was = stage.setting, stage.blueprint
    blueprint = plan(new, bool(was.ints[slots.CHUNK]))
    found = carried(was, x, blueprint)
    if old.adapted:
        a, b = int(was.ints[slots.AT_WATCH]), int(blueprint.ints[slots.AT_WATCH])
        size = setting.n_outputs * int(was.ints[slots.WATCH])
        found[b : b + size] = x[a : a + size]
    move = columns_between(old, new)
    at, to = int(was.ints[slots.AT_ROW]), int(blueprint.ints[slots.AT_ROW])
    found[to : to + new.width] = move @ x[at : at + old.width]
    if found[slots.FIRST]:
        found[slots.FIRST] = new.poles.size
    moments = move @ moments_of(was, x) @ move.T
    write_moments(blueprint, found, moments, float(x[places.MOMENTS]))
    parallel, working = (one @ move.T for one in signals_of(old, was, x))
    unknowns = new.unknowns_of(theta)
    models = outputs_of(new, unknowns)
    if new.nuisance.free:
        impulse = slice(0, new.kept)
        models[:, impulse] = working[:, impulse]
    if new.nuisance.offset:
        models[:, -1] = working[:, -1]
    put_parallel(new, blueprint, found, parallel)
    put_unknowns(blueprint, found, unknowns)
    blueprint = with_tables(
        new, blueprint, models, models, moments, noise_of(was, x), orthogonal=method.orthogonal,
        rate=rate, ready=_readiness(new, was, batches),
    )  # fmt: skip
    as_expected(blueprint, found)
    begin_period(found, setting, rate, rested=False)
    return State(
        found,
        stage.but(
            blueprint=blueprint, poles=new.filter_poles, extra=_kept(stage, batches, rate, periods)
        ),
    )


def extra_of(batches: Array, rate: float, periods: int) -> tuple[Array, ...]:
    """What a stage keeps of the periods, of the rate and of how many there have been."""
    return (batches.ravel(), np.array([rate, float(periods)]))


def _kept(stage: layout.Stage, batches: Array, rate: float, periods: int) -> tuple[Array, ...]:
    """With what is kept of a suspicion behind them."""
    return *extra_of(batches, rate, periods), *stage.extra[OWN_ARRAYS:]


def periods_of(stage: layout.Stage) -> tuple[Array, float, int]:
    """The same, read."""
    flat, (rate, periods) = stage.extra[:OWN_ARRAYS]
    return flat.reshape(-1, len(stage.setting.names) + 1), float(rate), int(periods)


def _readiness(basis: Basis, before: layout.Blueprint, batches: Array) -> float:
    """Whether samples may be doubted and changes told; what may be doubted stays so."""
    if basis.adapted and len(batches) >= PERIODS_TO_BE_SURE:
        return places.TELLS
    return min(float(before.constants[places.READY]), places.DOUBTS)


LINEAR = 0.1
"""Standard error over value of a denominator's coefficients up to which a first model is near
enough to linearise about."""


def launched(
    method: GradientRule,
    state: State,
    found: FoundPoles,
    samples: Array,
    begun_anew: bool,
    full: bool,
) -> tuple[State, Indices] | None:
    """The models that begin at what was found, and the flags of the samples; None if unsure."""
    stage, setting = state.stage, state.stage.setting
    poles = admissible(setting, found.poles, samples)
    basis = Basis.on_model(setting, nuisance_of(setting, begun_anew), poles)
    blank = plan(basis)
    rows = np.zeros((len(samples), blank.n_columns))
    x = begun(blank, np.zeros(setting.n_outputs), reference_of(state))
    run_kept(method, setting, blank, x, samples, rows)
    unknowns, models = fitted_to(basis, rows, samples)
    constant, matrix = basis.physical
    theta = constant + matrix @ unknowns
    moments = rows.T @ rows / len(rows)
    noise = found.noise_std
    cov = expected_covariance(basis, models, moments, noise**2, len(rows))[0]
    cov = matrix @ cov @ matrix.T
    a = slice(0, setting.n_poles)
    near = np.all(np.isfinite(cov)) and np.all(
        np.sqrt(np.diagonal(cov)[a]) < LINEAR * np.abs(theta[a])
    )
    if not near and not full:
        return None
    count = float(len(samples))
    rate = method.rate or first_rate(basis, count)
    blueprint = with_tables(
        basis, plan(basis, len(samples) < MOST_KEPT), models, models, moments, noise**2,
        orthogonal=method.orthogonal, rate=rate, ready=places.DOUBTS,
    )  # fmt: skip
    x = begun(blueprint, noise, reference_of(state))
    write_moments(blueprint, x, moments, count)
    put_unknowns(blueprint, x, unknowns)
    x[places.FROM] = np.inf
    flags = run_kept(method, setting, blueprint, x, samples)
    take_clocks(state.values, stage.blueprint, x, blueprint, len(samples))
    x[slots.FILLED] = 0.0
    put_unknowns(blueprint, x, unknowns)
    for _, series, _ in fits(blueprint):
        x[series] = 0.0  # beta = (1, 0, ..., 0)
    first = np.concatenate([[count], theta])
    new = stage.but(
        blueprint=blueprint, poles=basis.filter_poles, past=(samples,), searching=False,
        extra=extra_of(first[None, :], rate, 0),
    )  # fmt: skip
    calm(x, new)
    begin_period(x, setting, rate, rested=False)
    return State(x, new), flags


def nuisance_of(setting: layout.Setting, restarted: bool) -> layout.NuisanceColumns:
    """The nuisance terms of the rule, which knows no drift."""
    found = layout.NuisanceColumns.of(setting.structure, restarted)
    return layout.NuisanceColumns(found.free, found.offset, False)
