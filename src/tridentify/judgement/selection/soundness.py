"""Whether an estimate can be recommended at all, and what speaks against it, in words.

No statistics of fit are asked here. A candidate may predict well and still be no model: its pole
may run to the edge of what the sampling or the length of the record shows, a pole may cancel with a
zero within their errors, its leading numerator coefficient may be anything.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.posterior.mean import vagueness
from tridentify.judgement.selection.numbers import share
from tridentify.numerics.arrays import Array
from tridentify.numerics.realization import sort_poles
from tridentify.record.record import Record

CANCELS = "a pole and a zero cancel within their errors"
"""Said by a covariance; the likelihood may refute it (`rule.refuted`)."""

SWING = "beside faster modes, a swing that is slower than the record"
"""Said where `ONE_PERIOD` is not reached; no objection where larger candidates explain no more."""

VAGUE, KNOWN_TO = "poles not determined", " known to "

HALF = 0.5
"""Standard error over natural size from which a coefficient counts as not determined: an interval
of 95 % then holds zero and twice the value."""

MANY_RECORDS = 5.0
"""Time constant over the longest record from which it cannot have been seen: the response has moved
by less than a fifth of the way, a straight line and a constant do as well."""

LASTING = 3.0
"""Decay over the record [nepers] below which a swing is not over at its end: 5 percent are left."""

ONE_PERIOD = 2.0 * np.pi
"""Natural frequency times the record [rad] below which a swing that lasts has not come round once:
beside faster modes it is not told from a drift that the input has no part in."""

WITHIN = 2.0
"""Standard errors of the distance between a pole and a zero within which they cancel."""


def doubts(estimate: Estimate, records: Sequence[Record]) -> tuple[str, ...]:
    """What speaks against recommending an estimate; empty where nothing does.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    """
    longest = max(record.duration for record in records)
    found = []
    if not estimate.status.ok or estimate.status is Status.AT_STABILITY_LIMIT:
        found.append(estimate.status.value)
    slow = slowest(estimate, longest)
    if slow:
        found.append(slow)
    found += undetermined(estimate, longest)
    if not found and _swings_once(estimate, longest):
        found.append(SWING)
    if not found:
        found += cancelling(estimate, longest)
    return tuple(found)


def apart_from_vagueness(found: Sequence[str]) -> tuple[str, ...]:
    """Those of the `doubts` that do not only say how well the record shows the coefficients.

    Examples
    --------
    >>> apart_from_vagueness(["poles not determined", "b1 known to 80 %", "at stability limit"])
    ('at stability limit',)
    """
    return tuple(one for one in found if one not in (VAGUE, SWING) and KNOWN_TO not in one)


def slowest(estimate: Estimate, longest: float) -> str:
    """A time constant that the record cannot have shown, in words; not of poles that are held."""
    if estimate.structure.constrained:
        return ""
    decay = slowest_decay(estimate, longest)
    if decay >= 1.0 / MANY_RECORDS:
        return ""
    if decay < 1e-6:
        return "a pole at the origin"
    return f"a time constant {1.0 / decay:.2g} times the record"


def slowest_decay(estimate: Estimate, longest: float) -> float:
    """Magnitude of the slowest pole [rad/s] times the duration ``longest`` [s] of the record."""
    rates = np.concatenate([np.abs(np.roots(den)) for row in estimate.model.den for den in row])
    return float(np.min(rates, initial=np.inf)) * longest


def _swings_once(estimate: Estimate, longest: float) -> bool:
    """Whether a pair of poles, not the fastest of a channel, swings for less than a period."""
    if estimate.structure.constrained:
        return False
    for row in estimate.model.den:
        for den in row:
            poles = np.roots(den)
            sizes = np.abs(poles) * longest
            slow = (poles.imag > 0) & (sizes < ONE_PERIOD) & (-poles.real * longest < LASTING)
            if np.any(slow & (sizes < sizes.max())):
                return True
    return False


def undetermined(estimate: Estimate, longest: float) -> list[str]:
    """Poles and leading numerator coefficients that the record does not determine, in words."""
    found = []
    structure = estimate.structure
    if structure.shared and not structure.constrained and estimate.model.is_stable:
        den = estimate.model.den[0][0]
        n = den.size - 1
        poles = sort_poles(np.roots(den).astype(np.complex128))
        if vagueness(poles, np.asarray(estimate.cov)[:n, :n], longest) > HALF:
            found.append(VAGUE)
    leading = []
    for i in range(len(estimate.output_names)):
        for j in range(len(estimate.input_names)):
            zeros = structure.zeros_matrix(len(estimate.output_names), len(estimate.input_names))
            start = f"b{zeros[i][j]}"
            names = [one for one in estimate.names if one == start or one.startswith(start + "[")]
            leading += names
    known = {name: estimate.parameters[name] for name in dict.fromkeys(leading)}
    free = [one for one in known.values() if one.std > 0]
    if free and all(one.relative_std > HALF for one in free):
        best = min(free, key=lambda one: one.relative_std)
        found.append(f"{best.name}{KNOWN_TO}{share(best.relative_std)}")
    return found


def cancelling(estimate: Estimate, longest: float) -> list[str]:
    """What says that a pole lies on a zero of every channel, in words; empty where none does."""
    within, close = [], []
    for i in range(len(estimate.output_names)):
        for j in range(len(estimate.input_names)):
            num, den, cov = estimate.channel(i, j)
            if np.trim_zeros(num, "f").size < 2:
                return []
            within.append(_covered(num, den, cov))
            close.append(_close(num, den, longest))
    shared = estimate.structure.shared
    if _in_all(within, shared):
        return [CANCELS]
    if not estimate.structure.constrained and _in_all(close, shared):
        return ["a pole and a zero lie closer together than a record of this length tells apart"]
    return []


def _in_all(on: Sequence[NDArray[np.bool_]], shared: bool) -> bool:
    """Whether one pole is meant in all channels; in any, where each has poles of its own."""
    if shared:
        return bool(np.any(np.all(np.array(on), axis=0)))
    return any(bool(np.any(one)) for one in on)


def _close(num: Array, den: Array, longest: float) -> NDArray[np.bool_]:
    """(n_poles,) whether a slowly decaying pole lies near a zero.

    The response to both together differs from none by ``exp`` of their distance times the length:
    what they do is a slow swing, begun once and not yet over.
    """
    poles, zeros = np.roots(den), np.roots(np.trim_zeros(num, "f"))
    found = np.zeros(poles.size, dtype=bool)
    if not zeros.size:
        return found
    apart = np.min(np.abs(zeros[None, :] - poles[:, None]), axis=1)
    return np.asarray((apart * longest < 1.0) & (np.abs(poles.real) * longest < LASTING))


def _covered(num: Array, den: Array, cov: Array) -> NDArray[np.bool_]:
    """(n_poles,) whether a zero lies on a pole within the errors of their distance."""
    poles, zeros = np.roots(den), np.roots(num)
    if zeros.size != num.size - 1:
        return np.zeros(poles.size, dtype=bool)
    cov = cov[:-1, :-1]
    n = den.size - 1
    found = np.zeros(n, dtype=bool)
    with np.errstate(all="ignore"):
        da = -_powers(poles, n) / np.polyval(np.polyder(den), poles)[:, None]
        db = -_powers(zeros, num.size) / np.polyval(np.polyder(num), zeros)[:, None]
    for k, pole in enumerate(poles):
        nearest = int(np.argmin(np.abs(zeros - pole)))
        row = np.concatenate([da[k], -db[nearest]])
        if not np.all(np.isfinite(row)):
            continue
        spread = float(np.real(row @ cov @ row.conj()))
        found[k] = abs(pole - zeros[nearest]) < WITHIN * np.sqrt(max(spread, 0.0))
    return found


def _powers(roots: NDArray[Any], count: int) -> NDArray[np.complex128]:
    """(n_roots, count) powers, the highest first."""
    return np.asarray(np.power.outer(np.asarray(roots, complex), np.arange(count - 1, -1, -1)))
