"""What the residual gives away at a glance: colour, and a share that follows the input."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.trust import predicts
from tridentify.estimation.likelihood.setup.raster import on_raster, places_on_raster, spread_out
from tridentify.judgement.causes.attempts.first_samples import Predictions, beginning
from tridentify.judgement.causes.system.slow import HALVES, MOSTLY_SLOW, PER_WAVE, slow_waves
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.correlation import autocorrelation
from tridentify.numerics.quantiles import root_mean_square
from tridentify.numerics.slow_spectrum import BY_NOISE, slow_chance
from tridentify.numerics.whiteness import input_share
from tridentify.record.record import Record

ROUNDING = 1e-9
"""Residual over output below which there is nothing but rounding."""

LONGEST_TESTED = 20_000
"""Samples of a record that are looked at."""

MOST_LAGS = 40
"""Lags of the correlation that are looked at; `MOST_OUTSIDE` is for so many."""

BOUND_99 = 2.5758
"""Quantile of the normal distribution that 99 % stay within."""

MOST_OUTSIDE = 3
"""Of 40 lags of white noise more than three lie outside in one of 1,300 records."""

MISSED = 1e-3
"""Probability of taking noise for a response."""

MEMORIES = 25.0
"""Memories of the noise model in a record from which what is slow is noise that the record shows
often enough: what is fitted to a random walk over a record has 15 to 20, or fewer."""


def residual_findings(
    estimate: Estimate, record: Record, experiment: int, known: Predictions
) -> list[Finding]:
    """Colour of the residual, and what of it follows the input, in one experiment."""
    several = len(estimate.nuisance) > 1
    where = f" in experiment {experiment + 1}" if several else ""
    own = experiment if several else None
    found = []
    whitened = dict(zip(estimate.output_names, estimate.noise_model, strict=True))
    for name, outside, n_lags in coloured_outputs(estimate, record, experiment, known):
        which = "whitened residual" if whitened[name].size else "residual"
        found.append(
            Finding(
                "noise-model",
                "warning",
                f"The {which} of {name}{where} is not white: {outside} of {n_lags} lags lie "
                "outside the 99 % bounds. The noise is coloured or the model misses some of the "
                "response; the standard errors may be too small.",
                "Try a drift (--drift auto, in Python drift='auto'), more poles or zeros, or an "
                "input shifted by a delay (--delay, in Python delay='free' or a number).",
                (name,),
                own,
            )
        )
    for name in missed_outputs(estimate, record, experiment, known):
        found.append(
            Finding(
                "unmodelled-response",
                "warning",
                f"The residual of {name}{where} is not white, and part of it follows the input: "
                "the model misses some of the response. The standard errors allow for noise of "
                "that colour, not for the missing part.",
                "Try more poles or zeros, or an input shifted by a delay (--delay, in Python "
                "delay='free' or a number).",
                (name,),
                own,
            )
        )
    return found


def slow_findings(
    estimate: Estimate, records: Sequence[Record], known: Predictions
) -> list[Finding]:
    """A slow disturbance that the noise model takes for noise.

    A score test cannot see it: under such a model of the noise slow waves are what is to be
    expected. So it is looked for in the residual that is not whitened. What to do about it is left
    to who tries it (`remedies.with_drift_tried`).
    """
    if not any(a.size for a in estimate.noise_model):
        return []
    if estimate.trace.about(DecisionKind.RESPONSE_AS_NOISE):
        return []
    parts = [_slow_parts(estimate, record, e, known) for e, record in enumerate(records)]
    slow, whole = (np.sum([one[k] for one in parts], axis=0) for k in range(2))
    found = []
    for i, name in enumerate(estimate.output_names):
        model = estimate.noise_model[i]
        if not (model.size and slow[i] > MOSTLY_SLOW * whole[i]):
            continue
        if max(record.n_samples for record in records) > MEMORIES * memory(model):
            continue
        if parts[0][2][i] > BY_NOISE and len(records) == 1:
            continue  # noise that rises towards low frequencies
        found.append(
            Finding(
                "drift",
                "warning",
                f"A slow disturbance moves {name}: of the residual {100 * slow[i] / whole[i]:.0f} "
                f"% is slower than {HALVES // 2} periods a record. It is taken for noise, which "
                "holds as long as it does not follow the input; slow coefficients and the static "
                "gain rest on that.",
                "",
                (name,),
            )
        )
    return found


def memory(a: Array) -> float:
    """Samples in which an autoregression forgets all but ``1/e``.

    Parameters
    ----------
    a : (p,) array
        Its coefficients.

    Examples
    --------
    >>> round(memory(np.array([-0.9])), 1), memory(np.zeros(0))
    (9.5, 0.0)
    """
    if not a.size:
        return 0.0
    largest = float(np.max(np.abs(np.roots(np.append(1.0, a)))))
    return -1.0 / math.log(largest) if 0.0 < largest < 1.0 else (0.0 if largest == 0.0 else np.inf)


def _slow_parts(
    estimate: Estimate, record: Record, experiment: int, known: Predictions
) -> tuple[Array, Array, Array]:
    """(n_outputs,) energy of the residual in slow waves, in all about its mean, and its chance."""
    residual = evenly(estimate, beginning(record, LONGEST_TESTED), experiment, known)
    n, outputs = residual.shape
    slow, whole, chance = np.zeros((3, outputs))
    columns = slow_waves(np.linspace(0.0, 1.0, n))
    for i in range(outputs):
        seen = np.isfinite(residual[:, i])
        if int(seen.sum()) < PER_WAVE * (HALVES + 1):
            continue
        one = residual[seen, i] - residual[seen, i].mean()
        basis = np.linalg.qr(columns[seen] - columns[seen].mean(axis=0))[0]
        slow[i], whole[i] = float(np.sum((basis.T @ one) ** 2)), float(one @ one)
        chance[i] = slow_chance(residual[:, i] - np.nanmean(residual[:, i]))
    return slow, whole, chance


def far_likelier(estimate: Estimate) -> list[Finding]:
    """That another end is far likelier than the one that was kept, as the method saw it."""
    return [
        Finding(
            "noise-model",
            "error",
            "The numbers are those with which the model follows the output from end to end; but "
            f"{told.replace('a model', 'another model', 1)}. So something that was not recorded "
            "moves the output, a slow disturbance or a controller behind the input, and the "
            "standard errors know nothing of it.",
            "If a controller or a person kept the output in place, use ThreeModel(route='direct') "
            "(--route direct). If a disturbance acts through the plant for as long as the record "
            "lasts, noise='ar' (--noise ar) takes the likelier numbers, whatever the fit; else cut "
            "the record to where it is calm.",
            estimate.output_names,
        )
        for told in estimate.trace.about(DecisionKind.FAR_LIKELIER)
    ]


def response_as_noise(estimate: Estimate) -> list[Finding]:
    """Slow parts of the output that are a response or noise, as the method saw it.

    On the direct route neither the fit of a simulation nor white weights say which.
    """
    if predicts(estimate):
        return _leaves_its_record(estimate)
    return [
        Finding(
            "noise-model",
            "warning" if told.kind is DecisionKind.RESPONSE_AS_NOISE else "note",
            f"{told[0].upper()}{told[1:]}. The record cannot say which of the two is right.",
            "Compare with ThreeModel(noise='white'), and try a drift, or more poles or zeros.",
        )
        for told in estimate.trace.about(DecisionKind.RESPONSE_AS_NOISE, DecisionKind.SLOW_AS_NOISE)
        if not _overtaken(told, estimate)
    ]


def _overtaken(told: str, estimate: Estimate) -> bool:
    """Whether the estimate fits better than the white end did: a constraint made another of it."""
    reached = [float(each) for each in re.findall(r"reach (-?[\d.]+) %", told)]
    return bool(reached) and float(np.min(estimate.fit)) > max(reached)


def _leaves_its_record(estimate: Estimate) -> list[Finding]:
    """That a simulation by itself is no measure of an estimate by the direct route."""
    away = [
        f"{name} (fit {fit:.0f} %)"
        for name, fit in zip(estimate.output_names, estimate.fit, strict=True)
        if fit < 0.0
    ]
    if not away:
        return []
    return [
        Finding(
            "noise-model",
            "note",
            f"Simulated without its controller the model leaves {' and '.join(away)}: what pushed "
            "the plant adds up there, and the controller answered to it. The coefficients are "
            "those that predict the output from sample to sample; the fit of a simulation, which "
            "white weights make larger, is no measure of them.",
        )
    ]


def coloured_outputs(
    estimate: Estimate, record: Record, experiment: int, known: Predictions | None = None
) -> list[tuple[str, int, int]]:
    """Outputs whose residual is not white.

    Parameters
    ----------
    estimate : Estimate
    record : Record
        Its first 20,000 samples are looked at.
    experiment : int
        Position of the record among those identified.
    known : Predictions, optional
        What was computed before.

    Returns
    -------
    list of (name, lags outside the 99 % bounds, lags)

    Notes
    -----
    White noise leaves the bounds at 4 or more of 40 lags once in 1,300 records. A residual that
    is no more than rounding is not judged. Where the noise has a model, the residual is whitened
    first.
    """
    record = beginning(record, LONGEST_TESTED)
    residual = evenly(estimate, record, experiment, known)
    n_lags = min(MOST_LAGS, record.n_samples // 4)
    found = []
    for i, name in enumerate(estimate.output_names):
        size = root_mean_square(record.y[:, i])
        if not root_mean_square(residual[:, i]) > ROUNDING * size:
            continue
        innovations = whiten(residual[:, i], estimate.noise_model[i])[0]
        correlation, count = autocorrelation(innovations, n_lags)
        outside = int(np.sum(np.abs(correlation[1:]) > BOUND_99 / math.sqrt(max(count, 1))))
        if outside > MOST_OUTSIDE:
            found.append((name, outside, n_lags))
    return found


def evenly(
    estimate: Estimate, record: Record, experiment: int, known: Predictions | None = None
) -> Array:
    """The residual on its raster, without the samples that a robust loss set aside.

    Parameters
    ----------
    estimate : Estimate
    record : Record
        The beginning of one that was identified.
    experiment : int
    known : Predictions, optional

    Returns
    -------
    (n, n_outputs) array
        ``nan`` where nothing was recorded, and at outliers.
    """
    residual = (known or Predictions(estimate)).residual(record, experiment)
    rows = estimate.outliers[estimate.outliers[:, 0] == experiment]
    rows = rows[rows[:, 2] < record.n_samples]
    residual[rows[:, 2].astype(int), rows[:, 1].astype(int)] = np.nan
    places = None if record.dt is not None else places_on_raster(np.asarray(record.t))
    return residual if places is None else spread_out(residual, places)


def missed_outputs(
    estimate: Estimate, record: Record, experiment: int, known: Predictions | None = None
) -> list[str]:
    """Outputs with a noise model whose residual follows the input.

    Parameters
    ----------
    estimate : Estimate
    record : Record
        Its first 20,000 samples are looked at.
    experiment : int
        Position of the record among those identified.
    known : Predictions, optional
        What was computed before.

    Returns
    -------
    list of str
        Their names.

    Notes
    -----
    By `numerics.whiteness.input_share`; noise is taken for a response in at most one of
    1,000 records.
    """
    if not any(a.size for a in estimate.noise_model):
        return []
    record = beginning(record, LONGEST_TESTED)
    full = on_raster(record)
    residual = evenly(estimate, record, experiment, known)
    if len(residual) != full.n_samples:
        return []
    found = []
    for i, name in enumerate(estimate.output_names):
        if not estimate.noise_model[i].size:
            continue
        _, statistic, dimension = input_share(residual[:, i], full.u, estimate.noise_model[i])
        if statistic > chdtri(float(dimension), MISSED):
            found.append(name)
    return found
