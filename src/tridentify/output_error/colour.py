"""Coloured measurement noise: its model and the coefficients, in turn.

With ``A_i(q) v_i = e_i`` for the noise of output ``i`` the likelihood is that of the innovations
``e``, and for a held ``A`` it is the output-error cost of whitened samples (`regression`): all
that is known about its minimum stays true. The two are fitted in turn,

    coefficients -> residual -> A (its order by AICc) -> coefficients on whitened samples -> ...

each step on the same likelihood, until the coefficients stand still. At its end the information
matrix is block diagonal, as the derivatives of the innovations with respect to ``A`` are made of
past noise and those with respect to the system of the input alone (Pierce 1972; Ljung 1999,
section 9.3). So ``(J' J)^{-1}`` with ``J`` of the whitened columns is the covariance of the
coefficients, as if ``A`` were known; its count lowers the degrees of freedom.

White weights remain consistent where the noise is coloured, but are not efficient, their standard
errors are wrong (too small for a system slower than the noise's memory), and AICc takes slow noise
for offsets, drifts and free responses. So the nuisance terms are decided anew on whitened samples.

Whether the noise is white is tested on the residual of the white fit. A response that the model
misses looks like coloured noise there, but no whitening can make it independent of the input. Where
more than half of the whitened residual follows the input, the samples are left as they are: with
whitening the coefficients would move to where the missing response is smallest for its size, which
can be far from anything wanted. A smaller part is usual in measured records; the standard errors
then allow for its colour, and `cautions` says that it is there. What white weights explain and the
whitened samples leave to the noise is told too.

References: D. Pierce, Biometrika 59 (1972) 73-78. G. Box, G. Jenkins & G. Reinsel, *Time Series
Analysis*, 4th ed., chapter 12 (2008). L. Ljung, *System Identification*, 2nd ed. (1999).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import OptionError, TooFewSamplesError, UnsupportedError
from tridentify.estimate import Status
from tridentify.numerics.autoregression import (
    fit_autoregression,
    most_coefficients,
)
from tridentify.numerics.realization import Complex
from tridentify.numerics.whiteness import input_share, is_white
from tridentify.output_error.decide import Finished
from tridentify.output_error.finish import (
    MOST_STEPS,
    Recorder,
    at_rounding,
    coefficients,
    criterion,
    finish,
)
from tridentify.output_error.point import Point, evaluate
from tridentify.output_error.problem import Problem
from tridentify.output_error.raster import NEARLY, places_on_raster
from tridentify.output_error.result import output_rss, standard_errors, taken
from tridentify.trace import RESPONSE_AS_NOISE, SLOW_AS_NOISE

Array = NDArray[np.float64]
NoiseChoice = Literal["white", "ar", "auto"]
Decide = Callable[[Problem, Sequence[Complex]], tuple[Finished, tuple[str, ...]]]
Seek = Callable[[Problem], Sequence[Complex]]

CHOICES = ("white", "ar", "auto")
MOST_ROUNDS = 8
OPEN_ROUNDS = 3
STILL = 0.01
ROUNDING = 1e-9
PER_UNKNOWN = 2.0
MOSTLY = 0.5
LOST = 10.0
NOTABLE, LARGE = 1.5, 4.0
"""Residual power with whitened samples over that with white weights: worth a note, a caution. Right
models in noise that wanders over the whole record reach three, others 1.1."""
LONGEST = 20_000
TESTED = 200_000
PASSED = "noise white: the residual passes the portmanteau test"


@dataclass(frozen=True, eq=False)
class Coloured:
    """What came of the noise.

    Attributes
    ----------
    best : Finished
        On whitened samples, or as it was where the noise passes for white.
    decisions : tuple of str
        About the noise, and about the nuisance terms.
    changed : bool
        Whether the samples were whitened.
    """

    best: Finished
    decisions: tuple[str, ...]
    changed: bool


def check_noise(noise: str) -> None:
    """Refuse an unknown option.

    Raises
    ------
    OptionError
    """
    if noise not in CHOICES:
        raise OptionError(
            f"found noise={noise!r}; expected 'white', 'ar' or 'auto'; choose one of them"
        )


def settle(
    noise: NoiseChoice,
    first: Finished,
    reasons: tuple[str, ...],
    base: Problem,
    decide: Decide,
    seek: Seek,
    say: Callable[[str], None],
    most: int = MOST_STEPS,
    *,
    white: bool = False,
) -> Coloured:
    """Model the noise if that is asked for, or if the residual is not white.

    Parameters
    ----------
    noise : {"white", "ar", "auto"}
    first : Finished
        The end with white weights.
    reasons : tuple of str
        Why its nuisance terms were chosen.
    base : Problem
        With all choices of nuisance terms.
    decide : callable
        Chooses nuisance terms for a problem like ``base`` from seeds.
    seek : callable
        Searches starting poles for a problem like ``base``.
    say : callable
        Is told what is going on.
    most : int
        Most steps on the output error in each round.
    white : bool
        Whether the residual is known to pass the test.

    Returns
    -------
    Coloured

    Raises
    ------
    UnsupportedError, TooFewSamplesError
        If a model of the noise is asked for and cannot be made.
    """
    if noise == "white":
        return Coloured(first, reasons, False)
    refusal = _refusal(first.point)
    if refusal is not None:
        if noise == "ar" and not at_rounding(first.point):
            raise refusal
        note = str(refusal).partition(";")[0].removeprefix("found ")
        told = () if at_rounding(first.point) else (f"noise taken as white: {note}",)
        return Coloured(first, reasons + told, False)
    if white and noise == "auto":
        return Coloured(first, (*reasons, PASSED), False)
    residuals = _series(first.point, TESTED)
    tinted = tuple(noise == "ar" or not is_white(series) for series in residuals)
    if not any(tinted):
        return Coloured(first, (*reasons, PASSED), False)
    if noise == "auto":
        tinted = tuple(
            coloured and not _follows_input(first.point, i, residuals[i])
            for i, coloured in enumerate(tinted)
        )
        if not any(tinted):
            told = ("noise taken as white: the residual is not, but most of it follows the input",)
            return Coloured(first, reasons + told, False)
    say("coloured noise")
    best, found = _alternate(first, reasons, tinted, base, decide, seek, say, most)
    if noise == "auto" and _is_lost(best, first):
        told = ("noise taken as white: on whitened samples there was no usable minimum",)
        return Coloured(first, reasons + told, False)
    words = (_in_words(best.point, tinted, noise), *_apart(first, best))
    return Coloured(best, (*found, *words), True)


def _alternate(
    first: Finished,
    reasons: tuple[str, ...],
    tinted: tuple[bool, ...],
    base: Problem,
    decide: Decide,
    seek: Seek,
    say: Callable[[str], None],
    most: int,
) -> tuple[Finished, tuple[str, ...]]:
    """Noise model and coefficients in turn, until the coefficients stand still."""
    best, trail = first, Recorder(list(first.recorder.passes))
    orders: list[int] | None = None
    searched = settled = False
    for count in range(MOST_ROUNDS):
        model = _noise_model(best.point, tinted, orders)
        open_round = count < OPEN_ROUNDS
        if open_round:
            whole = base.whitened(model)
            seeds = [best.point.poles]
            following, found = decide(whole, seeds)
            if not searched:
                say("another search, on whitened samples")
                other, others = decide(whole, list(seek(whole)))
                searched = True
                if other.criterion < following.criterion - STILL:
                    following, found = other, others
            reasons = found or reasons
        else:
            orders = [a.size for a in model]
            following = _finished(best, model, most)
        label = ", ".join(str(a.size) for a in model)
        for one in following.recorder.passes:
            note = f"samples whitened, order {label}" + (f"; {one.note}" if one.note else "")
            trail.passes.append(replace(one, number=len(trail.passes) + 1, note=note))
        settled = following.nuisances == best.nuisances and _stands(following.point, best.point)
        best = following
        if settled:
            break
    return replace(best, recorder=trail), reasons


def _finished(best: Finished, model: tuple[Array, ...], most: int) -> Finished:
    """The minimum for another model of the noise, from where the last one ended."""
    problem = best.point.problem.whitened(model)
    at, recorder = partial(evaluate, problem), Recorder()
    point, status, why = finish(at, at(best.point.poles), recorder, most)
    return Finished(best.nuisances, point, status, why, criterion(point), recorder)


def _is_lost(best: Finished, first: Finished) -> bool:
    """Whether whitening led astray: to a limit, or to a model that explains far less."""
    if first.status is Status.CONVERGED and best.status is not Status.CONVERGED:
        return True
    return bool(np.any(output_rss(best.point) > LOST * output_rss(first.point)))


def _stands(point: Point, before: Point) -> bool:
    """Whether the coefficients moved by less than a hundredth of their standard errors."""
    moved = np.abs(coefficients(point) - coefficients(before))
    return bool(np.all(moved <= STILL * standard_errors(point)))


def _series(point: Point, most: int | None = None) -> list[list[Array]]:
    """Residuals, ``[output][experiment]``."""
    residuals = point.residuals(most)
    return [[one[:, i] for one in residuals] for i in range(point.problem.n_outputs)]


def _noise_model(
    point: Point, tinted: Sequence[bool], orders: Sequence[int] | None
) -> tuple[Array, ...]:
    found = []
    for i, series in enumerate(_series(point)):
        if not tinted[i]:
            found.append(np.zeros(0))
            continue
        order = None if orders is None else orders[i]
        small = point.counts.sum() < LONGEST
        extra = taken(point, i) if small else []
        found.append(fit_autoregression(series, _most(point, i), order, fewest=1, taken=extra))
    return tuple(found)


def _follows_input(point: Point, output: int, series: Sequence[Array]) -> bool:
    """Whether most of the residual is a response that the model misses, not noise."""
    a = fit_autoregression(series, _most(point, output), fewest=1)
    found = [
        (input_share(one[:LONGEST], e.u[:LONGEST], a)[0], one[:LONGEST].size)
        for one, e in zip(series, point.problem.experiments, strict=True)
    ]
    return sum(share * n for share, n in found) > MOSTLY * sum(n for _, n in found)


def _most(point: Point, output: int) -> int:
    """Highest order for one output: what its samples leave after the other unknowns."""
    own = point.fits[output].matrix.shape[1] + point.problem.n_poles
    return most_coefficients(int(point.counts[output] - PER_UNKNOWN * own))


def _refusal(point: Point) -> UnsupportedError | TooFewSamplesError | None:
    """Why there can be no model of the noise."""
    power = point.rss / point.counts
    if at_rounding(point) or np.any(power < ROUNDING**2 * point.problem.size):
        return UnsupportedError(
            "found a residual that is no more than rounding; expected noise; use noise='white'"
        )
    instants = [e.t for e in point.problem.experiments if e.t is not None]
    if any(not _is_nearly_uniform(t) for t in instants):
        return UnsupportedError(
            "found time that is not uniform; expected a uniform step, as an autoregression is a "
            "model of evenly spaced samples; use noise='white', or resample the record"
        )
    steps = [e.dt for e in point.problem.experiments]
    same = NEARLY if instants else 1e-6
    if not all(math.isclose(dt, steps[0], rel_tol=same) for dt in steps):
        return UnsupportedError(
            f"found experiments with sampling intervals from {min(steps):g} to {max(steps):g} s; "
            "expected one interval, as the noise model is that of the samples; resample the "
            "records to one interval, or use noise='white'"
        )
    fewest = min(_most(point, i) for i in range(point.problem.n_outputs))
    if fewest == 0:
        return TooFewSamplesError(
            f"found too few samples for a noise model ({int(point.counts.min())}); expected at "
            "least 20 more than twice the unknowns; record longer, or use noise='white'"
        )
    return None


def _apart(first: Finished, best: Finished) -> tuple[str, ...]:
    """A word where white weights explain far more of the output than whitened samples do.

    Slow noise looks like a slow response, and the other way round: the record cannot say which,
    only by how much the two ends differ.
    """
    counts = first.point.counts
    size = np.maximum(first.point.problem.power * counts, 1e-300)
    plain, own = (output_rss(end.point) / size for end in (first, best))
    told: list[str] = []
    for known, much in ((RESPONSE_AS_NOISE, LARGE), (SLOW_AS_NOISE, NOTABLE)):
        where = np.flatnonzero(own > much * plain)
        if where.size and not told:
            fits = [
                f"{100.0 * (1.0 - math.sqrt(own[i])):.1f} % where white weights reach "
                f"{100.0 * (1.0 - math.sqrt(plain[i])):.1f} %"
                for i in where
            ]
            told.append(f"{known}: fit {', '.join(fits)}")
    return tuple(told)


def _is_nearly_uniform(t: Array) -> bool:
    """Whether samples are so evenly spaced that noise makes no difference of it."""
    places = places_on_raster(t)
    return places is not None and bool(places[-1] + 1 == t.size)


def _in_words(point: Point, tinted: Sequence[bool], noise: str) -> str:
    why = "as asked for" if noise == "ar" else "the residual with white weights is not white"
    orders = [
        f"order {a.size}" if coloured else "white"
        for a, coloured in zip(point.problem.noise, tinted, strict=True)
    ]
    return f"noise coloured ({why}): samples whitened by autoregressions, {', '.join(orders)}"
