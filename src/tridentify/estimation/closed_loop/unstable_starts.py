"""Step 2 for a plant that may be unstable or integrate: its equation error, from what is driven.

Step 1 gives ``u_M`` and ``y_M`` (`driven`), both bounded, as the loop is stable.

*Step 2* is the equation error of the two. With a stable ``c(p)``

    (p^n / c) y_M = - sum a_k (p^k / c) y_M + sum b_k (p^k / c) u_M

is linear in the coefficients and carries no noise; its poles are taken as they come. ``c`` is
``(p + g)^n`` with the rate ``g`` of the operators and its neighbours, then the mirrored ``a``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.linear_errors import linear_errors, slowest, stacked
from tridentify.estimation.closed_loop.predictor import Plant, Predictor, recorded, shifted
from tridentify.models.regression import Experiment, response_of
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import cascade, denominator, monomials, sort_poles

SHARES = (1.0, 0.3, 3.0, 0.1)
"""Rates of the first filters over that of the operators, which is one of the loop's."""
START_PASSES = 6
"""Of Step 2 on the mirrored denominator; they settle in three or not at all."""


def starting_plants(loops: Sequence[Loop], n: int, zeros: Sequence[int]) -> list[Plant]:
    """Step 2 from several filters.

    Parameters
    ----------
    loops : sequence of Loop
    n : int
        Number of poles.
    zeros : sequence of int
        Of every input.
    """
    found = []
    for share in SHARES:
        poles = np.full(n, -share * loops[0].fitted.rate, dtype=np.complex128)
        try:
            for _ in range(START_PASSES):
                plant = _equation_error(loops, poles, zeros)
                poles = _mirrored(plant, loops)
        except (np.linalg.LinAlgError, ValueError):
            continue
        if np.all(np.isfinite(plant.theta)):
            found.append(plant)
    sampled = _difference_equation(loops, n, zeros)
    return found if sampled is None else [*found, sampled]


def _difference_equation(loops: Sequence[Loop], n: int, zeros: Sequence[int]) -> Plant | None:
    """Step 2 in discrete time: the same equation between samples, by instrumental variables.

    ``y_k = - sum alpha_i y_{k-i} + sum beta_i u_{k-i}`` is exact for a held input, and needs
    nothing of what lies between the samples; its instruments are the same lags of the driven
    signals. The numerators follow from the poles, as ``e`` is linear in them.
    """
    rows, mates, target = [], [], []
    for loop in loops:
        part, y = loop.fitted, recorded(loop).y
        signals = np.column_stack([y, _acting(loop, loop.record.u)])
        free = np.column_stack(
            [part.outputs[:, 0] - part.outputs[0, 0], _acting(loop, part.inputs)]
        )
        lags = [range(1, n + 1), *(range(n + 1) for _ in zeros)]
        rows.append(lagged(signals, lags, n))
        mates.append(lagged(free, lags, n))
        target.append(y[n:])
    phi, z = np.vstack(rows), np.vstack(mates)
    norms = np.linalg.norm(z, axis=0) + 1e-300
    alpha = -np.linalg.lstsq(
        (z / norms).T @ phi, (z / norms).T @ np.concatenate(target), rcond=1e-12
    )[0][:n]
    roots = np.roots(np.concatenate([[1.0], alpha]))
    if not np.isfinite(roots).all() or np.any((roots.imag == 0) & (roots.real <= 0)):
        return None
    step = float(loops[0].record.dt or 0.0)
    poles = np.asarray(np.log(roots.astype(np.complex128)) / step, dtype=np.complex128)
    return with_poles(loops, poles, zeros)


def with_poles(loops: Sequence[Loop], poles: Complex, zeros: Sequence[int]) -> Plant | None:
    """The plant of given poles: ``e`` is linear in its numerators. None where it runs away."""
    a = np.real(np.poly(poles))[1:]
    plant = Plant(a, tuple(np.zeros(m + 1) for m in zeros))
    linear = linear_errors(loops, plant, np.zeros(0))
    if not linear.is_finite:
        return None
    matrix = np.hstack([linear.slopes[:, a.size :], linear.rest])
    norms = np.linalg.norm(matrix, axis=0) + 1e-300
    weights = np.linalg.lstsq(matrix / norms, linear.errors, rcond=1e-12)[0] / norms
    return plant.with_theta(np.concatenate([a, weights[: plant.theta.size - a.size]]))


def _acting(loop: Loop, inputs: Array) -> Array:
    """(n_samples, n_inputs) as late as they act."""
    return shifted(np.array(inputs), np.array(loop.late)) if loop.late else np.asarray(inputs)


def lagged(signals: Array, lags: Sequence[range], most: int) -> Array:
    """(n_samples - most, k) lags of the signals, and a constant."""
    columns = [
        signals[most - lag : len(signals) - lag, j] for j, own in enumerate(lags) for lag in own
    ]
    return np.column_stack([*columns, np.ones(len(signals) - most)])


def _mirrored(plant: Plant, loops: Sequence[Loop]) -> Complex:
    step = float(loops[0].record.dt or 0.0)
    return sort_poles(Predictor(plant, step, slowest(loops)).mirrored)


def _equation_error(loops: Sequence[Loop], poles: Complex, zeros: Sequence[int]) -> Plant:
    bank, n = cascade(poles), len(poles)
    c = denominator(poles)
    powers = monomials(bank, n)
    rows, target = [], []
    for loop in loops:
        part = loop.fitted
        held = part.means(1, slice(0, loop.record.n_inputs + 1))
        held = held - np.column_stack([part.inputs, part.outputs])[0]
        held[:, :-1] = _acting(loop, held[:, :-1])
        width = held.shape[1]
        experiment = Experiment(
            np.ascontiguousarray(held), np.zeros((len(held), 1)), float(loop.record.dt or 0.0),
            "zoh", free=True, offset=False, drift=False,
        )  # fmt: skip
        q = n * (width + 1)
        pick = np.zeros((q, q + width + 2))
        pick[:, :q] = np.eye(q)
        states = response_of(experiment, bank, pick[:, : q + width], outputs=[0] * q)
        start, own = states[:, :n], states[:, n:].reshape(len(held), width, n)
        filtered = np.einsum("kjs,ps->kjp", own, powers)
        columns = [-filtered[:, -1, ::-1]]
        for j, m in enumerate(zeros):
            block = filtered[:, j, : min(m + 1, n)][:, ::-1]
            if m == n:
                block = np.column_stack([held[:, j], block])
                block[:, 0] -= filtered[:, j, :] @ c[:0:-1]
            columns.append(block)
        y = part.outputs[:, 0] - part.outputs[0, 0]
        rows.append(np.hstack([*columns, start, np.ones((len(y), 1))]))
        target.append(y - filtered[:, -1, :] @ c[:0:-1])
    n_theta = n + sum(m + 1 for m in zeros)
    matrix = stacked([one[:, :n_theta] for one in rows], [one[:, n_theta:] for one in rows])
    norms = np.linalg.norm(matrix, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    theta = np.linalg.lstsq(matrix / scale, np.concatenate(target), rcond=1e-12)[0] / scale
    ends = np.cumsum([n, *(m + 1 for m in zeros)])
    parts = np.split(theta[:n_theta], ends[:-1])
    return Plant(parts[0], tuple(parts[1:]))
