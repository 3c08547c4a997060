"""One output of records as the parallel model sees it: its response, its noise, and to which input.

What noise is depends on what is taken for response, and the other way about. An output and an input
that both wander resemble one another over any one record, and least squares, to which the noise is
white, makes a response of that (Granger & Newbold, Journal of Econometrics 2, 1974, 111-120). So
the model is fitted from two sides, the noise white at first and the output all noise at first, and
the likelier end is kept. Whether there is a response is asked from the side of those who deny it:
under the noise that the output shows by itself (a score test, whose chance is the stated one). A
steady tone is foretold by its own past, however large it is; there the two ends are compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.judgement.advice.frequency import FrequencyResponse
from tridentify.judgement.advice.seen import PART
from tridentify.judgement.causes.attempts.direct_part import has_direct_part
from tridentify.judgement.causes.attempts.parallel import (
    Parallel,
    WhitenedFit,
    p_value,
    residual_noise,
    with_noise_model,
)
from tridentify.judgement.cautions.residual import MEMORIES, memory
from tridentify.numerics.arrays import Array
from tridentify.record.checks.times import typical_step
from tridentify.record.record import Record

NO_RESPONSE = 1e-3
"""Chance that noise alone explains a response so well, above which there is none."""

LIKELIER, FAR_LIKELIER = 1e-5, 1e-12
"""The same where the noise is fitted again beside the response, for an output that does not wander,
and for one that does: any fit makes noise of what it leaves. The smallest chances of 260 and of 70
records whose inputs and outputs know nothing of each other were 1e-5 and 3e-9."""

APART, FEW = 4, (2, 4, 8)
"""Samples between delays that are tried, and operators of an input that is tried late."""


@dataclass(frozen=True, eq=False)
class Output:
    """One output.

    Attributes
    ----------
    index : int
    parallel : Parallel
        With its noise model.
    fit : WhitenedFit
    responds : tuple of float
        Chance that noise alone explains the response to each input so well.
    """

    index: int
    parallel: Parallel
    fit: WhitenedFit
    responds: tuple[float, ...] = ()

    @property
    def any(self) -> bool:
        """Whether it responds to any input."""
        return min(self.responds) < NO_RESPONSE


def glance(records: Sequence[Record], index: int, frequency: FrequencyResponse | None) -> Output:
    """An output with the noise white at first, and no word on whether it responds.

    Parameters
    ----------
    records : sequence of Record
    index : int
        Which output.
    frequency : FrequencyResponse or None
        As measured.
    """
    return Output(index, *with_noise_model(_white(records, index, frequency)))


def looked_into(
    records: Sequence[Record], index: int, frequency: FrequencyResponse | None
) -> Output:
    """An output with its likelier noise, and whether it responds to each input beside the others.

    Parameters
    ----------
    records, index, frequency
        As of `glance`.
    """
    white = _white(records, index, frequency)
    parallel, fit = likelier(white)
    n_inputs = records[0].n_inputs
    if n_inputs == 1:
        noise = residual_noise(white, _levelled(white))
        alone = white.changed(noise=noise)
        return Output(
            index, parallel, fit, (_chance(alone, 0, alone.without_inputs(), parallel, fit),)
        )
    chances = []
    for j in range(n_inputs):
        others = [name for k, name in enumerate(records[0].input_names) if k != j]
        fewer = tuple(record.select(inputs=others) for record in parallel.records)
        left, small = likelier(white.changed(records=fewer, delays=(0.0,) * (n_inputs - 1)))
        alone = white.changed(noise=left.noise)
        chances.append(_chance(alone, j, small, parallel, fit))
    return Output(index, parallel, fit, tuple(chances))


def likelier(white: Parallel) -> tuple[Parallel, WhitenedFit]:
    """The likelier of two ends: from white noise, and from an output that is all noise.

    Parameters
    ----------
    white : Parallel
        The noise taken for white.
    """
    start = white.changed(noise=residual_noise(white, _levelled(white)))
    ends = [with_noise_model(white), with_noise_model(start)]
    return min(ends, key=lambda end: unlikelihood(*end))


def unlikelihood(parallel: Parallel, fit: WhitenedFit) -> float:
    """AICc of a fit with its noise model.

    Parameters
    ----------
    parallel : Parallel
    fit : WhitenedFit
    """
    return fit.criterion + 2.0 * parallel.noise.size


def _chance(
    alone: Parallel, input_: int, small: WhitenedFit, parallel: Parallel, fit: WhitenedFit
) -> float:
    """That noise makes the whole model so much better than one without a response to an input.

    Parameters
    ----------
    alone : Parallel
        With all inputs, and the noise as of those who deny the response.
    input_ : int
    small : WhitenedFit
        Without that input.
    parallel, fit
        The likelier end.
    """
    chance = _at(alone, small, parallel, fit)
    if chance < NO_RESPONSE:
        return chance
    # few operators do not stand for a long delay
    white = parallel.changed(noise=np.zeros(0))
    step = typical_step(alone.records[0].t)
    longest = PART * min(record.duration for record in alone.records)
    tried = []
    for late in np.arange(APART * step, longest, APART * step):
        delays = tuple(late if j == input_ else d for j, d in enumerate(alone.delays))
        own = white.changed(delays=delays)
        found = [each for pole in own.poles()[::2] for each in own.fits(pole, FEW)]
        tried.append((min(each.criterion for each in found), delays))
    if not tried:
        return chance
    delays = min(tried)[1]
    end = likelier(white.changed(delays=delays))
    return min(chance, len(tried) * _at(alone.changed(delays=delays), small, *end))


def _at(alone: Parallel, small: WhitenedFit, parallel: Parallel, fit: WhitenedFit) -> float:
    """The same at one delay; parameters as of `_chance`."""
    chance = p_value(small, alone.best())
    if chance < NO_RESPONSE:
        return chance
    # the pole was searched for, and is an unknown too
    less = small.rank + alone.noise.size
    more = max(fit.rank + parallel.noise.size + 1, less + 1)
    rss = [one.count * float(np.exp(one.deviance / one.count)) for one in (small, fit)]
    again = p_value(replace(small, rss=rss[0], rank=less), replace(fit, rss=rss[1], rank=more))
    longest = max(record.n_samples for record in alone.records)
    wandering = longest < MEMORIES * memory(alone.noise)
    return again if again < (FAR_LIKELIER if wandering else LIKELIER) else chance


def _white(records: Sequence[Record], index: int, frequency: FrequencyResponse | None) -> Parallel:
    at_once = has_direct_part(records)
    return Parallel.of(records, index, _resonance(frequency, index), direct=at_once)


def _levelled(parallel: Parallel) -> list[Array]:
    """What each record has of the output about its mean."""
    columns = [record.y[:, parallel.output] for record in parallel.records]
    return [y - np.nanmean(y) if np.isfinite(y).any() else y for y in columns]


def _resonance(frequency: FrequencyResponse | None, output: int) -> float:
    """Where the measured response is largest [rad/s]."""
    if frequency is None:
        return 0.0
    size = np.where(frequency.good[:, output], np.abs(frequency.response[:, output]), 0.0)
    highest = size.max(axis=1)
    k = int(np.argmax(highest))
    return float(frequency.omega[k]) if highest[k] > 0 else 0.0
