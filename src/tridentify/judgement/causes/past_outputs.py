"""Whether past outputs forecast what an input does next, beside its own past: feedback.

`attempts.feedback` looks at what inputs to come explain of an output's residual. A servo or a hand
answers late and slowly, and of a plant that cannot stand by itself the residual is that of a model
which is none (the inverse of the controller), so that nothing is left to be explained. Then the
other direction tells: without feedback the past of an output holds nothing about the input that the
input's own past does not hold, whatever the plant is (Granger 1969).

What is linear and finite about a forecast makes exceptions, and each is kept out:

* A commanded input (held steps, pulses, a few sines) has no surprises, and is not asked. Large
  moves are left out: only the small ones are forecast.
* A sweep or a sum of many sines is told by an output that remembers more of it than the lags do.
  Twice as many lags must leave what it tells, and not tell clearly more than it; and what is found
  in each half of a record must forecast the other one, taken together: a controller stays what it
  is.
* Of an input that is not held, or measured with noise, an output knows what its samples do not say.
  Then outputs to come know far more of it, as the plant answers after it, and past ones must tell
  a good half of that. A smooth one on a floor of noise that follows no output is not asked. The
  output of the same sample does not count: a controller that acts at once answers to it. Nor do
  samples soon after a large move: when it came, an output knows as well.

References: C. Granger, Econometrica 37 (1969) 424-438.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tridentify.estimation.answer.finding import Finding
from tridentify.judgement.causes.attempts.feedback import Inputs
from tridentify.judgement.causes.attempts.fewer import foretold
from tridentify.judgement.causes.sensors.input_floor import carries_noise
from tridentify.judgement.causes.signals.surprises import moved
from tridentify.numerics.arrays import Array
from tridentify.numerics.lagrange import added, span
from tridentify.record.record import Record

CODE = "feedback"

UNDERFLOW = 1e-12
"""Chance below which it is not told how small it is: no noise is Gaussian that far out."""

REMEDY = (
    "Record what the controller was told to follow and give it as reference, open the loop, or "
    "identify by the direct route (ThreeModel(route='direct'); --route direct), whose numbers are "
    "as good as its model of the noise."
)

PAST_INPUTS = 20
"""Samples of each input that it is forecast from; fewer where a record is short."""

PER_INPUT = 10
"""Samples for each of them, at least."""

PAST_OUTPUTS = 6
"""Samples of an output that may tell more."""

FEWEST = 100
"""Small moves of an input that are needed to ask."""

CHANCE = 1e-5
"""p-value, of all pairs of an input and an output together, from which it counts."""

BESIDE_MORE = 1e-3
"""The same beside twice as many past inputs: they cost degrees of freedom."""

REMEMBERS = 1e-6
"""p-value of these, from which an input remembers more of itself than it was asked for: it is
commanded by a rule. In loops it is seldom below 1e-3."""

LEAST_SHARE = 0.03
"""Of the surprises that past outputs must explain: the smallest imperfection of a long record is
significant, and means nothing."""

OF_COMING = 0.6
"""Share of the surprises that past outputs explain, over that which as many to come do, from which
an output tells what it does to the input, and not what the input does between its samples."""


class Told(NamedTuple):
    """How past samples of an output tell what an input does next.

    Attributes
    ----------
    input : int
    share : float
        Of the input's small surprises.
    p_value : float
        Times the number of pairs that were asked.
    """

    input: int
    share: float
    p_value: float


def told_by_past(records: Sequence[Record]) -> list[Told | None]:
    """Which input the past of each output tells.

    Parameters
    ----------
    records : sequence of Record
        Experiments on one system.

    Returns
    -------
    list of Told or None
        One per output; None where the past of the output tells nothing.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u, y = np.zeros(400), np.zeros(400)
    >>> for k in range(1, 400):
    ...     y[k] = 0.9 * y[k - 1] + u[k - 1] + rng.standard_normal()
    ...     u[k] = 0.8 * u[k - 1] - 0.1 * y[k - 1] + 0.3 * rng.standard_normal()
    >>> told_by_past([Record(u, y, dt=0.1)])[0] is None
    False
    >>> told_by_past([Record(rng.standard_normal(400), y, dt=0.1)])
    [None]
    """
    n_outputs, n_inputs = records[0].n_outputs, records[0].n_inputs
    nothing: list[Told | None] = [None] * n_outputs
    if any(record.dt is None for record in records):
        return nothing
    inputs = Inputs.of(records)
    if inputs.commanded:
        return nothing
    found = nothing
    asked = [j for j in range(n_inputs) if not carries_noise(records, j)]
    for i in range(n_outputs):
        seen = [_told(inputs, i, j, n_outputs * n_inputs) for j in asked]
        clear = [one for one in seen if one is not None]
        found[i] = min(clear, key=lambda one: one.p_value, default=None)
    return found


def exchanged(records: Sequence[Record]) -> bool:
    """Whether what is called the output is a command, and what is called the input answers it.

    It moves as commands do, by what its past tells and by large moves alone; its past tells what
    the input does next, and the input foretells nothing of it.

    Parameters
    ----------
    records : sequence of Record
        Of one input and one output; of others it is not told.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u, y = np.repeat(rng.choice([-1.0, 1.0], 50), 8), np.zeros(400)
    >>> for k in range(1, 400):
    ...     y[k] = 0.9 * y[k - 1] + u[k - 1] + 0.05 * rng.standard_normal()
    >>> exchanged([Record(y, u, dt=0.1)]), exchanged([Record(u, y, dt=0.1)])
    (True, False)
    """
    if any(one.n_inputs + one.n_outputs > 2 or np.isnan(one.y).any() for one in records):
        return False
    # what answers is no command, whatever it does between its samples
    held = [one.settled("zoh") for one in records]
    turned = [one._derive(u=one.y, y=one.u) for one in held]
    told = told_by_past(held)[0] is not None and Inputs.of(turned).commanded
    return told and foretold(records, PAST_OUTPUTS) is False


def unless_exchanged(findings: Sequence[Finding], records: Sequence[Record]) -> list[Finding]:
    """Findings; where input and output look exchanged that, in place of what comes of it.

    A command holds its values as a slow sensor does, reacts to nothing, and moves what answers it.

    Parameters
    ----------
    findings : sequence of Finding
    records : sequence of Record
        Of which they were found.
    """
    instead = (CODE, "no-response", "stuck-sensor")
    if not any(one.code in instead for one in findings) or not exchanged(records):
        return list(findings)
    (input_,), (output,) = records[0].input_names, records[0].output_names
    said = Finding(
        "no-response",
        "error",
        f"{output} moves as a command does and {input_} answers it, but what {input_} does tells "
        f"nothing of {output}: input and output look exchanged.",
        f"Take {output} for the input and {input_} for the output, or check the columns.",
        (output,),
    )
    return [said, *(one for one in findings if one.code not in instead)]


def told_finding(told: Told, inputs: Sequence[str], output: str) -> Finding:
    """In words.

    Parameters
    ----------
    told : Told
    inputs : sequence of str
        Names of the inputs.
    output : str
    """
    return Finding(
        CODE,
        "warning",
        f"Past samples of {output} tell {100.0 * told.share:.3g} % of the small moves of "
        f"{inputs[told.input]} that its own past does not tell (by chance "
        f"{max(told.p_value, UNDERFLOW):.1g}{' or less' * (told.p_value < UNDERFLOW)}): the input "
        "reacts to the output (feedback), late or slowly.",
        REMEDY,
        (output,),
    )


def _told(inputs: Inputs, output: int, input_: int, pairs: int) -> Told | None:
    """What the past of one output tells of one input; None where that is nothing."""
    inputs = inputs.at_rest()
    now, known, more, before, after = _columns(inputs, output, input_)
    if now.size < max(FEWEST, 2 * (known.shape[1] + PAST_OUTPUTS)):
        return None
    basis = span(known)
    test = added(now, basis, span(before, basis), now.size)
    if test.p_value * pairs > CHANCE or test.share < LEAST_SHARE:
        return None
    coming = added(now, basis, span(after, basis), now.size)
    if test.share < OF_COMING * coming.share or not _lasts(now, before, basis):
        return None
    older = added(now, basis, span(more, basis), now.size)
    if older.p_value < REMEMBERS and older.share > test.share:
        return None
    longer = span(np.hstack([known, more]))
    if not added(now, longer, span(before, longer), now.size).p_value < BESIDE_MORE:
        return None
    return Told(input_, test.share, min(1.0, test.p_value * pairs))


def _lasts(now: Array, before: Array, basis: Array) -> bool:
    """Whether what past outputs tell in each half of the samples holds in the other one."""
    left, columns = now - basis @ (basis.T @ now), before - basis @ (basis.T @ before)
    middle, gained = now.size // 2, 0.0
    halves = (slice(0, middle), slice(middle, None))
    for own, other in (halves, halves[::-1]):
        slopes = np.linalg.lstsq(columns[own], left[own], rcond=None)[0]
        missed = left[other] - columns[other] @ slopes
        gained += 1.0 - float(missed @ missed) / max(float(left[other] @ left[other]), 1e-300)
    return bool(gained > 0.0)


def _columns(inputs: Inputs, output: int, input_: int) -> tuple[Array, ...]:
    """An input where it moves a little; past ones and older ones, outputs before and to come."""
    records = inputs.records
    count = sum(record.n_samples for record in records)
    most = max(1, min(PAST_INPUTS, count // (PER_INPUT * records[0].n_inputs)))
    first, ahead = max(most, PAST_OUTPUTS), range(-1, -PAST_OUTPUTS, -1)
    level, parts = np.eye(len(records)), []
    for e, (record, own) in enumerate(zip(records, inputs.surprises, strict=True)):
        u = record.u - np.median(record.u, axis=0)
        y = record.y[:, output : output + 1] - np.nanmedian(record.y[:, output])
        before = moved(y, range(1, PAST_OUTPUTS + 1))
        known = np.hstack([moved(u, range(1, most + 1)), np.tile(level[e], (u.shape[0], 1))])
        there = (own[:, input_] != 0.0) & np.isfinite(before).all(axis=1)
        there[:first] = False
        older, after = moved(u, range(most + 1, 2 * most + 1)), np.nan_to_num(moved(y, ahead))
        parts.append([one[there] for one in (u[:, input_], known, older, before, after)])
    return tuple(np.concatenate(group) for group in zip(*parts, strict=True))
