"""The tests of every output and the causes that were fitted, without the samples that are bad."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.judgement.causes.attempts.attempt import Attempt
from tridentify.judgement.causes.attempts.explanation import Explanation, Explanations
from tridentify.judgement.causes.attempts.feedback import (
    Inputs,
    Within,
    by_predictor,
    coming,
    forecasts_react,
)
from tridentify.judgement.causes.attempts.intersample import is_staircase
from tridentify.judgement.causes.sensors.breaks import steps
from tridentify.judgement.causes.sensors.input_floor import may_carry_noise
from tridentify.judgement.causes.sensors.lost import LEAST_PIECE, Place, after_gaps, jumps
from tridentify.judgement.causes.signals.interpolated import interpolated
from tridentify.judgement.validation.explained import (
    change,
    explanations,
    of_input_noise,
    same_records,
    settled,
    still_far,
    told_alone,
)
from tridentify.judgement.validation.far_samples import (
    FIRST_SAMPLES,
    WORTH_A_LOOK,
    after_a_jump,
    first_ones,
    with_bad_samples_alone,
    with_outliers,
    with_those_between,
    without_foreseen,
)
from tridentify.judgement.validation.known_causes import KnownCauses
from tridentify.judgement.validation.residuals import View, refitted
from tridentify.judgement.validation.statistics.distribution import distribution
from tridentify.judgement.validation.statistics.evidence import (
    Evidence,
    examine,
    suspicious,
    without_outliers,
)
from tridentify.judgement.validation.statistics.likelihood_ratio import CALLED
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.quantiles import median
from tridentify.numerics.robust import median_scale

FADED = 0.5
"""Share of the far samples that may be left beside a cause that they come from."""

NOTHING = 1.0
"""p-value of a test whose result another cause explains."""

WILD = 6.0
"""Standard deviations from which one of them is worth all tests: of Gaussian noise one in a
thousand million."""
FEW_LEFT = 0.9
"""Share of the samples that must be left where outliers are taken out and the tests made again."""
LOOKS = 3
"""Times that bad samples are looked for beside those that were found."""
FEW_BAD = 0.97
"""Share of the samples that must be left where those that stand alone are taken out."""


def torn_at(view: View) -> list[Place]:
    """Where rows may have been lost: the state of the model jumps there."""
    if view.stamped:
        return []
    residuals = [
        np.stack([output.standardised[e] for output in view.outputs], axis=1)
        for e in range(len(view.records))
    ]
    noise = [output.noise for output in view.outputs]
    return jumps(residuals, [one.inner for one in view.point.branches], noise, view.step)


_REACTS: WeakKeyDictionary[View, bool] = WeakKeyDictionary()
"""What `may_react` said of looks that are still in use."""


def may_react(view: View) -> bool:
    """Whether inputs to come explain what is left of an output, as far as one look tells."""
    said = _REACTS.get(view)
    if said is None:
        said = _REACTS[view] = _may_react(view)
    return said


def _may_react(view: View) -> bool:
    if view.stamped or view.driven:
        return False
    inputs = Inputs.of(view.records)
    if inputs.commanded:
        return False
    for i, one in enumerate(view.outputs):
        own = [np.hstack(pair) for pair in zip(one.coefficients, one.nuisance, strict=True)]
        within = Within.of(view.point, inputs, i)
        left = coming(one.residual, own, one.noise, inputs, within, one.scale)
        if left.is_clear or by_predictor(inputs, i, within.guard).is_clear:
            return True
    return False


def starts_wild(view: View) -> bool:
    """Whether some of the first samples are far from the model, alone or together.

    A free start follows them as far as it can, and a noise model the rest: what tests the residual
    as a whole does not see them.
    """
    for output in view.outputs:
        seen = np.concatenate([one[np.isfinite(one)] for one in output.standardised])
        limit = WILD * median_scale(np.abs(seen - median(seen))) if seen.size else 0.0
        first = [one[:FIRST_SAMPLES] for one in output.standardised]
        if limit > 0 and any(np.any(np.abs(one[np.isfinite(one)]) > limit) for one in first):
            return True
    return False


def try_causes(view: View, estimate: Estimate, n_lags: int, rate: float) -> KnownCauses:
    """Make all tests, and fit what may explain what they find.

    Where the state of the model jumps rows may have been lost; if that is not what explains the
    record best, the jumps are no cause of their own.

    Parameters
    ----------
    view : View
    estimate : Estimate
    n_lags : int
        Of the autocorrelations.
    rate : float
        Probability of a false outlier.
    """
    setting = _Setting(estimate, n_lags, rate, (), {})
    known: Explanations | None = None
    in_gaps = tuple(after_gaps(view.records))
    for gaps in (True, False) if in_gaps else (False,):
        torn = setting._replace(torn=in_gaps if gaps else tuple(torn_at(view)))
        if not torn.torn:
            continue
        tried = _looked_again(_tried(view, torn, True), view, torn)
        if tried.named is not None and tried.named.rival.code == "lost-rows":
            return tried
        known = tried.explained
    outputs = range(len(view.outputs))
    bad = any(len(_examined(view, i, setting).normality.outliers) for i in outputs)
    asked = bad and not (view.stamped or view.driven)
    with_bad = None
    if asked and forecasts_react(view.point, view.records):
        # a fit that feedback has bent calls good samples bad, and hides it without them
        with_bad = _tried(view, setting, False, known)
        if with_bad.cause == "feedback":
            return with_bad
    without = _looked_again(_tried(view, setting, True, known), view, setting)
    found = sum(len(one.normality.outliers) for one in without.evidence)
    if not found or not without.cause:
        return without
    # the start of a larger model follows whatever stands at the start of a record
    early = sum(len(first_ones(view, one.normality.outliers)) for one in without.evidence)
    follows = without.cause == "order-low" and early > FADED * found
    if follows and _far_without(without, view) > FADED * found:
        return without
    # what the model misses has far samples too: do they stand out where the cause is fitted along?
    if _stand_out(view, setting, without.cause, FADED * found):
        return without
    whole = with_bad if with_bad is not None and known is None else _tried(view, setting, False)
    rows = _far_beside(view, _ends(whole), rate)
    if whole.cause != without.cause or sum(len(one) for one in rows) > FADED * found:
        return without
    whole = _looked_again(whole, view, setting)
    evidence = [with_outliers(*pair) for pair in zip(whole.evidence, rows, strict=True)]
    return replace(whole, evidence=evidence)


class _Setting(NamedTuple):
    """What all tests are made with.

    Far samples right after the places where the record is torn are no outliers. The same output of
    the same view is looked at more than once; what was found is kept.
    """

    estimate: Estimate
    n_lags: int
    rate: float
    torn: tuple[Place, ...]
    known: dict[tuple[View, int, tuple[Place, ...] | None], Evidence]


def _tried(
    view: View, setting: _Setting, without_bad: bool, known: Explanations | None = None
) -> KnownCauses:
    """All tests and causes, with the bad samples or without; not yet what is left beside them."""
    torn = setting.torn
    outputs = range(len(view.outputs))
    evidence = [_examined(view, i, setting) for i in outputs]
    moved_by = ""
    if without_bad and any(len(one.normality.outliers) for one in evidence):
        view, evidence, moved_by = _without_bad_samples(view, evidence, setting)
    explained = None
    called = any(_called(one) or one.feedback < CALLED for one in evidence)
    # what follows a command late has far samples there, and errors come from scatter
    far = any(after_a_jump(view, _far(view, i, setting), WORTH_A_LOOK).any() for i in outputs)
    hinted = view.own and (
        far
        or setting.estimate.errors == "scores"
        or any(suspicious(view, i, setting.estimate) for i in outputs)
    )
    stepped = any(steps(own) for output in view.outputs for own in output.residual)
    # lines between recorded samples look like most causes
    lines = any(map(interpolated, view.records))
    if not lines and (torn or called or hinted or stepped or may_react(view)):
        noises = [one.noise for one in evidence]
        explained = explanations(view, setting.estimate, noises, torn, known=known)
    elif view.own and may_carry_noise(view.records):
        explained = of_input_noise(view, setting.estimate, [one.noise for one in evidence])
    evidence = _reacting(view, evidence, explained)
    return KnownCauses(
        setting.estimate, view, evidence, explained, [None for _ in outputs], moved_by
    )


def _looked_again(tried: KnownCauses, given: View, setting: _Setting) -> KnownCauses:
    """With what is found beside the cause that is named.

    Parameters
    ----------
    tried : KnownCauses
    given : View
        With the bad samples.
    setting : _Setting
    """
    named, view, evidence = tried.named, tried.view, tried.evidence
    if named is None or not same_records(named):
        return tried
    if told_alone(named):
        evidence = [_beside(named, given, i, one) for i, one in enumerate(evidence)]
        tried = replace(tried, evidence=evidence)
    pieces = view
    if named.rival.code == "lost-rows":
        pieces = replace(view, records=named.rival.parts[0].records)
    other = refitted(pieces, named.attempts[0].point)
    again = [
        _examined(other, i, setting._replace(torn=())).having(feedback=NOTHING)
        if setting.torn or _called(evidence[i])
        else None
        for i in range(len(view.outputs))
    ]
    return replace(tried, again=again)


def _beside(named: Explanation, view: View, i: int, one: Evidence) -> Evidence:
    """Without the bad samples that the cause explains: those beyond a limit are none."""
    return with_outliers(one, still_far(named, view, i, one.normality.outliers))


def _ends(tried: KnownCauses) -> tuple[Attempt, ...]:
    """Where the cause that is named ended, or the present explanation."""
    assert tried.explained is not None
    named = tried.named
    return (tried.explained.present,) if named is None else named.attempts


def _far_without(tried: KnownCauses, given: View) -> int:
    """Bad samples that stay far from the cause that is named, fitted without them.

    All of them where it was fitted with them: nothing but them called for a cause.
    """
    named, bad = tried.named, [one.normality.outliers for one in tried.evidence]
    if named is None or tried.view is given:
        return sum(map(len, bad))
    return sum(len(still_far(named, given, i, rows)) for i, rows in enumerate(bad))


def _stand_out(view: View, setting: _Setting, cause: str, most: float) -> bool:
    """Whether far samples do stand out where a cause is fitted along, or it is no cause with them.

    That cause alone is fitted, which is a part of the work. Where it is not so sure all causes have
    to be compared.
    """
    if cause in ("feedback", "lost-rows"):
        return False
    noises = [_examined(view, i, setting).noise for i in range(len(view.outputs))]
    explained = explanations(view, setting.estimate, noises, only=cause)
    if explained is None or explained.best is None:
        return True
    rows = _far_beside(view, explained.best.attempts, setting.rate)
    return sum(len(one) for one in rows) > most


def _far_beside(view: View, ends: Sequence[Attempt], rate: float) -> list[Array]:
    """Outliers of every output in what an explanation leaves, whitened."""
    lengths = np.cumsum([record.n_samples for record in view.records])[:-1]
    times, found = [record.t for record in view.records], []
    for i, output in enumerate(view.outputs):
        whitened, a = [], np.zeros(0)
        for end in ends:
            noise = end.point.problem.noise
            a = noise[i] if noise else np.zeros(0)
            left = end.standardised()
            whitened += [whiten(np.ascontiguousarray(one[:, i]), a)[0] for one in left]
        series = np.split(np.concatenate(whitened), lengths)
        found.append(distribution(output.name, series, times, rate, a).outliers)
    return found


def _reacting(
    view: View, evidence: Sequence[Evidence], explained: Explanations | None
) -> list[Evidence]:
    """With feedback only where no other cause explains as much, and without what it explains."""
    found = []
    for i, one in enumerate(evidence):
        if explained is None:
            commanded = view.driven or is_staircase(view.records)
            found.append(one.having(feedback=NOTHING) if commanded else one)
        elif (seen := explained.reacts[i]) is not None:
            found.append(one.having(feedback=seen.p_value, past=NOTHING))
        else:
            found.append(one.having(feedback=NOTHING))
    return found


def _after(torn: Sequence[Place], view: View, rows: Array) -> Array:
    """Outliers but for those right after a jump of the state."""
    kept = np.ones(len(rows), dtype=bool)
    for place in torn:
        t = view.records[place.experiment].t
        last = min(place.sample + LEAST_PIECE, t.size - 1)
        near = (rows[:, 1] > t[place.sample - 1] - 1e-9) & (rows[:, 1] < t[last])
        kept &= ~(near & (rows[:, 0] == place.experiment))
    return rows[kept]


def _without_bad_samples(
    view: View, evidence: list[Evidence], setting: _Setting
) -> tuple[View, list[Evidence], str]:
    """The same model without samples that stand alone, where these are few.

    Returns
    -------
    view : View
        Seen from there, where something but noise was left; fitted to the identified record, as it
        is on another one.
    evidence : list of Evidence
    said : str
        How far the coefficients move.
    """
    clean, evidence = _cleaned(view, evidence, setting)
    kept = [a.count / b.count for a, b in zip(clean.outputs, view.outputs, strict=True)]
    if min(kept) < FEW_BAD:
        return view, evidence, ""
    seen, said = clean, ""
    if view.own:
        end = settled(clean, setting.estimate, [one.noise for one in evidence])
        if end is None:
            return view, evidence, ""
        seen, said = refitted(clean, end.point), change(end, setting.estimate)
    if not any(_called(one) for one in evidence):
        return view, evidence, said
    found = []
    for i, one in enumerate(evidence):
        again = _examined(seen, i, setting)
        found.append(again.having(normality=one.normality, innovations=one.innovations))
    return replace(seen, own=view.own, has_errors=view.has_errors), found, said


def _cleaned(
    view: View, evidence: list[Evidence], setting: _Setting
) -> tuple[View, list[Evidence]]:
    """Without bad samples, and without those at the start that are seen once these are gone.

    A free start follows the first samples as far as it can, however wild they are.
    """
    clean = _all_taken_out(view, evidence)
    for _ in range(LOOKS):
        # nothing is hidden where nothing is wild
        again = [
            _first_bad(clean, i, setting)
            if len(first_ones(view, one.normality.outliers))
            else one.normality.outliers[:0]
            for i, one in enumerate(evidence)
        ]
        if not any(map(len, again)):
            break
        evidence = [
            with_outliers(one, np.vstack([one.normality.outliers, rows]))
            for one, rows in zip(evidence, again, strict=True)
        ]
        clean = _all_taken_out(view, evidence)
    evidence = [with_those_between(view, i, one) for i, one in enumerate(evidence)]
    return _all_taken_out(view, evidence), evidence


def _first_bad(view: View, index: int, setting: _Setting) -> Array:
    """Bad samples at the start of an output.

    Not all that are far are bad: where none of the first is far, that need not be told.
    """
    far = first_ones(view, _whole(view, index, setting).normality.outliers)
    if not len(far):
        return far
    return first_ones(view, _examined(view, index, setting).normality.outliers)


def _all_taken_out(view: View, evidence: Sequence[Evidence]) -> View:
    """The same view with the outliers of all outputs missing."""
    for i, one in enumerate(evidence):
        if len(one.normality.outliers):
            view = without_outliers(view, i, one)
    return view


def _called(one: Evidence) -> bool:
    """Whether something but noise may be left in a residual."""
    return min(one.past, one.level) < CALLED or one.later < CALLED or one.linear < CALLED


def _examined(view: View, index: int, setting: _Setting) -> Evidence:
    """All tests of one output, on the samples that are no outliers."""
    known, key = setting.known, (view, index, setting.torn)
    if key not in known:
        known[key] = _tested(view, index, setting)
    return known[key]


def _far(view: View, index: int, setting: _Setting) -> Array:
    """All far samples of an output, also those that follow a jump."""
    found = setting.known.get((view, index, None))
    return np.zeros((0, 3)) if found is None else found.normality.outliers


def _whole(view: View, index: int, setting: _Setting) -> Evidence:
    """All tests of one output, on all samples."""
    estimate, n_lags, rate, _, known = setting
    key = view, index, None
    if key not in known:
        known[key] = examine(view, index, estimate, n_lags, rate)
    return known[key]


def _tested(view: View, index: int, setting: _Setting) -> Evidence:
    estimate, n_lags, rate, torn, _ = setting
    whole = with_bad_samples_alone(view, _whole(view, index, setting))
    found = without_foreseen(view, index, whole)
    if torn and len(found.normality.outliers):
        found = with_outliers(found, _after(torn, view, found.normality.outliers))
    if not len(found.normality.outliers) or found.past < CALLED:
        return found
    clean = without_outliers(view, index, found)
    if clean.outputs[index].count < view.outputs[index].count * FEW_LEFT:
        return found
    again = examine(clean, index, estimate, n_lags, rate)
    return again.having(normality=found.normality, innovations=found.innovations)
