"""The input between its samples: held, joined by lines, or band-limited, compared by likelihood.

An input that moves at every sample and is taken as held acts half a step late and without its
curvature; the coefficients make up for it, and their standard errors know nothing of it. The
behaviours have as many unknowns, so that ``-2 log L`` alone compares them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.decision import DecisionKind, KnownDecision
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.cost import Point, evaluate
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt
from tridentify.judgement.causes.attempts.revisit import point_of, stated, without_outliers
from tridentify.numerics.arrays import Array
from tridentify.numerics.interpolation import FEWEST
from tridentify.record.checks.samples import Behaviour, is_switched
from tridentify.record.record import Record

BEHAVIOURS: tuple[Behaviour, ...] = ("zoh", "foh", "band-limited")

AUTO = ", or 'auto'"
"""What stands beside a behaviour that is advised where one was stated."""

IN_WORDS = {
    "zoh": "held between its samples (zoh)",
    "foh": "joined by straight lines (foh)",
    "band-limited": "band-limited",
}

LONGEST = 20_000
"""Samples of each record that are compared: more would not change a clear answer. A sine that
sweeps upwards, a record of ten thousand samples, shows it in its second half alone."""

HOPELESS = 10.0
"""-2 log L above the present one, as a first step promises, from which a behaviour is not followed
up where the noise has a model: fitted with the present behaviour, it speaks for it."""

CLEARLY = 10.0
"""Fall of -2 log L (odds of 150 to 1) from which another behaviour is worth a word."""

MATERIAL = 0.01
"""The same a sample, about the share by which the residual's variance falls: in a long record whose
residual is what the model misses, a small difference is no evidence, however many samples."""

MATERIAL_STAIRCASE = 0.03
"""The same where the input repeats its values."""

TIE = 2.0
"""Fall of -2 log L below which nothing speaks against what the samples suggest."""

REPEATS = 0.5
"""Share of steps without movement from which an input is a staircase: exact repeats do not happen
in a measured signal, so that it takes a clear answer not to call it held, and it is never
band-limited."""

SLOPES = 0.75
"""Share of an input's moves that go on in the direction of a neighbouring one, from which it moves
on slopes: none of the moves of a command that is held for two samples and more does, and seven of
twelve where its levels come by chance."""

UNDECIDED = 6.0
"""Rise of -2 log L (odds of 20 to 1) up to which a behaviour that nobody stated is one of two."""

LEANS = 3.0
"""Fall of -2 log L (odds of 4 to 1) from which a record leans to another behaviour than the one
stated: to be told where much hangs on it."""

HANGS_ON_IT = 3.0
"""Movement of a coefficient [standard errors] from which much hangs on an open question."""

NOTABLY = 0.02
"""The same as a share of its natural size: less is no matter, however well it is known."""

MATTERS = 1.0
"""Movement of a coefficient [standard errors] from which it is a warning and not a note."""

SLOW = 1.0
"""Size of all poles times the sampling interval, below which a plant that answers within a sample
does so since its input moved there. The inverse of a controller that acts at once answers by poles
that are over within a sample, or that turn as fast as it: of 18 loops lines looked likelier in 14,
with a pole of 1.6 and more in each."""

FIT_LOST = 1.0
"""Fit [percent] that another behaviour may cost an output and still be advised: where it costs
more, its likelihood is that of a noise model that takes the response for noise."""


@dataclass(frozen=True, eq=False)
class Behaviours:
    """Every behaviour that the records allow, compared.

    Attributes
    ----------
    present : str
        That of the estimate.
    above : dict of str to float
        Behaviour -> by how much its ``-2 log L`` is higher than that of the present one; of those
        that are hopeless as the first step promises.
    attempts : dict of str to Attempt
        Those that were fitted; the present one among them where any was.
    staircase : bool
        Whether the inputs seem to be held (`seems_held`), or one is switched.
    count : int
        Samples of all outputs.
    stated : bool
        Whether the present one was stated, and not found.
    searched : dict of str to (n_coefficients,) array
        Coefficients of those that were searched for by themselves, each with its own model of the
        noise: AICc compares these, and takes the place of ``-2 log L`` in `above`.
    """

    present: Behaviour
    above: dict[Behaviour, float]
    attempts: dict[Behaviour, Attempt]
    staircase: bool
    count: int
    stated: bool = False
    searched: Mapping[Behaviour, Array] = field(default_factory=dict)

    @property
    def clearly(self) -> float:
        """Fall of ``-2 log L`` from which another behaviour is clearly better."""
        return clear_fall(self.count, self.staircase)

    @property
    def best(self) -> Behaviour:
        """The one of highest likelihood."""
        return min(self.above, key=lambda one: self.above[one])

    def fall(self, one: Behaviour, other: Behaviour) -> float:
        """By how much ``-2 log L`` is lower with one than with another."""
        return self.above[other] - self.above[one]

    @property
    def advised(self) -> Behaviour:
        """The best one where it is clearly better and costs no output its fit, else the present."""
        if self.best == self.present or self.fall(self.best, self.present) < self.clearly:
            return self.present
        gained = np.subtract(self.attempts[self.best].fits, self.attempts[self.present].fits)
        return self.present if np.min(gained) < -FIT_LOST else self.best

    def ended(self, one: Behaviour) -> Array | None:
        """Coefficients with a behaviour; None where it is hopeless."""
        if one in self.searched:
            return self.searched[one]
        return coefficients(self.attempts[one].point) if one in self.attempts else None

    def in_words(self) -> KnownDecision:
        """What the present behaviour has over the others."""
        others = [
            f"with {other} it is {abs(more):.3g} {'higher' if more > 0 else 'lower'}"
            for other, more in self.above.items()
            if other != self.present
        ]
        by = "AICc, each with its own noise model" if self.searched else "-2 log L"
        told = f" (of {by}: {', '.join(others)})" if others else ""
        return taken_as(self.present, told)


def taken_as(behaviour: str, why: str = "") -> KnownDecision:
    """That an input was taken to behave so between its samples.

    Parameters
    ----------
    behaviour, why : str
    """
    return DecisionKind.INPUT_TAKEN.told(f" {IN_WORDS[behaviour]}{why}")


def behaviours(estimate: Estimate, records: Sequence[Record]) -> Behaviours | None:
    """Compare the behaviours of the inputs, from where an estimate ended.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.

    Returns
    -------
    Behaviours or None
        None where there is nothing to compare: inputs that never move, a structure with
        constraints, an estimate that is not usable.

    Notes
    -----
    One Gauss-Newton step says what each behaviour promises; only where another one comes near the
    present one are both fitted, each with a noise model of its own.
    """
    first = records[0].behaviour
    alike = all(record.behaviour == first for record in records)
    if not (alike and estimate.status.ok and not estimate.structure.constrained):
        return None
    if not any(np.ptp(record.u, axis=0).any() for record in records):
        return None
    looked_at = [_beginning(record) for record in without_outliers(estimate, records)]
    try:
        point = point_of(estimate, looked_at, stated(estimate))
        problem, poles, here = point.problem, point.poles, _promised(point)
        switched = any(is_switched(record.u) for record in looked_at)
        repeats = switched or is_staircase(looked_at)
        steps = switched or seems_held(looked_at)
        above: dict[Behaviour, float] = {first: 0.0}
        for behaviour in BEHAVIOURS:
            limited = behaviour == "band-limited"
            if behaviour == first or (limited and (repeats or not _allows_band_limited(problem))):
                continue
            above[behaviour] = _promised(evaluate(_with(problem, behaviour), poles)) - here
    except (TridentifyError, np.linalg.LinAlgError, FloatingPointError):
        return None
    count = sum(int(np.isfinite(e.y).sum()) for e in problem.experiments)
    orders = [a.size for a in problem.noise] or [0] * problem.n_outputs
    limit = HOPELESS if any(orders) else -TIE if steps else UNDECIDED
    near = [one for one, more in above.items() if one == first or more < limit]
    if near == [first]:
        return Behaviours(first, above, {}, steps, count)
    tried = {one: attempt(_with(problem, one), [poles], orders) for one in near}
    fitted = {one: end for one, end in tried.items() if end is not None}
    if first not in fitted:
        return None
    above |= {one: end.deviance - fitted[first].deviance for one, end in fitted.items()}
    return Behaviours(first, above, fitted, steps, count)


def moves_between(estimate: Estimate, records: Sequence[Record]) -> bool:
    """Whether inputs that are taken as held moved between their samples.

    An output then tells what the input of the same sample is, as one that a controller acts on
    does. A controller makes lines look likelier, too, but as its own inverse.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified.
    """
    if estimate.route != "open-loop" or any(one.dt is None for one in records):
        return False
    found = behaviours(estimate, records)
    if found is None or found.present != "zoh" or found.advised == "zoh":
        return False
    fastest = float(np.abs(found.attempts[found.advised].point.poles).max(initial=0.0))
    return all(fastest * one.dt < SLOW for one in records if one.dt is not None)


def _promised(point: Point) -> float:
    """``-2 log L`` that a Gauss-Newton step leads to expect, the noise model held."""
    return point.objective - point.decrease()


def better_behaviour(found: Behaviours, suggested: Behaviour) -> Behaviour:
    """What to use where nothing was stated.

    Parameters
    ----------
    found : Behaviours
    suggested : str
        By the samples alone (`Record.behaviour`): kept where the likelihoods are equal.
    """
    best, least = found.best, found.clearly if found.staircase else TIE
    clear = suggested not in found.above or found.fall(best, suggested) >= least
    return best if clear else suggested


def clear_fall(count: int, staircase: bool) -> float:
    """Fall of ``-2 log L`` from which another behaviour is clearly better.

    Parameters
    ----------
    count : int
        Samples of all outputs.
    staircase : bool
        Whether the inputs repeat their values.

    Examples
    --------
    >>> clear_fall(500, True), clear_fall(2000, True), clear_fall(2000, False)
    (15.0, 60.0, 20.0)
    """
    return max(CLEARLY, (MATERIAL_STAIRCASE if staircase else MATERIAL) * count)


def is_staircase(records: Sequence[Record]) -> bool:
    """Whether the inputs repeat their values exactly at most samples.

    Examples
    --------
    >>> is_staircase([Record([0, 1, 1, 1, 1], np.zeros(5), dt=1.0)])
    True
    """
    moved = [np.any(np.diff(record.u, axis=0) != 0.0, axis=1) for record in records]
    return float(np.mean(np.concatenate(moved))) < REPEATS


def seems_held(records: Sequence[Record]) -> bool:
    """Whether the inputs repeat their values at most samples, and do not move on slopes.

    What was set moves from one level to the next within a sample. An actuator that takes its time
    was measured on the way; a ramp that was set step by step looks the same, so that the likelihood
    has to tell.

    Examples
    --------
    >>> held, moved = [0, 0, 0, 2, 2, 2, 0, 0, 0], [0, 0, 0, 1, 2, 2, 2, 2, 2]
    >>> [seems_held([Record(u, np.zeros(9), dt=1.0)]) for u in (held, moved)]
    [True, False]
    """
    return is_staircase(records) and not _on_slopes(records)


def needed_fall(records: Sequence[Record], count: int) -> float:
    """Fall of ``-2 log L`` from which another behaviour is used than the samples suggest.

    Parameters
    ----------
    records : sequence of Record
    count : int
        Samples of all outputs.
    """
    return clear_fall(count, True) if seems_held(records) else TIE


def _on_slopes(records: Sequence[Record]) -> bool:
    """Whether every input that moves goes on as it went at most of its moves."""
    steps = [np.diff(record.u, axis=0) for record in records]
    moves = np.sum([np.sum(own != 0.0, axis=0) for own in steps], axis=0)
    going = np.sum([_going_on(own) for own in steps], axis=0)
    return bool(moves.any() and np.all(going >= SLOPES * moves))


def _going_on(steps: Array) -> Array:
    """(n_inputs,) moves in the direction of the one before or after."""
    alike = np.sign(steps[1:]) * np.sign(steps[:-1]) > 0.0
    none = np.zeros((1, steps.shape[1]), dtype=bool)
    beside = np.concatenate([none, alike]) | np.concatenate([alike, none])
    return np.asarray(np.sum(beside, axis=0))


def in_doubt(found: Behaviours, estimate: Estimate) -> list[Behaviour]:
    """Behaviours to be searched for by themselves before one is taken.

    They were compared with noise models of the present one's order, and from the poles where it
    ended. Where the noise has memory that speaks for the present one; it is no matter where the
    answer is clear, or nothing hangs on it.

    Parameters
    ----------
    found : Behaviours
    estimate : Estimate
        With the present behaviour.
    """
    if found.staircase or not any(a.size for a in estimate.noise_model):
        return []
    return [
        one
        for one in found.attempts
        if one != found.present
        and found.above[one] < HOPELESS
        and _hanging(found, one, estimate) is not None
    ]


def _hanging(found: Behaviours, other: Behaviour, estimate: Estimate) -> tuple[int, float] | None:
    """The coefficient that hangs most on which of two it is, and by how many standard errors."""
    before, after = found.ended(found.present), found.ended(other)
    if before is None or after is None:
        return None
    std = np.where(estimate.std > 0, estimate.std, np.inf)
    sizes = np.abs(after - before) / std
    sizes = np.where(np.abs(after - before) > NOTABLY * np.abs(before), sizes, 0.0)
    k = int(np.argmax(sizes))
    return None if sizes[k] < HANGS_ON_IT else (k, float(sizes[k]))


def left_open(estimate: Estimate) -> bool:
    """Whether the behaviour was found, and not stated."""
    return bool(estimate.trace.about(DecisionKind.INPUT_TAKEN))


def for_left_open(remedy: str, estimate: Estimate) -> str:
    """A remedy without the advice to leave the behaviour open, where it was."""
    return remedy.replace(AUTO, "") if left_open(estimate) else remedy


def intersample_findings(estimate: Estimate, found: Behaviours) -> list[Finding]:
    """A word where another behaviour than the one stated explains the record clearly better."""
    fall = found.fall(found.best, found.present)
    if found.advised == found.present:
        return _undecided(estimate, found)
    best, present = found.attempts[found.best], found.attempts[found.present]
    moved = coefficients(best.point) - coefficients(present.point)
    std = np.where(estimate.std > 0, estimate.std, np.inf)
    sizes = np.abs(moved) / std
    k = int(np.argmax(sizes))
    before, after = (coefficients(one.point)[k] for one in (present, best))
    outputs = zip(estimate.output_names, present.fits, best.fits, strict=True)
    fits = ", ".join(f"fit of {name} from {a:.2f} to {b:.2f} %" for name, a, b in outputs)
    return [
        Finding(
            "intersample",
            "warning" if sizes[k] > MATTERS else "note",
            f"The input is taken as {IN_WORDS[found.present]}; {IN_WORDS[found.best]} explains the "
            f"record clearly better (-2 log L lower by {fall:.3g}).",
            f"State intersample={found.best!r} (--intersample {found.best})"
            + (f"{AUTO}, if the input was not as stated." if found.stated else "."),
            effect=f"With it: {estimate.names[k]} from {before:.4g} to {after:.4g} "
            f"({sizes[k]:.1f} standard errors), {fits}.",
            kind="alone",
        )
    ]


def is_clearly_better(one: Finding) -> bool:
    """Whether a finding is that a comparison without all other causes prefers a behaviour."""
    return one.code == "intersample" and one.kind == "alone"


def _undecided(estimate: Estimate, found: Behaviours) -> list[Finding]:
    """A word where the record does not tell two behaviours apart, and coefficients hang on it.

    An input that repeats its values is held, whatever a likelihood leans to.
    """
    least = -LEANS if found.stated else UNDECIDED
    known = {*found.attempts, *found.searched} - {found.present}
    near = [one for one in known if found.above[one] < least and not found.staircase]
    if not near:
        return []
    other = min(near, key=lambda one: found.above[one])
    hanging = _hanging(found, other, estimate)
    before, after = found.ended(found.present), found.ended(other)
    if hanging is None or before is None or after is None:
        return []
    k, size = hanging
    by = "AICc" if found.searched else "-2 log L"
    more = found.above[other]
    return [
        Finding(
            "intersample",
            "warning",
            f"The record does not tell whether the input is {IN_WORDS[found.present]}, as it is "
            f"taken here, or {IN_WORDS[other]} (of {by}: {abs(more):.2g} "
            f"{'higher' if more > 0 else 'lower'}); {estimate.names[k]} hangs on it.",
            "Find out what the input does between its samples and state it (intersample=, "
            "--intersample), or record faster.",
            effect=f"With the other: {estimate.names[k]} from {before[k]:.4g} to {after[k]:.4g} "
            f"({size:.1f} standard errors).",
        )
    ]


def _with(problem: Problem, behaviour: str) -> Problem:
    experiments = tuple(replace(e, intersample=behaviour) for e in problem.experiments)
    return replace(problem, experiments=experiments)


def _allows_band_limited(problem: Problem) -> bool:
    return all(e.t is None and e.n_samples >= FEWEST for e in problem.experiments)


def _beginning(record: Record) -> Record:
    if record.n_samples <= LONGEST or not np.isfinite(record.y[:LONGEST]).any(axis=0).all():
        return record
    return record.slice(None, float(record.t[LONGEST - 1]))
