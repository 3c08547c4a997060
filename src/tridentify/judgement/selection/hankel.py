r"""Hankel singular values of the parallel model, and which of them are more than noise.

The parallel model ``y = sum_i beta_i W_i(p) u`` is a system of high order. Its Hankel singular
values say how much each of its directions of state hands from past input to future output; a
system of order ``n`` has ``n`` that are not zero (Glover 1984; Antoulas 2005, chapter 5). On an
orthonormal cascade ``(A, B)`` they are exact and cheap, in continuous time: the controllability
Gramian is the identity, so with ``C`` the weights and

    A' Q + Q A + C' C = 0

they are the roots of the eigenvalues of ``Q``. The channels count as outputs of one system with one
input, whose order is that of the denominator they share; each is scaled with the root mean square
of its input over that of its noise, so that the values have no unit.

*The floor.* Fitted weights are ``beta + e``, where ``e`` has the covariance of the least-squares
fit. Hankel singular values are those of a linear operator, hence (Weyl) ``s_k(beta + e) <=
s_k(beta) + s_1(e)``: of a system of order ``n`` the values after the n-th stay below the largest
one of noise alone. The floor is the 95 % quantile of that over draws of ``e``; what rises above it
is not noise. That way is safe: a value below the floor may still be one of the system's, above all
where the input excites some operators poorly, so their number is a lower bound of the order.

*Which operators.* A floor that shows anything wants few operators that the input excites: those on
the poles of the recommended candidate, each three times. Twice would not do: there the fit is at
its stationary point, and all further values are zero by construction. More values above the floor
than the candidate has poles speak against it.

References: K. Glover, International Journal of Control 39 (1984) 1115-1193. A. Antoulas,
*Approximation of Large-Scale Dynamical Systems*, SIAM (2005).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.answer.trace import freeze_arrays
from tridentify.estimation.likelihood.setup.nuisance import build_base, candidates
from tridentify.estimation.likelihood.setup.problem import Problem, Variant
from tridentify.models.regression import Regression, regress
from tridentify.models.response import ColumnBlocks, nuisance_blocks
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.information import aicc_price
from tridentify.numerics.realization import Cascade, cascade
from tridentify.record.record import Record
from tridentify.structure import Structure

DRAWS = 200
"""Draws of the noise alone: the quantile below rests on ten of them."""
LEVEL = 0.95
"""Quantile of a singular value by noise alone above which it counts."""
SINGULAR = 1e-10
"""Singular values of the columns below this share of the largest count as nothing."""


@dataclass(frozen=True, eq=False)
class Hankel:
    """Hankel singular values of the parallel model.

    Attributes
    ----------
    values : ndarray, shape (n_operators,)
        Largest first; input size over noise size, so without unit.
    noise : ndarray, shape (n_operators,)
        What 95 % of draws of noise alone stay below, value by value.
    floor : float
        ``noise[0]``: what rises above it is not noise.
    operators : str
        Which operators the model has.

    Examples
    --------
    >>> Hankel(np.array([9.0, 4.0, 0.3]), np.array([0.5, 0.4, 0.3]), 0.5, "Laguerre").order
    2
    """

    values: Array
    noise: Array
    floor: float
    operators: str

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def order(self) -> int:
        """How many values rise above the floor: a lower bound of the order."""
        return int(np.sum(self.values > self.floor))


@dataclass(frozen=True, eq=False)
class _Weights:
    """Fitted weights (n_outputs n_inputs, q), a root of their covariance, and the fit's AICc."""

    bank: Cascade
    rows: Array
    roots: tuple[Array, ...]
    criterion: float

    def draw(self, rng: np.random.Generator) -> Array:
        """Weights of noise alone."""
        parts = [root @ rng.standard_normal(root.shape[1]) for root in self.roots]
        return np.concatenate(parts).reshape(self.rows.shape)


def hankel_values(
    records: Sequence[Record],
    operators: Sequence[tuple[str, Complex]],
    nuisances: Structure,
    noise: tuple[Array, ...] = (),
) -> Hankel:
    """Fit parallel models and give the Hankel singular values of the best one by AICc.

    Parameters
    ----------
    records : sequence of Record
    operators : sequence of (str, (q,) complex array)
        Banks to choose from: name and poles.
    nuisances : Structure
        Which offset, drift, initial state and known delay go along.
    noise : tuple of (p,) arrays
        Noise model of each output; empty for white.

    Returns
    -------
    Hankel

    Examples
    --------
    >>> from tridentify import TransferFunction, simulate
    >>> rng = np.random.default_rng(0)
    >>> u = np.repeat(rng.choice([-1.0, 1.0], 100), 5)
    >>> y = simulate(TransferFunction([2.0, 3.0], [1.0, 3.0, 9.0]), Record(u, u, dt=0.05))
    >>> record = Record(u, y + 0.02 * rng.standard_normal((500, 1)), dt=0.05)
    >>> hankel_values([record], [("Laguerre", -3.0 * np.ones(8))], Structure(1, 0)).order
    2
    """
    base, variants = build_base(records, nuisances, candidates(records, nuisances))
    base, variant = base.whitened(noise), variants[-1]
    found = [
        (_weights(base, variant, np.asarray(poles, complex)), name) for name, poles in operators
    ]
    best, name = min(found, key=lambda pair: pair[0].criterion)
    rng = np.random.default_rng(0)
    alone = [best.draw(rng) for _ in range(DRAWS)]
    values = _singular_values(best.bank.a, np.array([best.rows, *alone]))
    limits = np.quantile(values[1:], LEVEL, axis=0)
    return Hankel(values[0], limits, float(limits[0]), f"{best.bank.order} operators, {name}")


def _singular_values(a: Array, c: Array) -> Array:
    """(..., q) roots of the eigenvalues of the observability Gramians of (..., r, q) weights."""
    q = len(a)
    # one equation for all: A' Q + Q A in the entries of Q
    along = np.kron(a.T, np.eye(q)) + np.kron(np.eye(q), a.T)
    energies = np.swapaxes(c, -1, -2) @ c
    gramians = np.linalg.solve(along, -energies.reshape(-1, q * q).T).T.reshape(energies.shape)
    values = np.linalg.eigvalsh(0.5 * (gramians + np.swapaxes(gramians, -1, -2)))[..., ::-1]
    return np.asarray(np.sqrt(np.maximum(values, 0.0)))


def _weights(base: Problem, variant: Variant, poles: Complex) -> _Weights:
    """Step 1 with the covariance of its weights."""
    bank = cascade(poles)
    regressions = variant.regressions(tuple(regress(e, bank) for e in base.experiments), bank)
    u = np.vstack([e.u for e in base.experiments])
    size = u.std(axis=0)
    size = np.where(size > 0, size, 1.0)
    rows, roots, criterion = [], [], 0.0
    for i in range(base.n_outputs):
        columns = _columns(regressions, i, bank.order)
        matrix, target = columns.assemble()
        norms = np.linalg.norm(matrix, axis=0)
        norms = np.where(norms > 0, norms, 1.0)
        _, s, vt = np.linalg.svd(matrix / norms, full_matrices=False)
        q = np.linalg.lstsq(matrix / norms, target, rcond=SINGULAR)[0]
        rss = float(np.sum((target - matrix / norms @ q) ** 2))
        count = float(sum(r.counts[i] for r in regressions))
        k = float(matrix.shape[1])
        variance = max(rss / max(count - k, 1.0), 1e-30 * float(base.size[i]))
        inverse = np.where(s > SINGULAR * s[0], 1.0 / np.maximum(s, 1e-300), 0.0)
        root = (vt.T * inverse) / norms[:, None]
        where = np.concatenate(
            [
                np.arange(columns.width["beta", j].start, columns.width["beta", j].stop)
                for j in range(base.n_inputs)
            ]
        )
        gain = np.repeat(size, bank.order)
        rows.append((gain * (q / norms)[where] / np.sqrt(variance)).reshape(-1, bank.order))
        roots.append(gain[:, None] * root[where])
        criterion += count * np.log(max(rss / count, 1e-30 * float(base.size[i])))
        criterion += aicc_price(float(k), count)
    return _Weights(bank, np.vstack(rows), tuple(roots), criterion)


def _columns(regressions: Sequence[Regression], output: int, order: int) -> ColumnBlocks:
    """All columns of one output: operators, free responses, nuisance terms."""
    columns, unit = ColumnBlocks(), np.eye(order)
    layout = regressions[0].layout
    for e, regression in enumerate(regressions):
        blocks: dict[object, Array] = {}
        for j in range(layout.n_inputs):
            blocks["beta", j] = regression.input_signal(output, j, unit)
        if regression.layout.free:
            blocks["free", e] = regression.impulse_signal(output, unit)
        blocks |= nuisance_blocks(regression, e, output)
        columns.add(blocks, regression.targets[output])
    return columns
