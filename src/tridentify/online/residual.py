"""What a model leaves of kept samples, and how much better one model explains them than another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg

from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.slices import Slices
from tridentify.online.layout import Setting
from tridentify.online.result import model_of
from tridentify.record.record import Record

PIECES = 12
"""Pieces of the samples in which the gain of a new model is counted, so that one manoeuvre or gust
does not decide."""
MOST_LAGS, LAGS_PER_SAMPLE = 12, 0.1
"""Order of the autoregression that whitens, and the most of it for each sample."""
LEAST_PIECE = 40  # samples that tell a scale to a ninth
QUIET = 0.1  # of the median scale: a piece at rest does not decide alone
STEPS, SHORT = 3, 0.1  # of Gauss and Newton; of a standard error, for differences
DRIVEN = 30.0  # of -2 log L
LEAST_SEEN = 1e-9  # of a direction's energy over all rows: rounding of sums is far below


def is_driven(setting: Setting, record: Record, theta: Array) -> bool:
    """Whether the input explains anything of the outputs that coloured noise does not.

    Before a manoeuvre a model is easily found that follows the noise with the little that the input
    does; it has small standard errors and means nothing.

    Parameters
    ----------
    setting : Setting
    record : Record
    theta : (n_coefficients,) array
    """
    left = left_by(setting, record, theta)
    still = np.where(np.arange(theta.size) < setting.n_poles, theta, 0.0)
    alone = left_by(setting, record, still)
    gains = [gain_of(alone[:, i], left[:, i]).sum() for i in range(setting.n_outputs)]
    return bool(np.sum(gains) > DRIVEN)


def left_by(setting: Setting, record: Record, theta: Array) -> Array:
    """(n_samples, n_outputs) what a model leaves of a record, with free initial state and offset.

    Parameters
    ----------
    setting : Setting
    record : Record
    theta : (n_coefficients,) array
    """
    return _without(*_parts_of(setting, record, theta))


class Around(NamedTuple):
    """What a model leaves, and what a tenth of a standard error of each coefficient changes of it.

    Attributes
    ----------
    left : (n_samples, n_outputs) array
    tables : list of (n_samples, n_poles + 1) array
        Free responses and a constant, for each output.
    moves : list of (n_samples, n_outputs) array
    """

    left: Array
    tables: list[Array]
    moves: list[Array]


def around(setting: Setting, record: Record, theta: Array, std: Array) -> Slices[Around]:
    """What a model leaves, and its differences for `SHORT` of each standard error."""
    driven, tables = _parts_of(setting, record, theta)
    left, moves = _without(driven, tables), []
    for k in range(theta.size):
        yield
        moved = theta.copy()
        moved[k] += SHORT * std[k]
        same = tables if k >= setting.n_poles else None
        moves.append(_without(*_parts_of(setting, record, moved, same)) - left)
    return Around(left, tables, moves)


def _without(left: Array, tables: Sequence[Array]) -> Array:
    """What is left of each output without its free responses and constant."""
    found = np.array(left)
    for i, table in enumerate(tables):
        seen = np.isfinite(found[:, i])
        weights = np.linalg.lstsq(table[seen], found[seen, i], rcond=None)[0]
        found[:, i] -= table @ weights
    return found


def _parts_of(
    setting: Setting, record: Record, theta: Array, tables: list[Array] | None = None
) -> tuple[Array, list[Array]]:
    """What a model that begins at rest leaves; and of each output free responses and a constant.

    These tables hang on the poles alone: those of a model with the same poles may be given.
    """
    model, p, n = model_of(setting, theta), setting.n_outputs, setting.n_poles
    driven = simulate(model, record._derive(u=record.u - record.u[0]))
    if tables is not None:
        return record.y - driven, tables
    rested = record._derive(u=np.zeros_like(record.u), intersample="zoh")
    free = [simulate(model, rested, free_response=np.tile(np.eye(n)[k], (p, 1))) for k in range(n)]
    tables = []
    for i in range(p):
        table = np.column_stack([*(one[:, i] for one in free), np.ones(len(driven))])
        sizes = np.linalg.norm(table, axis=0)
        tables.append(table / np.where(sizes > 0.0, sizes, 1.0))
    return record.y - driven, tables


def gain_before(setting: Setting, record: Record, old: Array, new: Array) -> Slices[Array]:
    """(n_samples,) fall of -2 log L, were a record up to a sample of the old coefficients.

    Against the new ones throughout, both parts with an initial state and an offset of their own,
    whitened by the autoregression of what the new ones leave.

    Parameters
    ----------
    setting : Setting
    record : Record
    old, new : (n_coefficients,) arrays
    """
    total, parts = np.zeros(record.n_samples), []
    for theta in (old, new):
        parts.append(_parts_of(setting, record, theta))
        yield
    after = _without(*parts[1])
    for i in range(setting.n_outputs):
        yield
        a = autoregression(after[:, i])
        rows = [_whitened_rows(a, left[:, i], tables[i]) for left, tables in parts]
        seen = np.all(np.isfinite(np.hstack([*rows, through(a, after[:, i])[:, None]])), axis=1)
        if not seen.any():
            continue
        sizes = sizes_of(through(a, after[:, i])[seen])
        if not np.all(sizes > 0.0):
            continue
        before = _growing(rows[0][seen] / sizes[:, None])
        since = _growing((rows[1][seen] / sizes[:, None])[::-1])
        gain = np.zeros(record.n_samples)
        gain[a.size :][seen] = since[-1] - before - np.append(since[-2::-1], 0.0)
        last = np.maximum.accumulate(np.where(gain != 0.0, np.arange(gain.size), 0))
        total += gain[last]
    return total


def _whitened_rows(a: Array, left: Array, table: Array) -> Array:
    return np.column_stack([through(a, one) for one in (*table.T, left)])


def _growing(rows: Array) -> Array:
    """(k,) sum of squares that the columns leave of the last, over one row, two rows and so on.

    The columns are replaced by an orthonormal basis of theirs, by SVD: over all rows their products
    are the identity, so that nothing is lost where two are nearly one. Over the first rows, which
    cannot tell all of them, those with less than `LEAST_SEEN` of their energy count for little.
    """
    left, sizes, _ = np.linalg.svd(rows[:, :-1], full_matrices=False)
    told = sizes > max(rows.shape) * np.finfo(float).eps * sizes.max(initial=0.0)
    based = np.column_stack([left[:, told], rows[:, -1]])
    products = np.cumsum(based[:, :, None] * based[:, None, :], axis=0)
    sides = products[:, :-1, -1:]
    grams = products[:, :-1, :-1] + LEAST_SEEN * np.eye(int(told.sum()))
    return np.asarray(
        products[:, -1, -1] - np.sum(sides * np.linalg.solve(grams, sides), axis=(1, 2))
    )


def gain_of(before: Array, after: Array) -> Array:
    """(PIECES,) fall of -2 log L from one residual to the other, whitened, piece by piece."""
    one, other = whitened(before), whitened(after)
    found = []
    for a, b in zip(np.array_split(one, PIECES), np.array_split(other, PIECES), strict=True):
        seen = np.isfinite(a) & np.isfinite(b)
        top, below = float(np.sum(a[seen] ** 2)), float(np.sum(b[seen] ** 2))
        found.append(seen.sum() * np.log(top / below) if min(top, below) > 0.0 else 0.0)
    return np.array(found)


def whitened(left: Array) -> Array:
    """A residual through an autoregression of its own; without the first samples."""
    return through(autoregression(left), left)


def through(a: Array, values: Array) -> Array:
    """What an autoregression leaves of a series; without the first samples."""
    filled = _filled(values)
    white: Array = np.convolve(filled, np.append(1.0, -a))[: filled.size]
    white[~np.isfinite(values)] = np.nan
    return white[a.size :]


def _filled(values: Array) -> Array:
    """A series with straight lines over what is missing: zeros would be steps of the noise."""
    seen = np.isfinite(values)
    if seen.all() or not seen.any():
        return np.where(seen, values, 0.0)
    places = np.arange(values.size)
    return np.asarray(np.interp(places, places[seen], values[seen]))


def autoregression(left: Array) -> Array:
    """(order,) coefficients that foretell a series from its past, by Yule and Walker."""
    filled = _filled(left)
    order = int(min(MOST_LAGS, LAGS_PER_SAMPLE * left.size))
    lags = np.array([filled[k:] @ filled[: filled.size - k] for k in range(order + 1)])
    if order < 1 or not lags[0] > 0.0:
        return np.zeros(0)
    lags[0] *= 1.0 + 1e-9
    return np.asarray(scipy.linalg.solve_toeplitz(lags[:-1], lags[1:]))


def sizes_of(white: Array) -> Array:
    """(k,) root mean square of the piece that each sample of a series stands in.

    The noise of gusts comes and goes; the samples of its pauses tell the most.

    Parameters
    ----------
    white : (k,) array
    """
    count = int(np.clip(white.size // LEAST_PIECE, 1, PIECES))
    pieces = np.array_split(white, count)
    found = np.sqrt([np.mean(piece**2) for piece in pieces])
    found = np.maximum(found, QUIET * np.median(found))
    return np.repeat(found, [piece.size for piece in pieces])


class Refined(NamedTuple):
    """Coefficients at the minimum for coloured noise, and their covariance."""

    theta: Array
    cov: Array


def refined(setting: Setting, record: Record, theta: Array, std: Array) -> Slices[Refined | None]:
    """A model of white noise taken to the minimum for an autoregression of what it leaves.

    Where noise is coloured the coefficients for white noise are far from the most likely ones, and
    the wrong model may leave less. None where the steps lead nowhere.

    Parameters
    ----------
    setting : Setting
    record : Record
    theta, std : (n_coefficients,) arrays
    """
    cov = np.zeros((theta.size, theta.size))
    for _ in range(STEPS):
        yield
        left, _, moves = yield from around(setting, record, theta, std)
        slopes = [move / (SHORT * size) for move, size in zip(moves, std, strict=True)]
        rows, targets = [], []
        for i in range(setting.n_outputs):
            a = autoregression(left[:, i])
            white = through(a, left[:, i])
            table = np.column_stack([through(a, one[:, i]) for one in slopes])
            seen = np.isfinite(white)
            if seen.sum() <= theta.size:
                return None
            sizes = sizes_of(white[seen])
            if not np.all(sizes > 0.0):
                return None
            rows.append(table[seen] / sizes[:, None])
            targets.append(white[seen] / sizes)
        table = np.vstack(rows) * std
        u, s, vt = np.linalg.svd(table, full_matrices=False)
        if not s[-1] > 1e-8 * s[0]:
            return None
        root = std[:, None] * vt.T / s
        theta = theta - root @ (u.T @ np.concatenate(targets))
        cov = root @ root.T
        poles = np.roots(np.append(1.0, theta[: setting.n_poles]))
        if not np.all(np.isfinite(theta)) or np.any(poles.real >= 0.0):
            return None
    return Refined(theta, cov)
