"""What moves an output slowly beside its response: a straight drift, or what wanders.

Both pass for noise with a long memory, and what is fitted to white noise follows them with a slow
response. So each side is given the noise that it is likeliest with before they are compared.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tridentify.judgement.advice.outputs import Output, likelier, unlikelihood
from tridentify.judgement.advice.samples import is_slow
from tridentify.judgement.cautions.residual import MEMORIES, memory

SLOWLY = 0.05
"""Standard deviation of a slow disturbance, in that of the output, from which it is told."""

DRIFTS = 10.0
"""Fall of AICc from which a drift is told (odds of 150 to 1)."""


def slow_seen(output: Output) -> tuple[float, bool]:
    """Fall of the criterion that a straight drift brings, and whether a slow disturbance is left.

    What operators at one rate leave of a level or a heading goes on for as long as it does and is
    no disturbance: before any is told, an integrator is tried beside them. A drift that explains
    the record no better than that is none.

    Parameters
    ----------
    output : Output
    """
    level, ramp = _criteria(output)
    fall, wandering = level - ramp, wanders(output)
    if fall <= DRIFTS and not wandering:
        return fall, False
    end = likelier(output.parallel.changed(integrator=True, noise=np.zeros(0)))
    summed = replace(output, parallel=end[0], fit=end[1])
    own, with_ramp = _criteria(summed)
    if own < ramp:
        fall = own - with_ramp
    return fall, wandering and (own > level or wanders(summed))


def _criteria(output: Output) -> tuple[float, float]:
    """Without a drift, and with one."""
    straight = output.parallel.changed(drift=True, noise=np.zeros(0))
    drifting, ramped = likelier(straight)
    ramp = unlikelihood(drifting, ramped)
    level = unlikelihood(output.parallel, output.fit)
    if level > ramp:
        # the search for the noise ends where it ends: that of the other side is tried as well
        same = output.parallel.changed(noise=drifting.noise)
        level = min(level, unlikelihood(same, same.best()))
    return level, ramp


def wanders(output: Output) -> bool:
    """Whether a slow disturbance of some size is left of every record.

    Parameters
    ----------
    output : Output
    """
    records, noise = output.parallel.records, output.parallel.noise
    if max(record.n_samples for record in records) > MEMORIES * memory(noise):
        return False  # noise that comes by often enough to be known
    for record, fitted in zip(records, output.fit.fitted, strict=True):
        y = record.y[:, output.index]
        left = y - fitted
        if np.nanstd(left) < SLOWLY * np.nanstd(y) or not is_slow(record, left):
            return False
    return True
