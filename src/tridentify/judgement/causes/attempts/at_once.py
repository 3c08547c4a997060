"""Whether a gain alone explains a record as well as a first-order lag.

Under an input that moves slowly, a ramp or a slow wave, a lag shifts the output by its time
constant and does no more. Where that is small beside the noise, any short time constant fits, and
the number found is what the prior of a short record makes of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.attempts.first_samples import Predictions, beginning
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten
from tridentify.record.record import Record

LONGEST = 5_000
"""Samples of each record that are compared."""

PRICE = 4.0
"""Of an unknown, in ``-2 log L``: two standard errors, less than which tells no time constant."""


def gain_findings(
    estimate: Estimate, records: Sequence[Record], known: Predictions
) -> list[Finding]:
    """A word where the one pole of a structure explains nothing.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    known : Predictions
        Of the estimate.
    """
    given = estimate.structure
    if given.poles != 1 or given.delay == "free" or any(record.dt is None for record in records):
        return []
    short = [beginning(record, LONGEST) for record in records]
    names = [
        name for i, name in enumerate(estimate.output_names) if _alone(estimate, short, known, i)
    ]
    if len(names) < len(estimate.output_names):
        return []
    return [
        Finding(
            "outside-the-record",
            "warning",
            f"A gain alone, without any lag, explains {', '.join(names)} as well: the record tells "
            "no time constant, only that it is short beside how fast the input moves. The value "
            "that is given, its error included, rests on what is usual and not on the record.",
            "Take the static gain (dc_gain), or record steps or a faster input for the time "
            "constant.",
            tuple(names),
        )
    ]


def _alone(estimate: Estimate, records: Sequence[Record], known: Predictions, output: int) -> bool:
    """Whether a gain from each input, and a level a record, leave as little of one output."""
    noise = estimate.noise_model[output]
    left, targets, tables = 0.0, [], []
    for e, record in enumerate(records):
        y = record.y[:, output]
        own = np.zeros((y.size, len(records)))
        own[:, e] = 1.0
        missing = np.where(np.isfinite(y), 0.0, np.nan)
        columns = [record.u[:, j] + missing for j in range(record.n_inputs)]
        white = [_seen(one, noise) for one in (y, known.residual(record, e)[:, output])]
        targets.append(white[0])
        left += float(np.sum(white[1] ** 2))
        tables.append(
            np.column_stack([_seen(one, noise) for one in [*columns, *(own.T + missing)]])
        )
    table, target = np.vstack(tables), np.concatenate(targets)
    found = np.linalg.lstsq(table, target, rcond=1e-10)[0]
    alone = float(np.sum((target - table @ found) ** 2))
    return left > 0.0 and alone < left * float(np.exp(PRICE / target.size))


def _seen(series: Array, noise: Array) -> Array:
    white = whiten(series, noise)[0]
    return np.asarray(white[np.isfinite(white)])
