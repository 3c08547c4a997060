"""Far samples that stand alone: not after a jump, and not foretold by the past."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from tridentify.estimation.methods.around_maximum.predictor import forecast_errors
from tridentify.judgement.causes.attempts.intersample import is_staircase
from tridentify.judgement.validation.residuals import View
from tridentify.judgement.validation.statistics.evidence import Evidence
from tridentify.judgement.validation.statistics.likelihood_ratio import CALLED
from tridentify.numerics.arrays import Array
from tridentify.numerics.robust import median_scale
from tridentify.record.record import Record

AFTER_A_JUMP = 3
"""Samples after a jump of a held input where a far sample is a misfit of the model."""

MOSTLY_ALONE = 0.7
"""Share of the far samples that stand elsewhere, from which jumps are a coincidence."""

COINCIDENCE = 0.01
"""Probability, of places at random, from which it is one that so many follow a jump: two spikes
both do in one record of fifteen where the input jumps every tenth sample."""

WORTH_A_LOOK = 0.15
"""The same, from which causes are looked for: of a late command one sample may be far."""

FIRST_SAMPLES = 8
"""Samples at the start of a record that four poles, with a free start, fit whatever they are."""

UNFORESEEN = 4.0
"""Standard deviations of what the past does not tell of an output from which a sample is bad where
the input reacts to it: of Gaussian noise one in sixteen thousand."""


def with_outliers(one: Evidence, rows: Array) -> Evidence:
    """With other outliers."""
    return one.having(normality=replace(one.normality, outliers=rows))


def first_ones(view: View, rows: Array) -> Array:
    """Those of some far samples that are among the first of a record."""
    last = [record.t[min(FIRST_SAMPLES, record.n_samples) - 1] for record in view.records]
    return rows[rows[:, 1] <= np.take(last, rows[:, 0].astype(int))] if len(rows) else rows


def with_those_between(view: View, index: int, found: Evidence) -> Evidence:
    """With single samples between bad ones at the start: a free start follows one that is left."""
    rows = found.normality.outliers
    first, added = first_ones(view, rows), []
    for e, record in enumerate(view.records):
        at = np.searchsorted(record.t, first[first[:, 0] == e, 1] - 0.5 * view.step)
        for k in sorted((set(at + 1) & set(at - 1)) - set(at)):
            if np.isfinite(value := view.outputs[index].standardised[e][k]):
                added.append((float(e), float(record.t[k]), float(value)))
    return with_outliers(found, np.vstack([rows, *added])) if added else found


def with_bad_samples_alone(view: View, found: Evidence) -> Evidence:
    """Without far samples that follow a jump of a held input: there the model misses something.

    Nor is a sample wrong where a disturbance sets in, which a response to a jump is not.
    """
    shocks = found.normality.shocks
    if len(shocks):
        shocks = shocks[~after_a_jump(view, shocks, chance=1.0)]
        far = found.normality.outliers
        alone = far[[not np.any(np.all(row == shocks, axis=1)) for row in far]]
        found = found.having(normality=replace(found.normality, outliers=alone, shocks=shocks))
    rows = found.normality.outliers
    follow = after_a_jump(view, rows)
    if not follow.any() or 1.0 - np.mean(follow) > MOSTLY_ALONE:
        return found
    return with_outliers(found, rows[~follow])


def after_a_jump(view: View, rows: Array, chance: float = COINCIDENCE) -> NDArray[np.bool_]:
    """Which far samples follow a jump of a held input; none where so many may do by chance."""
    none = np.zeros(len(rows), dtype=bool)
    if not len(rows) or not is_staircase(view.records):
        return none
    follow = [_after_a_jump(record) for record in view.records]
    found = np.array([follow[int(e)][np.argmin(np.abs(view.records[int(e)].t - t))]
                      for e, t, _ in rows])  # fmt: skip
    by_chance = bdtrc(np.sum(found) - 1, found.size, float(np.mean(np.concatenate(follow))))
    return none if by_chance > chance else found


def without_foreseen(view: View, index: int, found: Evidence) -> Evidence:
    """Without far samples that the past foretells: where the input reacts the fit is bent."""
    rows = found.normality.outliers
    if not len(rows) or not found.feedback < CALLED:
        return found
    errors = [forecast_errors(record.u, record.y, index) for record in view.records]
    known = np.concatenate(errors)
    known = known[np.isfinite(known)]
    far = UNFORESEEN * median_scale(known) if known.size else 0.0
    sizes = [errors[int(e)][np.argmin(np.abs(view.records[int(e)].t - t))] for e, t, _ in rows]
    return with_outliers(found, rows[~(np.abs(sizes) < far)])


def _after_a_jump(record: Record) -> NDArray[np.bool_]:
    """Which samples follow a jump of an input."""
    jumps = np.diff(record.u, axis=0, prepend=record.u[:1]).any(axis=1)
    return np.convolve(jumps, np.ones(AFTER_A_JUMP))[: jumps.size] > 0
