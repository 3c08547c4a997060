"""A sensor or an actuator that goes no further than a level.

*An output.* What is recorded is ``min(max(y, low), high)`` and noise. A level stands where the
residual that it leaves of the present output is least; the samples that the model takes beyond it
tell the model nothing, so that it is fitted to the others, and so on from there. It is compared on
all samples: beyond a level the residual is the distance from the level. The model decides which
samples those are, not the noise, so that nothing is selected by it.

*An input.* What acted is ``min(max(u, low), high)`` of the recorded input, of levels that promise
most.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.judgement.causes.attempt import Attempt, Limited, attempt, promise
from tridentify.judgement.causes.present import Present
from tridentify.judgement.causes.rivals import Limits, Rival, one
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import deviance, fit_autoregression
from tridentify.record.record import Record

ROUNDS = 4
"""Fits and levels in turn: a model that was fitted to a limited output reaches beyond the level by
less than the truth, and the first levels are too wide."""

STEPS = 10
"""Levenberg-Marquardt steps of each."""

TAILS = np.linspace(0.01, 0.45, 45)
"""Shares of the samples beyond a level that are tried."""

INPUT_TAILS = np.array([0.02, 0.05, 0.1, 0.2, 0.3])
"""The same for an input."""

LEAST = 0.02
"""Share by which a level has to lower the sum of squares to be one."""

FEWEST_INSIDE = 0.4
"""Share of the samples that have to lie within the limits."""

LEVELS = 6
"""Values of an input from which a limit can be told from a smaller gain."""


def saturation_rivals(present: Present, fitted: Sequence[Array]) -> Iterator[Rival]:
    """Every output and every input with limits.

    Parameters
    ----------
    present : Present
    fitted : sequence of (n_samples, n_outputs) arrays
        Outputs of the present model.
    """
    for i in range(present.n_outputs):
        found = _of_output(present, fitted, i)
        if found is not None:
            yield found
    for j in range(present.records[0].n_inputs):
        found = _of_input(present, j)
        if found is not None:
            yield found


def with_limits(end: Attempt, limits: Limits) -> Attempt:
    """Where a fit to the samples within the limits ended, compared on all of them."""
    i = limits.output
    recorded, left = [], []
    pairs = zip(limits.records, end.point.outputs(), end.point.problem.experiments, strict=True)
    for record, outputs, experiment in pairs:
        y = np.array(experiment.y)
        y[:, i] = np.where(np.isfinite(outputs[:, i]), record.y[:, i], np.nan)
        limited = np.array(outputs)
        limited[:, i] = np.clip(outputs[:, i], limits.low, limits.high)
        recorded.append(y)
        left.append(y - limited)
    return replace(
        end,
        deviance=refitted_noise(end, left),
        unknowns=end.unknowns + limits.count,
        limited=Limited(tuple(recorded), tuple(left)),
    )


def refitted_noise(end: Attempt, left: Sequence[Array]) -> float:
    """``-2 log L`` of what something behind the outputs leaves, by a noise model of its own.

    Parameters
    ----------
    end : Attempt
    left : sequence of (n_samples, n_outputs) arrays
        Per experiment.
    """
    total = 0.0
    noise = list(end.point.problem.noise)
    for k in range(end.point.problem.n_outputs):
        series = [np.ascontiguousarray(one[:, k]) for one in left]
        order = noise[k].size if noise else 0
        a = fit_autoregression(series, order, order) if order else np.zeros(0)
        total += deviance(series, a)
    return total


def levels(recorded: Array, fitted: Array) -> tuple[float, float]:
    """Limits that leave least of an output; infinite where one does not help.

    Parameters
    ----------
    recorded, fitted : (n,) arrays
        Without missing samples.

    Examples
    --------
    >>> y = np.sin(np.arange(200.0))
    >>> low, high = levels(np.minimum(y, 0.5), y)
    >>> bool(np.isinf(low)), round(high, 1)
    (True, 0.5)
    """
    total = float(np.sum((recorded - fitted) ** 2))
    found = []
    for side in (-1.0, 1.0):
        own, response = side * recorded, side * fitted
        tried = np.unique(np.quantile(response, 1.0 - TAILS))
        energy = [float(np.sum((own - np.minimum(response, level)) ** 2)) for level in tried]
        k = int(np.argmin(energy))
        helps = total - energy[k] > LEAST * total
        found.append(side * float(tried[k]) if helps else side * np.inf)
    return found[0], found[1]


def _of_output(present: Present, fitted: Sequence[Array], i: int) -> Rival | None:
    """An output between two limits, or below or above one."""
    outputs, poles = [np.asarray(one[:, i]) for one in fitted], present.poles
    limits, part = None, present
    for _ in range(ROUNDS):
        found = _limits(present.records, outputs, i)
        if found is None:
            break
        limits = found
        pairs = zip(present.records, outputs, strict=True)
        part = replace(present, records=tuple(_within(r, f, limits) for r, f in pairs))
        try:
            problem = replace(part, noise=()).problem()
            end = attempt(problem, [poles], present.orders, steps=STEPS, rounds=0)
        except TridentifyError:
            return None
        if end is None:
            return None
        poles = end.point.poles
        outputs = [np.asarray(one[:, i]) for one in end.point.outputs()]
    if limits is None:
        return None
    name = present.records[0].output_names[i]
    rival = one(
        "saturation",
        part,
        f"a limit of {name} {_in_words(limits.low, limits.high)}",
        f"Mark the samples of {name} at the limit as missing (record.mask; --missing), or record "
        "again with a wider range.",
    )
    return replace(rival, starts=((poles, present.poles),), limits=limits)


def _limits(records: Sequence[Record], outputs: Sequence[Array], i: int) -> Limits | None:
    """Where the limits of an output stand for a model; None where it has none."""
    there = [np.isfinite(r.y[:, i]) & np.isfinite(f) for r, f in zip(records, outputs, strict=True)]
    y = np.concatenate([r.y[s, i] for r, s in zip(records, there, strict=True)])
    f = np.concatenate([one[s] for one, s in zip(outputs, there, strict=True)])
    low, high = levels(y, f)
    inside = float(np.mean((f > low) & (f < high)))
    if (np.isinf(low) and np.isinf(high)) or inside < FEWEST_INSIDE:
        return None
    return Limits(i, low, high, tuple(records))


def _within(record: Record, output: Array, limits: Limits) -> Record:
    """A record without the samples that a model takes beyond a limit."""
    y = np.array(record.y)
    y[~((output > limits.low) & (output < limits.high)), limits.output] = np.nan
    return record._derive(y=y)


def _of_input(present: Present, j: int) -> Rival | None:
    """An actuator between two limits, or below or above one."""
    values = np.concatenate([record.u[:, j] for record in present.records])
    if np.unique(values).size < LEVELS:
        return None
    below, above = np.quantile(values, INPUT_TAILS), np.quantile(values, 1.0 - INPUT_TAILS)
    tried = [*zip(below, above, strict=True)]
    tried += [(-np.inf, high) for high in above] + [(low, np.inf) for low in below]
    tried = [(low, high) for low, high in tried if low < high]
    plain = replace(present, noise=())
    parts = [_clipped(plain, j, low, high) for low, high in tried]
    promised = [promise(part, present.poles) for part in parts]
    low, high = tried[int(np.argmin(promised))]
    name = present.records[0].input_names[j]
    return one(
        "saturation",
        _clipped(present, j, low, high),
        f"an actuator that takes {name} no further than to a limit {_in_words(low, high)}",
        f"Use the measured position of the actuator as the input, or a smaller {name}.",
    )


def _clipped(present: Present, j: int, low: float, high: float) -> Present:
    records = []
    for record in present.records:
        u = np.array(record.u)
        u[:, j] = np.clip(u[:, j], low, high)
        records.append(record._derive(u=u))
    return replace(present, records=tuple(records))


def _in_words(low: float, high: float) -> str:
    """Limits, those that there are.

    Examples
    --------
    >>> _in_words(-1.0, 2.0), _in_words(-float("inf"), 2.0)
    ('at -1 and at 2', 'at 2')
    """
    return " and ".join(f"at {level:.3g}" for level in (low, high) if np.isfinite(level))
