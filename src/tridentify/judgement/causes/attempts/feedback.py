"""Whether small moves of an input to come explain what is left of an output: feedback.

A controller acts on what it measures, noise and all, so that the input from a sample on carries
the noise of that sample, and a fit on past inputs leaves what later ones explain (Sims 1972). What
a reference makes of the input says nothing of that, and drowns it: only the small moves count that
the past of the input does not tell (`signals.surprises`), at the first sample that a controller may
act at and at a few more. They are functions of the inputs alone, so that the F test of added
columns keeps its size without feedback, whatever the inputs are.

An input that was not held as stated leaves something of that kind too: what lies between two
samples is drawn with the next one. That cannot be more than the model does within two samples. And
the test is made on what is left of the present explanation, beside the past inputs, and compared
with what other explanations gain.

What is left of a fit that feedback has bent, of an integrator that a controller holds most of all,
may be so large and slow that no surprise shows in it, and a drift explains more of it than inputs
to come. So the test is made once more on what the predictor leaves, the best forecast of the output
from its own past and that of the inputs, which no feedback bends (`by_predictor`). What that leaves
knows of no model, and no other explanation of one stands against it.

References: C. Sims, American Economic Review 62 (1972) 540-552. C. Granger, Econometrica 37 (1969)
424-438.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.noise.noise_levels import noise_sizes
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.judgement.causes.attempts.attempt import Attempt
from tridentify.judgement.causes.attempts.direct_part import has_direct_part
from tridentify.judgement.causes.signals.levels_in_noise import is_noise_of_its_sensor, levels_of
from tridentify.judgement.causes.signals.surprises import at_rest, moved, small_surprises
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten_columns
from tridentify.numerics.lagrange import Added, added, span
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

PAST = 12
"""Past samples of each input that the coming ones are judged beside: an input that is smooth is
known from them."""

PER_PAST = 24
"""Samples for each past one of the output that the predictor goes by, at least."""

OLDER = 120
"""Past samples of the inputs beside which what inputs to come seem to explain is asked again. Tones
of a multisine are told by two samples each, and what comes of it tells what is long past."""

PER_OLDER = 12
"""Samples for each of them, at least."""

BESIDE_OLDER = 1e-2
"""p-value beside these, which cost degrees of freedom, up to which it counts."""

AT_REST = 1e-2
"""The same where an input that is not held did not move far just before."""

FEWEST_AT_REST = 60
"""Surprises there that it takes to ask."""

COMING = 4
"""Samples to come that a controller may act at first."""

GUARD = 2
"""Samples to come that an input which is not held may act through: between two samples it is drawn
with the next ones."""

CHANCE = 1e-3
"""p-value from which an input reacts to the output: one right record of a thousand, where its input
moves a little at every sample."""

CHANCE_FORECAST = 1e-4
"""The same of what the predictor leaves, where something else explains more of the model's errors:
of 417 open-loop records, with gusts, coloured noise, gaps and bends, none was below 1e-3."""

CHANCE_MEASURED = 1e-8
"""The same of an input that is not held: it is smooth, and hardly anything quite linear."""

LEAST_SHARE = 0.02
"""Of the residual that inputs to come must explain: in a long record the slightest imperfection is
significant, and means nothing."""

FIRST = 0.25
"""Share of what the most telling sample explains from which an earlier one is where the input
begins to react."""

AS_MUCH = 0.8
"""Share of the gain of any other cause that inputs to come must have to be named before it."""


class Coming(NamedTuple):
    """What inputs to come explain of one output.

    Attributes
    ----------
    gain : float
        Fall of ``-2 log L``, less twice the number of columns.
    share : float
        Of the whitened residual's sum of squares.
    p_value : float
        Of the first sample that may react, or of all of them, whichever is less, twice.
    lag : int
        Samples until the input begins to react [samples].
    input : int
    chance : float
        p-value from which it counts.
    """

    gain: float
    share: float
    p_value: float
    lag: int
    input: int
    chance: float = CHANCE

    @property
    def is_clear(self) -> bool:
        """Whether noise alone does not explain it."""
        return self.p_value < self.chance and self.share > LEAST_SHARE


@dataclass(frozen=True, eq=False)
class Inputs:
    """What the inputs of some records may show of a controller.

    Attributes
    ----------
    records : tuple of Record
    surprises : tuple of (n_samples, n_inputs) arrays
        Small ones, per experiment.
    """

    records: tuple[Record, ...]
    surprises: tuple[Array, ...]

    def scale_of(self, output: int) -> tuple[float, ...]:
        """Noise of an output in each experiment over that of all; empty where it is one."""
        return noise_sizes(self.records, output)

    @classmethod
    def of(cls, records: Sequence[Record], past: int = PAST) -> Inputs:
        """Those of some records, without what is noise of an input's own sensor.

        What is no surprise is told from so many past samples at most.
        """
        own = [
            np.where(_recorded_noise(record), 0.0, one) if one.any() else one
            for record, one in zip(records, small_surprises(records, past), strict=True)
        ]
        return cls(tuple(records), tuple(own))

    @property
    def commanded(self) -> bool:
        """Whether no input moves but by what its past tells and by large moves."""
        return not any(np.any(one) for one in self.surprises)

    @property
    def held(self) -> bool:
        """Whether all are held between samples."""
        return all(record.behaviour == "zoh" for record in self.records)

    def at_rest(self) -> Inputs:
        """Those where no input moved far just before, if they are not held; else all.

        When an input jumped between two samples, and what it did there, an output knows as well.
        """
        own = self.surprises if self.held else tuple(at_rest(one) for one in self.surprises)
        return replace(self, surprises=own)


def _recorded_noise(record: Record) -> NDArray[np.bool_]:
    """(n_inputs,) which inputs stand at levels, and move on these by what no output tells.

    Where the output follows at once, what is left of it follows that noise, and a later sample of
    the input, which tells its level once more, explains some of what is left.
    """
    found = np.zeros(record.n_inputs, dtype=bool)
    for j in range(record.n_inputs):
        levels = levels_of(record.u[:, j])
        at_levels = bool(np.isfinite(levels).any())
        found[j] = at_levels and is_noise_of_its_sensor(record, j, levels, COMING)
    return found


def reacts(
    end: Attempt,
    records: Sequence[Record],
    most: float = 0.0,
    rival: Sequence[tuple[Attempt, Sequence[Record]]] = (),
) -> list[Coming | None]:
    """Whether the input reacts to the outputs, and no other cause explains that.

    Parameters
    ----------
    end : Attempt
        The present explanation.
    records : sequence of Record
    most : float
        Largest fall of the criterion that any other cause brings; 0 for none.
    rival : sequence of (Attempt, sequence of Record)
        Where the parts of the likeliest other cause ended, and on what. What explains more than
        inputs to come may still leave all that they explain: a pole in the right half-plane that a
        controller holds looks like a drift and like much else. For inputs that are held only.

    Returns
    -------
    list of Coming or None
        One per output; None where the input does not react, as one that is commanded cannot.
    """
    point, inputs = end.point, Inputs.of(records)
    n_outputs = point.problem.n_outputs
    found: list[Coming | None] = [None] * n_outputs
    if inputs.commanded:
        return found
    direct = inputs.held and has_direct_part(records)
    for i in range(n_outputs):
        within = Within.of(point, inputs, i, direct=direct)
        left = _left_by(point, i, inputs, within)
        seen = left if left.is_clear else by_predictor(inputs, i, within.guard)
        if not seen.is_clear:
            continue
        beside = inputs.held and any(
            _left_by(part.point, i, Inputs.of(own), within).is_clear for part, own in rival
        )
        if beside or seen.gain > AS_MUCH * most:
            found[i] = seen
            continue
        forecast = by_predictor(inputs, i, within.guard) if seen is left else seen
        told = forecast.is_clear and forecast.p_value < CHANCE_FORECAST
        if told and not (inputs.held and _drawn_between(i, rival)):
            found[i] = forecast
    return found


def _drawn_between(i: int, rival: Sequence[tuple[Attempt, Sequence[Record]]]) -> bool:
    """Whether inputs that are not held explain the records, and leave nothing to those to come.

    What lies between two samples is drawn with the next one, which a forecast that takes an input
    for held gains by as it would by feedback.
    """
    for part, records in rival:
        own = Inputs.of(records)
        if own.held:
            return False
        within = Within.of(part.point, own, i)
        left = _left_by(part.point, i, own, within)
        if left.p_value < CHANCE or by_predictor(own, i, within.guard).is_clear:
            return False
    return bool(rival)


def _left_by(point: Point, i: int, inputs: Inputs, within: Within) -> Coming:
    """What inputs to come explain of what an explanation leaves of an output."""
    noise = point.problem.noise[i] if point.problem.noise else np.zeros(0)
    own = point.sensitivities(np.eye(max(place.stop for place in point.width.values())), i)
    residual = [np.ascontiguousarray(one[:, i]) for one in point.residuals()]
    return coming(residual, own, noise, inputs, within, inputs.scale_of(i))


class Within(NamedTuple):
    """How soon inputs act on an output without feedback.

    Attributes
    ----------
    guard : int
        Samples ahead that may act: 0 where the input is held and the model strictly proper.
    soon : (n_inputs,) array
        What the model makes of a step within `GUARD` samples [output unit / input unit]; what is
        drawn between the samples of an input that is not held explains no more.
    """

    guard: int
    soon: Array

    @classmethod
    def of(cls, point: Point, inputs: Inputs, output: int, *, direct: bool = False) -> Within:
        """By the model at a point, or with the direct part that the records show."""
        problem = point.problem
        orders = {pair: group.order for group in problem.groups for pair in group.channels}
        proper = direct or any(problem.n_zeros[i][j] == order for (i, j), order in orders.items())
        if inputs.held:
            return cls(int(proper), np.zeros(0))
        if proper or any(record.dt is None for record in inputs.records):
            return cls(GUARD, np.full(problem.n_inputs, np.inf))
        return cls(GUARD, np.abs(_soon(problem, coefficients(point), output, inputs.records[0])))


def _soon(problem: Problem, theta: Array, output: int, record: Record) -> Array:
    """(n_inputs,) response of the model to a step of each input after `GUARD` samples."""
    dens, nums = problem.places()
    found = np.zeros(problem.n_inputs)
    for group, den in zip(problem.groups, dens, strict=True):
        for i, j in group.channels:
            if i == output:
                model = TransferFunction(theta[nums[i, j]], np.append(1.0, theta[den]))
                step = Record(np.ones(GUARD + 1), np.zeros(GUARD + 1), dt=record.dt)
                found[j] = simulate(model, step)[GUARD, 0]
    return found


def coming(
    residual: Sequence[Array],
    own: Sequence[Array],
    noise: Array,
    inputs: Inputs,
    within: Within,
    scale: Sequence[float] = (),
) -> Coming:
    """Test inputs to come in a residual.

    Parameters
    ----------
    residual : sequence of (n_samples,) arrays
        Per experiment, not whitened; ``nan`` where a sample is missing.
    own : sequence of (n_samples, k) arrays
        Derivatives by all that was fitted.
    noise : (p,) array
        What whitens them.
    inputs : Inputs
    within : Within
    scale : sequence of float
        Noise of each experiment over that of all; empty where it is one.
    """
    e = _white([one[:, None] for one in residual], residual, noise, scale)[:, 0]
    left = Left(residual, own, noise, inputs, e, scale)
    if within.soon.size:
        at_once, sizes = _from(0, left)
        if np.any(sizes > within.soon):
            return _asked_again(at_once, 0, left)
    return _asked_again(_from(within.guard, left)[0], within.guard, left)


def by_predictor(inputs: Inputs, output: int, guard: int) -> Coming:
    """Test inputs to come in what the past of an output and of the inputs leaves of it.

    Parameters
    ----------
    inputs : Inputs
    output : int
    guard : int
        Samples ahead that may act without feedback.
    """
    y = [np.ascontiguousarray(record.y[:, output]) for record in inputs.records]
    # where a sample is missing the past is the last one before it, which is past as well
    last = [_last_seen(one) for one in y]
    most = max(1, min(PAST, sum(one.size for one in y) // PER_PAST))
    # inputs count from where each experiment begins, so that each has a level of its own
    level = np.eye(len(y))
    own = [
        np.column_stack([_before(one, range(1, most + 1)), np.tile(level[e], (one.size, 1))])
        for e, one in enumerate(last)
    ]
    seen = [np.where(np.arange(one.size) < most, np.nan, one) for one in y]
    scale, white = inputs.scale_of(output), np.zeros(0)
    e = _white([one[:, None] for one in seen], seen, white, scale)[:, 0]
    left = Left(seen, own, white, inputs, e, scale)
    return _asked_again(_from(guard, left)[0], guard, left)


def forecasts_react(point: Point, records: Sequence[Record]) -> bool:
    """Whether the input reacts to an output by the forecasts, which bend with no model.

    Parameters
    ----------
    point : Point
        Of a model, for how soon inputs act.
    records : sequence of Record
        With all samples, also those that are far from the model.
    """
    inputs = Inputs.of(records)
    direct = not inputs.commanded and inputs.held and has_direct_part(records)
    return not inputs.commanded and any(
        by_predictor(inputs, i, Within.of(point, inputs, i, direct=direct).guard).is_clear
        for i in range(point.problem.n_outputs)
    )


def _last_seen(y: Array) -> Array:
    """A signal whose missing samples are those before them; those at the start are the first."""
    there = np.flatnonzero(np.isfinite(y))
    if not there.size:
        return np.zeros(y.size)
    place = np.searchsorted(there, np.arange(y.size), side="right") - 1
    return np.asarray(y[there[np.maximum(place, 0)]])


class Left(NamedTuple):
    """What is left of an output, what was fitted to it, and the inputs; as `coming` takes them.

    Attributes
    ----------
    residual, own : sequence of arrays
    noise : (p,) array
    inputs : Inputs
    white : (n_samples,) array
        The residual of all experiments, whitened.
    scale : sequence of float
    """

    residual: Sequence[Array]
    own: Sequence[Array]
    noise: Array
    inputs: Inputs
    white: Array
    scale: Sequence[float] = ()


def _asked_again(found: Coming, first: int, left: Left) -> Coming:
    """What inputs to come explain, asked again where it is clear: at rest, and beside a long past.

    What a short past does not tell of an input that repeats itself is no surprise: it resembles
    what is long past, and explains what a predictor or a noise model of few lags leaves of that.
    """
    if not found.is_clear:
        return found
    if not left.inputs.held:
        quiet = left.inputs.at_rest()
        if sum(np.count_nonzero(one) for one in quiet.surprises) >= FEWEST_AT_REST:
            again, _ = _from(first, left._replace(inputs=quiet))
            if again.p_value > AT_REST:
                return again._replace(chance=AT_REST)
    count = sum(int(np.isfinite(one).sum()) for one in left.residual)
    most = min(OLDER, count // (PER_OLDER * left.inputs.records[0].n_inputs))
    if most <= PAST:
        return found
    again, _ = _from(first, left._replace(inputs=Inputs.of(left.inputs.records, most)), most)
    return found if again.p_value < BESIDE_OLDER else again._replace(chance=BESIDE_OLDER)


def _from(first: int, left: Left, most: int = PAST) -> tuple[Coming, Array]:
    """The test from so many samples ahead; what an input explains at its best one, each."""
    residual, own, noise, inputs, e, scale = left
    past = [moved(record.u - record.u[0], range(1 - first, most + 1)) for record in inputs.records]
    ahead = range(-first, -first - COMING, -1)
    known = [np.hstack([np.nan_to_num(a), b]) for a, b in zip(own, past, strict=True)]
    basis = span(_white(known, residual, noise, scale))
    extra = _white([moved(one, ahead) for one in inputs.surprises], residual, noise, scale)
    count = sum(int(np.isfinite(one).sum()) for one in residual)
    n_inputs = inputs.records[0].n_inputs

    def test(columns: Array) -> Added:
        return added(e, basis, span(columns, basis), count)

    alone, pooled = test(extra[:, :n_inputs]), test(extra)
    best = min(alone, pooled, key=lambda one: one.p_value)
    ratio = best.statistic * best.dimension / max(best.freedom, 1)
    gain = count * float(np.log1p(ratio)) - 2.0 * best.dimension
    new = extra - basis @ (basis.T @ extra)
    norms = np.maximum(np.einsum("ij,ij->j", new, new), 1e-300)
    slopes = new.T @ e / norms
    shares = slopes**2 * norms
    most = int(np.argmax(shares >= FIRST * shares.max()))
    sizes = np.max(np.abs(slopes).reshape(COMING, n_inputs)[: GUARD + 1 - first], axis=0)
    found = Coming(
        gain,
        best.share,
        min(1.0, 2.0 * best.p_value),
        first + most // n_inputs,
        most % n_inputs,
        CHANCE if inputs.held else CHANCE_MEASURED,
    )
    return found, sizes


def misses(
    residual: Sequence[Array], own: Sequence[Array], noise: Array, records: Sequence[Record]
) -> float:
    """p-value of past inputs and outputs in the innovations; 1 where they explain next to nothing.

    Innovations of a right model are independent of both, with or without feedback.

    Parameters
    ----------
    residual : sequence of (n_samples,) arrays
        Per experiment, not whitened; ``nan`` where a sample is missing.
    own : sequence of (n_samples, k) arrays
        Derivatives by all that was fitted.
    noise : (p,) array
        What whitens them.
    records : sequence of Record
    """
    e = _white([one[:, None] for one in residual], residual, noise)[:, 0]
    basis = span(_white([np.nan_to_num(one) for one in own], residual, noise))
    lags = range(1, PAST + 1)
    innovations = np.split(e, np.cumsum([one.size for one in residual])[:-1])
    inputs = _white([moved(one.u - one.u[0], lags) for one in records], residual, noise)
    before = np.vstack([_before(one, lags) for one in innovations])
    # what the noise model took from the first lags is allowed for by as many columns
    count = sum(int(np.isfinite(one).sum()) for one in residual) - noise.size
    test = added(e, basis, span(np.hstack([inputs, before]), basis), count)
    return test.p_value if test.share > LEAST_SHARE else 1.0


def _before(e: Array, lags: range) -> Array:
    """A series so many samples ago, zero before its start."""
    return np.stack([np.concatenate([np.zeros(lag), e[:-lag]]) for lag in lags], axis=1)


def _white(
    columns: Sequence[Array], residual: Sequence[Array], noise: Array, scale: Sequence[float] = ()
) -> Array:
    if scale:
        columns = [one / size for one, size in zip(columns, scale, strict=True)]
    return whiten_columns(columns, [np.isfinite(left) for left in residual], noise)
