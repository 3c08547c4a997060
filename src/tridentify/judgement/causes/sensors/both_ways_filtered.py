"""Outputs that were filtered forth and back, so that they answer on both sides of a move.

A filter without phase and a linear system may be exchanged: such an output is the response to the
input behind the same filter. Low-pass filters that are run forth and back (``filtfilt``: the square
of a Butterworth filter's gain, here of one, two and four poles) stand for whatever was used; the
cut-off that promises most is found. No model answers before its input, so that a filter on the
output alone passes for an output that comes early.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tridentify.judgement.causes.attempts.intersample import is_staircase
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import LONG_ENOUGH, Rival, one
from tridentify.judgement.causes.signals.coarse_input import converter_steps
from tridentify.judgement.causes.timing.shifts import quickly_fitted
from tridentify.numerics.arrays import Array, Complex

POLES = (1, 2, 4)
"""Of the filter, before it is run back."""

CUT_OFFS = (0.8, 0.55, 0.4, 0.28, 0.2, 0.14, 0.1)
"""In half the sampling rate; a lower one leaves little of a record."""

FINER = (1.2, 1.1, 1.05)
"""Ratios of the refinement."""

PRICE = 2.0 * (1.0 + float(np.log(len(POLES))))
"""One unknown, and one of some filters."""

BOTH_WAYS = "an output was filtered forth and back"
"""What it is called, and known by."""


def both_ways_rivals(present: Present) -> Iterator[Rival]:
    """All outputs behind a low-pass filter without phase, which the inputs have not gone through.

    Parameters
    ----------
    present : Present
    """
    records = present.records
    if any(record.dt is None or record.n_samples < 2 * LONG_ENOUGH for record in records):
        return
    # a smooth input shows no moves that an output could come before, by a converter's steps or not
    if not is_staircase(records) or np.any(converter_steps(records) > 0.0):
        return
    found = [end for poles in POLES if (end := _best(present, poles)) is not None]
    if not found:
        return
    _, poles, cut, part, start = min(found, key=lambda one: one[0])
    what = (
        "outputs that were filtered forth and back (without phase, as by filtfilt; about a "
        f"Butterworth filter of {poles} {'pole' if poles == 1 else 'poles'} at {cut:.2g} of half "
        "the sampling rate), so that they begin to answer before the input moves, where the "
        "inputs were not"
    )
    rival = one(
        "filtered",
        part,
        what,
        "Take the outputs as they were recorded, or filter the inputs alike: the same filter, "
        "forth and back.",
    )
    # behind a delay nothing begins before its input, so that lags round an edge as well
    yield replace(
        rival,
        starts=((start, present.poles),),
        price=PRICE,
        exact=True,
        headline=BOTH_WAYS,
        as_lags=bool(np.all(present.delay >= present.step)),
    )


def _best(present: Present, poles: int) -> tuple[float, int, float, Present, Complex] | None:
    """``-2 log L`` a sample, poles and cut-off of the best filter, what it makes and the fit."""
    known: dict[float, tuple[float, int, float, Present, Complex]] = {}

    def at(cut: float) -> float:
        if cut not in known:
            part = smoothed(present, poles, cut)
            end = quickly_fitted(part, present.poles)
            cost = np.inf if end is None else end.deviance / end.count
            start = present.poles if end is None else end.point.poles
            known[cut] = (float(cost), poles, cut, part, start)
        return known[cut][0]

    best = CUT_OFFS[0]
    for cut in CUT_OFFS[1:]:
        if at(cut) > at(best):
            break
        best = cut
    for ratio in FINER:
        best = min((best, min(best * ratio, 0.95), best / ratio), key=at)
    return known[best] if np.isfinite(at(best)) else None


def smoothed(present: Present, poles: int, cut: float) -> Present:
    """With inputs behind a filter that is run forth and back.

    Parameters
    ----------
    present : Present
    poles : int
        Of a Butterworth filter.
    cut : float
        Its cut-off, in half the sampling rate.
    """
    made = [one._derive(u=forth_and_back(one.u, poles, cut)) for one in present.records]
    return replace(present, records=tuple(made))


def forth_and_back(u: Array, poles: int, cut: float) -> Array:
    """Columns behind a Butterworth filter forth and back, continued by their ends.

    Parameters
    ----------
    u : (n_samples, n_columns) array
    poles : int
    cut : float
        In half the sampling rate.

    Examples
    --------
    >>> u = np.repeat([0.0, 1.0], 50)[:, None]
    >>> forth_and_back(u, 2, 0.3)[[0, 48, 49, 50, 51, 99], 0].round(2) + 0.0
    array([0.  , 0.1 , 0.34, 0.66, 0.9 , 1.  ])
    """
    n = u.shape[0]
    beyond = min(n - 1, int(10.0 / cut) + 10)
    longer = np.vstack([np.repeat(u[:1], beyond, 0), u, np.repeat(u[-1:], beyond, 0)])
    # even about both ends, so that a circle closes
    circle = np.vstack([longer, longer[::-1]])
    half = 0.5 * np.pi * np.linspace(0.0, 1.0, circle.shape[0] // 2 + 1)
    with np.errstate(over="ignore"):
        gain = 1.0 / (1.0 + (np.tan(half) / np.tan(0.5 * np.pi * cut)) ** (2 * poles))
    spectrum = np.fft.rfft(circle, axis=0) * gain[:, np.newaxis]
    return np.asarray(np.fft.irfft(spectrum, circle.shape[0], axis=0)[beyond : beyond + n])
