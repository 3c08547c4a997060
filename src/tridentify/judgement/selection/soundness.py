"""Whether an estimate can be recommended at all, and what speaks against it, in words.

No statistics of fit are asked here. A candidate may predict well and still be no model: its pole
may run to the edge of what the sampling or the length of the record shows, a pole may cancel with a
zero within their errors, its leading numerator coefficient may be anything.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.answer.cancelling import LASTING, cancelling
from tridentify.estimation.answer.estimate import Estimate, Status
from tridentify.estimation.posterior.mean import vagueness
from tridentify.judgement.cautions.coefficients import over_within
from tridentify.judgement.selection.numbers import share
from tridentify.judgement.selection.orders import is_integrator
from tridentify.numerics.realization import sort_poles
from tridentify.record.record import Record

SWING = "beside faster modes, a swing that is slower than the record"
"""Said where `ONE_PERIOD` is not reached; no objection where larger candidates explain no more."""

FAST = "a pole whose response is over within a sample"
"""Said of one beside others where the next sample hardly shows it: where it explains anything, it
mends what the input is taken for between the samples."""

VAGUE, KNOWN_TO = "poles not determined", " known to "

HALF = 0.5
"""Standard error over natural size from which a coefficient counts as not determined: an interval
of 95 % then holds zero and twice the value."""

MANY_RECORDS = 5.0
"""Time constant over the longest record from which it cannot have been seen: the response has moved
by less than a fifth of the way, a straight line and a constant do as well."""

ONE_PERIOD = 2.0 * np.pi
"""Natural frequency times the record [rad] below which a swing that lasts has not come round once:
beside faster modes it is not told from a drift that the input has no part in."""


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
    if _is_beside_others(estimate) and over_within(estimate, records) is not None:
        found.append(FAST)
    found += undetermined(estimate, longest)
    if not found and _swings_once(estimate, longest):
        found.append(SWING)
    if not found:
        found += cancelling(estimate, longest)
    return tuple(found)


def _is_beside_others(estimate: Estimate) -> bool:
    """Whether a pole can be left out: none is alone, and none is held, but at zero."""
    held = int(is_integrator(estimate.structure))
    alone = any(den.size < 3 + held for row in estimate.model.den for den in row)
    return not alone and bool(held or not estimate.structure.constrained)


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
    every = estimate.parameters
    known = {name: every[name] for name in dict.fromkeys(leading)}
    free = [one for one in known.values() if one.std > 0]
    if free and all(one.relative_std > HALF for one in free):
        best = min(free, key=lambda one: one.relative_std)
        found.append(f"{best.name}{KNOWN_TO}{share(best.relative_std)}")
    return found
