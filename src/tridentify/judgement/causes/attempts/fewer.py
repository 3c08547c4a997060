"""Whether fewer poles and zeros explain a record as well: each smaller structure is fitted.

A mode that is surplus is found where it explains most noise among as many frequencies as there are
samples, so that two poles more have to gain more than their unknowns: ``2 ln N`` beside them (the
largest of ``N`` squared standard normal values is about ``2 ln N``), a real pole half of that. The
smallest structure of all is none: what an output does by itself, an autoregression about a level,
explains a record at rest as well as a response that was picked from it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from tridentify.errors import TridentifyError
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.likelihood.answer import model_of
from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.minimum.levenberg_marquardt import coefficients
from tridentify.judgement.causes.attempts.attempt import Attempt, attempt, deviance_at
from tridentify.judgement.causes.attempts.first_samples import beginning
from tridentify.judgement.causes.attempts.present import Present, Zeros
from tridentify.judgement.causes.attempts.revisit import (
    point_of,
    poles_of_estimate,
    problem_of,
    stated,
    without_outliers,
)
from tridentify.models.simulate import simulate
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import deviance, fit_autoregression, most_coefficients
from tridentify.numerics.rational import scaled_roots
from tridentify.numerics.realization import sort_poles
from tridentify.record.record import Record

LONGEST = 5_000
"""Samples of each record that are compared."""

BEYOND_RECORD = 3.0
"""Time constant over the length of the record from which its response is hardly seen: in a third
of a time constant a step reaches 28 % of its end."""

VAGUE = 0.5
"""Relative standard error of a coefficient from which smaller structures are fitted."""

MANY = 3
"""Poles from which they are fitted whatever the errors say: the error of a mode that was picked
among many is that of this mode, not of the choice."""

HOPELESS = 10.0
"""Times what fewer poles may cost, as a first step promises, from which they are not fitted. Of 255
smaller structures, the 76 that did as well promised up to 0.94, and what was fitted reached from
0.28 of its promise on."""

MORE_LAGS = 2
"""Lags of the input beyond the number of poles: a model of that order and a sample of delay."""

LATEST = 20
"""Lags of the input [samples] up to which a response may begin. A single step meets a past that
tells all but its first samples: where these come late, or softly, the model that is too small for
that must not be told that there is no response."""

MOVED_BY_CHANCE = 1e-4
"""Probability that inputs without effect seem to have one; a response is then only not denied."""

WANDERS = 20.0
"""Memories of an output by itself in its record, below which it wanders: one that wanders seems to
follow any input that does (Granger & Newbold, Journal of Econometrics 2, 1974, 111-120)."""

WANDERING = 2.0
"""Times the price of a response in such an output: two random walks of 200 or 600 samples that know
nothing of each other gained up to 1.6 times the plain one, a third of them more than that."""


@dataclass(frozen=True, eq=False)
class _Fitted:
    """The structure that was asked for, fitted again."""

    present: Present
    end: Attempt


def unsure(estimate: Estimate, longest: float) -> list[str]:
    """Parameters whose standard error is above `VAGUE` of their size; what is fixed has none.

    A coefficient of a denominator is a sum of products of poles, which cancel where poles lie on
    both sides of the axis: ``s^2 - w^2`` has ``a1 = 0`` however well it is known. Its size is what
    it would be with all of them on the left, ``2 w`` there, and for a stable plant its own value.

    Parameters
    ----------
    estimate : Estimate
    longest : float
        Duration of the longest record [s]. No pole counts for less than one that is told to be
        slower than the record (`BEYOND_RECORD`).
    """
    sizes: dict[str, float] = {}
    for output, row in zip(estimate.output_names, estimate.model.den, strict=True):
        for source, den in zip(estimate.input_names, row, strict=True):
            poles = scaled_roots(den)
            left = np.maximum(np.abs(poles.real), 1.0 / (BEYOND_RECORD * longest))
            size = np.abs(np.poly(1j * poles.imag - left))[::-1].tolist()
            for where in ("", f"[{output},{source}]"):
                sizes |= {f"a{k}{where}": one for k, one in enumerate(size)}
    known = zip(estimate.names, estimate.theta.tolist(), estimate.std.tolist(), strict=True)
    return [
        name
        for name, value, std in known
        if std and not std < VAGUE * max(abs(value), sizes.get(name, 0.0))
    ]


def order_findings(estimate: Estimate, records: Sequence[Record]) -> list[Finding]:
    """A word where a smaller structure does as well, or none at all.

    Parameters
    ----------
    estimate : Estimate
    records : sequence of Record
        Those that were identified, the behaviour of their inputs settled.
    """
    given = estimate.structure
    order = given.poles
    open_ = not given.constrained and given.delay != "free" and estimate.loss == "squared"
    if not (isinstance(order, int) and open_ and estimate.status.ok):
        return [NO_RESPONSE] if _gains_nothing(estimate, records) else []
    vague = bool(unsure(estimate, max(one.duration for one in records)))
    # what wanders follows any input that does, and the errors say that it follows it closely
    doubtful = vague or _follows_by_chance(estimate, records)
    if not (doubtful or order >= MANY):
        return []
    fitted = _fitted(estimate, records)
    if fitted is None:
        return []
    if doubtful and _is_noise(fitted):
        return [NO_RESPONSE]
    if not (vague or order >= MANY):
        return []
    found = _smallest(fitted, order)
    return [] if found is None else [_too_high(estimate, order, fitted.end, *found)]


NO_RESPONSE = Finding(
    "no-response",
    "error",
    "What the output did before tells as much of it as the input does: the record shows no "
    "response to this input that is more than coloured noise.",
    "Cut out a stretch in which the input moves the system, check the channels, or excite the "
    "system more.",
)


def foretold(records: Sequence[Record], n_poles: int) -> bool | None:
    """Whether the inputs foretell what the past of the outputs does not; None where time is uneven.

    Parameters
    ----------
    records : sequence of Record
    n_poles : int
        Of the model; so many lags of the input, and `MORE_LAGS`, are looked at.
    """
    alone = _by_itself(records)
    return None if alone is None else _any_moved(*alone, n_poles)


class _ByItself(NamedTuple):
    """The beginnings of records, outputs about their means, and what these do by themselves."""

    levelled: list[Array]
    records: list[Record]
    noise: list[Array]


def _by_itself(records: Sequence[Record]) -> _ByItself | None:
    """None where time is uneven."""
    if any(record.dt is None for record in records):
        return None
    short = [beginning(record, LONGEST) for record in records]
    levelled = [_levelled(record.y) for record in short]
    return _ByItself(levelled, short, [_noise_of(levelled, i) for i in range(short[0].n_outputs)])


def _any_moved(
    levelled: Sequence[Array], records: Sequence[Record], noise: Sequence[Array], n_poles: int
) -> bool:
    """Whether the inputs foretell anything of any output, beside a past that has a model."""
    inputs, lags = [record.u for record in records], n_poles + MORE_LAGS
    return any(
        _moved([one[:, i] for one in levelled], inputs, a.size, lags) for i, a in enumerate(noise)
    )


def _levelled(y: Array) -> Array:
    """Outputs about their means."""
    return np.asarray(y - np.nanmean(y, axis=0))


def _follows_by_chance(estimate: Estimate, records: Sequence[Record]) -> bool:
    """Whether an output wanders, and the inputs foretell nothing of any.

    What the model explains so much better than a model of the noise alone that `_is_noise` would
    say no in any case is not looked at.
    """
    alone, poles = _by_itself(records), estimate.structure.poles
    if alone is None or not any(_wanders(a, alone.records) for a in alone.noise):
        return False
    if _answers(estimate, alone):
        return False
    return isinstance(poles, int) and not _any_moved(*alone, poles)


def _answers(estimate: Estimate, alone: _ByItself) -> bool:
    """Whether the model as it is explains more than noise alone, with the longest noise model."""
    levelled, records, noise = alone
    if len(estimate.outliers):
        return False
    try:
        point = point_of(estimate, records, stated(estimate))
    except (TridentifyError, np.linalg.LinAlgError):
        return False
    problem = point.problem
    if any(e.start for e in problem.experiments):  # it need not explain the first samples
        return False
    longest = sum(most_coefficients(int(n)) for n in point.counts)
    unknowns = problem.n_coefficients + problem.n_nuisance + problem.n_outputs + longest
    more = unknowns - sum(a.size + len(levelled) + 1 for a in noise)
    price = WANDERING * _price(more, point.poles.size, float(point.counts.sum()))
    return _alone(levelled, noise) - deviance_at(point, problem.noise) >= price


def _alone(levelled: Sequence[Array], noise: Sequence[Array]) -> float:
    """``-2 log L`` of outputs that nothing but their own past explains."""
    return sum(
        deviance([np.ascontiguousarray(one[:, i]) for one in levelled], a)
        for i, a in enumerate(noise)
    )


def _price(unknowns: float, n_poles: int, count: float) -> float:
    """What a response that was picked gains where there is none."""
    return 2.0 * unknowns + 2.0 * ((n_poles + 1) // 2) * float(np.log(count))


def _wanders(noise: Array, records: Sequence[Record]) -> bool:
    """Whether what forgets as this does shows few of its memories in any record."""
    if not noise.size:
        return False
    slowest = float(np.max(np.abs(np.roots(np.append(1.0, noise)))))
    return (1.0 - slowest) * max(record.n_samples for record in records) < WANDERS


def _gains_nothing(estimate: Estimate, records: Sequence[Record]) -> bool:
    """Whether no gain is known and the inputs foretell nothing: of structures with constraints.

    A pole at zero follows whatever an output does by itself, so the fit tells nothing there.
    """
    rows = [p for p in estimate.parameters.values() if p.name.startswith("b") and p.std]
    vague = bool(rows) and not any(p.relative_std < VAGUE for p in rows)
    order = estimate.structure.poles
    return vague and isinstance(order, int) and foretold(records, order) is False


def _is_noise(fitted: _Fitted) -> bool:
    """Whether a noise model alone, about a level, explains the outputs as well.

    Where the initial state is free, it explains them beside what the model makes of that state: an
    output that goes to and fro by itself is followed by poles on the axis, and no input is needed.
    """
    first = fitted.end
    orders = [_noise_of(first.point.standardised(), i).size for i in range(len(first.point.rss))]
    present = fitted.present
    end = attempt(replace(present, noise=()).problem(), [first.point.poles], orders)
    if end is None or any(record.dt is None for record in present.records):
        return False
    levelled = [_levelled(y) for y in _driven(end.point, present.records)]
    noise = [_noise_of(levelled, i) for i in range(present.n_outputs)]
    if not all(a.size for a in noise):
        return False
    states = present.poles.size * sum(one.free for one in end.point.problem.experiments)
    unknowns = states + sum(a.size + len(levelled) + 1 for a in noise)
    price = _price(end.unknowns - unknowns, present.poles.size, end.count)
    price *= WANDERING if any(_wanders(a, present.records) for a in noise) else 1.0
    if _alone(levelled, noise) - end.deviance >= price:
        return False
    return not _any_moved(levelled, present.records, noise, present.poles.size)


def _driven(point: Point, records: Sequence[Record]) -> list[Array]:
    """Outputs as they were recorded, without what the model makes of a free initial state."""
    found = []
    parts = zip(records, point.problem.experiments, point.residuals(), strict=True)
    for record, experiment, residual in parts:
        if experiment.free:
            model = model_of(point.problem, coefficients(point), record)
            found.append(residual + simulate(model, record._derive(u=record.u - record.u[0])))
        else:
            found.append(np.where(np.isfinite(residual), experiment.y, np.nan))
    return found


def _moved(series: Sequence[Array], inputs: Sequence[Array], order: int, lags: int) -> bool:
    """Whether inputs foretell what the past of one output does not: least squares on both.

    Where a fit with coloured noise ends in a valley of its own this shows a response all the same:
    the problem is convex, and the differences of two walks know nothing of each other.
    """
    if _gains(series, inputs, order, [range(lags)], MOVED_BY_CHANCE):
        return True
    later = [range(begin, begin + lags) for begin in range(1, LATEST)]
    return _gains(series, inputs, order, [*later, range(LATEST)], MOVED_BY_CHANCE)


def _gains(
    series: Sequence[Array],
    inputs: Sequence[Array],
    order: int,
    windows: Sequence[range],
    chance: float,
) -> bool:
    """Whether the lags of the input in any window tell more than chance lets the best of them."""
    longest = max(order, windows[0][-1])
    rows, targets = [], []
    for y, u in zip(series, inputs, strict=True):
        if y.size <= longest:
            continue
        k = np.arange(longest, y.size)
        past = [y[k - 1 - j] for j in range(order)]
        moved = u - u.mean(axis=0)
        # before the record the input is where it begins
        given = [moved[np.maximum(k - j, 0)] for j in range(windows[-1][-1] + 1)]
        rows.append(np.column_stack([np.ones(k.size), *past, *given]))
        targets.append(y[k])
    if not rows:
        return False
    table, target = np.vstack(rows), np.concatenate(targets)
    seen = np.isfinite(target) & np.all(np.isfinite(table), axis=1)
    table, target = table[seen], target[seen]
    sizes = np.linalg.norm(table, axis=0)
    table /= np.where(sizes > 0.0, sizes, 1.0)
    # what is left of a target by any of the columns is left of its triangle
    triangle = np.asarray(np.linalg.qr(np.column_stack([table, target]), mode="r"))
    own, n_inputs = range(order + 1), inputs[0].shape[1]
    alone, fewer = _unexplained(triangle, own)
    for window in windows:
        first, last = (order + 1 + k * n_inputs for k in (window[0], window[-1] + 1))
        columns = [*own, *range(first, min(last, table.shape[1]))]
        if target.size < 2 * len(columns):
            continue
        whole, more = _unexplained(triangle, columns)
        if not (more > fewer and whole > 0.0):
            continue
        gain = target.size * float(np.log(alone / whole))
        if gain > chdtri(more - fewer, chance / len(windows)):
            return True
    return False


def _unexplained(triangle: Array, columns: Sequence[int]) -> tuple[float, int]:
    """What least squares on some columns leave of the last one, and their rank."""
    table, target = triangle[:, columns], triangle[:, -1]
    found, _, rank, _ = np.linalg.lstsq(table, target, rcond=1e-10)
    return float(np.sum((target - table @ found) ** 2)), int(rank)


def _noise_of(series: Sequence[Array], output: int) -> Array:
    """A model of one output of some series."""
    own = [np.ascontiguousarray(one[:, output]) for one in series]
    count = sum(int(np.isfinite(one).sum()) for one in own)
    return fit_autoregression(own, most_coefficients(count))


def _too_high(
    estimate: Estimate, order: int, base: Attempt, fewer: int, zeros: Zeros, end: Attempt
) -> Finding:
    most, less = max(max(row) for row in zeros), order - fewer
    pairs = zip(estimate.output_names, base.fits, end.fits, strict=True)
    fits = ", ".join(f"fit of {name} from {a:.2f} to {b:.2f} %" for name, a, b in pairs)
    lost = end.deviance - base.deviance
    by = f"{abs(lost):.3g} {'higher' if lost > 0.0 else 'lower, as this end is not the best'}"
    one = less == 1
    return Finding(
        "order-high",
        "warning",
        f"{_count(fewer, 'pole')} and {_count(most, 'zero')} explain the record as well: what the "
        f"other {'pole explains' if one else f'{less} poles explain'} is no more than noise lets "
        f"{'it' if one else 'them'}.",
        f"Use poles={fewer} and zeros={most}, or compare several orders (select_structure; "
        "tridentify select).",
        effect=f"With fewer: {fits}, -2 log L {by}.",
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _fitted(estimate: Estimate, records: Sequence[Record]) -> _Fitted | None:
    """The structure of an estimate from where it ended; None where that cannot be had."""
    looked_at = [beginning(record, LONGEST) for record in without_outliers(estimate, records)]
    nuisances = stated(estimate)
    try:
        problem = problem_of(estimate, looked_at, nuisances)
        poles = poles_of_estimate(estimate, problem)
        delay, noise = np.array(estimate.model.delay), estimate.noise_model
        present = Present.of(looked_at, estimate.structure, delay, nuisances, noise, poles)
        end = attempt(present.problem(), [poles], present.orders)
    except (TridentifyError, np.linalg.LinAlgError):
        return None
    return None if end is None else _Fitted(replace(present, noise=end.point.problem.noise), end)


def _smallest(fitted: _Fitted, order: int) -> tuple[int, Zeros, Attempt] | None:
    """The smallest structure that does as well, and its fit; None where there is none."""
    present, base = fitted.present, fitted.end
    orders = range(max(order - 2, 1), order)
    for fewer, zeros in ((n, own) for n in orders for own in _zeros(present.zeros, order, n)):
        try:
            smaller = replace(present, order=fewer, zeros=zeros).problem()
        except TridentifyError:
            continue
        whole, starts = base.point.problem, list(_starts(base.point.poles, order - fewer))
        price = 2.0 * (whole.n_coefficients - smaller.n_coefficients)
        price += 2.0 * (whole.n_nuisance - smaller.n_nuisance)
        price += (order - fewer) * float(np.log(base.count))
        hopeless = base.point.objective + HOPELESS * price
        end = attempt(smaller, starts, present.orders, hopeless=hopeless)
        if end is not None and end.deviance - base.deviance < price:
            return fewer, zeros, end
    return None


def _zeros(zeros: Zeros, order: int, fewer: int) -> tuple[Zeros, ...]:
    """As many zeros fewer, and none fewer; as many as poles only where that was so."""

    def without(less: int) -> Zeros:
        return tuple(
            tuple(max(min(m - less, fewer - (m < order)), 0) for m in row) for row in zeros
        )

    return tuple(dict.fromkeys((without(order - fewer), without(0))))


def _starts(poles: Complex, less: int) -> Iterator[Complex]:
    """Poles that are left when one or two are taken away, in every way that keeps them real."""
    real = [k for k in range(poles.size) if not poles[k].imag]
    pairs = [k for k in range(poles.size) if poles[k].imag > 0]
    for k in pairs:
        partner = int(np.argmin(np.abs(poles - poles[k].conjugate())))
        left = np.delete(poles, [k, partner])
        yield sort_poles(left if less == 2 else np.append(left, -abs(poles[k])))
    if less == 1:
        for k in real:
            yield sort_poles(np.delete(poles, k))
        return
    for a, k in enumerate(real):
        for other in real[a + 1 :]:
            yield sort_poles(np.delete(poles, [k, other]))
    for k in real:
        for j in pairs:
            partner = int(np.argmin(np.abs(poles - poles[j].conjugate())))
            yield sort_poles(np.append(np.delete(poles, [k, j, partner]), -abs(poles[j])))
