"""Validation of a plant that is not stable, or nearly so: by the errors of its predictor.

The response of such a model runs away from any record, and is not laid beside one. What is fitted
is a predictor (`closed_loop.predictor`); its errors are white, or what the model of the noise makes
of white noise, where plant and noise are right. Start, offset and levels of the inputs are those
that suit the record best. The input of a continuous controller is neither held nor straight between
the samples: held references make it jump there, and it is on its way to where it jumps from. Where
there is no such predictor (several outputs, uneven time), nothing is tested, and that is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.closed_loop.as_recorded import Foretold, jumps
from tridentify.estimation.closed_loop.between_samples import Loop, with_input
from tridentify.estimation.closed_loop.joint import Together
from tridentify.estimation.closed_loop.unstable_answer import open_loops
from tridentify.estimation.methods.in_loop import looked_for, plant_of
from tridentify.judgement.causes.signals.surprises import moved
from tridentify.judgement.validation.phrases import one_finding
from tridentify.judgement.validation.residuals import check_channels
from tridentify.judgement.validation.result import Check, Validation, untested
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import most_coefficients
from tridentify.numerics.lagrange import added, holm, span
from tridentify.numerics.portmanteau import autocorrelation_of_fit, portmanteau
from tridentify.record.record import Record

NO_RESPONSE_BESIDE = (
    "a plant that is not stable, or nearly so, has no response to lay beside a record: fit and "
    "tests are those of its predictor, one sample ahead"
)
LAGS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24)
"""Samples ago at which inputs are looked for in what the predictor leaves."""
INPUTS, REFERENCES = "past inputs", "past references"
NOT_GIVEN = (
    "the model is of a loop with a reference, and without it whether part of the response is "
    "missing was not tested (--reference NAME, in Python Record(reference=...))"
)
NOT_TESTED = "its predictor cannot be made of these records: nothing was tested"


def validate_foretold(
    estimate: Estimate, records: Sequence[Record], level: float, *, own: bool
) -> Validation:
    """Test the errors of the predictor that an estimate is a fit of.

    Parameters
    ----------
    estimate : Estimate
        Of a plant that is not stable, or nearly so.
    records : sequence of Record
    level : float
        Probability that a right model passes.
    own : bool
        Whether they are those that were identified.

    Raises
    ------
    ChannelCountError
        The channels are not those of the estimate.
    TooFewSamplesError
        An output was not recorded.
    """
    check_channels(estimate, records, None)
    there = _at(estimate, records)
    if there is None:
        none = tuple(np.full(record.y.shape, np.nan) for record in records)
        lost = np.full(len(estimate.output_names), np.nan)
        fit = np.array(estimate.fit) if own else lost.copy()
        nothing = untested(
            estimate,
            records,
            level,
            own=own,
            fits=(fit, lost),
            residual=none,
            findings=_not_tested(estimate.output_names),
            verdict=f"No verdict: {NO_RESPONSE_BESIDE}; {NOT_TESTED}.",
            notes=(NO_RESPONSE_BESIDE, NOT_TESTED),
        )
        return replace(nothing, innovations=none)
    unknown = estimate.route == "reference" and any(one.reference is None for one in records)
    tests = _tests(there, records, level, unknown)
    found = _findings(tests, estimate.output_names[0])
    grown = [one.predictor.amplification for one in there.ahead]
    errors = [one / size for one, size in zip(there.errors, grown, strict=True)]
    fits = _fits(records, errors)
    where = f"fit {estimate.output_names[0]} {fits[0][0]:.1f} %, one sample ahead"
    size = np.sqrt(there.size / max(there.count - there.unknowns, 1))
    places = np.cumsum([one.seen.size for one in there.ahead])[:-1]
    plain = untested(
        estimate,
        records,
        level,
        own=own,
        fits=fits,
        residual=tuple(one[:, None] for one in errors),
        findings=found,
        verdict=f"{found[0].message[:-1]} ({where})."
        if found
        else f"Nothing speaks against the predictor of the model ({where}).",
        notes=(NO_RESPONSE_BESIDE, *([NOT_GIVEN] if unknown else [])),
    )
    white = np.split(there.innovations / size, places)
    return replace(plain, tests=tests, innovations=tuple(one[:, None] for one in white))


def _at(estimate: Estimate, records: Sequence[Record]) -> Together | None:
    """The predictor beside these records; None where there is none, or it runs away too."""
    sought = looked_for(records, estimate.structure)
    if sought is None:
        return None
    try:
        plant = plant_of(estimate)
        plant = sought.within(plant, None, sought.known(plant.scale))
        noise = np.array(estimate.noise_model[0]) if estimate.noise_model else np.zeros(0)
        taken = estimate.loop
        moving = taken is not None and taken.sampling == "continuous"
        loops = _moving(records) if moving else open_loops(records)
        found = Together.at(loops, plant, noise)
        return found if np.isfinite(found.size) and found.size > 0 else None
    except (TridentifyError, np.linalg.LinAlgError, ValueError):
        return None


def _moving(records: Sequence[Record]) -> list[Loop]:
    """Records whose inputs a continuous controller makes of its references and the output.

    Without a reference nothing tells the jumps from the rest, and it is as recorded.
    """
    found = []
    for record, plain in zip(records, open_loops(records), strict=True):
        u = np.asarray(record.u)
        ahead = Foretold(with_input(record, u, "foh"), u - jumps(record))
        found.append(plain if record.reference is None else Loop(ahead, "continuous"))
    return found


def _tests(
    there: Together, records: Sequence[Record], level: float, unknown: bool
) -> tuple[Check, ...]:
    """Whether the innovations are white and know nothing of what moved the plant before.

    That is the references, where there are some: a controller made the inputs of past outputs, and
    mirrored poles make the errors of past noise. Without them it is the inputs; neither where the
    references are ``unknown``. Coefficients and noise are taken as fitted to these records, to
    first order: on others that allows for their errors.
    """
    name = records[0].output_names[0]
    finite = np.isfinite(there.columns).all()
    known = there.columns[:, : 0 if not finite else None]
    basis = span(np.hstack([there.start_basis, known]))
    left = there.innovations - basis @ (basis.T @ there.innovations)
    seen = [one.seen.astype(np.float64) for one in there.ahead]
    places = np.cumsum([one.size for one in seen])[:-1]
    lags = max(most_coefficients(there.count), there.noise.size + 4)
    found = autocorrelation_of_fit(np.split(left, places), seen, np.split(basis, places), lags)
    values = {"white": portmanteau(found, there.noise).p_value}
    referred = [record.reference for record in records if record.reference is not None]
    outer = referred if len(referred) == len(records) else [record.u for record in records]
    what = REFERENCES if outer is referred else INPUTS
    past = np.vstack(
        [
            one.white(moved(moves - moves[0], LAGS), there.noise)
            for one, moves in zip(there.ahead, outer, strict=True)
        ]
    )
    if not unknown:
        values[what] = added(left, basis, span(past, basis), there.count).p_value
    rejected = holm(np.array(list(values.values())), 1.0 - level)
    pairs = zip(values.items(), rejected, strict=True)
    return tuple(Check(what, name, float(p), bool(far)) for (what, p), far in pairs)


def _not_tested(names: Sequence[str]) -> tuple[Finding, ...]:
    said = f"Nothing was tested of {', '.join(names)}: {NO_RESPONSE_BESIDE}, which cannot be made."
    remedy = "Compare the coefficients of two records, or of the halves of one."
    return (Finding("unstable", "warning", said, remedy, tuple(names)),)


def _findings(tests: Sequence[Check], name: str) -> tuple[Finding, ...]:
    """What the innovations still hold."""
    rejected = {one.name for one in tests if one.rejected}
    found = []
    for what in rejected & {INPUTS, REFERENCES}:
        found.append(
            one_finding(
                "unmodelled-response",
                name,
                f"what the predictor of {name} leaves follows {what}: part of the response is "
                "missing, or the model of the noise stands for some of it",
                "try other orders, a delay or as many zeros as poles; a predictor of a wrong "
                "structure may end on a pole that is not there",
            )
        )
    if "white" in rejected:
        found.append(
            one_finding(
                "noise-model",
                name,
                f"what the predictor of {name} leaves is correlated with itself: the noise model "
                "does not fit, and the standard errors do not allow for it",
                "compare the coefficients of two records, or of the halves of one",
            )
        )
    return tuple(found)


def _fits(records: Sequence[Record], errors: Sequence[Array]) -> tuple[Array, Array]:
    """NRMSE [percent], each experiment about its own mean as in the estimate, and R2."""
    y = [record.y[:, 0] - np.nanmean(record.y[:, 0]) for record in records]
    spread = sum(float(np.nansum(one**2)) for one in y)
    left = sum(float(np.nansum(one**2)) for one in errors)
    share = left / spread if spread > 0 else np.nan
    return np.array([100.0 * (1.0 - np.sqrt(share))]), np.array([1.0 - share])
