"""A plant that is not stable, in open loop: where the best stable model gives itself away.

The search keeps to stable models. Of a plant with a pole to the right of zero, and a record short
enough for its response to stay within bounds, the best of them ends at the limit of stability, with
a mode slower than the record, or nowhere. Then the model without that limit is tried
(`closed_loop.unstable`), and taken where the record clearly speaks for it: by its likelihood, by a
pole to the right of zero by several standard errors, by a response that grew in the record, and by
a simulation that follows it no worse: what only forecasts from sample to sample was held by
somebody.

Something else may have grown there: a drift, which is as good as the free response of such a pole.
So, where it grew no more than a drift may, a stable plant beside a disturbance that grows at the
same rate, as another input, must explain the record clearly worse: what grows is then the response
to the input. Where the search itself put a polynomial beside the stable plant, both need only be
worse, by AICc, which chose the polynomial: that bends as any growth does, and nobody asked for it,
whereas beside a drift a stable plant answers its input otherwise than one that grows.

Where the record decides for neither, the stable plant stays, and the pole that is as likely is told
with it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.answer.trace import Status
from tridentify.estimation.closed_loop.unstable_answer import (
    AS_LIKELY,
    estimate_of,
    orders_of,
    without_controller,
    worse_by,
)
from tridentify.estimation.methods.base import Progress
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.information import aicc_price
from tridentify.numerics.rational import scaled_roots
from tridentify.record.record import Record
from tridentify.structure import Structure

SLOW = 2.0
"""Decay of a mode within the record from below which it is suspicious: an unstable one is best
replaced by one that hardly decays."""
CLEARLY = 10.0
"""Fall of ``-2 log L`` that speaks for a model without the limit: by chance it falls by 4."""
SURELY = 3.0
"""Standard errors that its pole lies to the right of zero."""
GROWTH = 0.7
"""Rate of the pole times length of the record, from which a response doubles within it."""
BEYOND_DOUBT = 100.0
"""Fall of ``-2 log L`` from which no standard errors are asked for: two poles that are hardly told
apart are known together far better than each. In white noise alone: a
model of the noise may fall as far by itself."""
BESIDE = " beside a drift that grows as fast"
"""What a stable plant needs for that."""
EXPLOSION = 3.0
"""Rate of the pole times length of the record, from which no drift grows like that: twentyfold."""


def unless_unstable(
    found: Estimate,
    asked: Request,
    again: Callable[[Sequence[Record], Structure], Estimate],
    coloured: bool,
    say: Progress,
) -> Estimate:
    """The estimate, or that of a plant which is not stable where the record clearly shows one.

    Parameters
    ----------
    found : Estimate
        Of the search among stable models.
    asked : Request
    again : callable
        The search among stable models.
    coloured : bool
        Whether the noise may have a model.
    say : callable
        Is told what is going on.
    """
    if not may_be_unstable(found, asked.records, asked.structure):
        return found
    reached = without_controller(asked, coloured, say)
    if reached is None:
        return found
    loops, best = reached
    rate = float(best.plant.poles.real.max())
    error = _error_of_rate(np.append(1.0, best.plant.a), best.cov)
    longest = max(record.duration for record in asked.records)
    gain = _deviance(found, asked.records) - best.deviance
    sure = rate > SURELY * error or (gain > BEYOND_DOUBT and not best.noise.size)
    like_a_drift = rate * longest < EXPLOSION
    # a polynomial that nobody asked for bends as any growth does: AICc tells it from growth
    beside = found.structure.drift_degree > asked.structure.drift_degree
    least = 0.0 if beside and not (like_a_drift and best.noise.size) else CLEARLY
    grew = rate * longest >= GROWTH
    if gain < (CLEARLY if not grew else -CLEARLY if sure else 0.0):
        return found
    rival = f"{rate:+.3g} +/- {error:.2g} rad/s"
    if gain < least or not (sure and grew):
        return _as_likely(found, rival, gain, " with a drift" if beside else "")
    if like_a_drift and (more := _beside_a_drift(asked, again, rate) - best.deviance) < least:
        return found if more < -CLEARLY else _as_likely(found, rival, more, BESIDE)
    told = f"-2 log L is lower by {gain:.1f} than of the best stable model"
    reached_end = replace(estimate_of(asked, loops, best, (told,)), route=found.route)
    # what nobody held follows from the model alone, from the start of the record to its end
    return found if worse_by(reached_end, found) > AS_LIKELY else reached_end


def _as_likely(found: Estimate, rival: str, gain: float, beside: str) -> Estimate:
    """A stable plant in whose record a pole to the right of zero is not excluded, which is told."""
    said = Finding(
        "unstable",
        "warning",
        f"The record does not tell whether the plant is stable: with a pole of {rival} -2 log L is "
        f"{abs(gain):.1f} {'lower' if gain > 0.0 else 'higher'} than of a stable plant{beside}.",
        "Record again from another start, or longer: what grows each time, and as fast, is the "
        "plant.",
    )
    return replace(found, findings=(*found.findings, said))


def may_be_unstable(found: Estimate, records: Sequence[Record], structure: Structure) -> bool:
    """Whether a stable model looks like the best stand-in for one that is not.

    Needless poles are loose, and their posterior mean is no sign of it: a mode that grows is
    replaced by one that hardly decays, whatever else there is; or by a drift that nobody asked for.
    """
    if orders_of(records, structure) is None:
        return False
    if found.structure.drift_degree > structure.drift_degree:
        return True
    longest = max(record.duration for record in records)
    rates = np.abs(scaled_roots(found.model.den[0][0]).real)
    slowest = float(np.min(rates, initial=np.inf))
    ended = found.status in (Status.CONVERGED, Status.POSTERIOR_MEAN)
    return not ended or slowest * longest < SLOW


def _beside_a_drift(
    asked: Request, again: Callable[[Sequence[Record], Structure], Estimate], rate: float
) -> float:
    """Minus two log likelihood of a stable plant beside a disturbance that grows."""
    orders = orders_of(asked.records, asked.structure)
    n, zeros = orders or (0, ())
    with_drift = [_with_drift(one, rate) for one in asked.records]
    structure = Structure(n, [[*zeros, 0]], offset=True, initial_state="free")
    try:
        return _deviance(again(with_drift, structure), with_drift)
    except TridentifyError:  # not even so is there a stable plant
        return np.inf


def _with_drift(record: Record, rate: float) -> Record:
    """A record with an exponential for another input."""
    return Record(
        np.column_stack([record.u, np.expm1(rate * (record.t - record.t[0]))]),
        record.y,
        t=record.t,
        intersample=record.behaviour,
    )


def _error_of_rate(den: Array, cov: Array) -> float:
    """Standard error of the real part of the rightmost pole."""
    n = den.size - 1
    poles = np.roots(den)
    pole = poles[int(np.argmax(poles.real))]
    derivative = np.polyval(np.polyder(den), pole)
    slopes = (-(pole ** np.arange(n - 1.0, -1.0, -1.0)) / derivative).real
    return float(np.sqrt(max(slopes @ cov[:n, :n] @ slopes, 0.0)))


def _deviance(found: Estimate, records: Sequence[Record]) -> float:
    """Minus two log likelihood of the residuals, with AICc's price of noise model and drift."""
    left = [found.residual(record, experiment=e)[:, 0] for e, record in enumerate(records)]
    noise = found.noise_model[0]
    if noise.size:
        left = [whiten(one, noise)[0] for one in left]
    every = np.concatenate(left)
    every = every[np.isfinite(every)]
    least = float(np.log(np.mean(every**2)))
    along = noise.size + found.structure.drift_degree * len(records) + 1.0
    return every.size * least + aicc_price(along, float(every.size))
