"""Periods of the gradient rule: how long they are, their mean and scatter, the model they give.

What stands in the vector of the gradient rule: read, and written when models begin anew.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.special import ndtri, stdtrit

from tridentify.errors import OptionError
from tridentify.estimation.likelihood.setup.problem import BELOW_NYQUIST, FASTEST, LEAST_DAMPED
from tridentify.models.regression import Layout
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import sort_poles
from tridentify.online.gradient_rule.plan import Basis, inverse_of, without_constant
from tridentify.online.kernels import gradient_slots as places
from tridentify.online.kernels import slots
from tridentify.online.kernels.gradient_slots import MEMORY
from tridentify.online.layout import Blueprint, Setting, watch_of
from tridentify.online.scatter import widened
from tridentify.online.summary import change_columns, transfer
from tridentify.transfer_function import TransferFunction


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


def fits(blueprint: Blueprint) -> Iterator[tuple[slice, slice, int]]:
    """Places of each output: weights of Step 1 and of Step 3 in the vector, ``t_0`` in ``c``."""
    ints, n = blueprint.ints, blueprint.n_columns
    k1, k3 = int(ints[places.PARALLEL_UNKNOWNS]), int(ints[places.SERIES_UNKNOWNS])
    for i in range(int(ints[slots.OUTPUTS])):
        at = int(ints[places.X_FITS]) + i * (k1 + k3 + 2)
        t0 = int(ints[places.C_FITS]) + i * places.fits_stride(ints) + k1 * (n + k1)
        yield slice(at, at + k1), slice(at + k1 + 1, at + k1 + 1 + k3), t0


def signals_of(basis: Basis, blueprint: Blueprint, x: Array) -> tuple[Array, Array]:
    """(n_outputs, n) rows of the parallel model and of the one that Step 2 works on, constants too.

    Parameters
    ----------
    basis : Basis
    blueprint : Blueprint
    x : array
    """
    c, n = blueprint.constants, blueprint.n_columns
    first, working = np.zeros((2, basis.setting.n_outputs, n))
    for i, (one, three, t0) in enumerate(fits(blueprint)):
        working[i] = first[i] = x[one] @ basis.parallel
        if basis.adapted:
            table = c[t0 + n : t0 + n + (three.stop - three.start) * n].reshape(-1, n)
            working[i] = c[t0 : t0 + n] + x[three] @ table
    return first, working


def models_of(blueprint: Blueprint) -> Array:
    """(n_outputs, n) the rows ``t_0`` of a blueprint."""
    c, n = blueprint.constants, blueprint.n_columns
    return np.array([c[t0 : t0 + n] for _, _, t0 in fits(blueprint)])


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


def put_unknowns(blueprint: Blueprint, x: Array, unknowns: Array) -> None:
    """Step 2 begins at a model."""
    at, k = int(blueprint.ints[places.X_SECOND]), unknowns.size
    x[at : at + k] = unknowns
    x[at + k : at + 2 * k + 1] = 0.0
    as_expected(blueprint, x)


def as_expected(blueprint: Blueprint, x: Array) -> None:
    """The means of ``phi' P phi`` are what they ought to be; sums begin anew."""
    ints, p = blueprint.ints, int(blueprint.ints[slots.OUTPUTS])
    for one, three, _ in fits(blueprint):
        x[one.stop], x[three.stop] = one.stop - one.start, three.stop - three.start
    k = int(ints[places.POLES] + p * ints[places.OWN])
    at = int(ints[places.X_SECOND])
    x[at + k] = k / p
    x[at + k + 1 : at + 2 * k + 1] = 0.0


def put_parallel(basis: Basis, blueprint: Blueprint, x: Array, signals: Array) -> None:
    """The weights of the parallel model whose output is a row, as far as it can be."""
    for (one, _, _), signal in zip(fits(blueprint), signals, strict=True):
        x[one] = basis.parallel @ signal


STEPS_PER_UNKNOWN, SLOWER = 10, 4.0
"""Samples for each unknown in one over the rate, and how many times slower than the slowest pole it
is at least."""
PERIODS_TO_BE_SURE = 4
"""Periods below which their scatter is not believed."""
FIRST = 2
"""Periods that are left out at the beginning."""
SMALL = 0.1
"""Share of the smallest relative standard error that the square of a move must be below to be left
out."""
DEGENERATE = 1e-13
"""Smallest eigenvalue over the largest, near one, below which products do not determine the
unknowns: rounding."""
ROUNDING = 1e-12
"""Relative movement of a pole that is rounding."""


def first_rate(basis: Basis, searched: float) -> float:
    """Where the rate begins [1/s]: slower than the slowest pole, with samples for each unknown."""
    dt = basis.setting.dt
    few = STEPS_PER_UNKNOWN * basis.unknowns * dt
    slow = SLOWER / float(np.min(np.abs(basis.filter_poles)))
    most = max(searched, 2.0 * STEPS_PER_UNKNOWN * basis.unknowns) * dt
    return 1.0 / max(few, 0.25 * searched * dt, min(slow, most))


def samples_of_period(setting: Setting, rate: float) -> float:
    """Samples of a period."""
    return max(float(np.ceil(MEMORY / (rate * setting.dt))), 10.0 * len(setting.names))


def begin_period(x: Array, setting: Setting, rate: float, *, rested: bool) -> None:
    """Begin to average: at once, or where models begin anew after half of a period."""
    length = samples_of_period(setting, rate)
    x[slots.TICK] = x[slots.COUNT] + np.ceil(length if rested else 0.5 * length)
    x[places.FROM] = x[slots.COUNT] if rested else np.inf
    x[places.SUMMED] = 0.0


def mean_of(basis: Basis, blueprint: Blueprint, x: Array) -> tuple[Array, Array]:
    """Mean of the coefficients, and of the unknowns, over the present period."""
    at, k = int(blueprint.ints[places.X_SECOND]), basis.unknowns
    mean = x[at + k + 1 : at + 2 * k + 1] / max(float(x[places.SUMMED]), 1.0)
    constant, matrix = basis.physical
    return constant + matrix @ mean, mean


def present(basis: Basis, blueprint: Blueprint, x: Array) -> Array:
    """The coefficients as they are, as one period; none before the step lengths are known."""
    constant, matrix = basis.physical
    if not blueprint.constants[places.KNOWN]:
        return np.zeros((0, constant.size + 1))
    at = int(blueprint.ints[places.X_SECOND])
    remembered = 2.0 / float(blueprint.constants[places.RATE] * basis.setting.dt)
    row = [min(float(x[slots.COUNT]), remembered)], constant + matrix @ x[at : at + basis.unknowns]
    return np.concatenate(row)[None, :]


def used_of(batches: Array) -> Array:
    """All periods but the oldest quarter, and the first two."""
    return batches[max(len(batches) // 4, min(FIRST, len(batches) - 1)) :]


def average(batches: Array) -> Array:
    """Mean of the coefficients over the periods that are used, by samples."""
    used = used_of(batches)
    return np.asarray(used[:, 0] @ used[:, 1:] / used[:, 0].sum())


def scatter(used: Array) -> Array:
    """Covariance of the mean from the scatter of the periods."""
    weights = used[:, 0] / used[:, 0].sum()
    off = used[:, 1:] - weights @ used[:, 1:]
    k = len(used)
    widened = float(stdtrit(k - 1, 0.975) / ndtri(0.975))
    return np.asarray(widened**2 * (off.T * weights) @ off / (k - 1))


def near_enough(poles: Complex, basis: Basis, batches: Array) -> bool:
    """Whether a move of the poles may be left out: its square is far below the standard error."""
    old = basis.filter_poles
    rates = np.maximum(-old.real, LEAST_DAMPED * np.abs(old))
    distance = float(np.max(np.abs(poles - old) / rates))
    if distance < ROUNDING:
        return True
    used = used_of(batches)
    if len(used) < PERIODS_TO_BE_SURE:
        return False
    n = basis.n_poles
    std = np.sqrt(np.diagonal(scatter(used)))[:n]
    sizes = np.maximum(np.abs(average(batches)[:n]), 1e-300)
    return distance**2 < SMALL * float(np.min(std / sizes))


def stable_poles(a: Array, setting: Setting) -> Complex | None:
    """Roots of a denominator, reflected and held where samples can show them."""
    if not np.all(np.isfinite(a)):
        return None
    n = a.size
    unit = max(float(np.max(np.abs(a) ** (1.0 / np.arange(1, n + 1)))), 1e-300)
    scaled = np.concatenate([[1.0], a / unit ** np.arange(1, n + 1)])
    poles = unit * np.roots(scaled).astype(np.complex128)
    if poles.size != n or not np.all(np.isfinite(poles)):
        return None
    poles = poles * np.minimum(1.0, FASTEST / setting.dt / np.maximum(np.abs(poles), 1e-300))
    limit = BELOW_NYQUIST * np.pi / setting.dt
    imag = np.clip(poles.imag, -limit, limit)
    least = np.maximum(LEAST_DAMPED * np.abs(imag), 1e-6 * float(np.max(np.abs(poles))))
    return sort_poles(-np.maximum(np.abs(poles.real), least) + 1j * imag)


def fitted_to(basis: Basis, rows: Array, samples: Array) -> tuple[Array, Array]:
    """``b``, free response and constant by least squares for given poles."""
    setting = basis.setting
    unknowns = np.zeros(basis.unknowns)
    models = np.zeros((setting.n_outputs, basis.width))
    for i in range(setting.n_outputs):
        y = samples[:, 1 + setting.n_inputs + i]
        good = (np.abs(y) < slots.LARGEST) & np.any(rows != 0, axis=1)
        table = basis.numerators(i)
        if basis.nuisance.offset:
            table = np.vstack([table, basis.at(basis.width - 1)])
        columns = rows[good] @ table.T
        sizes = np.linalg.norm(columns, axis=0)
        sizes = np.where(sizes > 0, sizes, 1.0)
        weights = np.linalg.lstsq(columns / sizes, y[good], rcond=None)[0] / sizes
        place = basis.n_poles + i * basis.own
        unknowns[place : place + basis.own] = weights[: basis.own]
        models[i] = weights @ table
    return unknowns, models


def coefficients_of(start: TransferFunction, setting: Setting) -> Array:
    """Coefficients of a model that was given, on the orders that are asked for."""
    den = np.asarray(start.den[0][0], dtype=np.float64)
    parts = [den[1:] / den[0]]
    for i, row in enumerate(setting.zeros):
        for j, m in enumerate(row):
            try:
                num = np.trim_zeros(np.asarray(start.num[i][j], dtype=np.float64), "f") / den[0]
            except IndexError:
                num = np.zeros(m + 2)
            if num.size > m + 1:
                raise OptionError(
                    f"found a start with other channels or more than {m} zeros; expected those of "
                    "the structure; give another model, or leave start out"
                )
            parts.append(np.pad(num, (m + 1 - num.size, 0)))
    return np.concatenate(parts)


def outputs_of(basis: Basis, unknowns: Array) -> Array:
    """(n_outputs, n) the outputs of the model that Step 2's unknowns stand for, as rows."""
    outputs = range(basis.setting.n_outputs)
    return np.array([basis.output_of(i, unknowns) for i in outputs])


def columns_between(old: Basis, new: Basis) -> Array:
    """(n', n) what takes a row on the columns of one bank to those of another."""
    free, offset, _ = old.nuisance
    layout = Layout(old.poles.size, old.setting.n_inputs, free, offset, False)
    move = change_columns(np.eye(old.width), layout, transfer(old.bank, new.bank))
    return np.ascontiguousarray(move.T)


def expected_covariance(
    basis: Basis, signals: Array, moments: Array, noise: Array, count: float
) -> tuple[Array, float]:
    """Covariance of least squares over so many samples, and the condition of its columns.

    Of the unknowns of Step 2, for white noise.
    """
    p, k, offset = basis.setting.n_outputs, basis.unknowns, basis.nuisance.offset
    size = k + p * offset
    noise = np.maximum(noise, 1e-300)
    total = np.zeros((size, size))
    for i in range(p):
        table = np.zeros((size, basis.width))
        table[:k] = basis.second(i, without_constant(basis, signals[i]))
        if offset:
            table[k + i, -1] = 1.0
        total += table @ moments @ table.T / noise[i]
    means = np.diagonal(total)
    live = means > 1e-24 * max(float(means.max()), 1e-300)
    live &= means > 0
    root = np.where(live, 1.0 / np.sqrt(np.where(live, means, 1.0)), 0.0)
    scaled = (total * root[:, None] * root)[np.ix_(live, live)]
    values = np.linalg.eigvalsh(scaled) if scaled.size else np.zeros(1)
    if not live[: basis.n_poles].all() or values[0] < DEGENERATE:
        return np.full((k, k), np.nan), np.inf
    inverse = np.zeros((k, k))
    inside = np.flatnonzero(live)
    whole = inverse_of(total[np.ix_(live, live)], DEGENERATE)
    own = inside < k
    inverse[np.ix_(inside[own], inside[own])] = whole[np.ix_(own, own)] / count
    return inverse, float(np.sqrt(values[-1] / values[0]))


def as_scattered(basis: Basis, blueprint: Blueprint, x: Array, cov: Array, noise: Array) -> Array:
    """The covariance of Step 2's unknowns, widened where the scores say that noise is coloured.

    Parameters
    ----------
    basis : Basis
    blueprint : Blueprint
    x : array
    cov : (unknowns, unknowns) array
        For white noise.
    noise : (n_outputs,) array
        Its variance.
    """
    n, setting = basis.n_poles, basis.setting
    listed, own = list(range(n)), []
    for i, counts in enumerate(basis.counts):
        places = np.full(setting.n_directions, -1)
        places[:n] = np.arange(n)
        places[n : n + sum(counts)] = len(listed) + np.arange(sum(counts))
        listed += [n + i * basis.own + k for k in range(sum(counts))]
        own.append(places)
    white = cov[np.ix_(listed, listed)]
    seen = widened(blueprint, x, white, noise, own)
    ratio = np.ones(len(cov))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio[listed] = np.sqrt(np.diagonal(seen) / np.diagonal(white))
    ratio = np.where(np.isfinite(ratio), ratio, 1.0)
    return np.asarray(ratio[:, None] * cov * ratio)
