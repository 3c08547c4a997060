"""Plants that are not stable in questions that their predictor cannot be asked, refused in words.

The search among stable models has an answer to every question, which is none of such a plant. So
where the predictor cannot be told what is asked, it is told less: each output by itself, nothing
known beforehand, uniform time. Where that shows a pole to the right of zero beyond doubt, and the
stable answer leaves more of that output, the question is refused.

A stable model of a held input without a direct part is a prediction of the output from past inputs.
None leaves less than the innovations, and these are larger than the noise of the output by the
gain of the all-pass filter of the poles to the right of zero. Where that alone is clear, the stable
answer, which may have to be sought over delays, need not be known.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import TridentifyError, UnstablePlantError
from tridentify.estimation.answer.assemble import Request
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.closed_loop.between_samples import Sampling
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.closed_loop.unstable_answer import NotStable, unstable_estimate
from tridentify.estimation.closed_loop.unstable_starts import lagged
from tridentify.estimation.likelihood.thresholds import CLEARLY
from tridentify.record.record import Record
from tridentify.structure import Structure

SURELY = 5.0
"""Standard errors that a pole lies to the right of zero."""
PAST = 20
"""Samples before an innovation of which it is asked whether they tell it."""
BY_CHANCE = 40.0
"""Fall of ``-2 log L`` that the coefficients of a stable answer may take of the innovations, which
are as many as 20 with its starts: twice what they take on the mean."""


@dataclass(frozen=True, eq=False)
class _Shown:
    """An output that shows a pole to the right of zero, by itself.

    Attributes
    ----------
    output : int
    pole : float
        [rad/s].
    variance : float
        Of the noise of the output.
    count : int
        Samples.
    least : float
        Variance that predictions from past inputs leave; 0 where that is not known.
    """

    output: int
    pole: float
    variance: float
    count: int
    least: float

    def clearly(self, left: float, beyond: float = 0.0) -> bool:
        """Whether what a stable answer leaves is clearly more."""
        return bool(left > 0.0 and self.count * np.log(left / self.variance) > CLEARLY + beyond)


def refuse_not_stable(
    asked: Request,
    kind: Sampling,
    loss: bool,
    stable: Callable[[], Estimate],
    say: Callable[[str], None],
) -> Estimate | None:
    """Refuse a plant that is not stable where its predictor cannot be asked.

    Parameters
    ----------
    asked : Request
    kind : {"sampled", "continuous"}
        Of the controller.
    loss : bool
        Whether another loss than squares is minimised.
    stable : callable
        The estimate among stable models.
    say : callable
        Is told what is going on.

    Returns
    -------
    Estimate or None
        The stable one, where it was made to compare; None where there is no doubt.

    Raises
    ------
    UnstablePlantError
    """
    if _in_the_way(asked.records, asked.structure, loss) is None:
        return None
    found = [one for one in _each(asked, kind, say) if one.pole > 0.0]
    if not found:
        return None
    refused = None if loss else next((o for o in found if o.clearly(o.least, BY_CHANCE)), None)
    other = None
    if refused is None:
        with contextlib.suppress(TridentifyError):
            other = stable()
        left = (
            np.full(asked.records[0].n_outputs, np.inf) if other is None else other.noise_variance
        )
        refused = next((o for o in found if o.clearly(float(left[o.output]))), None)
    if refused is None:
        return other
    what = _in_the_way(asked.records, asked.structure, loss, refused.output)
    assert what is not None
    beside, remedy = what
    raise UnstablePlantError(
        f"found a plant that is not stable, with a pole at {refused.pole:+.3g} rad/s, together "
        f"with {beside}; expected a question that its predictor can be asked; {remedy}"
    )


def _in_the_way(
    records: Sequence[Record], structure: Structure, loss: bool, output: int = 0
) -> tuple[str, str] | None:
    """What the predictor of an output cannot be told, and what to do; None if all can be."""
    first = records[0]
    if first.n_outputs > 1:
        name = first.output_names[output]
        return (
            f"{first.n_outputs} outputs",
            f"identify one output at a time, as record.select(outputs=[{name!r}]), with one number "
            "of poles",
        )
    if not structure.shared:
        return "separate denominators", "write one number of poles for all inputs"
    if structure.delay == "free":
        return "a delay that is to be estimated", "write the delay in seconds, or leave it out"
    if structure.priors:
        return "priors", "leave them out, or write fixed= or bounds="
    if any(record.dt is None for record in records):
        return "uneven time", "resample inputs, outputs and references on a uniform step"
    if loss:
        return "a loss other than squares", "write loss='squared'"
    return None


def _each(asked: Request, kind: Sampling, say: Callable[[str], None]) -> list[_Shown]:
    """Each output that shows such a pole."""
    rows = []
    for i in range(asked.records[0].n_outputs):
        structure = _alone(asked.structure, asked.records[0], i)
        records = tuple(_of_output(record, i) for record in asked.records)
        question = replace(asked, records=records, structure=structure)
        parts = [driven(one, between=kind == "continuous") for one in records]
        try:
            # beside a model of the noise nothing is surer, and it takes its time
            found = unstable_estimate(parts, kind, question, False, say)
        except (TridentifyError, np.linalg.LinAlgError):
            continue
        if found is None or found.follows or found.unseen:
            continue
        estimate = found.estimate
        poles = [(value, std) for name, value, std, _ in estimate.derived_rows() if "pole" in name]
        pole = float(np.roots(estimate.model.den[0][0]).real.max())
        std = max((std for value, std in poles if value > 0.0), default=np.inf)
        if pole > SURELY * std:
            variance = float(estimate.noise_variance[0])
            count = sum(one.n_samples for one in records)
            known = all(one.dt is not None for one in asked.records)
            least = _least(found, records, structure) if known else 0.0
            rows.append(_Shown(i, pole, variance, count, least))
    return rows


def _least(found: NotStable, records: Sequence[Record], alone: Structure) -> float:
    """Variance of innovations that their own past and that of the inputs do not tell.

    0 where the output at a sample may follow the input at the same one.
    """
    n_inputs = records[0].n_inputs
    zeros, poles = (np.array(f(1, n_inputs)) for f in (alone.zeros_matrix, alone.poles_matrix))
    direct = bool(np.any(zeros >= poles))
    if direct or any(one.behaviour != "zoh" for one in records):
        return 0.0
    rows, target = [], []
    for left, record in zip(found.innovations, records, strict=True):
        if left.size <= PAST:
            return 0.0
        signals = np.column_stack([left, record.u])
        rows.append(lagged(signals, [range(1, PAST + 1)] * signals.shape[1], PAST))
        target.append(left[PAST:])
    table, told = np.vstack(rows), np.concatenate(target)
    whole = np.isfinite(told) & np.isfinite(table).all(axis=1)
    freedom = int(whole.sum()) - table.shape[1]
    if freedom <= table.shape[1]:
        return 0.0
    matrix, wanted = table[whole], np.asarray(told[whole], dtype=np.float64)
    matrix = matrix / (np.linalg.norm(matrix, axis=0) + 1e-300)
    rest = wanted - matrix @ np.linalg.lstsq(matrix, wanted, rcond=1e-12)[0]
    return float(np.sum(rest**2) / freedom)


def _alone(structure: Structure, first: Record, i: int) -> Structure:
    """One output with one denominator that is rich enough for all of its inputs."""
    shape = first.n_outputs, first.n_inputs
    zeros = structure.zeros_matrix(*shape)[i]
    own = structure.poles_matrix(*shape)[i]
    n = structure.common_poles if structure.shared else sum(own)
    more = [0] * len(own) if structure.shared else [n - one for one in own]
    free = structure.delay == "free"
    return Structure(
        n,
        [[m + extra for m, extra in zip(zeros, more, strict=True)]],
        delay=0.0 if free else [structure.delay_matrix(*shape)[i]],
        drift=structure.drift is True,
    )


def _of_output(record: Record, i: int) -> Record:
    """With one output, on uniform time."""
    t = record.t
    between, driving = record.behaviour, record.reference_behaviour or "zoh"
    if record.dt is not None:
        u, y, r = record.u, record.y[:, [i]], record.reference
        return Record(
            u, y, dt=record.dt, reference=r, intersample=between, reference_intersample=driving
        )
    even = np.linspace(t[0], t[-1], t.size)
    before = np.maximum(np.searchsorted(t, even, side="right") - 1, 0)
    seen = np.isfinite(record.y[:, i])
    y = np.interp(even, t[seen], record.y[seen, i])
    reference = np.asarray(record.reference)[before]
    return Record(
        record.u[before], y, dt=float(even[1] - even[0]), reference=reference,
        intersample=between, reference_intersample=driving,
    )  # fmt: skip
