"""Robust fitting: a least-squares method repeated on pseudo-samples.

Where a few samples are far off, or the noise has heavy tails, least squares is not the likelihood.
The losses of `numerics.robust` are minimised by any least-squares method that is given
pseudo-samples ``y* = f + s psi((y - f) / s) / m`` in place of the output, with ``f`` the fitted
output of the round before:

    fit -> residuals -> scale, weights -> pseudo-samples -> fit -> ...

until the coefficients stand still. Each output has its own scale. All that the least-squares method
says at the end is then true of the robust estimate: its standard errors are those of the
M-estimate, AICc compares nuisance terms by the robust variance, the weights of several outputs
are their precisions.

The way in must be robust too. The search and the first fit see the record without the samples that
a robust parallel model finds far off (`search.gross_outliers`), as if they were missing; all
samples come back with the first round. Where the end disagrees with what was set aside there, the
search is repeated without what is far off at the end, and the better of the two counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.errors import OptionError, TridentifyError
from tridentify.estimation.answer.assemble import fingerprint
from tridentify.estimation.answer.decision import DecisionKind
from tridentify.estimation.answer.estimate import Estimate, Trace
from tridentify.estimation.methods.base import Method
from tridentify.estimation.search.gross_outliers import gross_outliers
from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.robust import LOSSES, Judged, Loss, judge
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

Near = Callable[[TransferFunction], Method]

MOST_ROUNDS = 40
"""Most rounds of weights: it bounds the time, an estimate each."""
OPEN_ROUNDS = 3
"""Rounds in which nuisance terms are decided anew; later they would only alternate."""
STILL = 2e-4
"""Movement [standard errors] below which the coefficients stand still: so little that
pseudo-samples and end agree to the digits that are shown."""
SLOW = 0.7
"""Movement over that of the round before from which rounds alternate, and are damped."""
DITHER = 1e-2
"""Movement [standard errors] below which slow rounds are not damped: they are near their end."""
LEAST_DAMPING = 0.125
"""Least share of a round's change that is made."""
FAR = 4.0
"""Standard deviations from which a sample is an outlier: one of 16,000 good ones is."""
NEAR = 2.5
"""Standard deviations within which a sample that was set aside should not have been: one of 80 good
ones is farther off."""
DOUBTFUL = 0.02
"""Share of the samples that were set aside wrongly, or should have been, from which the search is
repeated."""
FEW = 3
"""The same as a number, for short records."""


@dataclass(frozen=True, eq=False)
class Settled:
    """Where the rounds ended.

    Attributes
    ----------
    estimate : Estimate
        Of the pseudo-samples.
    trace : Trace
        All rounds.
    judged : tuple of Judged
        One per output, the experiments one after the other.
    distance : tuple of (n_samples, n_outputs) arrays
        Of every sample of every record from the model, in standard deviations of the noise.
    rounds : int
    still : bool
        Whether the coefficients came to rest.
    """

    estimate: Estimate
    trace: Trace
    judged: tuple[Judged, ...]
    distance: tuple[Array, ...]
    rounds: int
    still: bool


def check_loss(loss: str, noise: str = "white") -> None:
    """Refuse an unknown loss, or one beside a model of the noise.

    Raises
    ------
    OptionError
    """
    if loss not in LOSSES:
        raise OptionError(
            f"found loss={loss!r}; expected 'squared', 'huber' or 'student'; choose one of them"
        )
    if loss != "squared" and noise == "ar":
        raise OptionError(
            f"found noise='ar' with loss={loss!r}; expected one of the two, as whitening spreads "
            "an outlier over its neighbours; leave one out"
        )


def robust_estimate(
    records: Sequence[Record],
    structure: Structure,
    loss: Loss,
    plain: Method,
    near: Near,
    say: Callable[[str], None],
    words: tuple[str, ...] = (),
) -> Estimate:
    """Minimise a robust loss by least squares.

    Parameters
    ----------
    records : sequence of Record
    structure : Structure
    loss : {"huber", "student"}
    plain : Method
        The whole method with squared loss, its search included.
    near : callable
        The method of the rounds, which begins at a model.
    say : callable
        Is told what is going on.
    words : tuple of str
        Further decisions for the trace.

    Returns
    -------
    Estimate
        With the samples that lie far off in `Estimate.outliers`.
    """
    say("gross outliers, from the parallel model")
    aside = gross_outliers(records, structure)
    first = plain.estimate(_without(records, aside), structure, say)
    best = _settle(records, structure, loss, first, near, say)
    far = tuple(one > FAR for one in best.distance)
    doubtful = sum(
        int(((before & (distance < NEAR)) | (~before & now)).sum())
        for before, now, distance in zip(aside, far, best.distance, strict=True)
    )
    if doubtful > max(FEW, DOUBTFUL * sum(record.y.size for record in records)):
        say("another search, with other outliers set aside")
        try:
            first = plain.estimate(_without(records, far), structure, say)
            other = _settle(records, structure, loss, first, near, say)
        except TridentifyError:
            other = best
        best = min(best, other, key=lambda one: one.estimate.aicc)
    return _completed(records, loss, best, plain.name, words)


def _settle(
    records: Sequence[Record],
    structure: Structure,
    loss: Loss,
    estimate: Estimate,
    near: Near,
    say: Callable[[str], None],
) -> Settled:
    """Rounds of pseudo-samples until the coefficients stand still."""
    say(f"robust fit ({loss})")
    passes = list(estimate.trace.passes)
    starts, decisions = estimate.trace.starts, estimate.trace.decisions
    damping, before, still = 1.0, np.inf, False
    # a redescending loss begins on the end of a convex one
    use: Loss = "huber"
    for count in range(1, MOST_ROUNDS + 1):
        now = structure if count <= OPEN_ROUNDS else estimate.structure
        judged = _judge(records, estimate, use, damping)
        following = near(estimate.model).estimate(_pseudo_records(records, estimate, judged), now)
        moved = _moved(estimate, following)
        for one in following.trace.passes[1:]:
            note = f"robust round {count}" + (f"; {one.note}" if one.note else "")
            passes.append(replace(one, number=len(passes) + 1, note=note))
        decisions = following.trace.decisions or decisions
        same = following.structure == estimate.structure
        estimate = following
        if use != loss:
            use, before = (loss, np.inf) if moved < 1.0 or count > OPEN_ROUNDS else (use, moved)
            continue
        still = same and moved <= STILL
        if still:
            break
        if count > OPEN_ROUNDS and moved > max(SLOW * before, DITHER):
            damping = max(0.5 * damping, LEAST_DAMPING)
        before = moved
    if damping < 1.0:
        # the standard errors are those of undamped pseudo-samples
        judged = _judge(records, estimate, loss, 1.0)
        again = _pseudo_records(records, estimate, judged)
        estimate = near(estimate.model).estimate(again, estimate.structure)
    trace = Trace(tuple(passes), starts, decisions, estimate.trace.stopped)
    judged = _judge(records, estimate, loss, 1.0)
    spread = np.array([one.spread for one in judged])
    distance = tuple(
        np.abs(estimate.residual(record, experiment=e)) / spread for e, record in enumerate(records)
    )
    return Settled(estimate, trace, judged, distance, count, still)


def _moved(estimate: Estimate, following: Estimate) -> float:
    """Largest movement of a coefficient in its standard errors."""
    if following.theta.size != estimate.theta.size:
        return float("inf")
    step = np.abs(following.theta - estimate.theta)
    return float(np.max(step / np.maximum(following.std, 1e-12 * np.abs(following.theta) + 1e-300)))


def _judge(
    records: Sequence[Record], estimate: Estimate, loss: Loss, damping: float
) -> tuple[Judged, ...]:
    residuals = [estimate.residual(record, experiment=e) for e, record in enumerate(records)]
    joined = np.vstack(residuals)
    y = np.vstack([record.y for record in records])
    n_outputs = y.shape[1]
    seen = int(np.isfinite(joined).sum())
    # the same unknowns whether or not samples were set aside
    unknowns = len(estimate.theta) + sum(
        n.offset.size * (bool(np.any(n.offset_std)) + bool(np.any(n.drift_std)))
        + n.bends.size
        + (n.free_response.size if n.initial_state == "free" else 0)
        for n in estimate.nuisance
    )
    each = min(unknowns, seen - 1) / n_outputs
    size = np.sqrt(np.nanmean(y**2, axis=0))
    return tuple(judge(joined[:, i], loss, each, float(size[i]), damping) for i in range(n_outputs))


def _pseudo_records(
    records: Sequence[Record], estimate: Estimate, judged: Sequence[Judged]
) -> list[Record]:
    columns = np.column_stack([one.pseudo for one in judged])
    parts = np.split(columns, np.cumsum([record.n_samples for record in records])[:-1])
    return [
        record.with_outputs(estimate.predict(record, experiment=e) + part)
        for e, (record, part) in enumerate(zip(records, parts, strict=True))
    ]


def _without(records: Sequence[Record], aside: Sequence[Flags]) -> list[Record]:
    """Records with samples taken for missing."""
    return [
        record.with_outputs(np.where(flags, np.nan, record.y)) if flags.any() else record
        for record, flags in zip(records, aside, strict=True)
    ]


def _completed(
    records: Sequence[Record], loss: Loss, settled: Settled, method: str, words: tuple[str, ...]
) -> Estimate:
    """The last round's estimate as one of the samples as recorded."""
    estimate = settled.estimate
    joined = np.column_stack([one.weights for one in settled.judged])
    weights = np.split(joined, np.cumsum([record.n_samples for record in records])[:-1])
    rows = [
        (float(e), float(i), float(k), float(weights[e][k, i]))
        for e, distance in enumerate(settled.distance)
        for k, i in np.argwhere(distance > FAR)
    ]
    return replace(
        estimate,
        noise_variance=np.array([one.spread**2 for one in settled.judged]),
        fit=_fit(records, estimate, settled.distance),
        loss=loss,
        outliers=np.array(rows).reshape(-1, 4),
        record_fingerprint=fingerprint(records),
        trace=settled.trace.told(*_in_words(estimate, loss, settled), *words),
        method=method,
    )


def _fit(records: Sequence[Record], estimate: Estimate, distance: Sequence[Array]) -> Array:
    """NRMSE fit [percent] of the samples that do not lie far off."""
    near = np.vstack(distance) <= FAR
    y = np.where(near, np.vstack([record.y for record in records]), np.nan)
    left = [estimate.residual(record, experiment=e) for e, record in enumerate(records)]
    residual = np.where(near, np.vstack(left), np.nan)
    power = np.nanmean((y - np.nanmean(y, axis=0)) ** 2, axis=0)
    rest = np.nanmean(residual**2, axis=0)
    return np.asarray(100.0 * (1.0 - np.sqrt(rest / np.where(power > 0, power, np.inf))))


def _in_words(estimate: Estimate, loss: Loss, settled: Settled) -> list[str]:
    several = len(settled.judged) > 1
    kind = {"huber": "Huber's loss", "student": "Student's distribution"}[loss]
    joined = np.vstack(settled.distance)
    parts = []
    for i, name in enumerate(estimate.output_names):
        far, of = int(np.sum(joined[:, i] > FAR)), int(np.isfinite(joined[:, i]).sum())
        what = f"{far} of {of} samples lie beyond {FAR:g} standard deviations"
        if loss == "student":
            what += f", {settled.judged[i].degrees:.3g} degrees of freedom"
        parts.append(f"{name}: {what}" if several else what)
    end = "" if settled.still else f"; not at rest after {settled.rounds} rounds"
    told = f"{kind} ({'; '.join(parts)}); noise std and fit are those of the others{end}"
    return [told, DecisionKind.NOISE_TAKEN_AS_WHITE.told(", as with every robust loss")]
