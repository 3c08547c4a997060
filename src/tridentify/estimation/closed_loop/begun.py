"""A loop that is on the move when its record begins: its start drives it as a reference does.

What input and output do from then on, beside what the references make of them, is a free response
of the loop: a function of time that no noise has a part in. Left out of the parallel model of
Step 1 (`driven`) it counts as noise, and where it is many times as large as that, the passes do not
come to rest. A pulse at the first sample, as one more reference, drives operators that span it. It
is an instrument like any other: what it drives tells of the plant.
"""

from __future__ import annotations

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.closed_loop.driven import Driven, driven
from tridentify.estimation.likelihood.thresholds import WORTHWHILE
from tridentify.numerics.arrays import Array
from tridentify.numerics.information import aicc_price
from tridentify.record.record import Record

LEAST = 1e-7
"""Share of a signal below which what is left of it is none: coefficients are known with no more
digits where there is no noise."""


def with_start(records: list[Record]) -> list[Record]:
    """Records with their start among the references, where it moves one of them.

    Parameters
    ----------
    records : list of Record
        With references.

    Examples
    --------
    >>> r = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 20), 10)
    >>> noise = 0.01 * np.random.default_rng(1).standard_normal(200)
    >>> u, fading = 2.0 * r + noise, np.exp(-0.1 * np.arange(200.0))
    >>> [one.n_references for one in with_start([Record(u, r + noise, dt=0.1, reference=r)])]
    [1]
    >>> moving = Record(u - fading, r + fading + noise, dt=0.1, reference=r)
    >>> [one.n_references for one in with_start([moving])]
    [2]
    """
    begun = [_begun(one) for one in records]
    try:
        moved = any(_moves(one, other) for one, other in zip(records, begun, strict=True))
    except TridentifyError:
        return records
    return begun if moved else records


def _begun(record: Record) -> Record:
    """With a pulse at its first sample as one more reference."""
    pulse = np.zeros((record.n_samples, 1))
    pulse[0] = 1.0
    free = (f"start{'_' * k}" for k in range(record.n_samples))
    taken = {*record.input_names, *record.output_names, *record.reference_names}
    return Record(
        record.u,
        record.y,
        t=record.t,
        intersample=record.intersample,
        reference=np.hstack([np.asarray(record.reference), pulse]),
        reference_names=[*record.reference_names, next(one for one in free if one not in taken)],
        reference_intersample=record.reference_behaviour,
        input_names=record.input_names,
        output_names=record.output_names,
        units=record.units,
        name=record.name,
    )


def _moves(record: Record, begun: Record) -> bool:
    """Whether the start clearly moves inputs or outputs beyond what the references do."""
    return _criterion(driven(record, own=True)) - _criterion(driven(begun, own=True)) > WORTHWHILE


def _criterion(part: Driven) -> float:
    """AICc of all signals together, the residual of each taken as white."""
    signals: Array = np.column_stack([part.record.u, part.record.y])
    left = signals - part.columns @ part.weights
    total = 0.0
    for series, own in zip(left.T, signals.T, strict=True):
        seen = np.isfinite(series)
        floor = LEAST**2 * float(own[seen] @ own[seen]) + 1e-300
        count = float(seen.sum())
        total += count * float(np.log((series[seen] @ series[seen] + floor) / count))
        total += aicc_price(part.columns.shape[1], count)
    return total
