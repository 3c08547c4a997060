"""Which kind of controller it was, sampled or continuous: as stated, or as the record tells.

What a controller does between the samples changes the answer, and is not recorded. Where its kind
is not stated, two things tell it. A linear controller that works on the recorded samples leaves
its rule in them, to the last digit (`closed_loop.input_rule`). And the residual of the right kind
has no part that follows the reference, whatever the noise does between the samples; the likelihood
of all of the residual would not do, as the noise is most of it, and the wrong kind may well explain
that better. Where neither tells, the kind is taken as the input is stated to behave, or as
continuous where no rule of the samples makes it, and what the other would make of the coefficients
is said. Where not even the rule is missing, or where it is because the controller is not linear or
reads what is not recorded, neither is likelier than the other: half the square of their distance
joins the covariance, as the mean square of what is off, unless only one of them leaves nothing that
follows the reference. Against a sampled one the record may speak, and for a computer of a few steps
a sample all the same: what the input is late by then is estimated from the two residuals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from scipy.special import chdtri

from tridentify.errors import OptionError, shown
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.closed_loop.between_samples import IN_WORDS, Loop, Sampling
from tridentify.estimation.closed_loop.driven import COARSE, Driven, driven, widest
from tridentify.estimation.closed_loop.input_rule import InputRule, input_rule
from tridentify.estimation.likelihood.thresholds import CLEARLY
from tridentify.estimation.methods.by_reference.passes import Rooted, residuals
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import fit_autoregression, whiten
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

Controller = Literal["unknown", "sampled", "continuous"] | TransferFunction

PLAINLY = 0.3
"""What follows the reference in the residual of one kind beyond that of the other, in variances of
the noise a sample, from which the record speaks against the former: errors of the driven input
between the samples make up to a tenth (120 random loops), a wrong kind mostly 0.6 to 5."""
MOST_NOISE = 20
"""Coefficients of the noise's model beside which that is asked, at most."""
ASIDE = 0.2
"""Difference of the coefficients under either kind [standard errors] up to which the kind does not
matter: it adds 2 % to the error."""
NEAR_ROOT = 1.0
"""Standard errors that passes still move by, up to which their end tells how far the kind moves it:
where that matters, by several."""
APART = 3.0
"""Difference of the coefficients under either kind [stated standard errors] from which the answer
is wrong beyond its interval if the kind is, so that one that was only assumed is warned of."""
MAY_BE_ZERO = 5.0
"""Stated standard errors within which a plant may integrate; they do not know of a wrong kind."""
OUTLASTS = 3.0
"""Duration of the record in time constants of its slowest mode, up to which that may be none."""
DRIVEN = 10.0
"""Times chance that references explain of an input beside what they leave, from which they drive
it: sines do 67 and more (101 random loops), three in four references that drive nothing less."""
DIGITS = 1e-6
"""Share of an output below which what is left of it is none: that is how well an input is known
between its samples where nothing else is in the way."""
MISSED = 1e-3
"""Probability of taking noise for what is left of the response."""


def check_controller(controller: object) -> None:
    """Refuse an unknown kind of controller.

    Raises
    ------
    OptionError
    """
    if isinstance(controller, TransferFunction):
        return
    if controller not in ("unknown", "sampled", "continuous"):
        raise OptionError(
            f"found controller={shown(controller)}; expected 'sampled' (its output is held between "
            "samples), 'continuous', 'unknown' or a TransferFunction; choose one of them"
        )


@dataclass(frozen=True)
class Assumed:
    """The kind of a controller before anything is fitted.

    Attributes
    ----------
    sampling : {"sampled", "continuous"}
    certain : bool
        Whether it was stated, or is seen in the input itself.
    why : str
        What shows it, to be told behind the kind; empty where nothing does.
    even : bool
        Whether the other kind is as likely for all that is known.
    against : str
        What the input shows against a kind that was stated; empty where nothing does.
    missing : InputRule, optional
        What the input shows in place of the rule that it mostly shows of a kind that was stated.
    """

    sampling: Sampling
    certain: bool
    why: str = ""
    even: bool = False
    against: str = ""
    missing: InputRule | None = None

    @property
    def stated(self) -> bool:
        """Whether somebody says so, and not the input."""
        return self.certain and not self.why


def assumed(controller: Controller, records: Sequence[Record], structure: Structure) -> Assumed:
    """How the controller worked: as stated, as the input shows, or as it is stated to behave.

    Parameters
    ----------
    controller : {"unknown", "sampled", "continuous"} or TransferFunction
    records : sequence of Record
    structure : Structure
        Of the plant.
    """
    if isinstance(controller, TransferFunction):
        return Assumed("continuous", True)
    rule = input_rule(records, int(np.max(np.asarray(structure.poles))))
    seen = rule in (InputRule.SAMPLED, InputRule.HELD)
    if controller == "continuous":
        return Assumed(controller, True, against=rule.value if seen else "")
    if controller == "sampled":
        return Assumed(controller, True, missing=None if seen else rule)
    if seen:
        return Assumed("sampled", True, f": {rule.value}")
    held = all(record.behaviour == "zoh" for record in records)
    unruled = rule in (InputRule.NONE, InputRule.UNSEEN)
    kind: Sampling = "sampled" if held and not unruled else "continuous"
    why = f": {rule.value}" if unruled else ""
    return Assumed(kind, False, why, even=rule is not InputRule.NONE)


def of_integrator(taken: Assumed, estimate: Estimate, records: Sequence[Record]) -> Assumed:
    """The kind again, of a plant that may integrate: its loop leaves a rule that is shorter by one.

    Parameters
    ----------
    taken : Assumed
    estimate : Estimate
        With the kind that was taken.
    records : sequence of Record
    """
    rule = InputRule.SAMPLED.value
    if rule not in (taken.why.removeprefix(": "), taken.against) or not may_integrate(
        estimate, records
    ):
        return taken
    poles = int(np.max(np.asarray(estimate.structure.poles)))
    if input_rule(records, poles - 1) is InputRule.SAMPLED:
        return taken
    if taken.stated:
        return replace(taken, against="")
    return Assumed("sampled", False, even=True)


def may_integrate(estimate: Estimate, records: Sequence[Record]) -> bool:
    """Whether a plant may integrate: a static coefficient of zero, or a pole that outlasts records.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
    """
    last = [k for k, name in enumerate(estimate.names) if name.split("[")[0] == "a0"]
    if np.any(np.abs(estimate.theta[last]) <= MAY_BE_ZERO * estimate.std[last]):
        return True
    slowest = min(float(np.min(np.abs(np.roots(den)))) for row in estimate.model.den for den in row)
    return slowest * max(float(one.t[-1] - one.t[0]) for one in records) < OUTLASTS


def opposite(kind: Sampling) -> Sampling:
    """The other kind."""
    return "continuous" if kind == "sampled" else "sampled"


@dataclass(frozen=True, eq=False)
class Compared:
    """What the record says of two kinds.

    Attributes
    ----------
    turned : bool
        Whether the other kind is clearly likelier.
    told : str
        Which was taken, and what speaks for it.
    left : LeftOpen, optional
        What the record does not exclude.
    """

    turned: bool
    told: str
    left: LeftOpen | None = None


def compared(mine: Rooted, other: Rooted, taken_for: Assumed) -> Compared:
    """What the record says of two kinds.

    Parameters
    ----------
    mine, other : Rooted
        The fit with the kind that was assumed, and with the other.
    taken_for : Assumed
        What was assumed.
    """
    kind, even = other.loops[0].sampling, taken_for.even
    words, rival = IN_WORDS[mine.loops[0].sampling], IN_WORDS[kind]
    basis = _wider(mine, other)
    mine_left, other_left = (_followed(_residuals(one), basis) for one in (mine, other))
    own, beside = mine_left.excess, other_left.excess
    plainly = PLAINLY * sum(int(np.isfinite(one.record.y).sum()) for one in mine.loops)
    turns = own - beside > plainly or (even and _alone(other_left, mine_left, mine, other))
    if other.still and (turns or not mine.still):
        against = (
            f"{own:.0f} variances of the noise, more than chance, follow the reference in the "
            f"residual, as {rival} {beside:.0f}"
        )
        against = against if mine.still else "the passes do not end"
        return Compared(True, f"controller taken as {rival}: as {words}, {against}")
    taken = f"controller taken as {words}{taken_for.why}"
    stays = beside - own > plainly or (even and _alone(mine_left, other_left, other, mine))
    # passes at the limit of stability may end nowhere, near a root all the same
    ended = other.still or (even and other.moved < NEAR_ROOT)
    against = f"{taken}; the record speaks against a {kind} one" if stays or not ended else taken
    if kind == "sampled" and other.still and (stays or not even):
        return _faster(mine, other, _held_for(mine, other, basis), against)
    if stays or not ended:
        return Compared(False, against)
    away = other.estimate.theta - mine.estimate.theta
    return Compared(False, taken, LeftOpen(away, rival, taken, even))


def _faster(mine: Rooted, other: Rooted, share: float, taken: str) -> Compared:
    """What is to be said of computers of several steps a sample, where one of a single is none."""
    away = share * (other.estimate.theta - mine.estimate.theta)
    rival = f"a computer {1.0 / max(share, 1e-9):.2g} times as fast as the record"
    return Compared(False, taken, LeftOpen(away, rival, taken, even=True, part=1.0))


def _alone(right: _Following, wrong: _Following, refuted: Rooted, kept: Rooted) -> bool:
    """Whether one kind leaves nothing that follows the reference, and the other plainly does.

    A continuous controller in a fast loop leaves something of what is not known between the
    samples, which does not speak against it.
    """
    fast = any(
        one.driven.rate * float(np.median(np.diff(one.record.t))) > COARSE
        for end in (refuted, kept)
        for one in end.loops
    )
    if refuted.loops[0].sampling == "continuous" and fast:
        return False
    clearly = wrong.size - right.size > 2.0 * CLEARLY
    return clearly and right.is_chance and not wrong.is_chance


class _Following(NamedTuple):
    """What follows the references in a residual, in variances of the noise, and what chance leaves.

    ``size`` is a sum of squares along ``freedom`` directions.
    """

    size: float
    freedom: int

    @property
    def excess(self) -> float:
        """Beyond what chance leaves."""
        return self.size - self.freedom

    @property
    def is_chance(self) -> bool:
        """Whether noise alone may be that."""
        return not self.freedom or self.size <= float(chdtri(self.freedom, MISSED))


def _wider(mine: Rooted, other: Rooted) -> list[Array]:
    """What the references drive, by the richer of two descriptions, record by record."""
    parts = ((_widest(one), _widest(two)) for one, two in zip(mine.loops, other.loops, strict=True))
    return [max(pair, key=lambda part: part.order).columns for pair in parts]


def _widest(loop: Loop) -> Driven:
    part = loop.driven if isinstance(loop.driven, Driven) else driven(loop.record)
    return widest(part.record, part.rate, part.before)


def driving_findings(parts: Sequence[Driven]) -> tuple[Finding, ...]:
    """What is to be said of references that drive no input.

    Parameters
    ----------
    parts : sequence of Driven
        Per experiment.
    """
    inputs, columns = [np.asarray(one.record.u) for one in parts], [one.columns for one in parts]
    # whitening by itself takes sines out of an input, and its rest holds what chance has fitted
    own = _followed(inputs, columns)
    beside = _followed(inputs, columns, [one.record.u - one.inputs for one in parts])
    if not own.freedom or not own.is_chance or beside.size > DRIVEN * beside.freedom:
        return ()
    return (
        Finding(
            "loop-not-excited",
            "warning",
            f"The reference ({', '.join(parts[0].record.reference_names)}) explains no more of the "
            "input than chance does: it drives nothing, and what is found from it means nothing.",
            "Check that it is what the controller followed, on the same clock; or leave it out.",
        ),
    )


def _followed(
    signals: Sequence[Array], basis: Sequence[Array], noises: Sequence[Array] | None = None
) -> _Following:
    """What follows the references in some signals, whitened one by one as their noises are."""
    size, freedom = 0.0, 0
    for left, columns, quiet in zip(signals, basis, noises or signals, strict=True):
        for series, own in zip(left.T, quiet.T, strict=True):
            if np.isfinite(series).sum() >= 2 * columns.shape[1]:
                along = _along(columns, own, series)
                size += float(np.sum(along**2))
                freedom += len(along)
    return _Following(size, freedom)


def _along(columns: Array, own: Array, *signals: Array) -> Array:
    """(n_columns, n_signals) of signals along columns, whitened as a noise is, in its deviations.

    Parameters
    ----------
    columns : (n_samples, n_columns) array
    own : (n_samples,) array
        The noise, with more in it.
    *signals : (n_samples,) arrays
        Missing where the first is; what that leaves beside the columns is the noise.
    """
    seen = np.isfinite(signals[0])
    noise = fit_autoregression([own - np.mean(own[seen])], MOST_NOISE)
    table = np.column_stack([columns, *signals]).T
    white = np.column_stack([whiten(np.where(seen, one, np.nan), noise)[0] for one in table])
    white, count = white[seen], columns.shape[1]
    along = np.linalg.qr(white[:, :count])[0].T @ white[:, count:]
    rest = white[:, count] @ white[:, count] - along[:, 0] @ along[:, 0]
    return np.asarray(along / np.sqrt(max(rest / (len(white) - count), 1e-300)))


def _held_for(mine: Rooted, other: Rooted, basis: Sequence[Array]) -> float:
    """Share of an interval for which the input of a controller may be held that counts as moving.

    A computer of ``m`` steps a sample is late by half a step, as one of a single step is by half a
    sample: so what it leaves lies ``1 / m`` of the way from what a continuous controller leaves to
    what a sampled one does. Its least squares, and their error, say how far.

    Parameters
    ----------
    mine, other : Rooted
        As continuous, and as sampled.
    basis : sequence of arrays
        What the references drive, record by record.
    """
    ends = [
        _along(columns, one, one, two)
        for lefts in zip(*(_residuals(one) for one in (mine, other)), basis, strict=True)
        for one, two, columns in _outputs(*lefts)
    ]
    if not ends:
        return 0.0
    here, there = np.vstack(ends).T
    way = there - here
    share = max(float(-here @ way / (way @ way)), 0.0)
    return float(min(np.hypot(share, 1.0 / np.linalg.norm(way)), 1.0))


def _outputs(left: Array, right: Array, columns: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Residuals of every output under both kinds, where both are there."""
    for one, two in zip(left.T, right.T, strict=True):
        if np.isfinite(one).sum() >= 2 * columns.shape[1] and np.isfinite(two).any():
            yield one, two, columns


@dataclass(frozen=True, eq=False)
class LeftOpen:
    """Another kind that the record does not exclude: the more is said, the more hangs on it.

    Attributes
    ----------
    away : (n,) array
        From the coefficients with the kind that was taken to those with the other.
    rival : str
        The other kind, in words.
    taken : str
        Which was taken and what speaks for it, in words.
    even : bool
        Whether nothing speaks for it, so that the standard errors allow for either.
    part : float
        Root mean square of what is off by not knowing, over ``away``.
    """

    away: Array
    rival: str
    taken: str
    even: bool
    part: float = 1.0 / np.sqrt(2.0)

    def moved(self, mine: Estimate) -> Array | None:
        """What joins the covariance of an estimate with the kind that was taken, if anything."""
        matters = self.even and self._far(mine).max() >= ASIDE
        return self.part * self.away if matters else None

    def said(self, mine: Estimate) -> tuple[str, tuple[Finding, ...]]:
        """What is told, and to be said, in the errors of an estimate with the kind taken."""
        far = self._far(mine)
        k = int(np.argmax(far))
        if far[k] < ASIDE:
            return "the record does not tell, and the coefficients are the same either way", ()
        told = (
            f"the record does not tell; as {self.rival}, {mine.names[k]} would be "
            f"{mine.theta[k] + self.away[k]:.4g} in place of {mine.theta[k]:.4g}"
        )
        either = " of one kind; those that are stated allow for either" if self.even else ""
        finding = Finding(
            "intersample",
            "warning" if far[k] > APART else "note",
            f"{self.taken[0].upper()}{self.taken[1:]}; {told} "
            f"({far[k]:.2g} standard errors{either}).",
            "State how the controller works: controller='sampled' or 'continuous' (--controller).",
        )
        return told, (finding,)

    def _far(self, mine: Estimate) -> Array:
        """(n,) [standard errors] of the kind that was taken, whatever those of the other are."""
        size = mine.std + 1e-12 * np.abs(mine.theta) + 1e-300
        return np.asarray(np.where(mine.std > 0.0, np.abs(self.away) / size, 0.0))


def follows(white: Rooted) -> bool:
    """Whether the residual of a root for white noise follows the references."""
    return not _followed(*_left(white)).is_chance


def _left(white: Rooted) -> tuple[list[Array], list[Array]]:
    return _residuals(white), [_widest(one).columns for one in white.loops]


def _residuals(white: Rooted) -> list[Array]:
    """Of every record; missing where they are no more than `DIGITS` of an output."""
    left = residuals(white.loops, white.estimate)
    moving = (np.nanstd(np.asarray(loop.record.y), axis=0) for loop in white.loops)
    return [
        np.where(np.nanstd(one, axis=0) > DIGITS * size, one, np.nan)
        for one, size in zip(left, moving, strict=True)
    ]


def following_findings(white: Rooted) -> tuple[Finding, ...]:
    """What is to be said where the residual of a continuous loop follows the reference.

    It is looked for under white weights: a model of the noise gives fast motion more weight, where
    what is not known between the samples is largest, and the coefficients then make up for it.

    Parameters
    ----------
    white : Rooted
        The root before the noise is modelled.
    """
    if white.loops[0].sampling == "sampled":
        return ()
    left = _followed(*_left(white))
    if left.is_chance:
        return ()
    return (
        Finding(
            "intersample",
            "warning",
            "The controller is continuous, and the residual follows the reference: "
            f"{left.size / left.freedom:.1f} times what chance leaves. What the input does between "
            "the samples is not known well enough, or the order is too low; the standard errors "
            "allow for part of it.",
            "Sample faster, by five times if possible, or try a higher order.",
        ),
    )


def coarse_findings(best: Rooted) -> tuple[Finding, ...]:
    """What is to be said of a continuous controller in a loop that is fast for its sampling.

    A model of the noise takes up what noise makes of the input between the samples.

    Parameters
    ----------
    best : Rooted
    """
    loops = best.loops
    steps = [float(np.median(np.diff(one.record.t))) for one in loops]
    fastest = max(one.driven.rate * step for one, step in zip(loops, steps, strict=True))
    allowed = any(one.size for one in best.estimate.noise_model)
    if loops[0].sampling == "sampled" or fastest <= COARSE or allowed:
        return ()
    return (
        Finding(
            "intersample",
            "warning",
            f"The controller is continuous and the loop fast for the sampling ({fastest:.2g} "
            "rad a step): what noise makes of the input between the samples is not recorded, "
            "and without a model of the noise the standard errors do not allow for it.",
            "Use noise='auto', or sample faster, by five times if possible.",
        ),
    )
