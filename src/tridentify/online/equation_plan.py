"""The plan of an estimator on the equation error, and what its unknowns mean."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tridentify.numerics.arrays import Array, Complex, Indices
from tridentify.numerics.realization import Cascade, cascade, degree_basis, denominator, numerators
from tridentify.online import layout
from tridentify.online.kernels import slots
from tridentify.online.kernels.slots import EXPONENTIAL, triangle_size

LEARNING = 20  # blocks, as the equation error is never white


class Maps(NamedTuple):
    """Physical coefficients from the unknowns: ``theta = constant + matrix @ unknowns``."""

    matrix: Array
    constant: Array


def maps_of(setting: layout.Setting, c: Cascade) -> Maps:
    """How the coefficients follow from the weights of the functions of ``c``."""
    n, q = setting.n_poles, c.order
    basis, table = degree_basis(c), numerators(c.poles)
    proper = basis.rows @ table
    count = len(setting.names)
    matrix, constant = np.zeros((count, count)), np.zeros(count)
    monic = denominator(c.poles)
    matrix[:n, :n] = proper[:n, q - n :].T
    constant[:n] = monic[1:] if q == n else (proper[n] / basis.leading[n])[q - n :]
    at = n
    for row in setting.zeros:
        for m in row:
            block = np.zeros((m + 1, m + 1))
            full = np.pad(proper[: min(m + 1, q)], ((0, 0), (1, 0)))
            if m == q:
                full = np.vstack([full, monic])
            block[:, :] = full[:, q - m :].T
            matrix[at : at + m + 1, at : at + m + 1] = block
            at += m + 1
    return Maps(matrix, constant)


def from_directions(setting: layout.Setting, poles: Complex) -> Array:
    """Physical coefficients by the directions of Step 1 (`online.steps.directions_of`).

    Parameters
    ----------
    setting : Setting
    poles : (n,) complex array
        Of the model.

    Returns
    -------
    (n_coefficients, n_coefficients) array
    """
    n, bank = setting.n_poles, cascade(poles)
    found = maps_of(setting, bank).matrix
    found[:n, :n] = numerators(bank.poles).T
    return found


def output_weights(blueprint: layout.Blueprint) -> Array:
    """(n_outputs,) by which the rows of the outputs count."""
    ints = blueprint.ints
    at = int(ints[slots.C_MONIC] + ints[slots.ORDER]) + 1
    return blueprint.constants[at : at + int(ints[slots.OUTPUTS])]


def equation_blueprint(
    setting: layout.Setting,
    poles: Complex,
    *,
    restarted: bool,
    weights: Array,
    forgetting: float = 1.0,
    kind: int = EXPONENTIAL,
    filtering: bool = False,
    keep: bool = False,
) -> layout.Blueprint:
    """The plan of an estimator on the equation error.

    Parameters
    ----------
    setting : Setting
    poles : (q,) complex array
        Of the filter.
    restarted : bool
        Whether it begins in the middle, from any state.
    weights : (n_outputs,) array
        Of the outputs.
    forgetting : float
    kind : int
        Of forgetting.
    filtering : bool
        Whether the coefficients drift.
    keep : bool
        Whether samples are kept.
    """
    m, p, q = setting.n_inputs, setting.n_outputs, poles.size
    wanted = layout.NuisanceColumns.of(setting.structure, restarted)
    # a constant comes with the transient of the filter that it begins with
    nuisance = layout.NuisanceColumns(wanted.free or wanted.offset, wanted.offset, False)
    coefficients = len(setting.names)
    columns = p * (q * nuisance.free + nuisance.offset) + coefficients
    ints, plan, constants = layout.places_of(
        setting, poles, nuisance, columns, coefficients, layout.CHUNK if keep else 0, kind
    )
    ints[slots.COEFFICIENTS] = coefficients
    ints[slots.FILTERING], ints[slots.LEARNING] = filtering, LEARNING
    ints[slots.WALKERS] = coefficients if filtering else 0
    ints[slots.AT_IMPULSE] = plan.take(q)
    ints[slots.AT_INPUTS] = plan.take(m * q)
    ints[slots.AT_OUTPUTS] = plan.take(p * q)
    ints[slots.AT_BEFORE] = plan.take(p)
    ints[slots.AT_THETA] = plan.take(columns)
    ints[slots.FACTOR] = 0 if filtering else triangle_size(columns)
    ints[slots.AT_FACTOR] = plan.take(int(ints[slots.FACTOR]))
    ints[slots.C_OUTPUT] = constants.take(2 * q)
    ints[slots.C_BASIS] = constants.take(q * q)
    ints[slots.C_MONIC] = constants.take(q + 1 + p)
    ints[slots.C_ZEROS] = constants.take(m * p + 1)
    if filtering:
        ints[slots.AT_COVARIANCE] = plan.take(columns * (columns + 1) // 2)
        ints[slots.AT_GAIN] = plan.take(columns + columns * (columns + coefficients))
        ints[slots.C_WALK] = constants.take(columns * coefficients)
        ints[slots.C_WIDTHS] = constants.take(coefficients)
    c = layout.filled(constants.at, ints, setting, poles, forgetting)
    # a triangle that all outputs share takes a row of each
    c[slots.FORGETTING] = forgetting ** (1.0 / p)
    _write_filter(c, ints, setting, cascade(poles), weights)
    return layout.Blueprint(ints, c, plan.at, poles, nuisance)


def _write_filter(
    c: Array, ints: Indices, setting: layout.Setting, bank: Cascade, weights: Array
) -> None:
    m, q, n = setting.n_inputs, bank.order, setting.n_poles
    joined = layout.discretize_each(bank, np.array([setting.dt]), "foh")
    at = int(ints[slots.C_OUTPUT])
    c[at : at + q], c[at + q : at + 2 * q] = joined.from_current[0], joined.from_next[0]
    basis = degree_basis(bank)
    at = int(ints[slots.C_BASIS])
    c[at : at + q * q] = basis.rows.ravel()
    at = int(ints[slots.C_MONIC])
    if q == n:
        c[at + q] = 1.0
    else:
        c[at : at + q] = basis.rows[n] / basis.leading[n]
    c[at + q + 1 : at + q + 1 + weights.size] = weights
    at = int(ints[slots.C_ZEROS])
    c[at : at + m * setting.n_outputs] = np.ravel(setting.zeros)
    c[at + m * setting.n_outputs] = n
