"""Whether a known controller worked on samples or continuously: which explains the recorded input.

A controller that is given in continuous time may have been run by a computer, by one of the usual
rules. Then the recorded input follows from the recorded output, sample by sample, without a model
of the plant. If it was continuous, what it did between the samples is that of the loop
(`innovations`). Either way the start of the controller is free, and a constant beside it. If
neither explains the input, the controller is not the one that was given: it has a limit, a delay,
or other coefficients.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Sampling
from tridentify.estimation.closed_loop.innovations import ContinuousLoop
from tridentify.estimation.closed_loop.most_likely import Likelihood
from tridentify.estimation.closed_loop.simulated import ENTRIES
from tridentify.models.simulate import free_responses
from tridentify.numerics.arrays import Array
from tridentify.record.record import Record
from tridentify.transfer_function import TransferFunction

Rule = Literal["bilinear", "zoh", "euler", "backward_diff"]

RULES: dict[Rule, str] = {
    "bilinear": "trapezoids",
    "zoh": "a held input",
    "euler": "forward differences",
    "backward_diff": "backward differences",
}
"""Rules by which controllers are sampled, as scipy and as people call them."""
EXACT = 1e-6
"""Share of the moving input up to which a rule is its own: recorded numbers have more digits."""
CLEARLY = 0.2
"""Share of the misfit of a continuous controller below which a sampled one is believed: where noise
moves between the samples, neither leaves nothing."""
SEEN = 0.1
"""Share of the moving input up to which a rule is believed where there is no loop to compare."""
STEPS = 4
"""Of Gauss-Newton on what is left of the input."""
LEFT = 0.1
"""Share of what the references do not drive that may be left of the input. A loop as it was given
leaves a hundredth; one with a limit that a hundredth of the samples meet, more than a tenth."""


@dataclass(frozen=True)
class Worked:
    """How a known controller worked.

    Attributes
    ----------
    sampling : {"sampled", "continuous"}
    rule : str
        By which it was sampled; empty if it was not.
    left : float
        What is left of the input, as a share of what the references do not drive.
    """

    sampling: Sampling
    rule: str
    left: float

    @property
    def explains(self) -> bool:
        """Whether it made the recorded input."""
        return self.left < LEFT

    @property
    def exact(self) -> bool:
        """Whether it made the input to the last digits."""
        return self.left < EXACT

    @property
    def seen(self) -> bool:
        """Whether the input alone shows it."""
        return self.left < SEEN

    @property
    def words(self) -> str:
        """How it is told."""
        how = f"sampled by the rule of {self.rule}" if self.rule else "continuous"
        return f"controller as given, {how}: {self.left:.2g} of the noise in the input is left"


def sampled_by(records: Sequence[Record], controller: TransferFunction) -> Worked:
    """The rule that comes nearest to recorded inputs, without a model of the plant.

    What is left is a share of all that moves of the inputs.

    Parameters
    ----------
    records : sequence of Record
        On uniform time, without missing outputs.
    controller : TransferFunction
    """
    size = sum(_beside(np.asarray(one.u)[:, 0], np.ones((one.n_samples, 1))) for one in records)
    found = {rule: sum(_sampled(one, controller, rule) for one in records) for rule in RULES}
    best = min(found, key=lambda rule: found[rule])
    return Worked("sampled", RULES[best], float(np.sqrt(found[best] / size)))


def worked(
    loops: Sequence[ContinuousLoop], likelihood: Likelihood, theta: Array, rule: Worked
) -> Worked:
    """How the controller worked that made the inputs of records.

    Parameters
    ----------
    loops : sequence of ContinuousLoop
    likelihood : Likelihood
        Of these loops.
    theta : (n,) array
        An estimate of the coefficients; near it, those count with which least is left.
    rule : Worked
        As `sampled_by` says.
    """
    plant = likelihood.model(theta)
    size = sum(_beside(one.undriven(plant), np.ones((one.record.n_samples, 1))) for one in loops)
    moving = sum(
        _beside(np.asarray(one.record.u)[:, 0], np.ones((one.record.n_samples, 1))) for one in loops
    )
    smooth = np.sqrt(_least(loops, likelihood, theta) / size)
    steps = rule.left * np.sqrt(moving / size)
    if steps < CLEARLY * smooth:
        return replace(rule, left=float(steps))
    return Worked("continuous", "", float(smooth))


def _least(loops: Sequence[ContinuousLoop], likelihood: Likelihood, theta: Array) -> float:
    """Sum of squares that a continuous controller leaves of the inputs, near an estimate."""
    least = np.inf
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            ends = []
            for j in (None, *np.flatnonzero(likelihood.free)):
                moved = np.array(theta)
                if j is not None:
                    moved[j] += likelihood.scale[j] / 10.0
                plant, rests = likelihood.model(moved), likelihood.rests(moved)
                if len(rests) != len(loops):
                    return least
                left = [one.input_left(plant, rest) for one, rest in zip(loops, rests, strict=True)]
                ends.append(
                    np.concatenate([_alone(one, own) for one, own in zip(loops, left, strict=True)])
                )
            if not np.isfinite(ends).all():
                return least
            least = min(least, float(ends[0] @ ends[0]))
            slopes = np.column_stack(ends[1:]) - ends[0][:, None]
            change = -np.linalg.lstsq(slopes, ends[0], rcond=1e-10)[0] / 10.0
            theta = np.array(theta)
            theta[likelihood.free] += change * likelihood.scale[likelihood.free]
    return least


def _alone(loop: ContinuousLoop, left: Array) -> Array:
    """Without a constant, and whatever the controller may have begun with."""
    columns, den = np.ones((len(left), 1)), loop.controller.den[0][0]
    if den.size > 1:
        columns = np.hstack([columns, free_responses(den, loop.record)])
    return _rest(left, columns)


def _sampled(record: Record, controller: TransferFunction, rule: Rule) -> float:
    """Sum of squares that a rule leaves of the input."""
    # slow to import, seldom needed
    from scipy.signal import cont2discrete, lfilter

    made = cont2discrete(
        (controller.num[0][0], controller.den[0][0]), float(record.dt or 0.0), method=rule
    )
    b, a = np.ravel(made[0]), np.ravel(made[1])
    reference = np.asarray(record.reference)
    pulse = np.eye(1, record.n_samples)[0]
    starts = [lfilter(np.eye(1, k + 1, k)[0], a, pulse) for k in range(a.size - 1)]
    columns = np.column_stack([*starts, np.ones(record.n_samples)])
    best = np.inf
    for entries in product(ENTRIES, repeat=reference.shape[1]):
        outside = reference @ np.array([one == "input" for one in entries], dtype=float)
        point = reference @ np.array([one == "set point" for one in entries], dtype=float)
        made_of = lfilter(b, a, point - np.asarray(record.y)[:, 0])
        best = min(best, _beside(np.asarray(record.u)[:, 0] - outside - made_of, columns))
    return best


def _beside(left: Array, columns: Array) -> float:
    rest = _rest(left, columns)
    return float(rest @ rest) if np.isfinite(rest).all() else np.inf


def _rest(left: Array, columns: Array) -> Array:
    if not (np.isfinite(left).all() and np.isfinite(columns).all()):
        return np.full(len(left), np.nan)
    scaled = columns / (np.linalg.norm(columns, axis=0) + 1e-300)
    return np.asarray(left - scaled @ np.linalg.lstsq(scaled, left, rcond=1e-10)[0])
