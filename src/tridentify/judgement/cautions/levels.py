"""Whether the answer hangs on what a record is counted from: its trim, and its state at the start.

Where an input moves little beside its level, that level over that of the output passes for a
gain: ``y = G(0) u`` explains two constants without an offset, and any gain does with one. Which of
them holds, and how the system was moving at the first sample, is decided by AICc where the
structure leaves it open. A standard error is that of the choice that was made. So where another
choice is about as likely, the model is fitted under that one too, and what moves is told.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.setup.nuisance import Nuisances
from tridentify.judgement.causes.attempts.attempt import Attempt
from tridentify.judgement.causes.attempts.revisit import stated
from tridentify.judgement.cautions.remedies import fitted_again
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record

STANDS = 1.5
"""Level of an input over its movement about it [standard deviations] from which it stands rather
than moves; 1 for an input that is switched on and off as long, 2 and more for a step in the first
fifth of a record, where the response to it and a start of its own look alike."""

TIED = 6.0
"""Difference of AICc up to which two choices are about as likely: odds of 20 to 1."""

APART = 3.0
"""Movement [standard errors] from which a coefficient hangs on the choice."""

NOTABLY = 0.1
"""The same, as a share of its value."""

CHOICE = re.compile(r"initial state (\w+), (no offset|offset)(, drift)? ([+-]\d[\d.e+]*)")
"""One choice and its difference of AICc, as a decision of the trace has it."""


def level_findings(estimate: Estimate, records: Sequence[Record]) -> list[Finding]:
    """A word where another trim or start explains a record at rest as well, with other numbers.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    """
    others = _others(estimate)
    standing = max((_standing(record) for record in records), key=lambda one: one[1])
    if not others or standing[1] <= STANDS:
        return []
    base = fitted_again(estimate, records)
    if base is None:
        return []
    found = [(fitted_again(estimate, records, one), one) for one in others]
    tied = [
        (end, one)
        for end, one in found
        if end is not None and end.criterion < base.criterion + TIED and _apart(estimate, end).any()
    ]
    if not tied:
        return []
    own = stated(estimate)
    end, choice = min(tied, key=lambda pair: pair[0].criterion)
    names, moved, values, elsewhere = _compared(estimate, end)
    size, n = np.where(_apart(estimate, end), np.abs(moved), 0.0), coefficients(end.point).size
    k = int(np.argmax(size[:n] if size[:n].any() else size))
    more = end.criterion - base.criterion
    return [
        Finding(
            "not-determined",
            # a test mostly begins at rest, somewhere
            "note" if own.initial_state == "rest" and own.offset else "warning",
            f"Input {standing[0]} moves little beside its level, which is {standing[1]:.2g} times "
            "as large, so that trim and start decide the answer: "
            f"{choice.label} explains the record as well (AICc {more:+.1f}), with other "
            "coefficients. The standard errors hold for the choice that was made "
            f"({own.label}).",
            "State offset and initial_state (--offset, --initial-state) if they are known, or use "
            "a stretch in which the input moves the system.",
            effect=f"With the other: {names[k]} from {values[k]:.4g} to {elsewhere[k]:.4g} "
            f"({size[k]:.1f} standard errors).",
        )
    ]


def _others(estimate: Estimate) -> list[Nuisances]:
    """Choices about as likely as the one that was made, as the method saw it."""
    found = []
    for told in estimate.trace.about(DecisionKind.INITIAL_STATE):
        _, lowest, listed = told.partition(": lowest AICc (")
        for state, offset, drift, more in CHOICE.findall(listed) if lowest else ():
            if float(more) < TIED:
                found.append(Nuisances(state, offset == "offset", bool(drift)))
    return found


def _standing(record: Record) -> tuple[str, float]:
    """The input that moves least beside its level, and the level over its standard deviation.

    An input that never moves is told of elsewhere.
    """
    level, moves = np.abs(record.u.mean(axis=0)), record.u.std(axis=0)
    ratios = np.divide(level, moves, out=np.zeros_like(level), where=moves > 0.0)
    k = int(np.argmax(ratios))
    return record.input_names[k], float(ratios[k])


class _Compared(NamedTuple):
    """Coefficients and static gains, of the estimate and with another choice."""

    names: tuple[str, ...]
    moved: Array
    """[standard errors]"""
    values: Array
    others: Array


def _compared(estimate: Estimate, end: Attempt) -> _Compared:
    found = coefficients(end.point)
    n = found.size
    own, other = (_gains(estimate, one) for one in (estimate.theta, found))
    # a gain may be known where the coefficients that make it are not
    gains = [one for one in estimate.derived() if one.name.startswith("dc gain")]
    names = (*estimate.names[:n], *(one.name for one in gains))
    values = np.concatenate([estimate.theta[:n], own])
    others = np.concatenate([found, other])
    std = np.concatenate([estimate.std[:n], [one.std for one in gains]])
    moved = (others - values) / np.where(std > 0, std, np.inf)
    return _Compared(names, np.nan_to_num(moved), values, others)


def _gains(estimate: Estimate, theta: Array) -> Array:
    """Static gains of all channels for some coefficients, as `Estimate.derived` orders them."""
    found = []
    whole = np.concatenate([theta, estimate.theta[theta.size :]])[None]
    for i in range(len(estimate.output_names)):
        for j in range(len(estimate.input_names)):
            num, den, _ = estimate.channel_draws(whole, i, j)
            with np.errstate(divide="ignore", invalid="ignore"):  # an integrator has none
                found.append(num[0, -1] / den[0, -1])
    return np.asarray(np.nan_to_num(np.array(found), posinf=0.0, neginf=0.0))


def _apart(estimate: Estimate, end: Attempt) -> NDArray[np.bool_]:
    """Whether each of `_compared` hangs on the choice."""
    _, moved, values, others = _compared(estimate, end)
    return np.asarray(
        (np.abs(moved) > APART) & (np.abs(others - values) > NOTABLY * np.abs(values))
    )
