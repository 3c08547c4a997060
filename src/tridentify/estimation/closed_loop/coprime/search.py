"""Which coprime factors a record of a loop shows, and whether it shows any.

The number of the controller's poles is not known. Beginning with none, one after the other is
added as long as the errors fall by more than its price (AIC; a pole too few is a bias, one too many
costs little). The poles of the loop begin where the Laguerre description, whose controllability
Gramian is the unit matrix, has them when it is cut off at the largest eigenvalues of its
observability Gramian (Moore 1981), or where the fit with one pole less has ended, with another pole
and a zero upon it.

Where a controller rests at its limits, the input carries no noise at all, or operators on the
references explain more of the errors than chance does, there are no such factors, and
`coprime_root` finds nothing. A controller that works on samples is not seen by this, but its rule
is in the input (`input_rule`).

Reference: B. Moore, IEEE Transactions on Automatic Control 26 (1981) 17-32.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.coprime.factors import Factors, Fit
from tridentify.estimation.closed_loop.coprime.plant_form import Rows, covariance, weighed
from tridentify.estimation.closed_loop.driven import Driven, driven, widest
from tridentify.estimation.closed_loop.input_rule import InputRule, input_rule
from tridentify.estimation.closed_loop.linear_errors import slowest
from tridentify.estimation.closed_loop.own_poles import FASTEST, LEAST_DAMPED, own_poles
from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.realization import sort_poles

MOST_POLES = 4
"""Of the controller."""
ROUNDS = 4
"""Of weights and factors in turn."""
SETTLED = 0.02
"""Standard errors that a round still moves the plant by."""
CLEARLY = 4.0
"""Standard deviations of what operators on the references explain of the errors by chance."""
FAST = 0.1
"""Rate of the Laguerre description times sampling interval, from which the response between the
samples is more than these show. Noise of slower loops has a colour that takes modes of its own."""
TOLD_APART = 1e-3
"""Part of such an operator, of unit length, that the factors do not make."""
AT_LIMITS = 0.005
"""Share of the samples at a limit of the input, from which the controller is not linear."""

LEAST_NOISE = 1e-6
"""Of the input, over the input: a controller that hears less (a simulated one, or one with a sensor
of its own) gives rows that count beyond measure, and what factors miss would show in the plant."""
CLEARLY_GROWS = 4.0
"""Standard errors from zero of the pole farthest right, from which factors are taken: beside an
integrator a pole too few of the controller shows in the plant, and intervals are too narrow."""

Choice = Callable[[Sequence[Array]], Array]


@dataclass(frozen=True, eq=False)
class Coprime:
    """Factors that were found.

    Attributes
    ----------
    fit : Fit
    cov : (n, n) array
        Of the plant's coefficients.
    """

    fit: Fit
    cov: Array

    @property
    def plant(self) -> Plant:
        """As it was found."""
        return self.fit.factors.plant

    @property
    def clearly_grows(self) -> bool:
        """Whether the pole farthest right is clearly right of zero."""
        plant, n = self.plant, self.plant.a.size
        pole = plant.poles[np.argmax(plant.poles.real)]
        slope = np.polyval(np.polyder(np.append(1.0, plant.a)), pole)
        moves = (pole ** np.arange(n)[::-1] / slope).real
        return float(pole.real) > CLEARLY_GROWS * float(np.sqrt(moves @ self.cov[:n, :n] @ moves))


def coprime_root(
    loops: Sequence[Loop], plants: Sequence[Plant], choose_noise: Choice | None
) -> Coprime | None:
    """The factors that suit best, from several plants; None where none do as well as any response.

    Parameters
    ----------
    loops : sequence of Loop
        With Laguerre descriptions of what the references drive.
    plants : sequence of Plant
        Where the plant begins.
    choose_noise : callable, optional
        Gives the autoregressive coefficients of errors; white without it.
    """
    if not applies(loops, plants):
        return None
    loops = tuple(loops)
    longest = max(loops, key=lambda loop: loop.record.n_samples)
    described = [_fitted(longest), driven(longest.record, between=True)]
    best: Fit | None = None
    for plant in plants:
        rows = Rows.plain(loops[0], plant, slowest(loops))
        try:
            rows = weighed(
                rows, [rows.of(one[:, None])[:, 0] for one in _left(loops)], choose_noise
            )
            fit = _of_order(loops, plant, rows, described)
            if fit is not None and _hears_noise(fit):
                fit = _complete(_settled(fit, choose_noise), choose_noise)
        except (np.linalg.LinAlgError, ValueError):  # a plant or a loop beyond all bounds
            continue
        if fit is not None and (best is None or _is_better(fit, best)):
            best = fit
    if best is None or not (_hears_noise(best) and _is_as_good(best, described)):
        return None
    cov = covariance(best.slopes, best.errors, _counts(best))
    free = best.factors.plant.free
    k = free.shape[1]
    if not np.isfinite(cov).all():
        return None
    found = Coprime(best, np.asarray(free @ cov[:k, :k] @ free.T))
    return found if found.clearly_grows else None


def applies(loops: Sequence[Loop], plants: Sequence[Plant]) -> bool:
    """Whether the loop is fast, continuous, of one input, strictly proper, linear, and complete."""
    late = [one for loop in loops for one in loop.late]
    return (
        bool(plants)
        and all(
            loop.record.n_inputs == 1
            and isinstance(loop.driven, Driven)
            and bool(np.isfinite(loop.record.y).all())
            and _fitted(loop).rate * float(loop.record.dt or 0.0) > FAST
            and not _is_at_limits(loop)
            for loop in loops
        )
        and all(one == round(one) for one in late)
        and plants[0].b[0].size <= plants[0].a.size
        and input_rule([loop.record for loop in loops], plants[0].a.size)
        not in (InputRule.SAMPLED, InputRule.HELD)
    )


def _fitted(loop: Loop) -> Driven:
    part = loop.fitted
    assert isinstance(part, Driven)
    return part


def _left(loops: Sequence[Loop]) -> list[Array]:
    """(n_samples, 2) what the Laguerre descriptions leave."""
    found = []
    for loop in loops:
        part = _fitted(loop)
        own = np.column_stack([loop.record.u[:, 0], loop.record.y[:, 0]])
        found.append(own - part.columns @ part.weights)
    return found


def _counts(fit: Fit) -> list[int]:
    lags = len(fit.rows.weights) - 1
    return [loop.record.n_samples - lags for loop in fit.loops]


def _of_order(
    loops: tuple[Loop, ...], plant: Plant, rows: Rows, described: Sequence[Driven]
) -> Fit | None:
    """The order of the controller, and the factors, as rows weigh them."""
    best: Fit | None = None
    last: Fit | None = None
    for more in range(MOST_POLES + 1):
        poles = [_reduced(one, plant.a.size + more) for one in described]
        begun = _begun(loops, plant, rows, [one for one in poles if one is not None])
        if last is not None:
            begun += _with_another(last)
        ends = [one.descended() for one in begun if one.factors.is_seen(loops)]
        ends = [one for one in ends if np.isfinite(one.cost) and not _runs_off(one)]
        if not ends:
            continue
        last = min(ends, key=lambda one: one.cost)
        if best is None or _price(last) < _price(best):
            best = last
        elif more > best.factors.x.shape[1]:  # two in vain
            break
    return best


def _complete(fit: Fit, choose_noise: Choice | None) -> Fit:
    """With more poles of the controller, where settled weights show them."""
    while fit.factors.x.shape[1] <= MOST_POLES:
        ends = [one.descended() for one in _with_another(fit) if one.factors.is_seen(fit.loops)]
        ends = [one for one in ends if not _runs_off(one) and _price(one) < _price(fit)]
        if not ends:
            break
        fit = _settled(min(ends, key=lambda one: one.cost), choose_noise)
    return fit


def _runs_off(fit: Fit) -> bool:
    """Whether a mode went to where the samples show nothing of it, or to noise at one frequency."""
    step, poles = float(fit.loops[0].record.dt or 0.0), fit.factors.poles
    fast = np.abs(poles).max() * step > 0.9 * FASTEST
    return bool(fast or np.any(-poles.real < 1.2 * LEAST_DAMPED * np.abs(poles)))


def _price(fit: Fit) -> float:
    """AIC, of errors of unit variance."""
    unknowns = fit.factors.x.size + fit.factors.poles.size
    return fit.cost + 2.0 * unknowns


def _begun(
    loops: tuple[Loop, ...], plant: Plant, rows: Rows, poles: Sequence[Complex]
) -> list[Fit]:
    """From poles of the loop."""
    found = []
    for one in poles:
        x = np.zeros((loops[0].record.n_references, one.size - plant.a.size + 1))
        factors = Factors(plant, x, one)
        if factors.is_seen(loops):
            found.append(_with_best_x(Fit(loops, factors, rows)))
    return found


def _with_best_x(fit: Fit) -> Fit:
    k, x = fit.factors.plant.free.shape[1], fit.factors.x
    empty = fit.at(replace(fit.factors, x=np.zeros_like(x)))
    return fit.at(empty.factors.moved(empty.solved(0.0, slice(k, k + x.size))))


def _with_another(fit: Fit) -> list[Fit]:
    """A pole and a zero upon it, faster than the others or among them."""
    factors, found = fit.factors, []
    sizes = np.abs(factors.poles)
    step = float(fit.loops[0].record.dt or 0.0)
    for rate in (2.0 * sizes.max(), float(np.exp(np.mean(np.log(sizes))))):
        own = min(rate, 0.4 * FASTEST / step)
        x = np.stack([np.polymul(one, [1.0, own]) for one in factors.x])
        found.append(fit.at(Factors(factors.plant, x, sort_poles(np.append(factors.poles, -own)))))
    return found


def _settled(fit: Fit, choose_noise: Choice | None) -> Fit:
    """Weights and factors that agree with each other."""
    for _ in range(ROUNDS):
        plant = fit.factors.plant
        rows = Rows.plain(fit.loops[0], plant, fit.rows.predictor.slowest)
        plain = Fit(fit.loops, fit.factors, rows)
        rows = weighed(rows, plain.pairs, choose_noise)
        fit = Fit(fit.loops, fit.factors, rows).descended()
        k = plant.free.shape[1]
        errors = np.sqrt(np.diag(np.linalg.pinv(fit.slopes.T @ fit.slopes))[:k])
        moved = np.linalg.pinv(plant.free) @ (fit.factors.plant.theta - plant.theta)
        if np.all(np.abs(moved) <= SETTLED * errors):
            break
    return fit


def _hears_noise(fit: Fit) -> bool:
    """Whether what the factors leave of the input is more than rounding makes."""
    left = np.concatenate([one[:, 1] for one in fit.pairs])
    given = np.concatenate([loop.record.u[:, 0] for loop in fit.loops])
    return float(np.std(left)) > LEAST_NOISE * float(np.std(given))


def _is_better(one: Fit, other: Fit) -> bool:
    """Whether it leaves less, as the other one weighs it."""
    return replace(other, factors=one.factors).cost < other.cost


def _is_as_good(fit: Fit, described: Sequence[Driven]) -> bool:
    """Whether operators on the references explain no more of the errors than chance does."""
    blocks = []
    for loop in fit.loops:
        own = widest(loop.record, described[-1].rate, _fitted(loop).before).columns[:, 1:]
        table = np.zeros((len(own), 2 * own.shape[1], 2))
        table[:, : own.shape[1], 0] = table[:, own.shape[1] :, 1] = own
        blocks.append(fit.rows.white(fit.rows.of(table)))
    taken = np.hstack([fit.beside, fit.slopes / (np.linalg.norm(fit.slopes, axis=0) + 1e-300)])
    known = np.linalg.qr(taken)[0]
    more = np.vstack(blocks)
    size = np.linalg.norm(more, axis=0) + 1e-300
    more = more / size - known @ (known.T @ (more / size))
    basis, values, _ = np.linalg.svd(more, full_matrices=False)
    basis = basis[:, values > TOLD_APART]
    expected = float(np.trace(covariance(basis, fit.errors, _counts(fit))))
    explained = float(np.sum((basis.T @ fit.errors) ** 2))
    most = 1.0 + CLEARLY * float(np.sqrt(2.0 / max(basis.shape[1], 1)))
    return explained < most * expected


def _is_at_limits(loop: Loop) -> bool:
    """Whether the controller rests at the largest or the smallest value of the input."""
    u = loop.record.u[:, 0]
    return bool(max(np.mean(u == u.max()), np.mean(u == u.min())) > AT_LIMITS)


def _reduced(part: Driven, count: int) -> Complex | None:
    """Poles of the description cut off at so many."""
    record = part.record
    left = np.column_stack([record.u, record.y]) - part.columns @ part.weights
    levels = np.sqrt(np.mean(left**2, axis=0)) + 1e-300
    weights = part.weights[1 + record.n_references :] / levels
    step = float(record.dt or 1.0)
    begun = 3.0 * LEAST_DAMPED
    return own_poles(part.poles, weights, count, record.duration, step, least_damped=begun)
