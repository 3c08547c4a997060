"""The Fisher information of a planned experiment, as the estimators will see it.

For independent Gaussian noise of standard deviation ``sigma_i`` on output ``i`` the information of
all unknowns is ``sum_i J_i' J_i / sigma_i^2``, with ``J_i`` the derivatives of the sampled output,
those by offset, drift and initial state included (Kay 1993, section 3.9). What is not asked for is
projected off: ``J_i`` minus its share along the nuisance columns. That is done with the very
columns that the estimators use, at the true coefficients, for the output that the planned input
gives without noise: `knowledge.fixed_denominator` where all channels share one denominator
(integrators and knowledge of coefficients included), `likelihood.cost` where they do not, or where
a delay is estimated along. Only the triangle of the result is kept.

Coefficients move along the directions ``N`` that the structure leaves free, and priors bring
information of their own: ``cov = N (N' F N + N' P N)^{-1} N'``. ``F`` is proportional to the square
of the amplitude of all inputs together, and to the number of repetitions of the experiment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import OrderError, UndeterminedError, UnsupportedError
from tridentify.estimation.knowledge.affine import Knowledge, known_of
from tridentify.estimation.knowledge.fixed_denominator import fit, place
from tridentify.estimation.knowledge.solve import problem_for
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.curvature import SINGULAR, physical_transform
from tridentify.estimation.likelihood.setup.nuisance import Nuisances, build, candidates
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.least_squares import column_norms, triangle
from tridentify.physical.model import model_of
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction


@dataclass(frozen=True, eq=False)
class Information:
    """What an experiment, or what is known beforehand, tells of the coefficients.

    Attributes
    ----------
    factor : (r, k) array
        ``R`` with ``R' R = N' F N``, the nuisance terms eliminated.
    directions : (p, k) array
        ``N``: the directions in which coefficients may move.
    held : (m, k) array
        The same for the priors.
    """

    factor: Array
    directions: Array
    held: Array

    def covariance(self, scale: float = 1.0) -> Array:
        """(p, p), for noise that is ``1 / scale`` times as large.

        Raises
        ------
        UndeterminedError
            The experiment cannot tell the coefficients apart.
        """
        root = self.root(scale)
        cov = root @ root.T
        return np.asarray(0.5 * (cov + cov.T))

    def root(self, scale: float = 1.0) -> Array:
        """(p, k) factor of the covariance."""
        rows = np.vstack([scale * self.factor, self.held])
        norms = column_norms(rows)
        _, s, vt = np.linalg.svd(rows / norms, full_matrices=False)
        if s.size < norms.size or not s[-1] * SINGULAR > s[0]:
            raise UndeterminedError(
                "found an experiment that cannot tell the coefficients apart; expected an input "
                "that determines all of them; excite at more frequencies, record longer, or state "
                "what is known"
            )
        return np.asarray(self.directions @ ((vt.T / s) / norms[:, None]))


def coefficients_of(model: TransferFunction, structure: Structure) -> Array:
    """The parameter vector of a model, in the order of `Structure.names`.

    Parameters
    ----------
    model : TransferFunction
    structure : Structure

    Returns
    -------
    (p,) array

    Raises
    ------
    OrderError, UnsupportedError
        The model has other orders than the structure, or no common denominator where it needs one.

    Examples
    --------
    >>> coefficients_of(TransferFunction([2.0], [1.0, 3.0, 4.0]), Structure(2, 1)).tolist()
    [3.0, 4.0, 0.0, 2.0]
    """
    shape = (model.n_outputs, model.n_inputs)
    poles, zeros = structure.poles_matrix(*shape), structure.zeros_matrix(*shape)
    if structure.shared and model.common_denominator is None:
        raise UnsupportedError(
            "found a model whose channels have different denominators; expected a common one as in "
            "the structure; nest poles[output][input]"
        )
    found: list[Array] = [model.den[0][0][1:]] if structure.shared else []
    for i, row in enumerate(model.num):
        for j, num in enumerate(row):
            b = np.trim_zeros(num, "f")
            if model.den[i][j].size - 1 != poles[i][j] or b.size > zeros[i][j] + 1:
                raise OrderError(
                    f"found a model with {model.den[i][j].size - 1} poles and "
                    f"{max(b.size - 1, 0)} zeros; expected {poles[i][j]} poles and at most "
                    f"{zeros[i][j]} zeros as in the structure; correct one of the two"
                )
            if not structure.shared:
                found.append(model.den[i][j][1:])
            found.append(np.pad(b, (zeros[i][j] + 1 - b.size, 0)))
    if structure.delay == "free":
        if np.any(model.delay != model.delay[0]):
            raise UnsupportedError(
                "found delays that differ between outputs; expected one for each input, as "
                "delay='free' estimates them; state the delays"
            )
        found.append(model.delay[0])
    return np.concatenate(found)


def structure_of(model: TransferFunction) -> Structure:
    """The structure that a model has: its orders, its delays, and poles at the origin as known."""
    shape = [[0] * model.n_inputs for _ in range(model.n_outputs)]
    zeros = [
        [max(np.trim_zeros(model.num[i][j], "f").size - 1, 0) for j in range(len(row))]
        for i, row in enumerate(shape)
    ]
    den = model.common_denominator
    delay: float | list[list[float]] = model.delay.tolist() if np.any(model.delay) else 0.0
    if den is None:
        poles = [[d.size - 1 for d in row] for row in model.den]
        return Structure(poles, zeros, delay=delay)
    integrators = den.size - np.trim_zeros(den, "b").size
    fixed = {f"a{k}": 0.0 for k in range(integrators)}
    return Structure(den.size - 1, zeros, delay=delay, fixed=fixed or None)


def model_from(theta: Array, structure: Structure, like: TransferFunction) -> TransferFunction:
    """The model of a parameter vector, with the names of channels of another."""
    return model_of(structure, theta, like.input_names, like.output_names)


def fullest(records: Sequence[Record], structure: Structure) -> tuple[Nuisances, bool]:
    """The most that the structure allows to be estimated along, and whether it allows less too."""
    choices = candidates(records, structure)
    return choices[-1], len(choices) > 1


def information(
    theta: Array,
    records: Sequence[Record],
    structure: Structure,
    nuisances: Nuisances,
    noise_std: Array,
    like: TransferFunction,
    colour: tuple[Array, ...] = (),
) -> Information:
    """Information of planned experiments on the coefficients.

    Parameters
    ----------
    theta : (p,) array
        The true coefficients.
    records : sequence of Record
        Their inputs count, and which output samples are there.
    structure : Structure
    nuisances : Nuisances
        What is estimated along.
    noise_std : (n_outputs,) array
        Of white noise, or of the innovations where the noise has a colour.
    like : TransferFunction
        Names of channels.
    colour : tuple of arrays
        Autoregressive coefficients of each output's noise.

    Returns
    -------
    Information

    Raises
    ------
    UnsupportedError
        The model is not stable (apart from integrators that the structure knows of).
    """
    model = model_from(theta, structure, like)
    if structure.shared and structure.delay != "free":
        known = known_of(structure, like.input_names, like.output_names, _sizes(theta))
        _refuse_unstable(model, known.integrators)
        plans = [_flown(model, record, nuisances) for record in records]
        problem = problem_for(plans, structure, nuisances, known).whitened(colour)
        return _of_place(theta, problem, known, noise_std)
    if structure.constrained:
        known_of(structure, like.input_names, like.output_names)  # says why it is refused
    _refuse_unstable(model, 0)
    plans = [_flown(model, record, nuisances) for record in records]
    free = structure.delay == "free"
    held = replace(structure, delay=model.delay.tolist()) if free else structure
    problem = build(plans, held, nuisances).whitened(colour)
    if free:
        problem = problem.freed(np.full(model.n_inputs, np.inf))
    return _of_point(theta, problem, model, noise_std)


def _of_place(theta: Array, problem: Problem, known: Knowledge, noise_std: Array) -> Information:
    here = place(problem, theta[: problem.n_poles - known.integrators], known.integrators)
    derivatives = fit(here, theta).columns
    rows = np.vstack([own / s for own, s in zip(derivatives, noise_std, strict=True)])
    prior = np.isfinite(known.spread)
    held = known.directions[prior] / known.spread[prior, None]
    return Information(triangle(rows @ known.directions), known.directions, held)


def _of_point(
    theta: Array, problem: Problem, model: TransferFunction, noise_std: Array
) -> Information:
    roots = [np.roots(model.den[g.channels[0][0]][g.channels[0][1]]) for g in problem.groups]
    point = evaluate(problem, problem.admissible(np.concatenate(roots).astype(complex))[0])
    matrix, output = point.jacobian()
    rows = matrix / noise_std[output][:, None]
    turn = physical_transform(point, rows.shape[1])
    own = np.flatnonzero(np.any(turn, axis=0))
    others = np.setdiff1d(np.arange(rows.shape[1]), own)
    # what stands first in the triangle is eliminated from the corner that stands last
    corner = triangle(rows[:, np.concatenate([others, own])])[others.size :, others.size :]
    sizes = _sizes(theta)
    factor = np.asarray(np.linalg.solve(turn[:, own].T / sizes, corner.T).T, dtype=np.float64)
    return Information(factor, np.diag(sizes), np.zeros((0, theta.size)))


def _sizes(theta: Array) -> Array:
    """What the coefficients are counted in."""
    return np.where(theta != 0, np.abs(theta), 1.0)


def _flown(model: TransferFunction, record: Record, nuisances: Nuisances) -> Record:
    """The record as it would be without noise, from rest or from what its first input holds."""
    t = record.t if record.dt is None else None
    zeros = np.zeros((record.n_samples, model.n_outputs))
    start = record.u[0] if nuisances.initial_state == "equilibrium" else 0.0
    moved = Record(record.u - start, zeros, dt=record.dt, t=t, intersample=record.behaviour)
    y = simulate(model, moved)
    if record.n_outputs == model.n_outputs:
        y = np.where(np.isnan(record.y), np.nan, y)
    return Record(
        record.u,
        y,
        dt=record.dt,
        t=t,
        intersample=record.behaviour,
        **record._loop,
        input_names=model.input_names,
        output_names=model.output_names,
    )


def _refuse_unstable(model: TransferFunction, integrators: int) -> None:
    for row in model.den:
        for den in row:
            a = den[: den.size - integrators]
            poles = np.roots(a)
            if poles.size and (np.any(poles.real >= 0) or np.any(den[a.size :])):
                raise UnsupportedError(
                    f"found a pole at {poles[np.argmax(poles.real)]:.4g} 1/s; expected all in the "
                    "open left half plane, apart from integrators that the structure knows of; "
                    "correct the model, or state fixed={'a0': 0.0}"
                )
