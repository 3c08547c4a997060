"""What to be careful about, in words: cautions that go with an estimate wherever it is shown.

They need the record, so they are drawn up once, when the estimate is made, and kept with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from tridentify.cautions.beginning import Predictions, beginning
from tridentify.cautions.outliers import outlier_cautions
from tridentify.cautions.sensors import sensor_cautions
from tridentify.estimate import Estimate
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.correlation import autocorrelation
from tridentify.numerics.whiteness import input_share
from tridentify.record import Record
from tridentify.trace import OTHER_DELAYS

VAGUE = 0.5
TOGETHER = 0.9
ROUNDING = 1e-9
LONGEST = 20_000
MOST_LAGS = 40
BOUND_99 = 2.5758
MISSED = 1e-3


def cautions(estimate: Estimate, records: Sequence[Record]) -> tuple[str, ...]:
    """What a reader should know before using the numbers.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.

    Returns
    -------
    tuple of str
        Found, and what to do; empty when nothing stands out.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, identify
    >>> noise = np.random.default_rng(0).standard_normal(100)
    >>> record = Record(np.sign(noise[::-1]), noise, dt=0.1)
    >>> estimate = identify(record, Structure(1, 0), throw=False)
    >>> any("no better than by a constant" in line for line in estimate.cautions)
    True
    """
    # those of the method come first: what it alone could see
    found = [*estimate.cautions]
    found += [*_nothing_explained(estimate, records), *_constant_input(estimate, records)]
    # what is fixed has no standard error, whatever its value
    unsure = [p.name for p in estimate.parameters.values() if p.std and not p.relative_std < VAGUE]
    vague = [name for name in unsure if not name.startswith("delay")]
    late = [name for name in unsure if name.startswith("delay")]
    if vague and np.isnan(estimate.std).all():
        found.append(f"{estimate.method} gives no standard errors; ThreeModel() does.")
    elif vague:
        found.append(
            f"Standard error above half of the value: {', '.join(vague)}. Do not rely on these "
            "coefficients one by one; excite the system more, or use fewer poles or zeros."
        )
    if not np.isnan(estimate.std).all():
        found += _unsure_delays(estimate, late, vague)
    found += [
        f"{told[0].upper()}{told[1:]}. The standard errors allow for them; record longer, or "
        "excite the system faster, to tell them apart."
        for told in estimate.trace.decisions
        if told.startswith(OTHER_DELAYS)
    ]
    known = Predictions(estimate)
    found += outlier_cautions(estimate, records, known)
    found += _at_bounds(estimate)
    parameters = estimate.parameters.values()
    integrates = any(p.name.startswith("a0") and not (p.value or p.std) for p in parameters)
    if not (estimate.model.is_stable or integrates):
        found.append("The model is not stable. Check whether the system is, or use fewer poles.")
    for number, record in enumerate(records):
        where = f" in experiment {number + 1}" if len(records) > 1 else ""
        missing = int(np.isnan(record.y).sum())
        if missing:
            found.append(f"{missing} output samples are missing{where}; they do not count.")
        found += sensor_cautions(estimate, record, number, where, known)
        whitened = dict(zip(estimate.output_names, estimate.noise_model, strict=True))
        for name, outside, n_lags in coloured_outputs(estimate, record, number, known):
            which = "whitened residual" if whitened[name].size else "residual"
            found.append(
                f"The {which} of {name}{where} is not white: {outside} of {n_lags} lags lie "
                "outside the 99 % bounds. The noise is coloured or the model misses some of the "
                "response; the standard errors may be too small. Try a drift (--drift auto, in "
                "Python drift='auto'), more poles or zeros, or an input shifted by a delay "
                "(--delay, in Python delay='free' or a number)."
            )
        for name in missed_outputs(estimate, record, number, known):
            found.append(
                f"The residual of {name}{where} is not white, and part of it follows the input: "
                "the model misses some of the response. The standard errors allow for noise of "
                "that colour, not for the missing part. Try more poles or zeros, or an input "
                "shifted by a delay (--delay, in Python delay='free' or a number)."
            )
    return tuple(dict.fromkeys(found))


def _unsure_delays(estimate: Estimate, late: Sequence[str], vague: Sequence[str]) -> list[str]:
    """Delays that may be zero, and those that a numerator can stand for.

    For a slow input ``exp(-p L) = 1 - p L + ...``: the delay moves the output as the next higher
    coefficient of the numerator does, and the two errors go together.
    """
    found, zero = [], []
    for name in late:
        at = estimate.names.index(name)
        channel = name.removeprefix("delay").strip("[]").split(",")[-1]
        rivals = []
        for other in vague:
            k = estimate.names.index(other)
            size = float(estimate.std[at] * estimate.std[k])
            own = other.startswith("b") and (not channel or other.endswith((f"{channel}]",)))
            if own and size > 0 and abs(float(estimate.cov[at, k])) > TOGETHER * size:
                rivals.append(other)
        if not rivals:
            zero.append(name)
            continue
        found.append(
            f"{name} and {', '.join(rivals)} cannot be told apart: the response to a later input "
            "is that to another numerator, and their errors go together. Use fewer zeros for that "
            "input, give the delay (--delay, in Python delay=...), or excite the system faster."
        )
    if zero:
        found.append(
            f"Not distinguishable from zero: {', '.join(zero)}. Leave it out, or excite the system "
            "faster if the delay matters."
        )
    return found


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
    record = beginning(record, LONGEST)
    residual = (known or Predictions(estimate)).residual(record, experiment)
    n_lags = min(MOST_LAGS, record.n_samples // 4)
    found = []
    for i, name in enumerate(estimate.output_names):
        size = float(np.sqrt(np.nanmean(np.square(record.y[:, i]))))
        if not float(np.sqrt(np.nanmean(np.square(residual[:, i])))) > ROUNDING * size:
            continue
        innovations = whiten(residual[:, i], estimate.noise_model[i])[0]
        correlation, count = autocorrelation(innovations, n_lags)
        outside = int(np.sum(np.abs(correlation[1:]) > BOUND_99 / math.sqrt(max(count, 1))))
        if outside > 3:
            found.append((name, outside, n_lags))
    return found


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
    record = beginning(record, LONGEST)
    residual = (known or Predictions(estimate)).residual(record, experiment)
    found = []
    for i, name in enumerate(estimate.output_names):
        if not estimate.noise_model[i].size:
            continue
        _, statistic, dimension = input_share(residual[:, i], record.u, estimate.noise_model[i])
        if statistic > chdtri(float(dimension), MISSED):
            found.append(name)
    return found


def _nothing_explained(estimate: Estimate, records: Sequence[Record]) -> list[str]:
    """Compare with a constant for each output: Akaike's criterion on what the fit gains."""
    samples = sum(np.isfinite(record.y).sum(axis=0) for record in records)
    left = np.maximum(1.0 - estimate.fit / 100.0, 1e-12)
    gained = float(np.sum(-2.0 * samples * np.log(left)))
    if not gained < 2.0 * len(estimate.names):
        return []
    return [
        "The output is explained no better than by a constant (AIC): the record shows no response "
        "to this input. Check the channels, excite the system more, or reduce the noise."
    ]


def _at_bounds(estimate: Estimate) -> list[str]:
    """Name the coefficients that a bound holds."""
    held = []
    for name, (low, high) in (estimate.structure.bounds or {}).items():
        parameter = estimate.parameters[name]
        if parameter.value in (low, high) and not parameter.std:
            held.append(f"{name} = {parameter.value:.6g}")
    if not held:
        return []
    return [
        f"Held by a bound: {', '.join(held)}. The record pulls beyond it; the standard errors are "
        "those of a model where it is fixed there. Check whether the bound is right."
    ]


def _constant_input(estimate: Estimate, records: Sequence[Record]) -> list[str]:
    assumed = [
        name
        for j, name in enumerate(estimate.input_names)
        if all(np.ptp(record.u[:, j]) == 0 for record in records)
    ]
    if not assumed:
        return []
    return [
        f"Input {', '.join(assumed)} never changes: the result holds only if it was switched on at "
        "the first sample, with the system at rest before."
    ]
