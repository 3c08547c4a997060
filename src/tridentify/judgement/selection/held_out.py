"""The cross-validated fit: on a second record, or on blocks of the first that the fit did not see.

*A second record.* Coefficients are held; offset and initial state, which belong to each record,
are fitted to it.

*Without one* the usual cut into a first and a second half does not serve a manoeuvre: the response
to a step has died away in the second half, which then says nothing. Here blocks of output samples
all over the record are marked as missing, the coefficients are fitted to what is left, from where
the candidate's own estimate ended and with its own noise model, and judged on the blocks. Every
sample is left out once: five folds, each of several blocks. The blocks are contiguous because
neighbouring samples of coloured noise know each other (Burman, Chow & Nolan, Biometrika 81, 1994,
351-358; Racine, Journal of Econometrics 99, 2000, 39-61).

*How long a block is.* A twentieth of the record. But after a single step all that is to be learnt
about the plant happens in a few samples: they may all lie in one block, and what is fitted without
them is anything. So where one fold holds nearly all of the information on some combination of the
coefficients, blocks hold equal shares of length and information instead, half of each: the
information of a sample is its leverage.

*Offset, drift and initial state* belong to the record, not to the plant. Fitted without the first
block, a free initial state has to be run backwards through it, which explodes for every pole that
is faster than the block. Fitted to each block by itself, it would explain the block of a slow
plant whatever the input did. So with the coefficients held they are fitted once, to all samples of
the record, and the state at a block's begin follows from the input all the way. A sample helps to
fix these few terms; what that saves it pays back: its error is divided by ``1 - h``, ``h`` its
leverage on them, which makes it the error of a fit without that sample (Allen, Technometrics 16,
1974, 125-127).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.answer import model_of
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients, finish
from tridentify.estimation.likelihood.setup.nuisance import first_explained
from tridentify.estimation.methods.output_error import OutputError
from tridentify.judgement.causes.attempts.revisit import poles_of_estimate, problem_of, stated
from tridentify.judgement.selection.paired import RANK, without
from tridentify.models.columns import drift_columns
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

FOLDS = 5
"""Parts that are held out in turn."""
BLOCKS = 4
"""Stretches of each part, spread over the record, so that no part is one manoeuvre."""
MOST_HELD = 0.9
"""Share of the information on a combination of coefficients in one fold, from which the others
cannot say what it is. Manoeuvres and random inputs have up to 0.8, a short transient 0.96 to 1."""
INFORMED = 0.5
"""Share of information in what blocks then hold equally much of; the rest is length. All of it
would leave a stretch at rest, where a wrong model may drift away, in one block."""
FEWEST = 40
"""Samples below which a fifth of them is no test: eight."""
MOST_STEPS = 20
"""Steps without a part, from the end with all of them: it is near."""
NEAR = 1e-5
"""Fall of ``-2 log L`` that a further step has to promise: less moves coefficients by a three
hundredth of a standard error, and nothing that shows of the samples that were left out."""


@dataclass(frozen=True, eq=False)
class HeldEstimate:
    """One estimate, its records, perhaps records that it has not seen, and what was asked for."""

    estimate: Estimate | None
    records: tuple[Record, ...]
    validation: tuple[Record, ...]
    asked: Structure | None = None


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What became of the samples that were not fitted.

    Attributes
    ----------
    fit : (n_outputs,) array
        NRMSE [percent]; nan where there is none, minus infinity where a response grows without
        bound.
    errors : tuple of (n_samples, n_outputs) arrays
        One for each record that was judged; empty where there is none.
    reason : str
        Why there is none.
    terms : tuple of tuples of (n_samples, k) arrays
        For each of these records and every output, what offset, drift and initial state may add
        where the structure as asked for leaves them open.
    """

    fit: Array
    errors: tuple[Array, ...] = ()
    reason: str = ""
    terms: tuple[tuple[Array, ...], ...] = ()


def cross_fit(task: HeldEstimate) -> HeldOut:
    """Fit and errors on samples that were not fitted."""
    if task.estimate is None:
        return HeldOut(np.zeros(0), reason="no estimate")
    nothing = np.full(len(task.estimate.output_names), np.nan)
    seen = task.validation or task.records
    if not task.validation and sum(record.n_samples for record in seen) < FEWEST:
        return HeldOut(nothing, reason=f"fewer than {FEWEST} samples")
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"), one_blas_thread():
            warnings.simplefilter("ignore")
            if task.validation:
                errors = [_on_all(task.estimate, task.estimate.model, one, False) for one in seen]
            else:
                errors = _left_out(task)
            terms = tuple(_open_terms(task, one) for one in seen)
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return HeldOut(nothing, reason="not determined without every part of the record")
    return HeldOut(_percent(errors, seen), tuple(errors), terms=terms)


def _percent(errors: Sequence[Array], records: Sequence[Record]) -> Array:
    """Fit over all records, on the samples that have an error."""
    found = np.full(errors[0].shape[1], np.nan)
    for i in range(found.size):
        energy = spread = 0.0
        for one, record in zip(errors, records, strict=True):
            # those before a free initial state, and before its delays, are explained by nothing
            seen = np.isfinite(np.asarray(record.y)[:, i]) & ~np.isnan(one[:, i])
            y = np.asarray(record.y)[seen, i]
            energy += float(np.sum(one[seen, i] ** 2))
            spread += float(np.sum((y - y.mean()) ** 2)) if y.size else 0.0
        if not np.isfinite(energy):
            found[i] = -np.inf
        elif spread > 0:
            found[i] = 100.0 * (1.0 - np.sqrt(energy / spread))
    return found


def folds(weight: Array) -> NDArray[np.intp]:
    """(n_samples,) number of the fold that leaves out each sample.

    Parameters
    ----------
    weight : (n_samples,) array
        Information of each sample, in any unit.

    Examples
    --------
    >>> np.bincount(folds(np.ones(100))).tolist(), folds(np.ones(100))[:12].tolist()
    ([20, 20, 20, 20, 20], [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2])
    >>> folds(np.repeat([0.0, 1.0, 0.0], [40, 10, 50]))[40:50].tolist()
    [4, 0, 1, 2, 3, 0, 1, 2, 3, 4]
    """
    total, count = float(np.sum(weight)), weight.size
    known = weight / total if total > 0 and np.isfinite(total) else np.full(count, 1.0 / count)
    share = INFORMED * known + (1.0 - INFORMED) / count
    middles = np.cumsum(share) - 0.5 * share
    return np.asarray((middles * (FOLDS * BLOCKS)).astype(np.intp) % FOLDS, dtype=np.intp)


def fold_numbers(estimate: Estimate, records: Sequence[Record]) -> list[NDArray[np.intp]]:
    """`folds` of each record: of equal length, unless one would hold nearly all there is to know.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record

    Returns
    -------
    list of (n_samples,) int arrays
    """
    even = [folds(np.ones(record.n_samples)) for record in records]
    parts = directions(estimate, records)
    if most_held(parts, even) <= MOST_HELD:
        return even
    return [folds(np.sum(one**2, axis=(1, 2))) for one in parts]


def most_held(parts: Sequence[Array], numbers: Sequence[NDArray[np.intp]]) -> float:
    """The largest share of the information on one direction in one fold."""
    shares = [0.0]
    for fold in range(FOLDS):
        rows = [one[own == fold] for one, own in zip(parts, numbers, strict=True)]
        flat = np.vstack([one.reshape(one.shape[0] * one.shape[1], one.shape[2]) for one in rows])
        shares.append(float(np.linalg.norm(flat, 2)) ** 2 if flat.size else 0.0)
    return max(shares)


def directions(estimate: Estimate, records: Sequence[Record]) -> list[Array]:
    """How the outputs move with the coefficients, nuisance terms fitted along.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record

    Returns
    -------
    list of (n_samples, n_outputs, k) arrays
        For each record, in coordinates in which the information is the identity; ``k`` is 0 where
        a response grows out of bounds, or there is none.
    """
    problem = problem_of(estimate, records, stated(estimate))
    point = evaluate(problem, poles_of_estimate(estimate, problem))
    matrix, _ = point.jacobian()
    noise = np.sqrt(point.rss / np.maximum(point.counts, 1))
    noise = np.where(noise > 0, noise, 1.0)
    unknowns = np.eye(matrix.shape[1])
    moved = [point.sensitivities(unknowns, i) for i in range(problem.n_outputs)]
    shapes = [(record.n_samples, problem.n_outputs) for record in records]
    stacked = np.vstack(
        [
            np.stack([one[e] / noise[i] for i, one in enumerate(moved)], axis=1).reshape(
                -1, matrix.shape[1]
            )
            for e in range(len(records))
        ]
    )
    along = np.zeros(matrix.shape[1], dtype=bool)
    for key, at in point.width.items():
        along[at] = _is_nuisance(key)
    nuisance = _basis(np.nan_to_num(stacked[:, along]))
    rest = np.nan_to_num(stacked[:, ~along])
    found = _basis(rest - nuisance @ (nuisance.T @ rest))
    ends = np.cumsum([n * m for n, m in shapes])[:-1]
    parts = zip(np.split(found, ends), shapes, strict=True)
    return [one.reshape(*shape, found.shape[1]) for one, shape in parts]


def _is_nuisance(key: object) -> bool:
    """Whether unknowns of that name belong to the record: those of an output but its ``b``."""
    return isinstance(key, tuple) and isinstance(key[1], tuple) and key[1][0] != "b"


def _basis(columns: Array) -> Array:
    """Orthonormal columns of the same span."""
    norms = np.linalg.norm(columns, axis=0)
    if not (np.any(norms > 0) and np.all(np.isfinite(norms))):
        return np.zeros((len(columns), 0))
    basis, sizes, _ = np.linalg.svd(columns[:, norms > 0] / norms[norms > 0], full_matrices=False)
    return np.asarray(basis[:, sizes > RANK * sizes[0]])


def _left_out(task: HeldEstimate) -> list[Array]:
    """Errors of every sample by the coefficients that did not see it."""
    assert task.estimate is not None
    errors = [np.full(record.y.shape, np.nan) for record in task.records]
    numbers = fold_numbers(task.estimate, task.records)
    for fold in range(FOLDS):
        kept = tuple(
            record.mask(number == fold)
            for record, number in zip(task.records, numbers, strict=True)
        )
        model = _again(task.estimate, kept)
        for e, record in enumerate(task.records):
            out = numbers[e] == fold
            errors[e][out] = _on_all(task.estimate, model, record, True)[out]
    return errors


def _again(estimate: Estimate, kept: Sequence[Record]) -> TransferFunction:
    """The model without some samples, from where the estimate ended, with its noise model."""
    if estimate.structure.constrained:
        structure = estimate.structure
        if structure.delay == "free":
            structure = replace(structure, delay=estimate.model.delay.tolist())
        return OutputError(estimate.model, MOST_STEPS).estimate(list(kept), structure).model
    problem = problem_of(estimate, kept, stated(estimate))
    at = partial(evaluate, problem)
    # no covariance is formed: a fast initial state that no kept sample shows is no obstacle
    point = finish(at, at(poles_of_estimate(estimate, problem)), None, MOST_STEPS, NEAR)[0]
    return model_of(point.problem, coefficients(point), kept[0])


def _on_all(estimate: Estimate, model: TransferFunction, record: Record, own: bool) -> Array:
    """Errors with coefficients held, offset and free response fitted to the whole record.

    Of its ``own`` records an estimate says which of them there are; another one may have any.
    """
    known = estimate.structure
    free, offset = not own or known.initial_state == "free", not own or bool(known.offset)
    at_once = known.initial_state == "equilibrium" or (free and offset)
    begin = record.u[0] if not own or at_once else 0.0
    error = np.array(record.y - simulate(model, record._on_its_times(record.u - begin)))
    if free:
        late = replace(known, delay=model.delay.tolist(), initial_state="free")
        error[: first_explained(record, late)] = np.nan
    for i, columns in enumerate(
        _columns(estimate, model, record, Open(offset, known.drift_degree, free))
    ):
        error[:, i] = without(columns, error[:, i])
    return error


@dataclass(frozen=True)
class Open:
    """Which nuisance terms there are."""

    offset: bool
    drift: int
    free: bool


def _open_terms(task: HeldEstimate, record: Record) -> tuple[Array, ...]:
    """What offset, drift and initial state may add to a record, where they are left open."""
    assert task.estimate is not None
    asked = task.asked or task.estimate.structure
    beyond = bool(task.validation)
    terms = Open(
        beyond or asked.offset is not False,
        asked.drift_degree,
        beyond or asked.initial_state in ("auto", "free"),
    )
    return tuple(_columns(task.estimate, task.estimate.model, record, terms))


def _columns(
    estimate: Estimate, model: TransferFunction, record: Record, terms: Open
) -> list[Array]:
    """For every output, (n_samples, k) what its nuisance terms may add."""
    still = record._on_its_times(np.zeros_like(record.u))
    found = []
    for i in range(record.n_outputs):
        columns = [np.ones(record.n_samples)] if terms.offset else []
        for j in range(record.n_inputs) if terms.free else ():
            if j and estimate.structure.shared:
                continue
            for k in range(model.den[i][j].size - 1):
                unit = _unit(estimate, model, i, j, k)
                columns.append(simulate(model, still, free_response=unit)[:, i])
        columns += [*drift_columns((record.t - record.t[0]) / record.duration, terms.drift)]
        found.append(np.column_stack(columns) if columns else np.zeros((record.n_samples, 0)))
    return found


def _unit(estimate: Estimate, model: TransferFunction, output: int, input_: int, k: int) -> Array:
    """The free response ``p^k / a(p)`` of one channel alone."""
    if estimate.structure.shared:
        free = np.zeros((model.n_outputs, model.den[output][0].size - 1))
        free[output, -1 - k] = 1.0
        return free
    longest = max(den.size - 1 for row in model.den for den in row)
    nested = np.zeros((model.n_outputs, model.n_inputs, longest))
    nested[output, input_, -1 - k] = 1.0
    return nested
