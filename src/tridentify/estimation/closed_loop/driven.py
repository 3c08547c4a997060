"""Step 1 in closed loop: what the reference makes of inputs and outputs, without the noise.

In a loop ``u = S r - C S v`` and ``y = G S r + S v``: input and output both carry the noise ``v``,
filtered by the loop. The reference does not. So the parallel model of Step 1, driven by the
reference and fitted to *every* recorded signal ``s``,

    s_M(t) = sum_i beta_i W_i(p) r(t) + d r(t) + constant,

has regressors without noise and finds the part of ``s`` that the reference drives, whatever
controller and noise are: for a controller that is not linear, or that works on samples, the part
that is linear in ``r``. It is a function of continuous time.

Operators are Laguerre functions. Rate and number are those of the lowest AICc of all signals
together, where the residual of each is taken as white: the signals that are wanted here need not be
complete, as what the model leaves of ``u`` is not lost (`between_samples`). Between the samples it
is: where the input counts there too, operators with the poles of the loop itself (`own_poles`) take
the place of Laguerre functions, of which a loop that swings needs dozens, if their AICc is lower.

References: P. Van den Hof & R. Schrama, Automatica 29 (1993) 1523-1527, fit the map from reference
to input in a first stage of its own. U. Forssell & L. Ljung, Automatica 36 (2000) 1357-1364.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tridentify.estimation.closed_loop.cheapest import TOLD_APART, cheapest
from tridentify.estimation.closed_loop.own_poles import own_poles
from tridentify.estimation.likelihood.thresholds import CLEARLY
from tridentify.models.regression import Experiment, response_of
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import (
    fit_autoregression,
    most_coefficients,
)
from tridentify.numerics.interpolation import between
from tridentify.numerics.realization import cascade
from tridentify.record.checks.rates import evaluated
from tridentify.record.record import Record

MOST_FUNCTIONS = 16
"""Most operators on each reference: a loop of plant and controller of order 8, twice over."""
PER_DECADE = 3.0
"""Rates in a decade, as in `search.starts`: neighbours are a factor of two apart."""
SLOW_EDGE = 3.0
"""Slowest rate times length of the record: it decays to 5 % within it."""
FAST_EDGE = 1.0
"""Fastest rate times sampling interval: that of the fastest loops; of faster operators the samples
show no shape, and they are hardly told apart."""
BESIDE = (0.5, 2.0, 4.0, 8.0)
"""Rates over that of a description, of those whose distances from it tell how far it may be off:
loops that are over within a sample are faster than any rate that is tried."""
COARSE = 0.3
"""Rate of the loop times sampling interval from which what a continuous controller does between the
samples counts: standard errors are then a fifth too small and more."""
MOST_OWN = 8
"""Poles of the loop, as `MOST_FUNCTIONS` has them."""
STARTS = 3
"""Laguerre functions of so many rates, from which these are found: of a short record the cheapest
may be far from them."""
MOST_COLOUR = 10
"""Coefficients of a model of what is left of a signal."""
ROUNDS = 3
"""Of operators and their poles in turn: the third moves them by less than their errors."""


@dataclass(frozen=True, eq=False)
class Driven:
    """What the references of one record drive.

    Attributes
    ----------
    record : Record
    poles : (order,) complex array
        Of the operators on each reference [rad/s].
    before : (n_references,) array
        What the references were before the record.
    weights : (n_columns, n_inputs + n_outputs) array
        Of the columns: a constant, the references, their operators.
    columns : (n_samples, n_columns) array
        At the samples.
    noise : (n_samples, n_outputs) array, optional
        Beside which the weights were found, where they were (`noise_driven`).
    about : float, optional
        Rate of the Laguerre functions in whose place these operators stand [rad/s].
    """

    record: Record
    poles: Complex
    before: Array
    weights: Array
    columns: Array
    noise: Array | None = None
    about: float | None = None

    @property
    def rate(self) -> float:
        """Of the Laguerre functions, or of those in whose place the operators stand [rad/s]."""
        return self.fastest if self.about is None else self.about

    @property
    def fastest(self) -> float:
        """Of all operators [rad/s]."""
        return float(np.max(np.abs(self.poles)))

    def repeated(self, order: int) -> Complex:
        """So many poles of the operators, from the first on and again; no pair is torn apart."""
        often = -(-order // self.order)
        poles = np.tile(self.poles, often)
        torn = poles[order - 1].imag > 0.0
        return poles[: order + torn]

    @property
    def order(self) -> int:
        """Operators on each reference."""
        return self.poles.size

    @property
    def words(self) -> str:
        """How it was found, as it is told."""
        return f"{self.order} operators on each reference"

    @property
    def inputs(self) -> Array:
        """(n_samples, n_inputs) part of the inputs that the references drive, at the samples."""
        return self.columns @ self.weights[:, : self.record.n_inputs]

    @property
    def outputs(self) -> Array:
        """(n_samples, n_outputs) part of the outputs that the references drive."""
        return self.columns @ self.weights[:, self.record.n_inputs :]

    def inputs_between(self, pieces: int) -> Array:
        """(pieces * n_samples, n_inputs) means of the driven inputs over pieces of every interval.

        Examples
        --------
        >>> r = np.repeat([0.0, 1.0], 40)
        >>> part = driven(Record(2.0 * r, r, dt=0.1, reference=r))
        >>> part.inputs_between(2)[[0, -1], 0].round(9).tolist()
        [0.0, 2.0]
        """
        return self.means(pieces, slice(0, self.record.n_inputs))

    def means(self, pieces: int, signals: slice) -> Array:
        """(pieces * n_samples, k) means of driven signals over equal pieces of every interval.

        By Simpson's rule on the ends and the middle of each piece. At a jump of a held reference
        the driven input jumps, and the rule takes the value after it.

        Parameters
        ----------
        pieces : int
            In an interval; the last one is as long as the one before.
        signals : slice
            Of inputs and outputs.
        """
        halves = 2 * pieces
        fine = refined(self.record, self.before, halves)
        states = operators(fine, self.poles)
        after, before = _sides(self.before, fine)
        right = columns_of(after, states[:-1]) @ self.weights[:, signals]
        left = columns_of(before, states[1:]) @ self.weights[:, signals]
        # piece k: from node 2 k over 2 k + 1 to 2 k + 2
        return np.asarray((right[0::2] + 2.0 * (left[0::2] + right[1::2]) + left[1::2]) / 6.0)


def driven(record: Record, *, between: bool = False, own: bool = False) -> Driven:
    """Fit the parallel model that the references drive to inputs and outputs.

    Parameters
    ----------
    record : Record
        With at least one reference.
    between : bool
        Whether the signals count between the samples too (`shown_by_samples`).
    own : bool
        Whether the poles of the loop are sought without that, too.

    Returns
    -------
    Driven
    """
    direct = np.asarray(record.reference)
    most = _affordable(record)
    found: list[_Described] = []
    for before in befores(direct):
        experiment = starting(record, before)
        for rate in _rates(record):
            count = min(most, shown_by_samples(rate * experiment.dt)) if between else most
            found.append(_Described.of(record, before, laguerre(rate, count), 1))
    found.sort(key=lambda one: one.criterion)
    best = found[0].part
    if between or own:
        begun = [one for one in found if np.array_equal(one.before, best.before)]
        colours = colours_of(best)
        lowest = _Described.of(record, best.before, best.poles, 1, colours).criterion
        for one in begun[:STARTS]:
            for criterion, part in _by_own_poles(one.part, most, colours):
                if criterion < lowest:
                    lowest, best = criterion, part
    return best


@dataclass(frozen=True, eq=False)
class _Described:
    """As many of some operators as have the lowest AICc."""

    record: Record
    before: Array
    poles: Complex
    columns: Array
    criterion: float

    @classmethod
    def of(
        cls,
        record: Record,
        before: Array,
        poles: Complex,
        each: int,
        colours: Sequence[Array] | None = None,
    ) -> _Described:
        """Of operators with these poles, so many of which are taken together."""
        direct, references = np.asarray(record.reference), record.n_references
        signals = np.column_stack([record.u, record.y])
        states = operators(starting(record, before), poles)
        whole = columns_of(direct, states)
        criterion, order = cheapest(whole, signals, references, poles.size, each, colours)
        columns = columns_of(direct, states[:, _first(order, poles.size, references)])
        return cls(record, before, poles[:order], columns, criterion)

    @cached_property
    def part(self) -> Driven:
        """With their weights."""
        signals = np.column_stack([self.record.u, self.record.y])
        weights = fitted(self.columns, signals)
        return Driven(self.record, self.poles, self.before, weights, self.columns)


def colours_of(part: Driven) -> list[Array]:
    """Autoregressive coefficients of what is left of each signal.

    What a controller that integrates makes of noise is slow; taken as white it would pay for modes.
    """
    left = np.column_stack([part.record.u, part.record.y]) - part.columns @ part.weights
    fewest = int(np.isfinite(left).sum(axis=0).min())
    most = min(MOST_COLOUR, most_coefficients(fewest))
    return [fit_autoregression([one - np.nanmean(one)], most) for one in left.T]


def _by_own_poles(part: Driven, most: int, colours: Sequence[Array]) -> list[tuple[float, Driven]]:
    """With poles of the loop, as often as it pays, and AICc, for every number of them.

    Parameters
    ----------
    part : Driven
        From which the poles are found.
    most : int
        Operators.
    colours : sequence of arrays
        Of what is left of each signal.
    """
    record = part.record
    signals, step = np.column_stack([record.u, record.y]), starting(record, part.before).dt
    found = []
    for count in range(1, min(most, MOST_OWN) + 1):
        current = part
        for _ in range(ROUNDS):
            left = signals - current.columns @ current.weights
            levels = np.sqrt(np.nanmean(left**2, axis=0)) + 1e-300
            weights = current.weights[1 + record.n_references :] / levels
            poles = own_poles(current.poles, weights, count, record.duration, step)
            often = 0 if poles is None else min(most, _shown(poles, step)) // count
            if poles is None or not often:
                break
            own = np.tile(poles, often)
            following = _Described.of(record, part.before, own, count, colours)
            current = replace(following.part, about=part.rate)
            # its poles were sought, too, among many: modes of the noise must not pay
            price = float(np.log(record.n_samples)) * count
            found.append((following.criterion + price, current))
    return found


def _shown(poles: Complex, step: float) -> int:
    """As `shown_by_samples`, of some poles in turn."""
    each = float(np.mean(np.arctan(np.abs(poles) * step / np.pi)))
    return max(1, int(np.pi / (2.0 * each)))


def shown_by_samples(step: float) -> int:
    """Most operators that samples determine between the samples too.

    An operator turns the phase by ``2 arctan(w / rate)``; what turns above the Nyquist frequency is
    not seen at the samples, and half a turn there is a function that may swing between them.

    Parameters
    ----------
    step : float
        Rate times sampling interval.

    Examples
    --------
    >>> shown_by_samples(0.05), shown_by_samples(0.5), shown_by_samples(2.0)
    (98, 9, 2)
    """
    return max(1, int(np.pi / (2.0 * np.arctan(step / np.pi))))


def befores(reference: Array) -> list[Array]:
    """What the references may have been before the record: as at its start for long, or nothing."""
    first = np.array(reference[0])
    return [first, np.zeros_like(first)] if np.any(first) else [first]


def widest(record: Record, rate: float, before: Array, most: int = MOST_FUNCTIONS) -> Driven:
    """With all operators of a rate that the samples determine between them too, up to so many.

    Parameters
    ----------
    record : Record
    rate : float
        [rad/s].
    before : (n_references,) array
    most : int
    """
    step = float(np.median(np.diff(record.t)))
    order = min(_affordable(record), shown_by_samples(rate * step), most)
    columns = columns_of(
        np.asarray(record.reference), operators(starting(record, before), laguerre(rate, order))
    )
    weights = fitted(columns, np.column_stack([record.u, record.y]))
    return Driven(record, laguerre(rate, order), before, weights, columns)


def described_otherwise(part: Driven) -> list[Driven]:
    """Operators of slower and of faster rates, where they explain the inputs as well.

    They pass through the same samples. Where a loop is slow beside these they agree between them
    too; where it is fast, they are as far from each other as from what was there. One that misses
    the samples is none, nor is any where a part of a slow loop was told apart from the noise: it
    is known better than they are. The part itself then takes their place.
    """
    step = float(np.median(np.diff(part.record.t)))
    if part.noise is not None and part.rate * step <= COARSE:
        return [part] * len(BESIDE)
    own = part if part.about else widest(part.record, part.rate, part.before)
    others = [widest(part.record, rate * part.rate, part.before) for rate in BESIDE]
    return [one if _as_good(one, own) else part for one in others]


def _as_good(one: Driven, other: Driven) -> bool:
    """Whether a description explains the inputs as well as another, but for operators it lacks."""
    u = one.record.u
    ratio = np.sum((u - one.inputs) ** 2, axis=0) / np.sum((u - other.inputs) ** 2, axis=0)
    lacking = max(other.columns.shape[1] - one.columns.shape[1], 0) * u.shape[1]
    return bool(len(u) * np.sum(np.log(ratio)) < 2.0 * lacking + CLEARLY)


def near(part: Driven, most: int) -> list[Driven]:
    """`widest` of rates up to four times as slow and as fast, and of all that may have been before.

    The one of the same rate and the same before is the first.
    """
    rates = [rate for rate in _rates(part.record) if 0.2 < rate / part.rate < 5.0]
    found = [
        widest(part.record, rate, before, most)
        for rate in sorted(rates, key=lambda one: abs(np.log(one / part.rate)))
        for before in befores(np.asarray(part.record.reference))
    ]
    return sorted(found, key=lambda one: one.rate != part.rate or (one.before != part.before).any())


def laguerre(rate: float, order: int) -> Complex:
    """Poles of Laguerre functions."""
    return np.full(order, -rate, dtype=np.complex128)


def operators(experiment: Experiment, poles: Complex) -> Array:
    """(n_samples, order * n_references) orthonormal ones on every reference, at the samples."""
    bank, order = cascade(poles), poles.size
    n_references = experiment.u.shape[1]
    n_signals = order * n_references + n_references
    rows = np.eye(order * n_references, n_signals)
    return response_of(experiment, bank, rows, outputs=[0] * len(rows))


def starting(record: Record, before: Array) -> Experiment:
    """The references of a record, from what they were before it."""
    return Experiment(
        np.ascontiguousarray(np.asarray(record.reference) - before),
        np.zeros((record.n_samples, 1)),
        float(np.median(np.diff(record.t))) if record.dt is None else record.dt,
        str(record.reference_behaviour),
        free=False,
        offset=False,
        drift=False,
        t=record.t - record.t[0] if record.dt is None else None,
    )


def refined(record: Record, before: Array, factor: int) -> Experiment:
    """The references on a raster so many times as fine, one interval longer."""
    coarse, steps = starting(record, before), np.arange(record.n_samples * factor + 1)
    if coarse.t is not None:
        gaps = np.append(np.diff(coarse.t), coarse.t[-1] - coarse.t[-2])
        own = (coarse.t[:, None] + gaps[:, None] * np.arange(factor) / factor).ravel()
        t = np.append(own, coarse.t[-1] + gaps[-1])
        fine = replace(coarse, t=t)
    else:
        t = steps * (coarse.dt / factor)
        fine = replace(coarse, dt=coarse.dt / factor)
    base = coarse.instants
    if coarse.intersample == "zoh":
        values = coarse.u[np.minimum(steps // factor, record.n_samples - 1)]
    elif coarse.intersample == "foh":
        values = evaluated(base, coarse.u, np.minimum(t, base[-1]), "foh")
    else:
        inner = np.hstack(
            [
                between(np.ascontiguousarray(one), np.arange(factor) / factor).reshape(-1, 1)
                for one in coarse.u.T
            ]
        )
        values = np.vstack([inner, inner[-1:]])
    return replace(fine, u=np.ascontiguousarray(values), y=np.zeros((t.size, 1)))


def _sides(before: Array, fine: Experiment) -> tuple[Array, Array]:
    """References just after the first and just before the last node of every half piece."""
    after = fine.u[:-1] + before
    return after, after if fine.intersample == "zoh" else fine.u[1:] + before


def columns_of(direct: Array, states: Array) -> Array:
    """Columns at the samples: a constant, the references, their operators."""
    return np.hstack([np.ones((len(states), 1)), direct, states])


def _rates(record: Record) -> Array:
    step = record.dt if record.dt is not None else float(np.median(np.diff(record.t)))
    low, high = SLOW_EDGE / record.duration, FAST_EDGE / step
    count = max(2, int(np.ceil(PER_DECADE * np.log10(high / low))) + 1)
    return np.geomspace(low, high, count)


def _affordable(record: Record) -> int:
    """Operators that leave at least ten samples each."""
    each = record.n_samples // (10 * record.n_references)
    return int(np.clip(each, 1, MOST_FUNCTIONS))


def _first(order: int, most: int, n_references: int) -> Array:
    """Positions of the first operators of every reference."""
    return np.concatenate([k * most + np.arange(order) for k in range(n_references)])


def fitted(columns: Array, signals: Array) -> Array:
    """(n_columns, n_signals) weights of columns by least squares; samples that are missing are out.

    Parameters
    ----------
    columns : (n_samples, n_columns) array
    signals : (n_samples, n_signals) array
    """
    norms = np.linalg.norm(columns, axis=0)
    scale = np.where(norms > 0, norms, 1.0)
    found = np.empty((columns.shape[1], signals.shape[1]))
    seen = np.isfinite(signals)
    whole = np.flatnonzero(seen.all(axis=0))
    alone = np.flatnonzero(~seen.all(axis=0))
    # one decomposition for all signals without gaps
    for which in (whole, *alone[:, np.newaxis]):
        if which.size:
            rows = np.flatnonzero(seen[:, which].all(axis=1))
            wanted = signals[rows][:, which]
            solved = np.linalg.lstsq(columns[rows] / scale, wanted, rcond=TOLD_APART)[0]
            found[:, which] = solved / scale[:, np.newaxis]
    return found
