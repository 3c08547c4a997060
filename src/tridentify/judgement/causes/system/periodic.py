"""A disturbance that comes back: the sun every day, a shift, a shaft that turns.

It is a sine of a period ``T`` and its second harmonic beside the input, each with an amplitude of
its own for sine and cosine, through the same poles as a slow disturbance (`system.slow`). The
period is where the residual's periodogram is highest (Quinn & Hannan, *The Estimation and Tracking
of Frequency*, 2001, chapter 2); having been picked among all frequencies costs ``2 ln`` of their
number. Without it a model that is asked for more poles takes the disturbance for a mode without
damping, which answers nothing but has been swinging all the time.

A mode that rings after each move of the input looks alike for a while, but not with one phase
throughout: the sine of one half of the record has to tell part of the other. A bend under an input
that is itself periodic leaves the harmonics of the input, so nothing is said of such periods. What
moves slowly besides, as weather does, is told beside it by the waves of `causes.system.slow`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import Rival, one
from tridentify.judgement.causes.system.slow import HALVES, slow_waves
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

FEWEST_PERIODS = 4
"""In a record: of fewer nobody can say that they come back."""
FEWEST_SAMPLES = 8
"""In a period: faster tones are looked for in what the noise model leaves (`cautions.tones`)."""
HARMONICS = 2
"""A half-sine of the sun's is nine tenths of these."""
FINER = 4
"""Places in a bin of the periodogram: an amplitude is at most 3 % too small."""
OF_THE_INPUT, OWN = 0.8, 10
"""Share of an input's variance in so many harmonics from which the period is that of the input."""
FORETOLD, IN_ONE = (0.25, 0.2), 0.05
"""Share of one half of the residual that the sine of the other half has to tell, in the mean of the
two: where the residual is strongest, and where it is less what wanders. A fifth of random walks
come as far, and no white noise; the likelihood decides. And in one of the two at least."""
LONGER = 10.0
"""What twice the period has to explain besides, in ``-2 log L``."""
DAY, NEAR = 86400.0, 0.03
"""A day [s], and how far off, relative, a period may be that is called one."""

ADVICE = (
    "Record what drives it (the sun, a shift, a shaft) and give it as a further input; until then "
    "sines of its period as further inputs stand for it, and more poles do not."
)


def periodic_rivals(present: Present, fitted: Sequence[Array]) -> Iterator[Rival]:
    """Sines of the period at which the residual is strongest, alone and beside slow waves.

    Parameters
    ----------
    present : Present
    fitted : sequence of (n_samples, n_outputs) arrays
        Outputs of the present model.
    """
    if not isinstance(present.order, int) or len(present.records) > 1:
        return
    (record,) = present.records
    if record.dt is None:
        return
    step = record.dt
    for place, frequency in enumerate(comes_back(np.asarray(record.y) - fitted[0], step)):
        if not _belongs_to_an_input(record, frequency):
            waves = _waves(record.n_samples, frequency * step)
            yield from _rivals(present, record, frequency, waves, LONGER * place)


def _rivals(
    present: Present, record: Record, frequency: float, waves: Array, further: float
) -> Iterator[Rival]:
    other = present
    for k, wave in enumerate(waves.T, start=1):
        other = other.with_inputs([wave], f"sine {k}", 0)
    beside = other
    slow = slow_waves((record.t - record.t[0]) / record.duration)
    for k, wave in enumerate(slow.T, start=1):
        beside = beside.with_inputs([wave], f"wave {k}", 0)
    what = f"a disturbance that comes back every {_in_words(1.0 / frequency)}"
    free = replace(present.nuisances, offset=True)
    price = 2.0 * float(np.log(record.n_samples / 2)) + further
    for asked, drift, said in (
        (other, free.drift, what),
        (beside, True, f"{what}, and a slow one"),
    ):
        freed = replace(asked, nuisances=replace(free, drift=drift))
        found = one("drift", freed, said, ADVICE, refits=False)
        yield replace(found, price=price, headline="what disturbs the output comes back")


def comes_back(residual: Array, step: float) -> list[float]:
    """Frequencies [Hz] of what comes back in the residual of one output at least, with one phase.

    Parameters
    ----------
    residual : (n_samples, n_outputs) array
        nan where an output is missing.
    step : float
        Sampling interval [s].

    Returns
    -------
    list of float
        Where the residual is strongest and, as what is alike from period to period may be so at
        twice its frequency, the half of that; empty where nothing comes back, or the record is too
        short to say so.

    Examples
    --------
    >>> import numpy as np
    >>> wave = np.sin(2 * np.pi * 0.031 * np.arange(600.0))[:, np.newaxis]
    >>> [round(frequency, 4) for frequency in comes_back(wave, 1.0)]
    [0.031, 0.0155]
    """
    n = residual.shape[0]
    first = FINER * max(FEWEST_PERIODS, HALVES // 2 + 1)
    last = FINER * n // FEWEST_SAMPLES
    if last <= first:
        return []
    slow = np.hstack([np.ones((n, 1)), slow_waves(np.linspace(0.0, 1.0, n))])
    for left in (_without(slow, e) for e in residual.T if np.isfinite(e).sum() > n // 2):
        power = np.abs(np.fft.rfft(left, FINER * n)) ** 2
        place = np.arange(first, last + 1)
        # as it is, and less what wanders, whose spectrum falls with the square of the frequency
        for least, strength in zip(FORETOLD, (power[place], power[place] * place**2), strict=True):
            at = first + int(np.argmax(strength))
            both = [k / (FINER * n) for k in (at, at / 2) if k >= first]
            if _foretold(left, both[0]) > least:
                return [own / step for own in both]
    return []


def _foretold(left: Array, frequency: float) -> float:
    """Share of a half of the samples that the sines of the other half tell; 0 if of one only."""
    waves, half = _waves(left.size, frequency), left.size // 2
    told = []
    for own, other in ((slice(half), slice(half, None)), (slice(half, None), slice(half))):
        missed = left[other] - waves[other] @ np.linalg.lstsq(waves[own], left[own])[0]
        told.append(1.0 - float(np.sum(missed**2) / max(np.sum(left[other] ** 2), 1e-300)))
    return sum(told) / 2.0 if min(told) > IN_ONE else 0.0


def _waves(n: int, frequency: float) -> Array:
    """(n, k) cosines and sines of a frequency [1/sample] and its harmonics."""
    angle = 2.0 * np.pi * frequency * np.outer(np.arange(n), np.arange(1, HARMONICS + 1))
    return np.hstack([np.cos(angle), np.sin(angle)])


def _without(columns: Array, samples: Array) -> Array:
    """What columns leave of samples; zero where one is missing."""
    seen = np.isfinite(samples)
    left = np.zeros(samples.size)
    known = np.linalg.lstsq(columns[seen], samples[seen])[0]
    left[seen] = samples[seen] - columns[seen] @ known
    return left


def _belongs_to_an_input(record: Record, frequency: float) -> bool:
    """Whether an input is itself periodic with it."""
    angle = 2.0 * np.pi * frequency * np.outer(record.t - record.t[0], np.arange(1, OWN + 1))
    waves = np.hstack([np.ones((angle.shape[0], 1)), np.cos(angle), np.sin(angle)])
    u = record.u - record.u.mean(axis=0)
    left = u - waves @ np.linalg.lstsq(waves, u)[0]
    return bool(np.any(np.sum(left**2, axis=0) < (1.0 - OF_THE_INPUT) * np.sum(u**2, axis=0)))


def _in_words(period: float) -> str:
    return "day" if abs(period / DAY - 1.0) < NEAR else f"{period:.3g} s"
