"""What stands in the vector of the gradient rule: read, and written when models begin anew."""

from __future__ import annotations

import numpy as np

from tridentify.numerics.arrays import Array
from tridentify.online.gradient_plan import Basis
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.layout import Blueprint, watch_of


def moments_of(blueprint: Blueprint, x: Array) -> Array:
    """(n, n) mean of ``z z'``."""
    n, at = blueprint.n_columns, int(blueprint.ints[places.X_MOMENTS])
    found = np.zeros((n, n))
    found[np.tril_indices(n)] = x[at : at + n * (n + 1) // 2]
    return found + np.tril(found, -1).T


def write_moments(blueprint: Blueprint, x: Array, moments: Array, count: float) -> None:
    """Put the mean of ``z z'`` over ``count`` samples into a vector."""
    n, at = blueprint.n_columns, int(blueprint.ints[places.X_MOMENTS])
    x[at : at + n * (n + 1) // 2] = moments[np.tril_indices(n)]
    x[places.MOMENTS] = count


def signals_of(basis: Basis, blueprint: Blueprint, x: Array) -> tuple[Array, Array]:
    """(n_outputs, n) rows of the parallel model and of the one that Step 2 works on, constants too.

    Parameters
    ----------
    basis : Basis
    blueprint : Blueprint
    x : array
    """
    ints, c, n = blueprint.ints, blueprint.constants, blueprint.n_columns
    k1, k3 = int(ints[places.PARALLEL_UNKNOWNS]), int(ints[places.SERIES_UNKNOWNS])
    first = np.zeros((basis.setting.n_outputs, n))
    working = np.zeros_like(first)
    for i in range(len(first)):
        base = int(ints[places.C_FITS]) + i * places.fits_stride(ints)
        at = int(ints[places.X_FITS]) + i * (k1 + k3 + 2)
        first[i] = x[at : at + k1] @ basis.parallel
        working[i] = first[i]
        if basis.adapted:
            t0 = base + k1 * (n + k1)
            table = c[t0 + n : t0 + n + k3 * n].reshape(k3, n)
            working[i] = c[t0 : t0 + n] + x[at + k1 + 1 : at + k1 + 1 + k3] @ table
    return first, working


def models_of(basis: Basis, blueprint: Blueprint) -> Array:
    """(n_outputs, n) the rows ``t_0`` of a blueprint."""
    ints, n = blueprint.ints, blueprint.n_columns
    k1 = int(ints[places.PARALLEL_UNKNOWNS])
    found = np.zeros((basis.setting.n_outputs, n))
    for i in range(len(found)):
        at = int(ints[places.C_FITS]) + i * places.fits_stride(ints) + k1 * (n + k1)
        found[i] = blueprint.constants[at : at + n]
    return found


def noise_of(blueprint: Blueprint, x: Array) -> Array:
    """(n_outputs,) variance of the noise: of the innovations, less what the weights add."""
    ints, c = blueprint.ints, blueprint.constants
    p = int(ints[slots.OUTPUTS])
    k = int(ints[places.SERIES_UNKNOWNS] if ints[places.SERIES] else ints[places.PARALLEL_UNKNOWNS])
    added = 1.0 + min(0.5 * float(c[places.RATE] * c[slots.INTERVAL]) * k, 0.9)
    found = np.zeros(p)
    for i in range(p):
        w = watch_of(blueprint, i)
        found[i] = x[w + slots.SQUARES] / max(float(x[w + slots.WEIGHT]), 1.0) / added
    return found


def refer(old: Array, x: Array, blueprint: Blueprint) -> None:
    """The trim input, where samples begin in the middle."""
    ints = blueprint.ints
    if ints[slots.EQUILIBRIUM] and ints[slots.FREE]:
        at, m = int(ints[slots.AT_REFERENCE]), int(ints[slots.INPUTS])
        x[at : at + m] = old[at : at + m]
        x[slots.COUNT] = 1.0


def put_unknowns(blueprint: Blueprint, x: Array, unknowns: Array) -> None:
    """Step 2 begins at a model."""
    at, k = int(blueprint.ints[places.X_SECOND]), unknowns.size
    x[at : at + k] = unknowns
    x[at + k : at + 2 * k + 1] = 0.0
    as_expected(blueprint, x)


def as_expected(blueprint: Blueprint, x: Array) -> None:
    """The means of ``phi' P phi`` are what they ought to be; sums begin anew."""
    ints = blueprint.ints
    k1, k3 = int(ints[places.PARALLEL_UNKNOWNS]), int(ints[places.SERIES_UNKNOWNS])
    p, at = int(ints[slots.OUTPUTS]), int(ints[places.X_FITS])
    for i in range(p):
        x[at + i * (k1 + k3 + 2) + k1] = k1
        x[at + i * (k1 + k3 + 2) + k1 + k3 + 1] = k3
    k = int(ints[places.POLES] + p * ints[places.OWN])
    at = int(ints[places.X_SECOND])
    x[at + k] = k / p
    x[at + k + 1 : at + 2 * k + 1] = 0.0


def still_series(basis: Basis, blueprint: Blueprint, x: Array) -> None:
    """``beta = (1, 0, ..., 0)``."""
    ints = blueprint.ints
    k1, k3 = int(ints[places.PARALLEL_UNKNOWNS]), int(ints[places.SERIES_UNKNOWNS])
    for i in range(basis.setting.n_outputs):
        at = int(ints[places.X_FITS]) + i * (k1 + k3 + 2) + k1 + 1
        x[at : at + k3] = 0.0


def put_parallel(basis: Basis, blueprint: Blueprint, x: Array, signals: Array) -> None:
    """The weights of the parallel model whose output is a row, as far as it can be."""
    ints = blueprint.ints
    k1, k3 = int(ints[places.PARALLEL_UNKNOWNS]), int(ints[places.SERIES_UNKNOWNS])
    for i, signal in enumerate(signals):
        at = int(ints[places.X_FITS]) + i * (k1 + k3 + 2)
        x[at : at + k1] = basis.parallel @ signal
