"""Spectra of uninterrupted stretches of a record: what a frequency response is measured from.

A gap in the outputs, or in the time stamps, would spread every frequency over all others. Gaps of
a few samples are bridged by straight lines; at longer ones the record is cut, and each stretch has
a beginning of its own. An uneven time axis is brought onto an even one within each stretch.

The spectrum of an input is that of the signal that acted, not that of its samples: one that is held
for ``T`` has ``sinc(omega T / 2) exp(-i omega T / 2)`` of them, one of straight lines
``sinc(omega T / 2)^2`` (sinc x = sin x / x).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.numerics.arrays import Array, Complex
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record

BRIDGED = 4
"""Missing samples in a row that a straight line replaces; it hides little of what is sampled well
enough to be identified."""

TORN = 3.0
"""Interval between samples, in typical ones, at which the record is cut."""

SHORTEST = 32
"""Samples of a stretch: fewer have too few lines to tell a response from a beginning."""

BELOW_NYQUIST = 0.5
"""Share of the Nyquist frequency up to which lines are used: there a system of relative degree two
behind a held input has folded back by less than 4 %."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """The spectra of one stretch, for one output.

    Attributes
    ----------
    omega : (n_lines,) array
        Lines [rad/s], the one at zero left out.
    inputs : (n_lines, n_inputs) complex array
        Of the signals that acted.
    output, ramp : (n_lines,) complex array
        Of the output and of a drift.
    step : float
        Sampling interval [s].
    """

    omega: Array
    inputs: Complex
    output: Complex
    ramp: Complex
    step: float


@dataclass(frozen=True, eq=False)
class Told:
    """What was done to the samples.

    Attributes
    ----------
    bridged, dropped : int
        Samples replaced by straight lines; samples left out.
    """

    bridged: int = 0
    dropped: int = 0


def stretches(records: Sequence[Record], output: int) -> tuple[list[Stretch], Told]:
    """Cut records at their gaps and transform what remains.

    Parameters
    ----------
    records : sequence of Record
    output : int
        Position of the output.

    Returns
    -------
    list of Stretch
    Told

    Examples
    --------
    >>> y = np.sin(np.arange(100.0))
    >>> y[50:60] = np.nan
    >>> found, told = stretches([Record(np.ones(100), y, dt=1.0)], 0)
    >>> len(found), told.dropped
    (2, 10)
    """
    found: list[Stretch] = []
    bridged = dropped = 0
    for record in records:
        y, t = record.y[:, output], record.t
        step = typical_step(t) if record.dt is None else record.dt
        there = np.flatnonzero(np.isfinite(y))
        wide = np.diff(there) > BRIDGED + 1
        torn = np.diff(t[there]) > (BRIDGED + TORN) * step
        kept = 0
        for part in np.split(there, np.flatnonzero(wide | torn) + 1):
            if part.size < SHORTEST:
                continue
            rows = slice(int(part[0]), int(part[-1]) + 1)
            bridged += int(rows.stop - rows.start - part.size)
            kept += int(rows.stop - rows.start)
            filled = np.interp(t[rows], t[part], y[part])
            found.append(_transform(record, rows, filled, step))
        dropped += record.n_samples - kept
    return found, Told(bridged, dropped)


def _transform(record: Record, rows: slice, y: Array, step: float) -> Stretch:
    """Spectra of one stretch, on an even axis."""
    t, u = record.t[rows], record.u[rows]
    behaviour: str = record.behaviour
    averaged = False
    if record.dt is None:
        even = np.arange(t[0], t[-1], step)
        if behaviour == "zoh":
            # its mean over a step about each instant: edges keep their places between them
            u, behaviour, averaged = _means(t, u, even, step), "band-limited", True
        else:
            u = np.column_stack([np.interp(even, t, column) for column in u.T])
        y = np.interp(even, t, y)
    n = y.size
    lines = np.arange(1, max(int(BELOW_NYQUIST * n / 2), 1) + 1)
    omega = np.asarray(2.0 * np.pi * lines / (n * step), dtype=np.float64)
    between = acted(omega, step, behaviour)
    if averaged:
        between = between / np.sinc(omega * step / (2.0 * np.pi))
    # a large trim would leave its rounding in every line
    spectrum = np.fft.rfft(u - u[0], axis=0)[lines] * between[:, None]
    ramp = np.fft.rfft(np.linspace(-1.0, 1.0, n))[lines]
    root = np.sqrt(n)
    return Stretch(omega, spectrum / root, np.fft.rfft(y - y[0])[lines] / root, ramp / root, step)


def _means(t: Array, u: Array, even: Array, step: float) -> Array:
    """Means of a held signal over a step about every instant."""
    total = np.vstack([np.zeros(u.shape[1]), np.cumsum(u[:-1] * np.diff(t)[:, None], axis=0)])
    ends = np.clip(np.concatenate([even - step / 2, even[-1:] + step / 2]), t[0], t[-1])
    taken = np.column_stack([np.diff(np.interp(ends, t, column)) for column in total.T])
    return np.asarray(taken / np.diff(ends)[:, None])


def acted(omega: Array, step: float, behaviour: str) -> Complex:
    """Spectrum of the signal between the samples over that of the samples.

    Parameters
    ----------
    omega : (n,) array
        [rad/s].
    step : float
        Sampling interval [s].
    behaviour : {"zoh", "foh", "band-limited"}

    Examples
    --------
    >>> bool(abs(acted(np.array([np.pi]), 1.0, "zoh")[0] - 2.0 / (1j * np.pi)) < 1e-12)
    True
    """
    half = np.asarray(np.sinc(omega * step / (2.0 * np.pi)), dtype=np.complex128)
    if behaviour == "zoh":
        return np.asarray(half * np.exp(-0.5j * omega * step))
    return half**2 if behaviour == "foh" else np.ones_like(half)
