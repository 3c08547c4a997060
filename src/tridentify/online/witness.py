"""A suspected change, judged by a witness: where a method's own answer cannot be the measure.

A model of the samples since an alarm (`online.suspicion`) would nearly always explain them better
than the coefficients of an equation error, which noise has biased, or those of a gradient rule that
is still on its way, although nothing has changed. So these methods keep their first samples, and
when the first alarm comes they are searched for a *witness*: the coefficients at the minimum for
coloured noise, and their covariance. The plant has changed only if the model of the samples since
the alarm explains them clearly better than the witness does, by likelihood and by both
covariances, *and* better than the present answer: a method that follows coefficients that drift has
nothing to be told. Where there is no witness the present answer stands alone.

The witness learns: from each suspicion that was dropped it takes the new coefficients, weighted by
the two covariances, or in its own place where the plant has drifted and the method has followed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.numerics.arrays import Array
from tridentify.numerics.slices import Slices
from tridentify.online.layout import Setting
from tridentify.online.residual import Refined, is_driven, refined
from tridentify.online.search import FoundPoles, clean_search, first_try, record_of
from tridentify.online.suspicion import (
    LARGER,
    Old,
    differ,
    explains_better,
    is_determined,
    together,
)
from tridentify.record.record import Record


class WitnessVerdict(NamedTuple):
    """What a look at the samples since an alarm has come to.

    Attributes
    ----------
    changed : bool
        Whether they are of another plant.
    witness : Old or None
        Before they are counted in.
    after : Old or None
        With them.
    found : FoundPoles or None
        The model of the samples.
    samples : (k, n_inputs + n_outputs + 1) array
        Without those that are far off.
    """

    changed: bool
    witness: Old | None
    after: Old | None
    found: FoundPoles | None
    samples: Array


class _Model(NamedTuple):
    """A model of kept samples, also for coloured noise."""

    found: FoundPoles
    new: Refined
    record: Record
    samples: Array


def looking(
    setting: Setting,
    beginning: Array,
    begun_anew: bool,
    samples: Array,
    witness: Old | None,
    present: Old | None,
) -> Slices[WitnessVerdict]:
    """Whether the samples since an alarm are of another plant.

    Parameters
    ----------
    setting : Setting
    beginning : (l, n_inputs + n_outputs + 1) array
        The first samples, of which a witness is made where there is none.
    begun_anew : bool
        Whether these begin in the middle, from any state.
    samples : (k, n_inputs + n_outputs + 1) array
        Since the alarm.
    witness : Old or None
    present : Old or None
        The answer at the alarm.
    """
    if witness is None and len(beginning) >= first_try(setting):
        first = yield from _model_of(setting, beginning, begun_anew)
        if first is not None:
            witness = Old(first.new.theta, LARGER * first.new.cov)
    now = yield from _model_of(setting, samples, True)
    if now is None:
        return WitnessVerdict(False, witness, witness, None, samples)
    taken = Old(now.new.theta, LARGER * now.new.cov)
    changed, others = True, [one for one in (witness, present) if one is not None]
    for old in others:
        yield
        changed = changed and explains_better(setting, now.record, old, now.new)
    if not others:
        return WitnessVerdict(False, None, taken, now.found, now.samples)
    moved = differ(others[0], now.new)
    after = taken if moved or witness is None else together(witness, taken)
    return WitnessVerdict(changed and moved, witness, after, now.found, now.samples)


def _model_of(setting: Setting, samples: Array, begun_anew: bool) -> Slices[_Model | None]:
    """A model that samples determine, for white and for coloured noise; None if they do not."""
    try:
        found, left = yield from clean_search(setting, samples, begun_anew)
        if found is None or not found.certain:
            return None
        record = record_of(setting, left)
        yield
        if not is_driven(setting, record, found.estimate.theta):
            return None
        new = yield from refined(setting, record, found.estimate.theta, found.estimate.std)
    except (TridentifyError, np.linalg.LinAlgError):
        return None
    if new is None or not is_determined(setting, new):
        return None
    return _Model(found, new, record, left)
