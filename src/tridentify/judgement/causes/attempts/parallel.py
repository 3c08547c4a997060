"""The parallel model of a record: operators at one rate, fitted by linear least squares.

Laguerre functions at a rate explain the response of any stable system the better the more of them
there are, and Kautz functions on a pair of poles that of one with a resonance there; nothing is
searched but the rate or the damping, on a grid, and how many, by AICc. That is enough
to say what the noise is, and then whether a delay, a drift, another behaviour of the input between
its samples or samples of the future explain more than noise would let them (`-2 log L` and F).

All columns are explicit: operators of the (delayed) input, impulse responses of the operators for
the state at the beginning, an offset. They are whitened by an autoregressive model of what the
first fit leaves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from scipy.special import fdtrc

from tridentify.models.operators import Kautz, Laguerre, apply_operators
from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.autoregression import Whitener, fit_autoregression, most_coefficients
from tridentify.numerics.least_squares import triangle
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record

RATES = 9
"""Rates that are tried, from three over the record to one over three samples."""

SLOWEST, FASTEST = 3.0, 0.35
"""The first rate times the duration, and the last times the sampling interval."""

ENDLESS = 1e-3
"""Rate, times the duration, of an operator that is an integrator over the record."""

ORDERS = (1, 2, 3, 4, 6, 8)
"""Numbers of operators."""

DAMPINGS = (0.5, 0.2, 0.05, 0.015)
"""Of the pairs of poles that are tried where the measured response is largest."""

STATES = 4
"""Impulse responses for the state at the beginning: slower ones than the operators have go into
offset and drift."""

MOST_NOISE = 20
"""Coefficients of the noise, at most."""

PARALLEL_CUTOFF = 1e-9
"""Column, beside those before it, that counts as nothing."""


@dataclass(frozen=True, eq=False)
class WhitenedFit:
    """Linear least squares on whitened columns.

    Attributes
    ----------
    deviance : float
        ``-2 log L`` up to a constant.
    rank, count : int
        Unknowns; samples.
    rss : float
    fitted : tuple of (n_samples,) arrays
        Response in the units of the output, one a record.
    pole, order : complex, int
        Of the operators: a real one [1/s] or one of a pair, and how many.
    """

    deviance: float
    rank: int
    count: int
    rss: float
    fitted: tuple[Array, ...] = ()
    pole: complex = -1.0
    order: int = 1

    @property
    def criterion(self) -> float:
        """AICc."""
        k = self.rank + 1.0
        return self.deviance + 2.0 * k * self.count / max(self.count - k - 1.0, 0.5)


def p_value(small: WhitenedFit, large: WhitenedFit) -> float:
    """Chance that noise alone makes the larger model so much better.

    Examples
    --------
    >>> round(p_value(WhitenedFit(0.0, 1, 100, 100.0), WhitenedFit(0.0, 2, 100, 90.0)), 5)
    0.00135
    """
    more, left = large.rank - small.rank, large.count - large.rank
    if more < 1 or left < 1:
        return 1.0
    ratio = (small.rss - large.rss) / more / max(large.rss / left, 1e-300)
    return float(fdtrc(more, left, max(ratio, 0.0)))


@dataclass(frozen=True, eq=False)
class Parallel:
    """One output of records and what its columns are made of.

    Attributes
    ----------
    records : tuple of Record
    output : int
    delays : tuple of float
        Of the inputs [s].
    noise : (p,) array
        Autoregressive coefficients.
    drift : bool
        Whether a ramp goes along.
    left : float
        Time after the beginning that is not explained [s], so that all delays are compared on the
        same samples.
    resonance : float
        Where the response is largest [rad/s]; 0 where that is not known.
    direct : bool
        Whether the inputs themselves stand beside the operators, which have no direct part.
    integrator : bool
        Whether the inputs through an integrator stand beside the operators, which are stable.
    """

    records: tuple[Record, ...]
    output: int
    delays: tuple[float, ...]
    noise: Array
    drift: bool = False
    left: float = 0.0
    resonance: float = 0.0
    direct: bool = False
    integrator: bool = False
    _columns: dict[object, Array] = field(default_factory=dict)

    @classmethod
    def of(
        cls, records: Sequence[Record], output: int, resonance: float = 0.0, *, direct: bool = False
    ) -> Parallel:
        """Without delays, the noise taken for white."""
        none = (0.0,) * records[0].n_inputs
        return cls(tuple(records), output, none, np.zeros(0), resonance=resonance, direct=direct)

    def changed(self, **fields: object) -> Parallel:
        """With other fields; operators that stay the same are kept."""
        kept = {} if "records" in fields else self._columns
        return replace(self, **({"_columns": kept} | fields))  # type: ignore[arg-type]

    def poles(self) -> list[complex]:
        """Poles to be tried [1/s]."""
        first = self.records[0]
        step = typical_step(first.t) if first.dt is None else first.dt
        longest = max(record.duration for record in self.records)
        fastest = max(FASTEST / step, 3 * SLOWEST / longest)
        found = [complex(-rate) for rate in np.geomspace(SLOWEST / longest, fastest, RATES)]
        if self.resonance:
            turns = [complex(-z, math.sqrt(1.0 - z * z)) for z in DAMPINGS]
            found += [self.resonance * turn for turn in turns]
        return found

    def best(self, orders: Sequence[int] = ORDERS, extra: Sequence[Array] = ()) -> WhitenedFit:
        """The fit of lowest AICc over poles and numbers of operators."""
        fits = [fit for pole in self.poles() for fit in self.fits(pole, orders, extra)]
        return min(fits, key=lambda fit: fit.criterion)

    def fits(
        self, pole: complex, orders: Sequence[int], extra: Sequence[Array] = ()
    ) -> list[WhitenedFit]:
        """Fits on one pole, for every number of operators.

        Parameters
        ----------
        pole : complex
            [1/s].
        orders : sequence of int
            Increasing; none may be 0.
        extra : sequence of (n_samples, k) arrays
            More columns, one array a record.
        """
        blocks = [self.record_columns(e, pole, max(orders)) for e in range(len(self.records))]
        widths = [own.shape[1] for own, _ in blocks]
        n_inputs = self.records[0].n_inputs
        rows, targets, plain, scale = [], [], [], 0.0
        for e, (own, operators) in enumerate(blocks):
            n = own.shape[0]
            before, after = sum(widths[:e]), sum(widths[e + 1 :])
            own = np.hstack([np.zeros((n, before)), own, np.zeros((n, after))])
            added = extra[e] if extra else np.zeros((n, 0))
            beside = np.hstack([self._at_once(e), self._summed(e)])
            whole = np.hstack([own, added, beside, operators.reshape(n, -1)])
            y, seen = self.target(e)
            whitener = Whitener(self.noise, whole.shape[1] + 1)
            joined = np.ascontiguousarray(np.column_stack([whole, y]).T)
            white = whitener.apply(joined, seen).T
            scale += whitener.log_scale
            rows.append(white[seen, :-1])
            targets.append(white[seen, -1])
            plain.append(whole)
        first = sum(widths) + (extra[0].shape[1] if extra else 0) + beside.shape[1]
        target = np.concatenate(targets)
        # fewer operators are leading columns: one triangle holds the fits of all numbers of them
        reduced = triangle(np.column_stack([np.vstack(rows), target]))
        found = []
        for order in orders:
            width = first + n_inputs * order
            solution, rank, rss = _least_squares(reduced[:, :width], reduced[:, -1])
            fitted = tuple(part[:, :width] @ solution for part in plain)
            found.append(_fit(rss, rank, target.size, scale, fitted, pole, order))
        return found

    def without_inputs(self) -> WhitenedFit:
        """Offset, state at the beginning and drift alone, on the best pole for them."""
        fits = []
        for pole in self.poles():
            blocks = [self.record_columns(e, pole, 1)[0] for e in range(len(self.records))]
            fits.append(self._alone(blocks, pole))
        return min(fits, key=lambda fit: fit.criterion)

    def _alone(self, blocks: Sequence[Array], pole: complex) -> WhitenedFit:
        rows, targets, scale = [], [], 0.0
        for e, own in enumerate(blocks):
            y, seen = self.target(e)
            whitener = Whitener(self.noise, own.shape[1] + 1)
            white = whitener.apply(np.ascontiguousarray(np.column_stack([own, y]).T), seen).T
            scale += whitener.log_scale
            rows.append(white[seen, :-1])
            targets.append(white[seen, -1])
        columns = [np.asarray(part) for part in scipy.linalg.block_diag(*rows)]
        matrix, target = np.asarray(columns), np.concatenate(targets)
        _, rank, rss = _least_squares(matrix, target)
        return _fit(rss, rank, target.size, scale, (), pole, 0)

    def target(self, e: int) -> tuple[Array, Flags]:
        """Output with zeros where it is missing or comes too early, and where it is there."""
        record = self.records[e]
        y = record.y[:, self.output]
        seen = np.isfinite(y) & (record.t - record.t[0] >= self.left)
        return np.where(seen, y, 0.0), np.ascontiguousarray(seen)

    def _at_once(self, e: int) -> Array:
        """(n_samples, k) the inputs that an output follows at once, delayed as they are."""
        record = self.records[e]
        if not self.direct:
            return np.zeros((record.n_samples, 0))
        since = record.t - record.t[0]
        moved = record.u - record.u[0]
        pairs = zip(self.delays, moved.T, strict=True)
        return np.column_stack([np.interp(since - late, since, one) for late, one in pairs])

    def _summed(self, e: int) -> Array:
        """(n_samples, k) the inputs through an integrator, which has no level to rest at."""
        record = self.records[e]
        if not self.integrator:
            return np.zeros((record.n_samples, 0))
        endless = Laguerre(ENDLESS / record.duration, 1)
        return apply_operators(endless, _inputs(record, 0.0))[:, :, 0]

    def record_columns(self, e: int, pole: complex, order: int) -> tuple[Array, Array]:
        """Columns of one record's own, (n, k), and its operators, (n, order, n_inputs).

        Parameters
        ----------
        e : int
            Which record.
        pole : complex
            Of the operators [1/s].
        order : int
            How many.
        """
        record = self.records[e]
        since = record.t - record.t[0]
        key = (e, pole)
        known = self._columns.get(key)
        if known is None or known.shape[1] < order:
            bank = Kautz(pole, (order + 1) // 2) if pole.imag else Laguerre(-pole.real, order)
            known = apply_operators(bank, _inputs(record, record.u[0])).transpose(0, 2, 1)
            self._columns[key] = known
        operators = known[:, :order].copy()
        for j, delay in enumerate(self.delays):
            if delay:
                for k in range(order):
                    operators[:, k, j] = np.interp(since - delay, since, known[:, k, j], left=0.0)
        own = [np.ones_like(since), *_beginnings(np.maximum(since - self.left, 0.0), pole)]
        if self.drift:
            own.append(since / since[-1] - 0.5)
        return np.column_stack(own), operators


def _inputs(record: Record, level: Array | float) -> Record:
    """The inputs about a level, and no output."""
    return Record(
        record.u - level,
        np.zeros(record.n_samples),
        **({"t": record.t - record.t[0]} if record.dt is None else {"dt": record.dt}),
        intersample=record.behaviour,
    )


def _beginnings(late: Array, pole: complex) -> list[Array]:
    """Responses to the state at the beginning."""
    decay = np.exp(pole.real * late)
    if pole.imag:
        turning = [decay * np.cos(pole.imag * late), decay * np.sin(pole.imag * late)]
        scaled = -pole.real * late
        return [*turning, *(scaled * one for one in turning)]
    return [(-pole.real * late) ** k * decay for k in range(STATES)]


def _fit(
    rss: float,
    rank: int,
    count: int,
    scale: float,
    fitted: tuple[Array, ...],
    pole: complex,
    order: int,
) -> WhitenedFit:
    deviance = count * math.log(max(rss, 1e-300) / count) + scale
    return WhitenedFit(deviance, rank, count, rss, fitted, pole, order)


def _least_squares(matrix: Array, target: Array) -> tuple[Array, int, float]:
    """Solution, rank and sum of squares left, with columns of one length."""
    norms = np.linalg.norm(matrix, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    solution, _, rank, _ = np.linalg.lstsq(matrix / norms, target, rcond=PARALLEL_CUTOFF)
    solution = solution / norms
    return solution, int(rank), float(np.sum((target - matrix @ solution) ** 2))


def with_noise_model(parallel: Parallel) -> tuple[Parallel, WhitenedFit]:
    """Whiten by what the best fit leaves, and fit again.

    Parameters
    ----------
    parallel : Parallel
        With the noise to begin with: none takes it for white.

    Returns
    -------
    Parallel
    WhitenedFit
    """
    fitted = parallel.best().fitted
    pairs = zip(parallel.records, fitted, strict=True)
    left = [record.y[:, parallel.output] - one for record, one in pairs]
    coloured = parallel.changed(noise=residual_noise(parallel, left))
    return coloured, coloured.best()


def residual_noise(parallel: Parallel, left: Sequence[Array]) -> Array:
    """Autoregressive coefficients of what is left of the output.

    Parameters
    ----------
    parallel : Parallel
    left : sequence of (n_samples,) arrays
        One a record; ``nan`` where it is missing.
    """
    series = [
        np.where(record.t - record.t[0] >= parallel.left, one, np.nan)
        for record, one in zip(parallel.records, left, strict=True)
    ]
    seen = [one[np.flatnonzero(np.isfinite(one))[0] :] for one in series]
    count = sum(int(np.isfinite(one).sum()) for one in seen)
    return fit_autoregression(seen, min(most_coefficients(count), MOST_NOISE))
