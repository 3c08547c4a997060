"""A tone beside the response: mains hum, an unbalanced shaft, a pump, a fan.

A noise model takes it up and the coefficients stand, but nothing else says why the fit is low, or
why a larger candidate ends at the stability limit (a pole without damping that rings through).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.attempts.first_samples import Predictions, beginning
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

LONGEST = 20_000
"""Samples of a record that are looked at."""
FEWEST = 100
"""Samples below which no line is told from the band around it."""
PERIODS = 8
"""Periods in the record below which it is a slow disturbance."""
SHARE = 0.2
"""Share of what is left of an output that a tone must be to be told."""
BESIDE = 12
"""Lines on either side that a tone is compared with."""
ABOVE = 40.0
"""Energy of a tone over the mean of the lines beside it. What is random is exponentially
distributed about its mean there: the chance is below 1e-15 in each, and steep spectra stay below
it as well."""
STEADY = 0.35
"""Difference of the tone in the two halves of the record, over the tone: what is excited by the
input or by noise comes with another phase each time."""
OWN_LINES = 100.0
"""The same as `ABOVE` for an input from which it has lines of its own: their overtones, by a system
that is not linear, are no tone from outside."""
MAINS = (50.0, 60.0)
"""Frequencies of the mains [Hz]."""
WANDERS = 0.1
"""By how much these wander [Hz]."""
TELLING = 0.02
"""Share of all frequencies that may pass for one of the mains by chance."""


class Tone(NamedTuple):
    """A steady sine: its frequency [Hz], its amplitude, and its share of the variance."""

    frequency: float
    amplitude: float
    share: float


def tone(left: Array, u: Array, step: float) -> Tone | None:
    """The tone in what a response leaves of an output, if there is one.

    Parameters
    ----------
    left : (n_samples,) array
        ``nan`` where nothing was recorded.
    u : (n_samples, n_inputs) array
    step : float
        Sampling interval [s].

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> t = 0.01 * np.arange(500)
    >>> noise, u = rng.standard_normal(500), np.sign(rng.standard_normal((500, 1)))
    >>> tone(noise, u, 0.01) is None
    True
    >>> found = tone(noise + np.sin(2 * np.pi * 7.3 * t), u, 0.01)
    >>> round(found.frequency, 1), round(found.amplitude)
    (7.3, 1)
    """
    seen = np.isfinite(left)
    n = left.size
    if int(seen.sum()) < max(FEWEST, n // 2):
        return None
    e = np.where(seen, left - np.mean(left[seen]), 0.0)
    window = np.hanning(n)
    lines = np.abs(np.fft.rfft(e * window)) ** 2
    lines[:PERIODS] = 0.0
    peak = int(np.argmax(lines))
    if _above(lines, peak) < ABOVE or any(_has_lines(one, window) for one in u.T):
        return None
    k = np.arange(float(n))
    tried = [_sine(e, seen, k, (peak + part) / n) for part in np.linspace(-1.0, 1.0, 41)]
    sine, frequency = min(tried, key=lambda one: float(np.sum((e - one[0])[seen] ** 2)))
    share = 1.0 - float(np.sum((e - sine)[seen] ** 2)) / float(np.sum(e[seen] ** 2))
    halves = [_sine(e, seen & (half == (k < n // 2)), k, frequency)[0] for half in (True, False)]
    apart = float(np.sum((halves[0] - halves[1]) ** 2)) / float(np.sum(sine**2))
    if share < SHARE or apart > STEADY**2:
        return None
    return Tone(float(frequency) / step, math.sqrt(2.0 * float(np.mean(sine**2))), share)


def _above(lines: Array, peak: int, usual: Callable[[Array], Any] = np.mean) -> float:
    """Energy of a line over that of those beside it, the main lobe of the window left out."""
    beside = np.r_[lines[max(peak - BESIDE, 0) : max(peak - 2, 0)], lines[peak + 3 :][: BESIDE - 2]]
    around = float(usual(beside)) if beside.size else 0.0
    return float(lines[peak]) / around if around > 0.0 else 0.0


def _has_lines(u: Array, window: Array) -> bool:
    """Whether an input is periodic, or close to it."""
    lines = np.abs(np.fft.rfft((u - u.mean()) * window)) ** 2
    highest = np.argsort(lines[PERIODS:])[-3:] + PERIODS
    # other lines of it may be among those beside one
    return any(_above(lines, int(line), np.median) > OWN_LINES for line in highest)


def _sine(e: Array, seen: NDArray[np.bool_], k: Array, frequency: float) -> tuple[Array, float]:
    """The sine of one frequency [periods a sample] that explains most, and its frequency."""
    waves = np.column_stack([np.cos(2 * np.pi * frequency * k), np.sin(2 * np.pi * frequency * k)])
    return np.asarray(waves @ np.linalg.lstsq(waves[seen], e[seen])[0]), frequency


def mains(frequency: float, n: int, step: float) -> float:
    """The mains [Hz] that a tone may be at that sampling interval; 0 where it is none.

    Examples
    --------
    >>> mains(10.0, 800, 1 / 60.0), mains(13.0, 800, 1 / 60.0), mains(0.1, 800, 1.0)
    (50.0, 0.0, 0.0)
    """
    rate = 1.0 / step
    near = WANDERS + 0.5 / (n * step)
    if 4.0 * near / rate > TELLING:  # either side of one, of half the sampling rate
        return 0.0
    for one in MAINS:
        if abs(abs(one - rate * round(one / rate)) - frequency) <= near:
            return one
    return 0.0


def tone_finding(
    left: Array, record: Record, output: int, taken_up: bool, experiment: int | None
) -> list[Finding]:
    """What is to be said of a tone in one output of one record.

    Parameters
    ----------
    left : (n_samples,) array
        The output less a response.
    record : Record
    output : int
    taken_up : bool
        Whether there is a noise model, which takes it up.
    experiment : int or None
    """
    if record.dt is None:
        return []
    found = tone(left, record.u, record.dt)
    if found is None:
        return []
    name, y = record.output_names[output], record.y[:, output]
    spread = float(np.nanstd(y))
    source = mains(found.frequency, left.size, record.dt)
    if source and abs(source - found.frequency) < 1.0:
        whence = f", that of {source:.0f} Hz mains,"
    elif source:
        rate = f"{1 / record.dt:.4g} samples a second"
        whence = f", as which {source:.0f} Hz mains appear at {rate},"
    else:
        whence = ""
    return [
        Finding(
            "tone",
            "note" if taken_up else "warning",
            f"A steady tone of {found.frequency:.4g} Hz{whence} is in {name} beside its response "
            f"(amplitude {found.amplitude:.3g}): {100 * found.share:.0f} % of what the input does "
            "not explain"
            + (". The noise model takes it up, so the coefficients stand." if taken_up else "."),
            ("" if taken_up else "Use a noise model (noise='ar'; --noise ar), which takes it up. ")
            + "Remove it at its source (shielding, a filter before sampling, another rate); more "
            "poles do not stand for it.",
            (name,),
            experiment,
            effect=f"It alone takes {100 * found.amplitude / math.sqrt(2.0) / spread:.2g} % of the "
            "output's size from the fit.",
        )
    ]


def tone_findings(
    estimate: Estimate, records: Sequence[Record], known: Predictions
) -> list[Finding]:
    """Tones in the residuals of an estimate; parameters as of `slow_findings`."""
    found = []
    for e, record in enumerate(records):
        short = beginning(record, LONGEST)
        residual = known.residual(short, e)
        for i, noise in enumerate(estimate.noise_model):
            number = e if len(records) > 1 else None
            found += tone_finding(residual[:, i], short, i, noise.size > 0, number)
    return found
