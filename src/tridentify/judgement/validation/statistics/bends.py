"""Columns for each cause that can be named beyond a linear response: where power is, few columns.

A test of many columns sees little of a misfit that one of them would show. So every cause has few
of its own, made as the cause would make them:

*Non-linearity within the loop.* A restoring force ``a(p) y + k f(y) = b(p) u`` adds the response of
``1 / a(p)`` to ``-f(y)``, not ``f(y)`` itself; an actuator that is not linear the response of the
model to ``f(u)``; dry friction that of ``1 / a(p)`` to ``-sign(dy/dt)``, or to ``-sign(y)`` where
the output is a speed. The fitted output stands for ``y``, and the states of the model for motions
that are not recorded (`signals.inner_states`): they carry no noise, so that the columns are as good
as fixed (Ramsey, J. Royal Statistical Society B 31, 1969, 350-371; Billings, *Nonlinear System
Identification*, 2013).

*Limits.* A sensor that saturates takes away the part of the output beyond a level; as the level is
unknown, those beyond several quantiles are added. An actuator likewise, through the model; what
follows an input at a limited rate stays behind it.

*A gain that changes with the output.* The response of the model to ``u y``, about their means.

*Play.* What a gap takes from an input (`system.backlash`), through the model.

*A late or smoothed input.* The response of the model to each input, some samples later.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.causes.sensors.saturation import following
from tridentify.judgement.causes.signals.inner_states import gripping, inner_states, turns
from tridentify.judgement.causes.system.backlash import taken_by_gaps
from tridentify.judgement.validation.residuals import View
from tridentify.models.simulate import simulate_each
from tridentify.numerics.arrays import Array, filled
from tridentify.numerics.quantiles import quantiles
from tridentify.record.record import Record

Columns = tuple[Array, ...]


class Channel(NamedTuple):
    """Numerator, monic denominator and delay [s] of one channel of a model."""

    num: Array
    den: Array
    delay: float


Asked = tuple[Channel, Sequence[Array]]
"""What is driven, and by which (n_samples, k) inputs in each experiment."""

TAILS = (0.05, 0.12, 0.2)
"""Shares of the samples that lie beyond a level, on either side: few samples tell a level that is
rarely reached, and one that is reached by more than a fifth moves the coefficients first."""

INPUT_TAILS = (0.1, 0.25)
"""The same for an actuator."""

RATES = (4, 16, 64)
"""Samples in which an actuator of a limited rate goes through its range: to a factor of two, any
that lets it settle between jumps and is slower than a sample."""

LEVELS = 4
"""Values of an input from which a limit can be told from a smaller gain, or a limited rate from a
lag."""

SHIFTS = (1, 2, 4, 8, 16, 32)
"""By how much the response is moved [samples]; together they make any that is late or smoother."""

FEW_SHIFTS = (1, 3, 9)
"""Fewer, which see a single delay better."""

LEAST_LEFT = 8
"""Samples over the largest shift."""


def bends(view: View, output: int, estimate: Estimate) -> list[Columns]:
    """Columns of every kind of non-linearity, kind by kind.

    Parameters
    ----------
    view : View
    output : int
    estimate : Estimate
        Whose model filters what acts within the loop.

    Returns
    -------
    list of tuples of (n_samples, k) arrays
        Per kind, one array per experiment.
    """
    records = view.records
    fitted = [filled(one) for one in view.outputs[output].fitted]
    shapes = _scaled(fitted)
    den = estimate.model.den[output][0]
    inner = Channel(np.array([den[-1] or 1.0]), den, 0.0)
    kinds: list[list[Asked]] = [
        [(inner, [np.stack([y**2, y**3], axis=1) for y in shapes])],
        [(inner, [_turns(y)[:, None] for y in shapes])],
    ]
    if turns(np.concatenate(fitted)):
        kinds.append([(inner, [np.sign(one)[:, None] for one in fitted])])
    kinds += _within(view, output, estimate)
    powers: list[Asked] = []
    limited: list[Asked] = []
    rates: list[Asked] = []
    plays: list[Asked] = []
    scheduled: list[Asked] = []
    for j in range(records[0].n_inputs):
        own = _channel(estimate, output, j)
        recorded = [np.asarray(record.u[:, j]) for record in records]
        u = _scaled(recorded)
        powers.append((own, [np.stack([x**2, x**3], axis=1) for x in u]))
        if np.unique(np.concatenate(u)).size >= LEVELS:
            limited.append((own, _limits(u, INPUT_TAILS)))
            rates.append((own, _behind(recorded)))
        products = [(x * y)[:, None] for x, y in zip(u, shapes, strict=True)]
        scheduled.append((own, products))
        taken = taken_by_gaps(recorded)
        plays += [] if taken is None else [(own, taken)]
    kinds += [several for several in (powers, limited, rates, plays, scheduled) if several]
    driven = iter(_through([one for kind in kinds for one in kind], records))
    found = [_beside([next(driven) for _ in kind]) for kind in kinds]
    return [*found[:2], _limits(shapes, TAILS), *found[2:]]


def _within(view: View, output: int, estimate: Estimate) -> list[list[Asked]]:
    """What takes hold of a motion within the model, state by state, wherever it comes out."""
    found: list[list[Asked]] = []
    for j in range(view.records[0].n_inputs):
        own = _channel(estimate, output, j)
        ways = [Channel(np.eye(k + 1)[0], own.den, 0.0) for k in range(len(own.den) - 1)]
        for state in inner_states(own.den, own.delay, view.records, j):
            held = [one[:, None] for one in gripping(state)]
            found.append([(way, held) for way in ways])
    return found


def late(view: View, output: int, estimate: Estimate) -> list[Columns]:
    """The fitted output, and the response to each of several inputs, some samples later.

    Parameters
    ----------
    view : View
    output : int
    estimate : Estimate

    Returns
    -------
    list of tuples of (n_samples, k) arrays
        Per kind, one array per experiment.
    """
    shortest = min(record.n_samples for record in view.records)
    few, many = ([k for k in one if k * LEAST_LEFT <= shortest] for one in (FEW_SHIFTS, SHIFTS))
    fitted = [filled(one) for one in view.outputs[output].fitted]
    found = [tuple(_later(one, shifts) for one in fitted) for shifts in (few, many)]
    n_inputs = view.records[0].n_inputs
    if n_inputs == 1:
        return found
    asked = [
        (_channel(estimate, output, j), [np.asarray(record.u[:, [j]]) for record in view.records])
        for j in range(n_inputs)
    ]
    moved = _through(asked, view.records)
    return [*found, _beside([tuple(_later(one[:, 0], few) for one in own) for own in moved])]


def _later(series: Array, shifts: Sequence[int]) -> Array:
    rows = np.arange(series.size)[:, None] - np.array(shifts, dtype=int)
    return np.asarray(series[np.maximum(rows, 0)])


def _channel(estimate: Estimate, output: int, j: int) -> Channel:
    model = estimate.model
    late_by = float(model.delay[output, j])
    return Channel(model.num[output][j], model.den[output][j], late_by)


def _scaled(series: Sequence[Array]) -> list[Array]:
    """About their common mean, over their common standard deviation."""
    joined = np.concatenate(series)
    middle = joined.mean()
    off = joined - middle
    size = float(np.sqrt(np.mean(off * off))) or 1.0
    return [(one - middle) / size for one in series]


def _through(asked: Sequence[Asked], records: Sequence[Record]) -> list[Columns]:
    """Responses from rest, those over one denominator and delay in one simulation."""
    together: dict[tuple[bytes, float], list[int]] = {}
    for k, (model, _) in enumerate(asked):
        together.setdefault((model.den.tobytes(), model.delay), []).append(k)
    found: list[list[Array]] = [[] for _ in asked]
    for e, record in enumerate(records):
        own = record._on_its_times(record.u)
        for same in together.values():
            models, inputs = zip(*((asked[k][0], asked[k][1][e]) for k in same), strict=True)
            widths = [one.shape[1] for one in inputs]
            nums = [m.num for m, width in zip(models, widths, strict=True) for _ in range(width)]
            columns = np.hstack(inputs)
            first = models[0]
            driven = simulate_each(nums, first.den, first.delay, own, columns - columns[0])
            for k, one in zip(same, np.split(driven, np.cumsum(widths)[:-1], axis=1), strict=True):
                found[k].append(one)
    return [tuple(one) for one in found]


def _turns(y: Array) -> Array:
    """The sign of the slope: of the central difference, at the ends of the one beside."""
    slope = np.empty(y.size)
    slope[1:-1], slope[0], slope[-1] = y[2:] - y[:-2], y[1] - y[0], y[-1] - y[-2]
    return np.sign(slope)


def _limits(series: Sequence[Array], tails: Sequence[float]) -> Columns:
    """What lies beyond quantiles on either side."""
    joined = np.concatenate(series)
    low, high = np.split(quantiles(joined, [*tails, *(1.0 - one for one in tails)]), 2)
    return tuple(
        np.hstack([np.minimum(x[:, None] - low, 0.0), np.maximum(x[:, None] - high, 0.0)])
        for x in series
    )


def _behind(series: Sequence[Array]) -> Columns:
    """How far what follows an input at a limited rate is behind."""
    size = float(np.ptp(np.concatenate(series)))
    return tuple(
        np.stack([following(one, size / k, held=False) - one for k in RATES], axis=1)
        for one in series
    )


def _beside(several: Sequence[Columns]) -> Columns:
    return tuple(np.hstack(one) for one in zip(*several, strict=True))
