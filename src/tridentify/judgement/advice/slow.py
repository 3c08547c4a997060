"""What moves an output slowly beside its response: a straight drift, or what wanders.

Both pass for noise with a long memory, and what is fitted to white noise follows them with a slow
response. So each side is given the noise that it is likeliest with before they are compared.
"""

from __future__ import annotations

import numpy as np

from tridentify.judgement.advice.outputs import Output, likelier, unlikelihood
from tridentify.judgement.advice.samples import is_slow
from tridentify.judgement.cautions.residual import MEMORIES, memory

SLOWLY = 0.05
"""Standard deviation of a slow disturbance, in that of the output, from which it is told."""


def drift_seen(output: Output) -> float:
    """Fall of the criterion that a straight drift brings.

    Parameters
    ----------
    output : Output
    """
    straight = output.parallel.changed(drift=True, noise=np.zeros(0))
    drifting, ramped = likelier(straight)
    level = unlikelihood(output.parallel, output.fit)
    if level > unlikelihood(drifting, ramped):
        # the search for the noise ends where it ends: that of the other side is tried as well
        same = output.parallel.changed(noise=drifting.noise)
        level = min(level, unlikelihood(same, same.best()))
    return level - unlikelihood(drifting, ramped)


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
