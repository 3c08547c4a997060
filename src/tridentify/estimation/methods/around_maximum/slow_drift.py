"""A slow disturbance of the outputs: a polynomial in time, where the residual asks for one.

Temperature, supply, sun and sensor move an output slowly and not because of the input. Left out,
what they do is taken for slow poles, for free responses or for noise whose autoregression whitens
the slow part of the response away as well. Over one record it is a smooth curve or not far from
one, so a polynomial of low degree stands for it: estimated along with offset and initial state it
costs a degree of freedom for each of its terms, and what it takes from the record is no more than
what is slower than its wiggles. Where the curve is rough, as a random walk is, an autoregression
serves better, and AICc, which counts the terms of both, says which of the two it is.

It is looked for only where white weights leave a residual that is not white, and part of it slow:
a right model in white noise has none to pay for; or where a pole is about as slow as the record,
which may have taken the disturbance for its own response and left nothing of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.fitted_point import TESTED
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import at_rounding
from tridentify.estimation.likelihood.noise.noise_model import residual_series
from tridentify.estimation.likelihood.question import Question
from tridentify.estimation.likelihood.setup.nuisance import build_base
from tridentify.estimation.likelihood.thresholds import CLEARLY
from tridentify.estimation.methods.around_maximum.maximum import Maximum
from tridentify.estimation.methods.around_maximum.noise import FOLLOWED
from tridentify.estimation.methods.around_maximum.turns import criterion_with_noise
from tridentify.models.columns import drift_columns
from tridentify.numerics.arrays import Array
from tridentify.record.checks.orders import HIGHEST_DRIFT

HIGHEST = HIGHEST_DRIFT + 1
"""Highest degree that is tried; a drift that is found is below it. A swing of one and a half
periods, thirty times as large as the noise, needs the ninth."""
PER_DEGREE = 25
"""Samples for each degree: with fewer a polynomial follows responses as well as drifts."""
SLOW = 0.05
"""Share of a residual's power that polynomials explain from which one is tried; white noise of 300
samples leaves 0.04 of it."""
BESIDE = 10.0
"""Size of a pole [rad in the record's duration] below which it may stand for a disturbance: one and
a half periods over the record, or a tenth of it as a time constant."""

BEYOND = 8.0
"""Wiggles of a polynomial where noise that is none of its kind has its level: what wanders as a
random walk is sixty-four times weaker there."""
FALLS = 2.0
"""Density of slow noise over that level from which a polynomial has left part of a wandering."""
MISSED = 100.0
"""AICc by which a drift beside such noise must be better all the same: of 24 random walks whose
response was found without a drift none was above 52, with a pole missing as well one had 66; where
the response was missed it was 113 to 150."""
MISSING = (DecisionKind.RESPONSE_AS_NOISE, DecisionKind.SLOW_AS_NOISE)
"""What is said where a model of the noise stands for a response that is missing."""


def drifting(question: Question, white: Maximum) -> Question | None:
    """The same with a drift of some degree left open; None where nothing asks for it.

    Parameters
    ----------
    question : Question
    white : Maximum
        Its end with white weights.
    """
    point = white.end.point
    most = min(HIGHEST, int(point.counts.min()) // PER_DEGREE)
    stated = question.structure.drift is not False or not all(
        choice.offset for choice in question.choices[-1:]
    )
    if most < 1 or stated or at_rounding(point) or not (_wanders(point, most) or _is_slow(point)):
        return None
    choices = tuple(
        replace(choice, drift=degree)
        for degree in range(most + 1)
        for choice in question.choices
        if choice.offset
    )
    base, variants = build_base(question.records, question.structure, choices)
    if question.base.limits is not None:
        base = base.delayed(question.base.delays).freed(question.base.limits)
    return replace(question, choices=choices, base=base, variants=variants)


def _wanders(point: Point, degree: int) -> bool:
    """Whether the residual of an output is not white, and part of it slow."""
    if all(point.white):
        return False
    for series, passes in zip(residual_series(point, TESTED), point.white, strict=True):
        if passes:
            continue
        slow, whole = 0.0, 0.0
        for one in series:
            seen = np.isfinite(one)
            columns = drift_columns(np.linspace(0.0, 1.0, one.size), degree)
            basis = np.linalg.qr(np.vstack([np.ones(one.size), columns]).T[seen])[0]
            slow += float(np.sum((basis.T @ one[seen]) ** 2))
            whole += float(one[seen] @ one[seen])
        if slow > SLOW * whole:
            return True
    return False


def _is_slow(point: Point) -> bool:
    """Whether a pole is so slow that it may stand for a disturbance."""
    longest = max(e.duration for e in point.problem.experiments)
    return bool(np.abs(point.poles).min(initial=np.inf) * longest < BESIDE)


def smooth(open_: Question, drifted: Maximum, plain: Maximum) -> Maximum | None:
    """The end with a drift if it explains the record clearly better, and leaves nothing rough.

    A polynomial follows a wandering disturbance, too, as far as its degree goes, and its terms then
    pass for known where they are but the slowest part of a noise. So it must not be of the highest
    degree tried, and the noise beside it no stronger up to a few of its own wiggles than beyond;
    unless the end without it is so much less likely that it must have missed the response. And what
    is left must not follow the input: a response that is missing is no disturbance.

    Parameters
    ----------
    open_ : Question
        From `drifting`.
    drifted : Maximum
        Its end.
    plain : Maximum
        The end without a drift.
    """
    degree, point = drifted.end.nuisances.drift, drifted.end.point
    if not 0 < degree < max(choice.drift for choice in open_.choices):
        return None
    if any(one == FOLLOWED or getattr(one, "kind", None) in MISSING for one in drifted.decisions):
        return None
    longest = max(e.n_samples for e in point.problem.experiments)
    rough = any(_is_rough(a, (degree + 1) / longest) for a in point.problem.noise if a.size)
    gain = criterion_with_noise(plain.end.point) - criterion_with_noise(point)
    if gain <= (MISSED if rough else CLEARLY):
        return None
    words = f" (degree {degree}): AICc lower by {gain:.3g} than with noise alone"
    return drifted.told(DecisionKind.SLOW_DRIFT.told(words))


def _is_rough(a: Array, wiggles: float) -> bool:
    """Whether the noise of an autoregression falls off beyond the wiggles of a polynomial.

    ``wiggles``: its half waves over the samples.
    """
    angles = np.pi * wiggles * np.array([0.0, 1.0, 2.0, 4.0, BEYOND])
    lags = np.exp(-1j * np.outer(angles, np.arange(a.size + 1)))
    density = 1.0 / np.abs(lags @ np.append(1.0, a)) ** 2
    return bool(density[:-1].max() > FALLS * density[-1])
