"""Whether what a model leaves of kept samples still follows the inputs.

On-line nothing else is tried than the structure that was asked: an input that acts late, or that
was not carried out, bends the coefficients by many of their standard errors, and the scatter of the
scores takes what is left for coloured noise. As long as all samples are kept they can be asked;
what they say when they are dropped is remembered (`layout.Doubt`).

What is left, whitened by an autoregression of its own, is independent of past inputs where the
model is right, also with coloured noise and with a controller. So means of the input over windows
of the past are to explain nothing of it, and neither are the responses of the model to squares and
cubes of the input, in which a limit or a bend of an actuator shows. Free responses and small moves
of the coefficients are taken out first: those for white noise are not the most likely ones where
the noise is coloured.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.finding import Finding
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.slices import Slices
from tridentify.online import residual
from tridentify.online.layout import Doubt, Setting
from tridentify.online.result import model_of
from tridentify.online.search import record_of
from tridentify.record.record import Record

WINDOWS = (1, 2, 3, 5, 9, 17, 33, 65)
"""Samples ago at which the windows of past inputs begin and end: short ones tell a late response,
long ones a missing slow one. The sample at the same instant may be a controller's answer to it."""
BY_CHANCE = 1e-5
"""Share of right models of which it may be said: estimates are asked for again and again."""
WAYS = {
    "nonlinear": ("Squares or cubes of the inputs", "is not carried out in full"),
    "unmodelled-response": ("Past inputs", "acts later than the structure says"),
}
"""Of each code, what explains, and why that may be."""
PER_COLUMN = 10  # samples for each column, from which a fall of -2 log L has its distribution


def doubting(setting: Setting, samples: Array, theta: Array, std: Array) -> Slices[Doubt | None]:
    """What speaks against a model in samples that it is of; None where nothing does.

    Parameters
    ----------
    setting : Setting
    samples : (k, n_inputs + n_outputs + 1) array
        All samples that the estimate is of, or the newest of them.
    theta, std : (n,) arrays
        Coefficients and their standard errors.
    """
    if not (np.all(np.isfinite(std)) and np.all(std > 0.0)):
        return None
    try:
        late, bent = yield from _explained(setting, samples, theta, std)
    except (TridentifyError, np.linalg.LinAlgError):
        return None
    if max(late.fall, bent.fall) <= 0.0:
        return None
    code = "nonlinear" if bent.fall > late.fall else "unmodelled-response"
    return Doubt(code, max(late, bent).share)


def doubt_finding(doubt: Doubt) -> Finding:
    """That the inputs explain part of what the model leaves, and in which way.

    Parameters
    ----------
    doubt : Doubt
    """
    what, how = WAYS[doubt.code]
    return Finding(
        doubt.code,
        "warning",
        f"{what} explain {100.0 * doubt.share:.3g} % of what the model leaves: the coefficients "
        f"may be off by more than their standard errors, as where an input {how}.",
        "Identify the stored record: off-line the causes are tried and named.",
    )


class Gain(NamedTuple):
    """What further columns explain of a whitened residual; zeros where it may be chance.

    Attributes
    ----------
    fall : float
        Of -2 log L.
    share : float
        Of the residual.
    """

    fall: float
    share: float


def _explained(
    setting: Setting, samples: Array, theta: Array, std: Array
) -> Slices[tuple[Gain, Gain]]:
    """What windows of past inputs explain of the residual, and what powers of the inputs do."""
    record = record_of(setting, samples)
    left, tables, moves = yield from residual.around(setting, record, theta, std)
    yield
    powers = _responses_to_powers(setting, record, theta)
    past = windows_of(record.u)
    tries = [([past] * setting.n_outputs), [powers[:, i].T for i in range(setting.n_outputs)]]
    found = []
    for one in tries:
        yield
        known = [
            np.column_stack([*(move[:, i] for move in moves), table])
            for i, table in enumerate(tables)
        ]
        found.append(_gain(left, known, one))
    return found[0], found[1]


def _responses_to_powers(setting: Setting, record: Record, theta: Array) -> Array:
    """(columns, n_outputs, k) responses of the model to squares and cubes of each input."""
    model, found = model_of(setting, theta), []
    for j in range(setting.n_inputs):
        moved = record.u[:, j] - record.u[:, j].mean()
        moved = moved / max(float(np.std(moved)), np.finfo(float).tiny)
        for power in (2, 3):
            u = np.zeros_like(record.u)
            u[:, j] = moved**power - moved[0] ** power
            found.append(simulate(model, record._derive(u=u)).T)
    return np.array(found)


def _gain(left: Array, known: list[Array], more: list[Array]) -> Gain:
    fall, freedom, before, after = 0.0, 0, 0.0, 0.0
    for i in range(left.shape[1]):
        a = residual.autoregression(left[:, i])
        white = residual.through(a, left[:, i])
        seen = np.isfinite(white)
        both = np.column_stack([residual.through(a, one) for one in (*known[i].T, *more[i].T)])
        if seen.sum() < PER_COLUMN * both.shape[1]:
            return Gain(0.0, 0.0)
        sizes = residual.sizes_of(white[seen])
        if not np.all(sizes > 0.0):
            return Gain(0.0, 0.0)
        rows, target = both[seen] / sizes[:, None], white[seen] / sizes
        without, fewer = _left(rows[:, : known[i].shape[1]], target)
        full, all_of_them = _left(rows, target)
        if not full > 0.0:
            return Gain(0.0, 0.0)
        fall += seen.sum() * np.log(without / full)
        freedom += all_of_them - fewer
        before, after = before + without, after + full
    if freedom < 1 or not fall > chdtri(freedom, BY_CHANCE):
        return Gain(0.0, 0.0)
    return Gain(float(fall), 1.0 - after / before)


def windows_of(u: Array) -> Array:
    """(k, windows * n_inputs) means of the inputs over windows of the past.

    Parameters
    ----------
    u : (k, n_inputs) array

    Examples
    --------
    >>> import numpy as np
    >>> windows_of(np.arange(5.0)[:, None])[:, :3].T
    array([[0. , 0. , 1. , 2. , 3. ],
           [0. , 0. , 0. , 1. , 2. ],
           [0. , 0. , 0. , 0. , 0.5]])
    """
    most = WINDOWS[-1]
    held = np.vstack([np.repeat(u[:1], most, axis=0), u]) - u[0]
    sums = np.vstack([np.zeros((1, u.shape[1])), np.cumsum(held, axis=0)])
    ends = np.arange(most + 1, most + 1 + len(u))
    means = [
        (sums[ends - begin] - sums[ends - end]) / (end - begin) for begin, end in pairwise(WINDOWS)
    ]
    return np.asarray(np.hstack(means) + np.tile(u[0], len(means)))


def _left(columns: Array, target: Array) -> tuple[float, int]:
    """Sum of squares that columns leave, and how many directions they span."""
    sizes = np.linalg.norm(columns, axis=0)
    scaled = columns / np.where(sizes > 0.0, sizes, 1.0)
    weights, _, rank, _ = np.linalg.lstsq(scaled, target, rcond=1e-9)
    return float(np.sum((target - scaled @ weights) ** 2)), int(rank)
