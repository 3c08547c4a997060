"""A suspected change: the old model is kept until a new one is clearly better on the samples since.

An alarm (`online.kernels.intake`) says that the innovations speak for other coefficients. So do
gusts, slow disturbances and bursts of noise, now and then. Since the alarm the samples are kept;
they are searched for a model of their own, and the plant has changed only if all of this holds:

*Likelihood.* The old coefficients, as they were at the alarm, and the new, taken to the minimum
for coloured noise (`online.residual.refined`), go through the samples since, each with a free
initial state and an offset. What they leave is whitened by an autoregression of its own: coloured
noise is no longer evidence. The logarithm of the ratio of the two remaining sums of squares is
summed over short pieces, each with a scale of its own, as the strength of gusts varies; the piece
that speaks loudest is left out. The sum must be ``CLEAR_GAIN``, and most pieces must agree. The new
ones must not leave more of the samples themselves: nobody would go over to such a model.

*Standard errors.* The coefficients must differ by more than what the two covariances explain, that
of the new ones made for coloured noise and ``LARGER``, as few samples tell little of its colour.

*A model.* The new one must be certain of its poles, with errors for white noise and with these.

*From two sides.* The search is for white noise, and a slow disturbance may lead it into another
valley: the steps to the minimum for coloured noise begin at the present coefficients, too, and the
more likely end counts. Samples at a limit that was known of the sensor are no response.

*Since when.* An alarm that noise gave, and a look without one, may come before the change. So the
samples are cut where the old coefficients before and the new ones after are the most likely
(`still_old`): the change is dated there, and the estimator begins there.

As long as it does not hold, the search is repeated on twice as many samples; in the end the
suspicion is dropped. Samples that came meanwhile have counted for the old model as all others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import sort_poles
from tridentify.numerics.slices import Slices
from tridentify.online.kernels import slots
from tridentify.online.launch import Launch, Planner, launching
from tridentify.online.layout import Blueprint, Doubt, NuisanceColumns, Setting, watch_of
from tridentify.online.residual import Refined, gain_before, gain_of, left_by, refined
from tridentify.online.search import DOUBTED, VAGUE, far_off, first_try, record_of, searching
from tridentify.online.steps import estimate_of, solving
from tridentify.online.unexplained import doubting
from tridentify.record.record import Record

CLEAR_GAIN = 30.0  # of -2 log L: one in a million for four coefficients, were the noise model true
WORTH_A_SEARCH = 15.0  # of -2 log L: half of what it has to show
AGREEING = 0.6  # of the pieces; of noise alone, half
NO_MORE = 1.02
"""Root mean square that the new coefficients may leave of an output, over what the old ones leave:
where a model misses part of the response, the most likely one of whitened samples is another one
than that of the samples themselves, changed or not, and leaves more of them (9 and 20 % of a
circuit that stayed as it was)."""
NO_DOUBT = 10.0  # of -2 log L: steps from two sides to one minimum differ by less than one
CLEARLY_OLD = 10.0  # of -2 log L: with less the first samples may be of either plant
RARE = 1e-5
"""Probability with which an unchanged plant is taken for another: changes are suspected often."""
LARGER = 2.0  # than by the noise model, the covariance of few samples


class Old(NamedTuple):
    """Coefficients that may hold no longer, and their covariance."""

    theta: Array
    cov: Array


class Look(NamedTuple):
    """What a look at the samples since an alarm has come to.

    Attributes
    ----------
    launch : Launch or None
        How to go on where the plant has changed.
    after : Old or None
        What the next look is to compare with.
    begin : int
        Samples since the alarm that are still of the old plant.
    doubt : Doubt or None
        What speaks against the present model in these samples, where they are no other plant's.
    """

    launch: Launch | None
    after: Old | None
    begin: int = 0
    doubt: Doubt | None = None


def trying(
    method: Planner,
    setting: Setting,
    blueprint: Blueprint,
    poles: Complex,
    x: Array,
    before: Array,
    samples: Array,
    reference: Array,
    witness: Old | None,
    alarm: bool,
) -> Slices[Look]:
    """Whether the samples since an alarm are of another plant, and how to go on from them.

    Without an alarm a change is too small to be far off: steps from the present coefficients show
    whether a search is worth its time.

    Parameters
    ----------
    method : Planner
    setting : Setting
    blueprint : Blueprint
    poles : (n,) complex array
    x : array
        Of the estimator at the alarm.
    before : (l, n_inputs + n_outputs + 1) array
        All samples before the alarm; empty where they are no longer kept.
    samples : (k, n_inputs + n_outputs + 1) array
        Since the alarm.
    reference : (n_inputs,) array
        Trim input.
    witness : Old or None
        What earlier looks have come to.
    alarm : bool
        Whether there was one, or the clock asked for a look.
    """
    samples = _within_limits(setting, blueprint, x, samples)
    try:
        solution = yield from solving(setting, blueprint, x, poles, choose=False)
        yield
        estimate = estimate_of(setting, blueprint, x, solution, "", poles)
    except (TridentifyError, np.linalg.LinAlgError):
        return Look(None, witness)
    look = yield from _tried(method, setting, before, samples, reference, witness, alarm, estimate)
    if look.launch is not None or len(samples) < DOUBTED * first_try(setting):
        return look
    yield
    doubt = yield from doubting(setting, samples, estimate.theta, estimate.std)
    return look._replace(doubt=doubt)


def _tried(
    method: Planner,
    setting: Setting,
    before: Array,
    samples: Array,
    reference: Array,
    witness: Old | None,
    alarm: bool,
    estimate: Estimate,
) -> Slices[Look]:
    """`trying`, with the estimate at the alarm."""
    nothing = Look(None, witness)
    present = Old(estimate.theta, estimate.cov)
    try:
        old = witness or (yield from _for_coloured_noise(setting, before, estimate)) or present
        if not alarm:
            record = record_of(setting, samples)
            near = yield from refined(setting, record, estimate.theta, estimate.std)
            yield
            if near is None or not _worth_a_search(setting, record, old, near):
                return _learnt(setting, old, near, witness)
    except (TridentifyError, np.linalg.LinAlgError):
        return nothing
    samples = yield from far_off(setting, samples)
    found = yield from searching(setting, samples, True)
    if found is None or not found.certain:
        return nothing
    record = record_of(setting, samples)
    poles = found.poles
    new = yield from refined(setting, record, found.estimate.theta, found.estimate.std)
    near = yield from _from_present(setting, record, estimate)
    yield
    if near is not None and (new is None or _is_likelier(setting, record, near, new)):
        roots = np.roots(np.append(1.0, near.theta[: setting.n_poles]))
        new, poles = near, sort_poles(roots.astype(np.complex128))
    if new is None or not is_determined(setting, new):
        return nothing
    yield
    changed = differ(old, new) and explains_better(setting, record, old, new)
    yield
    # what was missed so far is half believed by now: that leaves more, but not clearly
    if not changed or (witness is not None and gained(setting, record, present, new)[0] <= 0.0):
        return _learnt(setting, old, new, witness)
    yield
    begin = yield from still_old(setting, record, old, new)
    nuisance = NuisanceColumns.of(setting.structure, True)
    launch, _ = yield from launching(
        method, setting, poles, nuisance, samples[begin:], found.noise_std, reference
    )
    return Look(launch, Old(new.theta, LARGER * new.cov), begin)


def _within_limits(setting: Setting, blueprint: Blueprint, x: Array, samples: Array) -> Array:
    """The samples without outputs at a limit that was known of the sensor: they are no response."""
    kept = samples
    for i in range(setting.n_outputs):
        w, column = watch_of(blueprint, i), 1 + setting.n_inputs + i
        limits, y = int(x[w + slots.LIMITS]), samples[:, column]
        highest, lowest = x[w + slots.HIGHEST], x[w + slots.LOWEST]
        beyond = np.zeros(len(y), dtype=bool)
        # what goes farther shows that there is no limit
        if limits & 1 and not np.any(y > highest):
            beyond |= y == highest
        if limits & 2 and not np.any(y < lowest):
            beyond |= y == lowest
        if beyond.any():
            kept = kept.copy() if kept is samples else kept
            kept[beyond, column] = np.nan
    return kept


def _for_coloured_noise(setting: Setting, before: Array, estimate: Estimate) -> Slices[Old | None]:
    """What few samples before the alarm say of the coefficients where noise is coloured.

    Blocks of scores, which make the standard errors for it, are too few to tell then.
    """
    if not first_try(setting) <= len(before) < DOUBTED * first_try(setting):
        return None
    found = yield from refined(setting, record_of(setting, before), estimate.theta, estimate.std)
    return None if found is None else Old(found.theta, LARGER * found.cov)


def _worth_a_search(setting: Setting, record: Record, old: Old, near: Refined) -> bool:
    """Whether a few steps from the present coefficients show something that may be a change."""
    moved = is_determined(setting, near) and differ(old, near)
    return moved and gained(setting, record, old, near)[0] >= WORTH_A_SEARCH


def _from_present(setting: Setting, record: Record, estimate: Estimate) -> Slices[Refined | None]:
    try:
        return (yield from refined(setting, record, estimate.theta, estimate.std))
    except (TridentifyError, np.linalg.LinAlgError):
        return None


def _is_likelier(setting: Setting, record: Record, near: Refined, new: Refined) -> bool:
    """Whether steps from the present coefficients lead to a better minimum than the search.

    That is for white noise: of few samples with a slow disturbance it may end in another valley.
    """
    found = Old(new.theta, new.cov)
    return is_determined(setting, near) and gained(setting, record, found, near)[0] > NO_DOUBT


def _learnt(setting: Setting, old: Old, new: Refined | None, witness: Old | None) -> Look:
    """No change: what the samples say is counted in, if it agrees with the old coefficients."""
    if new is None or not is_determined(setting, new) or differ(old, new):
        return Look(None, witness)
    return Look(None, together(old, Old(new.theta, LARGER * new.cov)))


def explains_better(setting: Setting, record: Record, old: Old, new: Refined) -> bool:
    """Whether a record speaks clearly for the new coefficients, by their likelihoods.

    Parameters
    ----------
    setting : Setting
    record : Record
    old : Old
    new : Refined
        At the minimum for this record.
    """
    before, after = (left_by(setting, record, one.theta) for one in (old, new))
    gain, agreeing = _gained(before, after)
    leaves = np.sqrt(np.nanmean(after**2, axis=0) / np.nanmean(before**2, axis=0))
    return gain >= CLEAR_GAIN and agreeing >= AGREEING and bool(np.all(leaves <= NO_MORE))


def still_old(setting: Setting, record: Record, old: Old, new: Refined) -> Slices[int]:
    """Samples at the beginning of a record that are of the old plant.

    An alarm that noise gave, and a look without one, may come before the change. The cut is where
    the old coefficients before it and the new ones after it are the most likely.

    Parameters
    ----------
    setting : Setting
    record : Record
    old : Old
    new : Refined
        At the minimum for this record.

    Returns
    -------
    int
        No more than leaves samples enough for a search; 0 unless the old coefficients are clearly
        better before the cut.
    """
    gains = yield from gain_before(setting, record, old.theta, new.theta)
    gains = gains[: max(len(gains) - first_try(setting), 0)]
    if not gains.size or not gains.max() > CLEARLY_OLD:
        return 0
    return int(np.argmax(gains)) + 1


def gained(setting: Setting, record: Record, old: Old, new: Refined) -> tuple[float, float]:
    """Fall of -2 log L without the piece that speaks loudest, and the share of pieces that fall.

    Parameters
    ----------
    setting : Setting
    record : Record
    old : Old
    new : Refined
    """
    return _gained(*(left_by(setting, record, one.theta) for one in (old, new)))


def _gained(before: Array, after: Array) -> tuple[float, float]:
    """The same of what both leave, (n_samples, n_outputs) each."""
    gains = np.sum([gain_of(b, a) for b, a in zip(before.T, after.T, strict=True)], axis=0)
    return float(gains.sum() - gains.max()), float(np.mean(gains > 0.0))


def is_determined(setting: Setting, new: Refined) -> bool:
    """Whether coloured noise leaves the poles certain."""
    n = setting.n_poles
    std = np.sqrt(LARGER * np.diagonal(new.cov)[:n])
    return bool(np.all(std <= VAGUE * np.abs(new.theta[:n])))


def differ(old: Old, new: Refined) -> bool:
    """Whether the coefficients are others, by both covariances."""
    move, cov = new.theta - old.theta, old.cov + LARGER * new.cov
    unit = 1.0 / np.sqrt(np.diagonal(cov))
    scaled = np.linalg.lstsq(unit[:, None] * cov * unit, unit * move, rcond=1e-12)[0]
    distance = float(unit * move @ scaled)
    return distance > float(chdtri(move.size, RARE))


def together(one: Old, other: Old) -> Old:
    """Two estimates of the same coefficients, weighted by their covariances.

    Parameters
    ----------
    one, other : Old

    Examples
    --------
    >>> both = together(Old(np.array([1.0]), np.eye(1)), Old(np.array([4.0]), 0.5 * np.eye(1)))
    >>> both.theta.round(9).tolist(), both.cov.round(9).tolist()
    ([3.0], [[0.333333333]])
    """
    unit = np.sqrt(np.diagonal(one.cov))
    scaled = [each.cov / unit / unit[:, None] for each in (one, other)]
    weight = np.linalg.lstsq(scaled[0] + scaled[1], scaled[0], rcond=1e-12)[0].T
    theta = one.theta + unit * (weight @ ((other.theta - one.theta) / unit))
    cov = scaled[0] - weight @ scaled[0]
    return Old(theta, unit[:, None] * 0.5 * (cov + cov.T) * unit)


def packed(one: Old | None) -> tuple[Array, Array]:
    """As arrays of a stage; empty ones for none."""
    return (np.zeros(0), np.zeros(0)) if one is None else (one.theta, one.cov.ravel())


def unpacked(arrays: tuple[Array, ...]) -> Old | None:
    """From arrays of a stage."""
    theta, cov = arrays
    return Old(theta, cov.reshape(theta.size, theta.size)) if theta.size else None
