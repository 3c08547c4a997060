"""The cross-validated fit: on a second record, or on blocks of the first that the fit did not see.

*A second record.* Coefficients are held; offset and initial state, which belong to each record,
are fitted to it.

*Without one* the usual cut into a first and a second half does not serve a manoeuvre: the response
to a step has died away in the second half, which then says nothing, and the halves need initial
states of their own. Here blocks of output samples all over the record are marked as missing, the
model is fitted to what is left, and judged on the blocks. The input is known throughout, so the
state at a block's begin follows from it and needs no estimation, and nothing of the transient is
lost but the marked samples. Every sample is left out once: five folds, each of several blocks, so
that no fold loses the whole transient. The blocks are contiguous because neighbouring samples of
coloured noise know each other (Burman, Chow & Nolan, Biometrika 81, 1994, 351-358; Racine, Journal
of Econometrics 99, 2000, 39-61).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import TridentifyError
from tridentify.estimate import Estimate
from tridentify.methods.output_error import OutputError
from tridentify.numerics.least_squares import solve
from tridentify.numerics.threads import one_blas_thread
from tridentify.record import Record
from tridentify.simulate import simulate

Array = NDArray[np.float64]
FOLDS = 5
BLOCKS = 4
FEWEST = 40
MOST_STEPS = 20


@dataclass(frozen=True, eq=False)
class Held:
    """One estimate, its records, and perhaps records that it has not seen."""

    estimate: Estimate | None
    records: tuple[Record, ...]
    validation: tuple[Record, ...]


def cross_fit(task: Held) -> Array:
    """(n_outputs,) fit (NRMSE) [percent] on samples that were not fitted; nan if there is none."""
    if task.estimate is None:
        return np.zeros(0)
    nothing = np.full(len(task.estimate.output_names), np.nan)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"), one_blas_thread():
            warnings.simplefilter("ignore")
            if task.validation:
                errors = [_on_another(task.estimate, record) for record in task.validation]
                return _percent(errors, task.validation)
            if sum(record.n_samples for record in task.records) < FEWEST:
                return nothing
            return _percent(_left_out(task.estimate, task.records), task.records)
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return nothing


def _percent(errors: Sequence[Array], records: Sequence[Record]) -> Array:
    """Fit over all records, on the samples that have an error."""
    found = np.full(errors[0].shape[1], np.nan)
    for i in range(found.size):
        energy = spread = 0.0
        for one, record in zip(errors, records, strict=True):
            seen = np.isfinite(one[:, i])
            y = np.asarray(record.y)[seen, i]
            energy += float(np.sum(one[seen, i] ** 2))
            spread += float(np.sum((y - y.mean()) ** 2)) if y.size else 0.0
        if spread > 0:
            found[i] = 100.0 * (1.0 - np.sqrt(energy / spread))
    return found


def folds(n_samples: int) -> NDArray[np.intp]:
    """(n_samples,) number of the fold that leaves out each sample.

    Examples
    --------
    >>> np.bincount(folds(100)).tolist(), folds(100)[:12].tolist()
    ([20, 20, 20, 20, 20], [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2])
    """
    return np.asarray((np.arange(n_samples) * FOLDS * BLOCKS // n_samples) % FOLDS, dtype=np.intp)


def _left_out(estimate: Estimate, records: Sequence[Record]) -> list[Array]:
    """Errors of every sample by the fit that did not see it."""
    structure = estimate.structure
    if structure.delay == "free":
        structure = replace(structure, delay=estimate.model.delay.tolist())
    method = OutputError(estimate.model, MOST_STEPS)
    errors = [np.full(record.y.shape, np.nan) for record in records]
    numbers = [folds(record.n_samples) for record in records]
    for fold in range(FOLDS):
        kept = [
            record.mask(number == fold) for record, number in zip(records, numbers, strict=True)
        ]
        found = method.estimate(kept, structure)
        for e, record in enumerate(records):
            out = numbers[e] == fold
            errors[e][out] = np.asarray(found.residual(record, experiment=e))[out]
    return errors


def _on_another(estimate: Estimate, record: Record) -> Array:
    """Errors on another record: coefficients held, offset and free response fitted to it."""
    moved = record._on_its_times(record.u - record.u[0])
    error = np.asarray(record.y - simulate(estimate.model, moved))
    still = record._on_its_times(np.zeros_like(record.u))
    for i in range(error.shape[1]):
        columns = [np.ones(record.n_samples)]
        for j in range(record.n_inputs):
            n = estimate.model.den[i][j].size - 1
            if j and estimate.structure.shared:
                continue
            for k in range(n):
                free = _unit(estimate, i, j, k)
                columns.append(simulate(estimate.model, still, free_response=free)[:, i])
        if estimate.structure.drift:
            columns.append(record.t - record.t[0])
        matrix = np.column_stack(columns)
        norms = np.linalg.norm(matrix, axis=0)
        matrix = matrix / np.where(norms > 0, norms, 1.0)
        seen = np.isfinite(error[:, i])
        error[:, i] -= matrix @ solve(matrix[seen], error[seen, i]).x
    return error


def _unit(estimate: Estimate, output: int, input_: int, k: int) -> Array:
    """The free response ``p^k / a(p)`` of one channel alone."""
    model = estimate.model
    if estimate.structure.shared:
        free = np.zeros((model.n_outputs, model.den[output][0].size - 1))
        free[output, -1 - k] = 1.0
        return free
    longest = max(den.size - 1 for row in model.den for den in row)
    nested = np.zeros((model.n_outputs, model.n_inputs, longest))
    nested[output, input_, -1 - k] = 1.0
    return nested
