"""The gradient rule begins on kept samples: the model found in them, and their replay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tridentify.numerics.arrays import Array, Indices
from tridentify.online.gradient_follow import GradientRule, extra_of, tables_of
from tridentify.online.gradient_periods import (
    begin_period,
    expected_covariance,
    first_rate,
    fitted_to,
)
from tridentify.online.gradient_plan import Basis, Tables, plan
from tridentify.online.gradient_vector import put_unknowns, refer, still_series, write_moments
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.layout import NuisanceColumns, Setting, constants_for, fresh, watch_of
from tridentify.online.search import FoundPoles
from tridentify.online.starting import admissible, calm, run_kept, take_clocks
from tridentify.online.state import Stage, State
from tridentify.online.suspecting import MOST_KEPT

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
    x, stage = state
    setting = stage.setting
    poles = admissible(setting, found.poles, samples)
    basis = Basis.on_model(setting, nuisance_of(setting, begun_anew), poles)
    rows = _rows(method, x, stage, basis, samples)
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
    tables = tables_of(models, models, moments, noise**2, method.orthogonal)
    return _replayed(method, state, basis, samples, tables, unknowns, noise)


def _replayed(
    method: GradientRule, state: State, basis: Basis, samples: Array, tables: Tables,
    unknowns: Array, noise: Array,
) -> tuple[State, Indices]:  # fmt: skip
    """The kept samples on the bank of the model that was found in them, and their flags."""
    old, stage = state
    setting, count = stage.setting, float(len(samples))
    rate = method.rate or first_rate(basis, count)
    assert tables.moments is not None
    begun = replace(tables, rate=rate, ready=places.DOUBTS)
    blueprint = begun.written(basis, plan(basis, len(samples) < MOST_KEPT))
    x = fresh(blueprint)
    refer(old, x, blueprint)
    for i in range(setting.n_outputs):
        x[watch_of(blueprint, i) + slots.SCALE] = noise[i]
    write_moments(blueprint, x, tables.moments, count)
    put_unknowns(blueprint, x, unknowns)
    x[places.FROM] = np.inf
    flags = run_kept(method, setting, blueprint, x, samples)
    take_clocks(old, stage.blueprint, x, blueprint, len(samples))
    x[slots.FILLED] = 0.0
    put_unknowns(blueprint, x, unknowns)
    still_series(basis, blueprint, x)
    constant, matrix = basis.physical
    first = np.concatenate([[count], constant + matrix @ unknowns])
    found = stage.but(
        blueprint=blueprint, poles=basis.filter_poles, past=(samples,), searching=False,
        extra=extra_of(first[None, :], rate, 0),
    )  # fmt: skip
    calm(x, found)
    begin_period(x, setting, rate, rested=False)
    return State(x, found), flags


def _rows(method: GradientRule, old: Array, stage: Stage, basis: Basis, samples: Array) -> Array:
    """The row of each kept sample."""
    setting, blueprint = stage.setting, plan(basis)
    x = fresh(blueprint)
    refer(old, x, blueprint)
    n, at, m = blueprint.n_columns, int(blueprint.ints[slots.AT_ROW]), setting.n_inputs
    rows = np.zeros((len(samples), n))
    for k, after in enumerate(samples[:, 0].tolist()):
        c = blueprint.constants
        if k and abs(after - setting.dt) > 1e-9 * setting.dt:
            c = constants_for(blueprint, setting, np.array([after]))[0]
        x[slots.INBOX : slots.INBOX + m] = samples[k, 1 : 1 + m]
        x[slots.INBOX + m : slots.INBOX + samples.shape[1] - 1] = samples[k, 1 + m :]
        method.kernels().step(blueprint.ints, c, x, after)
        if not (basis.nuisance.free and k < setting.late):
            rows[k, int(x[slots.FIRST]) :] = x[at + int(x[slots.FIRST]) : at + n]
    return rows


def nuisance_of(setting: Setting, restarted: bool) -> NuisanceColumns:
    """The nuisance terms of the rule, which knows no drift."""
    found = NuisanceColumns.of(setting.structure, restarted)
    return NuisanceColumns(found.free, found.offset, False)
