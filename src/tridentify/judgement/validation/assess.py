"""The front door: an estimate and a record in, whether to trust it out.

The tests of every output (`validation.statistics.evidence`), and on another record those of
`statistics.transfer`, form one family. Holm's procedure rejects in it so that a model which is
right is called wrong with at most the probability ``1 - level``, whatever the dependence between
the tests; a tenth of it is spent on outliers. What is rejected is put into words
(`validation.verdict`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtri

from tridentify.errors import OptionError, SampleTypeError, TridentifyError
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding, joined
from tridentify.estimation.likelihood.noise.noise_levels import weighed
from tridentify.estimation.methods.explained import explained_or_refused
from tridentify.judgement.causes.attempts.feedback import Inputs
from tridentify.judgement.causes.attempts.fewer import VAGUE
from tridentify.judgement.causes.attempts.first_samples import Predictions, beginning
from tridentify.judgement.causes.sensors.input_floor import may_carry_noise
from tridentify.judgement.validation.foretold import validate_foretold
from tridentify.judgement.validation.phrases import decapitalised
from tridentify.judgement.validation.remembered import (
    as_identified,
    given_away,
    kept_look,
    remember,
    remembered,
)
from tridentify.judgement.validation.residuals import View, look
from tridentify.judgement.validation.result import Stationarity, Validation, Whiteness, untested
from tridentify.judgement.validation.statistics.correlation import correlate
from tridentify.judgement.validation.statistics.evidence import Evidence, suspicious
from tridentify.judgement.validation.statistics.likelihood_ratio import CALLED
from tridentify.judgement.validation.statistics.transfer import carried_over
from tridentify.judgement.validation.tried import may_react, starts_wild, torn_at, try_causes
from tridentify.judgement.validation.verdict import brief, family, findings, in_words
from tridentify.numerics.arrays import Array
from tridentify.numerics.lagrange import holm
from tridentify.numerics.threads import one_blas_thread
from tridentify.record.record import Record

FEWEST_LAGS, MOST_SHOWN_LAGS = 20, 60
"""Lags of the correlations that are shown: three of the slowest time constants, between these
two."""
LEVEL = 0.99
"""Confidence of the bounds that are drawn, by default."""
LONGEST_LOOK = 5_000
"""Samples of each record that every estimate is judged by; `validate` takes them all."""
OUTLIERS = 0.1
"""Share of the false alarms that is spent on outliers."""


def validate(
    estimate: Estimate,
    record: Record | Sequence[Record],
    *,
    experiment: int | None = None,
    level: float = LEVEL,
    n_lags: int | None = None,
) -> Validation:
    """Test whether an estimate explains a record but for noise, and say what it misses.

    Parameters
    ----------
    estimate : Estimate
    record : Record or sequence of Record
        The identified ones, or others with the same channels. Offset and initial state of others
        are fitted, those of lowest AICc, with the coefficients held. What the estimate found in its
        own record and no residual shows (no response, a sensor that hung, needless poles) stands
        among the findings of that record.
    experiment : int, optional
        The record is this experiment of the estimate; its offset and initial state are used.
    level : float
        Probability that a right model passes all tests together, and that one value of a
        correlation lies within its bounds.
    n_lags : int, optional
        Largest lag of the correlations that are given back [samples]; by default from the settling
        time of the model. The tests choose their own.

    Returns
    -------
    Validation

    Raises
    ------
    ChannelCountError
        The record has other channels.
    TooFewSamplesError
        There is no output, or too little of it to test.
    OptionError
        ``level`` or ``n_lags`` is out of range.
    SampleTypeError
        It is no record, or ``estimate`` is no estimate.

    References
    ----------
    L. Ljung, *System Identification*, 2nd ed., chapter 16 (1999). L. Godfrey, *Misspecification
    Tests in Econometrics*, Cambridge (1988), for tests of added columns.

    Examples
    --------
    >>> import numpy as np
    >>> from tridentify import Record, Structure, TransferFunction, identify, simulate, validate
    >>> rng = np.random.default_rng(1)
    >>> u = np.repeat(rng.choice([-1.0, 1.0], 50), 8)
    >>> y = simulate(TransferFunction([9.0], [1.0, 1.2, 9.0]), Record(u, u, dt=0.1))[:, 0]
    >>> record = Record(u, y + 0.1 * rng.standard_normal(400), dt=0.1)
    >>> validate(identify(record, Structure(2, 0)), record).ok
    True
    >>> validate(identify(record, Structure(1, 0)), record).findings[0].code
    'order-low'
    """
    if not isinstance(estimate, Estimate):
        raise SampleTypeError(
            f"found {type(estimate).__name__} in place of an estimate; expected what identify or "
            "Estimate.load gives, before the record; write validate(estimate, record)"
        )
    estimate, records, wild = as_identified(estimate, record)
    if fingerprint(records) == estimate.record_fingerprint:
        records = weighed(records, estimate.noise_levels)
    if not (isinstance(level, float) and 0.5 <= level < 1.0):
        raise OptionError(
            f"found level={level!r}; expected a probability from 0.5 to below 1; write level=0.99"
        )
    if n_lags is not None and (not isinstance(n_lags, int) or n_lags < 1):
        raise OptionError(
            f"found n_lags={n_lags!r}; expected a whole number of at least 1; leave it out"
        )
    with one_blas_thread():
        usual = experiment is None and n_lags is None and level == LEVEL
        known = given_away(estimate, records) if usual else None
        if known is not None:
            return _with_what_was_said(known, estimate, estimate.findings, wild)
        own = fingerprint(records) == estimate.record_fingerprint
        if estimate.loop is not None and estimate.loop.mirrored:
            found = validate_foretold(estimate, records, level, own=own)
        else:
            view = look(estimate, explained_or_refused(estimate, records), experiment, own=own)
            found = _judge(estimate, view, level, n_lags or _lags(view))
        return _with_what_was_said(found, estimate, estimate.findings if own else (), wild)


PASSES_FOR_KNOWN = 0.3
"""Median relative standard error below which coefficients pass for known. Then needless poles are
an objection; where they are as vague as they are needless, their errors say so. Of right models
that are told of needless poles the median is mostly 0.4 to 0.8, of four poles from one sine 0.01
to 1."""

FOLLOWED, NOT_FOLLOWED = 80.0, 33.0
"""Fit [percent] from which a record is one of little noise, and up to which its output is hardly
followed. Right models in noise of a third of their output's power (5 dB) reach 51 %, and are told
of needless poles or of no response in 3 of 100; one sine is fitted to 99 %, a wrong column to 1 to
31 %."""


def _stands(one: Finding, estimate: Estimate) -> bool:
    """Whether what an estimate says of its own record is an objection to the model."""
    errors = {p.name: p.relative_std for p in estimate.parameters.values() if p.std}
    fit = float(np.max(estimate.fit))
    if one.code == "order-high":
        known = np.median(list(errors.values())) < PASSES_FOR_KNOWN
        return bool(known) and fit > FOLLOWED
    if one.code == "no-response":
        vague = all(error > VAGUE for name, error in errors.items() if name.startswith("b"))
        return vague and fit < NOT_FOLLOWED
    between = one.code == "intersample" and estimate.route != "reference"
    return one.severity == "error" or one.code == "stuck-sensor" or between


def _with_what_was_said(
    found: Validation, estimate: Estimate, known: Sequence[Finding], wild: Sequence[Finding]
) -> Validation:
    """With what the estimate knows of the same record and no residual shows.

    What has no response, or follows from a sensor that hung, may leave a residual like noise.
    """
    said = list(wild)
    for one in (own for own in known if own.matters or own.code == "tone"):
        said.append(one if _stands(one, estimate) else replace(one, severity="note"))
    both = joined(found.findings, said)
    verdict = found.verdict
    if any(one.matters for one in both):
        if both != found.findings:
            verdict = in_words(both, found.output_names, found.transfer, found.fit.tolist())
        return replace(found, findings=both, verdict=verdict)
    warned = [brief(one.message) for one in known if one.matters]
    if warned:
        which = "; ".join(dict.fromkeys(warned))
        verdict = f"{verdict} The estimate itself warns of its numbers. To be known: {which}."
    elif both and not found.findings:
        verdict = f"{verdict} To be known: {decapitalised(both[0].message)}"
    return replace(found, findings=both, verdict=verdict)


def looked_at(
    estimate: Estimate, records: Sequence[Record], known: Predictions | None = None
) -> tuple[Finding, ...]:
    """What all tests find of the records that were identified, where a look calls for them.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified, their inputs' behaviour settled.
    known : Predictions, optional
        What was computed before.

    Returns
    -------
    tuple of Finding
        As `validate`; empty where a quick look finds nothing, or too little is there to test.
    """
    before = remembered(estimate, records)
    if before is not None:
        return before.findings
    view = own_look(estimate, records, known)
    if view is None:
        return ()
    cut = any(beginning(one, LONGEST_LOOK) is not one for one in records)
    try:
        outputs = range(len(view.outputs))
        called = _noise_may_hide(view) or any(suspicious(view, i, estimate) for i in outputs)
        hidden = may_carry_noise(view.records)
        if not (called or hidden or starts_wild(view) or torn_at(view) or may_react(view)):
            return ()
        found = _judge(estimate, view, LEVEL, _lags(view))
    except (TridentifyError, np.linalg.LinAlgError):
        return ()
    if cut:
        return tuple(f for f in found.findings if f.code != "noise-size")
    if fingerprint(records) == estimate.record_fingerprint:
        remember(estimate, records, found)
    return found.findings


def _noise_may_hide(view: View) -> bool:
    """Whether the noise has a model, which may have taken a drift or a change for noise.

    The quick look tests under the model of the estimate: one of many coefficients, found beside a
    drift, leaves nothing of it. The tests fit the noise again beside what they look for.
    """
    return any(output.noise.size for output in view.outputs)


def own_look(
    estimate: Estimate, records: Sequence[Record], known: Predictions | None = None
) -> View | None:
    """A quick look at the records that were identified; None where there is nothing to test."""
    short = [beginning(record, LONGEST_LOOK) for record in records]
    whole = all(one is record for one, record in zip(short, records, strict=True))

    def made() -> View | None:
        try:
            view = look(estimate, short, None, own=True, known=known if whole else None)
        except (TridentifyError, np.linalg.LinAlgError):
            return None
        return None if any(output.is_rounding for output in view.outputs) else view

    # what is kept keeps its records
    return kept_look(estimate, records, made) if whole else made()


def may_react_at_all(estimate: Estimate, records: Sequence[Record]) -> bool:
    """Whether a quick look at the identified records suspects that an input reacts to an output."""
    plain = not any(a.size for a in estimate.noise_model)
    if plain and Inputs.of([beginning(one, LONGEST_LOOK) for one in records]).commanded:
        return False  # whatever is left of the outputs
    view = own_look(estimate, records)
    return view is not None and may_react(view)


def _lags(view: View) -> int:
    """Three of the slowest time constants, within reason."""
    decay = np.min(np.abs(view.point.poles.real))
    fewest = min(record.n_samples for record in view.records) // 4
    wanted = int(min(3.0 / (decay * view.step), MOST_SHOWN_LAGS)) if decay > 0 else MOST_SHOWN_LAGS
    return max(min(max(wanted, FEWEST_LAGS), fewest), 2)


def _judge(estimate: Estimate, view: View, level: float, n_lags: int) -> Validation:
    if any(output.is_rounding for output in view.outputs):
        return _untested(estimate, view, level)
    outputs, n_inputs = range(len(view.outputs)), view.records[0].n_inputs
    rate = (1.0 - level) * OUTLIERS / len(outputs)
    tried = try_causes(view, estimate, n_lags, rate)
    view, evidence = tried.view, tried.evidence
    noises = [one.noise for one in evidence]
    transfer = None if view.own else carried_over(view, estimate, noises)
    tests = family(evidence, estimate.output_names, transfer)
    made = [k for k, test in enumerate(tests) if np.isfinite(test.p_value)]
    p_values = np.array([tests[k].p_value for k in made])
    for k, rejected in zip(made, holm(p_values, (1.0 - level) * (1.0 - OUTLIERS)), strict=True):
        tests[k] = replace(tests[k], rejected=bool(rejected))
    pictures = tuple(
        correlate(
            view,
            i,
            j,
            noises[i],
            n_lags,
            level,
            evidence[i].by_input[j],
            evidence[i].level < CALLED,
        )
        for i in outputs
        for j in range(n_inputs)
    )
    found = findings(tried, pictures, tests, transfer)
    if estimate.loss != "squared" or tried.wanders:
        # a robust loss does not follow them, and a delay that varies leaves some that it makes
        found = tuple(replace(f, severity="note") if f.code == "bad-samples" else f for f in found)
    innovations = zip(*(one.innovations for one in evidence), strict=True)
    plain = _untested(estimate, view, level)
    return replace(
        plain,
        whiteness=tuple(_whiteness(one, view, i, level) for i, one in enumerate(evidence)),
        cross_correlation=pictures,
        normality=tuple(one.normality for one in evidence),
        stationarity=tuple(_stationarity(one, view, i) for i, one in enumerate(evidence)),
        transfer=transfer,
        tests=tuple(tests),
        findings=found,
        verdict=in_words(found, estimate.output_names, transfer, plain.fit.tolist()),
        notes=_notes(view, evidence),
        innovations=tuple(np.stack(one, axis=1) for one in innovations),
    )


def _untested(estimate: Estimate, view: View, level: float) -> Validation:
    """A record without noise: the residual is rounding, and there is nothing to test."""
    return untested(
        estimate,
        view.records,
        level,
        own=view.own,
        fits=_fits(view),
        residual=_residual(view),
        verdict="Nothing speaks against the model: the residual of an output is no more than "
        "rounding.",
        notes=(*view.told, "a residual that is rounding is not tested"),
    )


def _residual(view: View) -> tuple[Array, ...]:
    rows = zip(*(output.residual for output in view.outputs), strict=True)
    return tuple(np.stack(one, axis=1) for one in rows)


def _fits(view: View) -> tuple[Array, Array]:
    """NRMSE [percent], each experiment about its own mean as in the estimate, and R2_T."""
    fit, r2 = [], []
    for output in view.outputs:
        energy = spread = variance = 0.0
        for y, r in zip(output.y, output.residual, strict=True):
            there = np.isfinite(r)
            energy += float(np.sum(r[there] ** 2))
            spread += float(np.sum((y[there] - y[there].mean()) ** 2))
            variance += float(np.sum((r[there] - r[there].mean()) ** 2))
        fit.append(100.0 * (1.0 - np.sqrt(energy / spread)) if spread > 0 else np.nan)
        r2.append(1.0 - variance / spread if spread > 0 else np.nan)
    return np.array(fit), np.array(r2)


def _whiteness(one: Evidence, view: View, index: int, level: float) -> Whiteness:
    found, test = one.autocorrelation, one.whiteness
    return Whiteness(
        view.outputs[index].name,
        np.asarray(np.arange(1, found.value.size + 1) * view.step, dtype=np.float64),
        found.value - found.mean,
        np.asarray(float(ndtri(0.5 + level / 2)) * found.std, dtype=np.float64),
        test.lags,
        test.statistics,
        test.p_values,
        test.p_value,
    )


def _stationarity(one: Evidence, view: View, index: int) -> Stationarity:
    name = view.outputs[index].name
    return Stationarity(name, one.level, one.scale, one.later, one.edges, one.scales)


def _notes(view: View, evidence: Sequence[Evidence]) -> tuple[str, ...]:
    told = list(view.told)
    if view.uneven:
        told.append(
            "time is uneven: lags count samples and stand for the typical step, so correlation "
            "over "
            "a fixed time is not tested, and the noise is taken as white in the estimate"
        )
    lost = bad = 0
    for i, output in enumerate(view.outputs):
        for record, residual in zip(view.records, output.residual, strict=True):
            gone = np.isnan(record.y[:, i])
            lost += int(gone.sum())
            bad += int((np.isnan(residual) & ~gone).sum())
    if lost:
        told.append(f"{lost} missing samples do not count")
    if bad:
        told.append(f"{bad} sample{' is' if bad == 1 else 's are'} left out as bad")
    for one, output in zip(evidence, view.outputs, strict=True):
        if one.noise.size and one.noise is not output.noise:
            told.append(
                f"the tests of {output.name} allow for noise that is autoregressive of order "
                f"{one.noise.size}"
            )
    return tuple(told)
