"""A sensor or an actuator that goes no further than a level.

*An output.* What is recorded is ``min(max(y, low), high)`` and noise. A level stands where the
residual that it leaves of the present output is least; the samples that the model takes beyond it
tell the model nothing, so that it is fitted to the others, and so on from there. It is compared on
all samples: beyond a level the residual is the distance from the level. The model decides which
samples those are, not the noise, so that nothing is selected by it.

*An input.* What acted is ``min(max(u, low), high)`` of the recorded input, of levels that promise
most; or what follows the recorded input no faster than at some rate, averaged over each sample
where that is held.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.judgement.causes.attempts.attempt import Attempt, Limited, attempt, promise
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Limits, Rival, one
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

NEARER = (0.1, 0.05, 0.025, 0.0125)
"""Shares of its range by which the best of these is moved."""

LEAST = 0.02
"""Share by which a level has to lower the sum of squares to be one."""

FEWEST_INSIDE = 0.4
"""Share of the samples that have to lie within the limits."""

RATES = np.geomspace(1.0, 256.0, 9)
"""Samples in which a limited rate takes an actuator through all of its range."""

SHARE = 0.25
"""Of a record, that it takes at most."""

FINER = (2**0.5, 2**0.25, 2**0.125, 2**0.0625)
"""Factors by which the rate is looked for beside the best of these."""

ONE_SIZE = 0.05
"""Share by which moves of one size differ."""

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
        for found in (_of_input(present, j), _of_rate(present, j)):
            if found is not None:
                yield found


def with_limits(limits: Limits, end: Attempt) -> Attempt:
    """Where a fit to the samples within the limits ended, compared on all of them."""
    i = limits.output
    recorded, shown = [], []
    pairs = zip(limits.records, end.point.outputs(), end.point.problem.experiments, strict=True)
    for record, outputs, experiment in pairs:
        y = np.array(experiment.y)
        y[:, i] = np.where(np.isfinite(outputs[:, i]), record.y[:, i], np.nan)
        limited = np.array(outputs)
        limited[:, i] = np.clip(outputs[:, i], limits.low, limits.high)
        recorded.append(y)
        shown.append(limited)
    return behind_outputs(end, recorded, shown, limits.count)


def behind_outputs(
    end: Attempt, recorded: Sequence[Array], shown: Sequence[Array], count: int
) -> Attempt:
    """The end of a fit where something stands behind the outputs, with a noise model of its own.

    Parameters
    ----------
    end : Attempt
    recorded, shown : sequence of (n_samples, n_outputs) arrays
        Per experiment: what counts of the record, and what the model takes it for.
    count : int
        Unknowns of what stands there.
    """
    left = [y - taken for y, taken in zip(recorded, shown, strict=True)]
    total = 0.0
    noise = list(end.point.problem.noise)
    for k in range(end.point.problem.n_outputs):
        series = [np.ascontiguousarray(one[:, k]) for one in left]
        order = noise[k].size if noise else 0
        a = fit_autoregression(series, order, order) if order else np.zeros(0)
        total += deviance(series, a)
    return replace(
        end,
        deviance=total,
        unknowns=end.unknowns + count,
        limited=Limited(tuple(recorded), tuple(left), tuple(shown)),
    )


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
        try:
            # an experiment may have no sample within the limits of the others
            part = replace(present, records=tuple(_within(r, f, limits) for r, f in pairs))
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
    return replace(rival, starts=((poles, present.poles),), behind=partial(with_limits, limits))


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
    ends = float(values.min()), float(values.max())
    below, above = np.quantile(values, INPUT_TAILS), np.quantile(values, 1.0 - INPUT_TAILS)
    # a command of few levels has its limit between two of them
    below, above = (
        np.unique([*tails, *(0.5 * (tails + end))])[::way]
        for tails, end, way in zip((below, above), ends, (1, -1), strict=True)
    )
    tried = [*zip(below, above, strict=False)]
    tried += [(-np.inf, high) for high in above] + [(low, np.inf) for low in below]
    plain = replace(present, noise=())
    known: dict[tuple[float, float], float] = {}
    # a limit that hardly anything passes explains single samples
    lowest, highest = np.quantile(values, [INPUT_TAILS[0], 1.0 - INPUT_TAILS[0]])

    def at(limits: tuple[float, float]) -> float:
        low, high = limits
        passed = low < high and not -np.inf < low < lowest and not highest < high < np.inf
        if limits not in known:
            known[limits] = (
                promise(_clipped(plain, j, low, high), present.poles) if passed else np.inf
            )
        return known[limits]

    low, high = min(tried, key=at)
    for share in NEARER:
        by = share * (ends[1] - ends[0])
        low = min((low, low - by, low + by), key=lambda level: at((level, high)))
        high = min((high, high - by, high + by), key=lambda level: at((low, level)))
    name, count = present.records[0].input_names[j], int(np.isfinite(low)) + int(np.isfinite(high))
    found = one(
        "saturation",
        _clipped(present, j, low, high),
        f"an actuator that takes {name} no further than to a limit {_in_words(low, high)}",
        f"Use the measured position of the actuator as the input, or a smaller {name}.",
    )
    return replace(found, price=2.0 * count)


def _clipped(present: Present, j: int, low: float, high: float) -> Present:
    return present.acted(j, lambda record: np.clip(record.u[:, j], low, high))


def _of_rate(present: Present, j: int) -> Rival | None:
    """An actuator that follows an input no faster than at a rate."""
    if any(record.dt is None for record in present.records):
        return None
    values = np.concatenate([record.u[:, j] for record in present.records])
    size, shortest = float(np.ptp(values)), min(record.n_samples for record in present.records)
    if not size > 0.0:
        return None
    plain = replace(present, noise=())
    starts = [plain, replace(plain, delay=np.zeros_like(plain.delay))][: 1 + plain.delay.any()]
    known: dict[tuple[int, float], Attempt | None] = {}

    def at(which: int, samples: float) -> float:
        key = which, samples
        if key not in known:
            part = _limited_rate(starts[which], j, size / samples)
            try:
                known[key] = attempt(
                    part.problem(), [present.poles], present.orders, steps=STEPS, rounds=0
                )
            except TridentifyError:
                known[key] = None
        end = known[key]
        return np.inf if end is None else end.deviance / end.count

    grid = RATES[shortest * SHARE > RATES]
    tried = [(k, float(samples)) for k in range(len(starts)) for samples in grid]
    if not tried:
        return None
    which, samples = min(tried, key=lambda one: at(*one))
    for step in FINER:
        near = (samples / step, samples, samples * step)
        samples = min(near, key=lambda one: at(which, one))
    end = known[which, samples]
    if end is None:
        return None
    name, part = present.records[0].input_names[j], replace(starts[which], noise=present.noise)
    rate = size / samples / present.step
    found = one(
        "saturation",
        _limited_rate(part, j, size / samples),
        f"an actuator that follows {name} no faster than at {rate:.3g} per second (a limit of its "
        "rate)",
        f"Use the measured position of the actuator as the input, or a {name} that moves no faster "
        "than that; no delay and no order stands for it.",
    )
    price = 2.0 * (1.0 + float(np.log(len(known))))
    return replace(
        found,
        starts=((end.point.poles, present.poles),),
        price=price,
        exact=True,
        headline="an actuator is at the limit of its rate",
        as_lags=all(alike(record.u[:, j], size / samples) for record in present.records),
    )


def alike(u: Array, most: float) -> bool:
    """Whether all moves of an input are of one size, and a limited rate has time for each.

    Behind a limit of the rate each of them is then the same ramp, which a linear lag makes as well:
    moves of other sizes tell the two apart.

    Parameters
    ----------
    u : (n,) array
    most : float
        What the rate allows, a sample.

    Examples
    --------
    >>> alike(np.repeat([0.0, 1.0, 0.0], 10), 0.2), alike(np.repeat([0.0, 1.0, 3.0], 10), 0.2)
    (True, False)
    """
    moves = np.diff(u)
    at = np.flatnonzero(moves)
    sizes = np.abs(moves[at])
    if at.size < 2:
        return True
    return bool(np.ptp(sizes) < ONE_SIZE * sizes.max() and np.diff(at).min() * most >= sizes.max())


def _limited_rate(present: Present, j: int, most: float) -> Present:
    """With what follows an input by no more than `most` a sample."""
    return present.acted(
        j, lambda record: following(record.u[:, j], most, held=record.behaviour == "zoh")
    )


def following(u: Array, most: float, *, held: bool) -> Array:
    """What follows an input by no more than some amount a sample.

    Parameters
    ----------
    u : (n,) array
    most : float
    held : bool
        Whether the input is held over each sample; the average of what follows over each is given
        then.

    Examples
    --------
    >>> u = np.array([0.0, 1.0, 1.0, 1.0])
    >>> following(u, 0.5, held=False).tolist(), following(u, 0.5, held=True).tolist()
    ([0.0, 0.5, 1.0, 1.0], [0.0, 0.25, 0.75, 1.0])
    """
    found = np.empty(u.size)
    place = float(u[0])
    for k, wanted in enumerate(u.tolist()):
        away = wanted - place
        reached = wanted if abs(away) <= most else place + (most if away > 0 else -most)
        moves = abs(reached - place) / most
        found[k] = reached - 0.5 * (reached - place) * moves if held else reached
        place = reached
    return found


def _in_words(low: float, high: float) -> str:
    """Limits, those that there are.

    Examples
    --------
    >>> _in_words(-1.0, 2.0), _in_words(-float("inf"), 2.0)
    ('at -1 and at 2', 'at 2')
    """
    return " and ".join(f"at {level:.3g}" for level in (low, high) if np.isfinite(level))
