"""State-variable filters on the sampled input and output: the equation error of a raw record.

Dividing ``a(p) y* = b(p) u + c_0(p) delta(t - t0)`` by a stable ``c(p)`` of degree ``q >= n`` makes
an equation between signals that can be computed (Young 1964; Garnier, Mensler & Richard 2003),

    (a / c) y - (b / c) u - (c_0 / c) delta = eps,                                            (1)

linear in the coefficients of ``a`` (monic, degree ``n``), ``b`` and ``c_0`` (degree ``n - 1``: the
free initial state). The filters are orthonormal cascades (`numerics.realization`) in state space
and the unknowns the weights of their functions sorted by degree, so that columns are of like size
for fast and slow systems. Between samples the input is what the record says, and its columns are
exact. The output is not known there: the samples are joined by straight lines and that signal is
filtered exactly. Joining costs an error of order ``dt^2`` (``dt`` where ``u`` acts on ``y``
directly and is held), which remains without any noise.

*Constants.* ``y = y* + o + d (t - t0)`` adds ``(a / c)(o + d (t - t0))``. Since ``p 1 = delta`` and
``p (t - t0) = 1`` from ``t0`` on, that lies in the span of ``(1 / c) (t - t0)``, ``(1 / c) 1`` and
``p^k / c delta, k < n``. These columns are freed; that their weights are products of ``a``, ``o``
and ``d`` is not used, which costs some variance and keeps the problem linear. The offset and drift
reported are those of the output error, at the model found.

*Noise.* White noise ``e`` at the samples enters (1) as ``(a / c) e``: coloured, and through the
columns of ``a`` in the regressors as well. With instruments ``Z`` and regressors ``Phi`` the
unknowns solve ``Z' eps = 0``, so to first order in ``e``

    dx = - (Z' Phi)^{-1} G' e,     G = F' Z  (+ D' eps in the columns of a, if Z = Phi),       (2)

where ``F`` is the filter ``a / c`` on samples joined by lines and ``D`` the filters that make the
columns of ``a``; their transposes run backward in time. For instruments free of noise,
``sigma^2 (Z' Phi)^{-1} G' G (Phi' Z)^{-1}`` is the asymptotic covariance (Soderstrom & Stoica 1989,
section 8.2: instruments filtered by the noise filter). For least squares it is that about the
*biased* limit; being the mean square of a gradient in Gaussian variables it is, on average, not
below the variance (the Poincare inequality; Chernoff 1981). It says nothing about the bias.

References
----------
P. C. Young, Simulation 3(1) (1964), 45-58.
H. Garnier, M. Mensler, A. Richard, Int. J. Control 76(13) (2003), 1337-1357.
T. Soderstrom, P. Stoica, System Identification, Prentice Hall 1989, chapter 8.
H. Chernoff, Annals of Probability 9(3) (1981), 533-535.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.likelihood.curvature import SINGULAR
from tridentify.estimation.likelihood.held_model import HeldModel
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.methods.filtered.filter_cascade import Filter
from tridentify.models.regression import Experiment, Layout, Regression, regress
from tridentify.models.response import ColumnBlocks, Response
from tridentify.numerics.arrays import Array, Indices
from tridentify.numerics.discretize import discretize
from tridentify.numerics.least_squares import solve
from tridentify.numerics.propagate import propagate
from tridentify.numerics.realization import Cascade, cascade, filter_map, roots_of, sort_poles

TINY = 1e-300
"""Keeps the inverse root of the power of an output of nothing finite: near the smallest double."""


# ---------------------------------------------------------------------------------- filtering
def filtered_outputs(experiment: Experiment, c: Cascade, *extra: Array) -> Array:
    """States of ``c`` driven by every output, joined by straight lines between the samples.

    Parameters
    ----------
    experiment : Experiment
    c : Cascade
        q states.
    *extra : (n_samples,) arrays
        Further signals to filter.

    Returns
    -------
    (n_samples, q * (n_outputs + len(extra))) array
    """
    signals = np.ascontiguousarray(np.column_stack([experiment.y, *extra]))
    step = discretize(c.a, c.b[:, None], experiment.dt, "foh")
    count, k = signals.shape
    out = np.empty((k * c.order, count))
    upper = int(np.any(c.poles.imag != 0))
    propagate(
        step.transition,
        step.from_current[:, 0],
        step.from_next[:, 0],
        signals,
        np.zeros((k, c.order)),
        out,
        upper=upper,
    )
    return out.T


def constants(experiment: Experiment) -> tuple[Array, ...]:
    """The constant and the drift over the record, where they are estimated along."""
    count = experiment.n_samples
    found: tuple[Array, ...] = ()
    if experiment.offset or experiment.drift:
        found += (np.ones(count),)
    return (*found, *experiment.drifts)


def with_filtered(experiment: Experiment, c: Cascade) -> Experiment:
    """The experiment with the columns of equation (1) that come from ``y`` as further outputs.

    The outputs are followed by their filtered states (q each), ``(1 / c) 1`` and
    ``(1 / c)(t - t0)`` as far as needed; `regress` takes all of them into its triangle.
    """
    extra = constants(experiment)
    states = filtered_outputs(experiment, c, *extra)
    n_outputs, q = experiment.y.shape[1], c.order
    lowest = Filter.of(c).basis.rows[0]
    first = range(q * n_outputs, states.shape[1], q)
    last = [states[:, k : k + q] @ lowest for k in first]
    y = np.column_stack([experiment.y, states[:, : q * n_outputs], *last])
    # other columns than the outputs, which have no noise level
    return replace(
        experiment, y=y, free=experiment.free or bool(extra), offset=False, drift=False, scale=None
    )


def unreduced(experiment: Experiment, bank: Cascade) -> Regression:
    """As `regress`, with every sample a row: for what depends on the order of the samples."""
    layout = Layout(bank.order, experiment.u.shape[1], experiment.free, False, False)
    count, q = experiment.n_samples, bank.order
    step = discretize(bank.a, bank.b[:, None], experiment.dt, experiment.intersample)
    out = np.empty((layout.n_signals, count))
    current, after = step.from_current[:, 0], step.from_next[:, 0]
    if layout.free:
        nothing = np.zeros((count, 1))
        propagate(step.transition, current, after, nothing, bank.b[None, :].copy(), out)
    state = np.zeros((layout.n_inputs, q))
    propagate(step.transition, current, after, experiment.u, state, out[q * layout.free :])
    out[layout.states :] = experiment.u.T
    n = experiment.y.shape[1]
    return Regression(layout, (out.T,) * n, tuple(experiment.y.T), (count,) * n)


# ---------------------------------------------------------------------------------- equation error
class Equation(NamedTuple):
    """Equation (1) as ``matrix x ~ target``.

    ``instruments`` has the shape of ``matrix`` and is the same array for least squares; ``width``
    says which unknown stands where; ``owner`` (rows, 2) the experiment and output of a row.
    """

    matrix: Array
    target: Array
    instruments: Array
    width: dict[object, slice]
    owner: Indices


def equation(
    problem: Problem,
    regressions: Sequence[Regression],
    bank: Cascade,
    c: Cascade,
    weights: Array,
    model: Response | None = None,
) -> Equation:
    """Set up equation (1).

    Parameters
    ----------
    problem : Problem
    regressions : sequence of Regression
        Of the experiments `with_filtered`, on ``bank``.
    bank : Cascade
        ``c`` itself, or the poles of a model followed by those of ``c``.
    c : Cascade
    weights : (n_outputs,) array
    model : Response, optional
        Noise-free output whose filtered states are the instruments of the columns of ``a``.
    """
    n, q, n_outputs = problem.n_poles, c.order, problem.n_outputs
    basis = Filter.of(c).basis
    rows = basis.rows[:n]
    input_rows, driven = np.eye(q), None
    if model is not None:
        map_ = filter_map(c, bank)
        input_rows = np.tensordot(bank.b, map_, 1)
        driven = model.on(bank).filtered(bank, map_)
    columns, instruments, owner = ColumnBlocks(), ColumnBlocks(), []
    for e, regression in enumerate(regressions):
        extra = np.column_stack(regression.targets[n_outputs:])
        for i in range(n_outputs):
            w = weights[i]
            states = extra[:, q * i : q * (i + 1)]
            monic = regression.targets[i] if q == n else states @ (basis.rows[n] / basis.leading[n])
            linear: dict[object, Array] = {}
            for j, m in enumerate(problem.n_zeros[i]):
                block = regression.input_signal(i, j, (basis.rows[: min(m + 1, q)] @ input_rows).T)
                if m == q:
                    direct = regression.signals[i][:, regression.layout.direct(j)]
                    block = np.column_stack([block, direct])
                linear["b", i, j] = -w * block
            if regression.layout.free:
                impulses = regression.impulse_signal(i, (rows @ input_rows).T)
                linear["nuisance", e, i] = -w * np.hstack([impulses, extra[:, q * n_outputs :]])
            columns.add({"a": w * (states @ rows.T), **linear}, -w * monic)
            if driven is not None:
                noiseless = driven.signals(regression, e, i) @ rows.T
                instruments.add({"a": w * noiseless, **linear}, monic)
            owner.append(np.tile([e, i], (monic.size, 1)))
    matrix, target = columns.assemble()
    z = matrix if driven is None else instruments.assemble()[0]
    return Equation(matrix, target, z, columns.width, np.vstack(owner))


def solve_equation(found: Equation, n_poles: int) -> tuple[Array, float, float]:
    """The unknowns, the sum of squares of the equation error, and the condition.

    Raises
    ------
    UnsupportedOrderError
        If the columns are linearly dependent.
    """
    if found.instruments is found.matrix:
        x, cost, condition, _ = solve(found.matrix, found.target)
    else:
        norms = np.linalg.norm(found.instruments, axis=0)
        q = np.linalg.qr(found.instruments / np.where(norms > 0, norms, 1.0))[0]
        x, _, condition, _ = solve(q.T @ found.matrix, q.T @ found.target)
        left = found.matrix @ x - found.target
        cost = float(left @ left)
    if not condition < SINGULAR:
        raise UnsupportedOrderError(
            f"found filtered signals of condition {condition:.1e} with {n_poles} poles; expected "
            f"signals that can be told apart (below {SINGULAR:.0e}); lower the number of poles or "
            "zeros, or excite the system more richly"
        )
    return x, cost, condition


def coefficient_map(
    problem: Problem, c: Cascade, width: dict[object, slice]
) -> tuple[Array, Array]:
    """``theta = constant + matrix x``: physical coefficients from the unknowns of equation (1)."""
    n, q = problem.n_poles, c.order
    known = Filter.of(c)
    basis, proper, monic = known.basis, known.proper, known.monic
    constant = np.zeros(problem.n_coefficients)
    matrix = np.zeros((problem.n_coefficients, max(s.stop for s in width.values())))
    constant[:n] = monic[1:] if q == n else proper[n, q - n :] / basis.leading[n]
    matrix[:n, width["a"]] = proper[:n, q - n :].T
    at = n
    for i, line in enumerate(problem.n_zeros):
        for j, m in enumerate(line):
            block = np.pad(proper[: min(m + 1, q)], ((0, 0), (1, 0)))
            if m == q:
                block = np.vstack([block, monic])
            matrix[at : at + m + 1, width["b", i, j]] = block[:, q - m :].T
            at += m + 1
    return constant, matrix


# ---------------------------------------------------------------------------------- solution
@dataclass(frozen=True, eq=False)
class SvfFit:
    """Equation (1) solved: the model, and what its covariance needs.

    Attributes
    ----------
    model : HeldModel
    c : Cascade
    weights : (n_outputs,) array
        Of the outputs.
    unknowns : array
        ``x``.
    cost, condition : float
        Mean square of the weighted equation error; condition of the equations.
    source : HeldModel or None
        The model that made the instruments.
    """

    model: HeldModel
    c: Cascade
    weights: Array
    unknowns: Array
    cost: float
    condition: float
    source: HeldModel | None


def fit(
    problem: Problem,
    experiments: Sequence[Experiment],
    c: Cascade,
    source: HeldModel | None = None,
) -> SvfFit:
    """Solve equation (1) by least squares, or with the instruments of a model.

    Parameters
    ----------
    problem : Problem
    experiments : sequence of Experiment
        Those of the problem `with_filtered` by ``c``.
    c : Cascade
    source : HeldModel, optional
        Its noise-free output is the instrument of ``y``, and its output error weights the outputs.

    Raises
    ------
    UnsupportedOrderError
        If the filtered signals are linearly dependent.
    """
    bank = bank_of(c, source)
    if source is None:
        weights = 1.0 / np.sqrt(np.maximum(problem.power, TINY))
    else:
        weights = 1.0 / np.sqrt(source.variance)
    regressions = [regress(e, bank) for e in experiments]
    model = None if source is None else source.response
    found = equation(problem, regressions, bank, c, weights, model)
    x, cost, condition = solve_equation(found, problem.n_poles)
    constant, matrix = coefficient_map(problem, c, found.width)
    theta = constant + matrix @ x
    n = problem.n_poles
    if c.order == n:
        roots = roots_of(c, x[found.width["a"]] @ Filter.of(c).basis.rows[:n])
    else:
        roots = sort_poles(np.roots(np.append(1.0, theta[:n])).astype(np.complex128))
    poles, note = problem.admissible(roots)
    samples = sum(e.n_samples for e in experiments) * problem.n_outputs
    held = HeldModel(problem, poles, theta[n:], note)
    return SvfFit(held, c, weights, x, cost / samples, condition, source)


def bank_of(c: Cascade, source: HeldModel | None) -> Cascade:
    """What the input is filtered by: ``c``, behind the poles of the model of the instruments."""
    if source is None:
        return c
    return cascade(np.concatenate([source.poles, c.poles]))


# ---------------------------------------------------------------------------------- covariance
def backward(columns: Array, row: Array, c: Cascade, dt: float) -> Array:
    """The transpose of ``e -> row X e`` on samples joined by lines, applied to every column.

    Parameters
    ----------
    columns : (n_samples, k) array
    row : (q,) array
    c : Cascade
    dt : float

    Returns
    -------
    (n_samples, k) array

    Notes
    -----
    With ``x_{k+1} = F x_k + g_0 e_k + g_1 e_{k+1}``, ``x_0 = 0`` and ``l_k = row' w_k +
    F' l_{k+1}`` the transpose is ``g_0' l_{k+1} + g_1' l_k``, without the second term at the
    first sample.
    """
    step = discretize(c.a, c.b[:, None], dt, "foh")
    count, k = columns.shape
    q = c.order
    states = np.empty((k * q, count + 1))
    reversed_ = np.zeros((count + 1, k))
    reversed_[:count] = columns[::-1]
    propagate(
        np.ascontiguousarray(step.transition.T),
        np.ascontiguousarray(row),
        np.zeros(q),
        reversed_,
        np.zeros((k, q)),
        states,
    )
    # states[:, m] is l at sample count - m; nothing follows the last sample
    costate = states.reshape(k, q, count + 1)[:, :, ::-1]
    after = np.einsum("kqm,q->mk", costate[:, :, 1:], step.from_current[:, 0])
    now = np.einsum("kqm,q->mk", costate[:, :, :-1], step.from_next[:, 0])
    now[0] = 0.0
    return np.asarray(after + now)
