"""Experiments of different noise: levels and coefficients in turn (`noise.noise_levels`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tridentify.errors import IdentifiabilityError
from tridentify.estimation.answer.decision import DecisionKind, KnownDecision
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.likelihood.answer import Ending
from tridentify.estimation.likelihood.curvature import degrees_of_freedom
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import at_rounding
from tridentify.estimation.likelihood.noise.noise_levels import ROUNDING, NoiseLevels, weighed
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.information import aicc_price
from tridentify.record.record import Record

MOST_TURNS = 8
"""Turns of levels and coefficients: they stand still after two or three."""

STILL = 0.01
"""Relative change of a level [standard deviation] below which it stands still: weights that are off
by as much cost a hundred-thousandth of a standard error."""

Ended = Callable[[Sequence[Record], Complex | None], Ending]
Weighed = Callable[[Any], Ending]


def at_own_levels(
    ended: Ended, records: Sequence[Record], follow: Weighed = lambda end: end
) -> tuple[Ending, list[Record]]:
    """Where a method ends with the noise level of each experiment, if these are not one.

    Parameters
    ----------
    ended : callable
        The method on records, from poles that they may well have or from nothing.
    records : sequence of Record
    follow : callable, optional
        What follows such an end, and takes long: the levels hardly depend on it, so it comes last.

    Returns
    -------
    Ending
    records : list of Record
        As they were fitted.
    """
    first, last = ended(records, None), follow
    if len(records) == 1:
        return last(first), list(records)
    if not first.status.ok:
        # there may be levels of what follows
        first, last = follow(first), lambda end: end
    own = _differing(first)
    if own is None:
        return last(first), list(records)
    end, levels = first, own
    for _ in range(MOST_TURNS):
        used = weighed(records, list(np.sqrt(levels)))
        try:
            end = ended(used, end.point.poles)
            end = end if last is follow else follow(end)
            found = NoiseLevels.at(end.curvature).known.variance
        except (IdentifiabilityError, np.linalg.LinAlgError):
            return last(first), list(records)
        # outputs of one level keep it
        found = np.where(np.ptp(levels, axis=0) > 0, found, levels)
        moved = np.max(np.abs(np.log(found / levels) - np.mean(np.log(found / levels), axis=0)))
        if moved < 2.0 * STILL:
            break
        levels = found
    return _with_levels(last(end), used), used


def _differing(end: Ending) -> Array | None:
    """(n_experiments, n_outputs) variances; None where one serves all experiments."""
    point = end.point
    if at_rounding(point) or not end.status.ok:
        return None
    try:
        seen = NoiseLevels.at(end.curvature)
    except np.linalg.LinAlgError:
        return None
    floor = ROUNDING**2 * point.problem.size
    if np.any((seen.variance <= floor) & (seen.freedom > 0)) or not seen.differ.any():
        return None
    known = seen.known.variance
    return np.where(seen.differ, known, known.mean(axis=0))


def _with_levels(end: Ending, records: Sequence[Record]) -> Ending:
    """With the levels that it was fitted with, their number in AICc, and a word about it."""
    point = end.point
    rss = np.sum([np.nansum(one**2, axis=0) for one in point.standardised()], axis=0)
    std = np.sqrt(rss / degrees_of_freedom(point))
    levels = tuple(
        np.asarray(std if r._noise_scale is None else std * r._noise_scale) for r in records
    )
    n = float(point.counts.sum())
    k = float(point.problem.n_coefficients + point.problem.n_nuisance + std.size)
    varied = np.ptp(np.array(levels), axis=0) > 0
    added = float((len(levels) - 1) * varied.sum())
    price = aicc_price(k + added, n) - aicc_price(k, n)
    criterion = end.criterion + price
    return replace(end, levels=levels, criterion=criterion).told(_in_words(levels))


def _in_words(levels: Sequence[Array]) -> KnownDecision:
    table = np.array(levels)
    ratio = float(np.max(table.max(axis=0) / table.min(axis=0)))
    return DecisionKind.NOISE_LEVELS.told(
        f": up to {ratio:.3g} to 1, so that the samples of each experiment count by its own"
    )


def constrained_at_own_levels(
    estimated: Callable[[Sequence[Record]], Estimate], records: Sequence[Record]
) -> Estimate:
    """The same for an estimate within constraints, each experiment less its share of the unknowns.

    Parameters
    ----------
    estimated : callable
        The estimate of records.
    records : sequence of Record
    """
    first = estimated(records)
    levels = _levels_of(first, records) if first.status.ok else None
    if levels is None or not levels.differ.any():
        return first
    own = np.where(levels.differ, levels.known.variance, levels.known.variance.mean(axis=0))
    found = first
    for _ in range(MOST_TURNS):
        found = estimated(weighed(records, list(np.sqrt(own))))
        seen = _levels_of(found, records)
        if seen is None:
            return first
        after = np.where(levels.differ, seen.known.variance, own)
        moved = np.max(np.abs(np.log(after / own)))
        own = after
        if moved < 2.0 * STILL:
            break
    std = tuple(np.sqrt(own))
    words = _in_words(std)
    return replace(found, noise_levels=std, trace=found.trace.told(words))


def _levels_of(estimate: Estimate, records: Sequence[Record]) -> NoiseLevels | None:
    """Noise levels by the residuals of an estimate; None where one of them is rounding."""
    residuals = [estimate.residual(record, experiment=e) for e, record in enumerate(records)]
    unknowns = float(sum(np.isfinite(one).sum() for one in residuals)) - estimate.degrees_of_freedom
    found = NoiseLevels.of(residuals, unknowns)
    sizes = np.array([np.nanmean(record.y**2, axis=0) for record in records])
    return None if np.any(found.variance <= ROUNDING**2 * sizes) else found


def one_level(estimate: Estimate, records: Sequence[Record]) -> tuple[str, ...]:
    """A word where experiments have noise of different levels, and one was taken for all."""
    if len(records) < 2 or estimate.noise_levels or len(estimate.nuisance) != len(records):
        return ()
    seen = _levels_of(estimate, records)
    if seen is None or not seen.differ.any():
        return ()
    known = np.sqrt(seen.known.variance[:, seen.differ])
    ratio = float(np.max(known.max(axis=0) / known.min(axis=0)))
    return (
        DecisionKind.NOISE_LEVELS.told(
            f": the residual differs up to {ratio:.3g} to 1, and one was taken for all; the "
            "estimate is not as precise as it could be, and its standard errors are those of "
            "equal noise"
        ),
    )
