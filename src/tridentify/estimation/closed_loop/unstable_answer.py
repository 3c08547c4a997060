"""The way of a plant that may be unstable or integrate, and its estimate."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from tridentify.estimation.answer.assemble import Request, Solved, assemble
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.answer.parameter import Nuisance
from tridentify.estimation.answer.trace import Status, Trace
from tridentify.estimation.closed_loop.added_up import with_added_up
from tridentify.estimation.closed_loop.as_recorded import AsRecorded
from tridentify.estimation.closed_loop.between_samples import IN_WORDS, Loop, Sampling
from tridentify.estimation.closed_loop.coprime.search import coprime_root
from tridentify.estimation.closed_loop.driven import Driven, described_otherwise, driven
from tridentify.estimation.closed_loop.linear_errors import (
    driven_basis,
    linear_errors,
    merit,
    slowest,
)
from tridentify.estimation.closed_loop.long_past import plants_of_forecast
from tridentify.estimation.closed_loop.noise_driven import beside_noise
from tridentify.estimation.closed_loop.predictor import Plant, Predictor
from tridentify.estimation.closed_loop.sought import Sought
from tridentify.estimation.closed_loop.unstable import (
    Found,
    at_plant,
    autoregressive,
    root,
    root_in_noise,
    with_fall,
)
from tridentify.estimation.closed_loop.unstable_starts import starting_plants
from tridentify.numerics.arrays import Array
from tridentify.numerics.information import aicc_price
from tridentify.record.record import Record
from tridentify.structure import Structure
from tridentify.transfer_function import TransferFunction

AS_LIKELY = 10.0
"""Rise of ``-2 log L`` by which the output's own errors may be worse than the mirrored ones: they
are all-pass of each other, and differ at the ends of the record alone."""
ROUNDING = 1e-9
"""Share of the output below which an error is none."""
MISSED = 1e-4
"""p-value of what the references explain of the errors, from which another end is looked for."""
UNSEEN = 4.0
"""Standard errors of a pole's residue, up to which it is asked whether an input moves it at all."""
MORE_ROUNDS = 4
"""Fits of the driven input beside the noise that the model leaves: more than of a stable plant, as
the input is more noise than response."""


@dataclass(frozen=True, eq=False)
class NotStable:
    """A plant that is not stable, and whether it may be an end that is none of the plant.

    Attributes
    ----------
    estimate : Estimate
    criterion : float
        AICc of the noise of the output, as a stable plant has it.
    follows : bool
        Whether what it leaves follows the references.
    unseen : bool
        Whether a pole that is not stable has a zero upon it, a pair that takes up the slow part of
        a stable plant beside slow noise; or is there with one kind of controller alone.
    innovations : tuple of (n_samples,) arrays
        Errors of the mirrored predictor, per experiment; ``nan`` where nothing was recorded.
    """

    estimate: Estimate
    criterion: float
    follows: bool
    unseen: bool
    innovations: tuple[Array, ...] = ()

    def or_stable(self, other: Estimate) -> Estimate:
        """A stable plant in its place, where that leaves clearly less, or is as simple."""
        likelier = other.aicc < self.criterion
        if self.unseen and likelier and other.status is Status.WEAKLY_IDENTIFIABLE:
            return other
        less = leaves_more(self.estimate, other)
        if any(one.size for one in self.estimate.noise_model):
            # what is left is as large as slow noise is, whichever plant leaves it
            less = other.aicc < self.criterion - AS_LIKELY
        better = less or (self.unseen and likelier)
        return other if better and other.status is Status.CONVERGED else self.estimate


def unstable_estimate(
    parts: Sequence[Driven],
    kind: Sampling,
    asked: Request,
    coloured: bool,
    say: Callable[[str], None],
    begun: Sequence[TransferFunction] = (),
) -> NotStable | None:
    """The estimate of a plant with a pole at zero or to the right of it; None for any other.

    It is looked for from Step 2. Where passes among stable plants do not end, it is from their
    models as well, and whatever the root is: that of a stable plant is theirs, by Newton's steps.
    """
    sought = Sought.of(asked.records, asked.structure)
    if sought is None:
        return None
    orders = sought.poles, sought.zeros
    loops: Sequence[Loop] = [
        Loop(part, kind, late=sought.late, drift=sought.drift) for part in parts
    ]
    edge = slowest(loops)
    plants = [_plant_of(model, sought.zeros) for model in begun] + starting_plants(loops, *orders)
    # fast operators follow the samples and swing between them, where Step 2 looks; slow ones miss
    others = [
        replace(loop, driven=driven(loop.record, between=kind == "sampled")) for loop in loops
    ]
    plants += starting_plants(others, *orders)
    if not (begun or any(plant.poles.real.max() > -edge for plant in plants)):
        return None
    say("a plant that is not stable")
    choose = autoregressive if coloured else None
    best = root(loops, plants, None, say)
    if asked.structure.constrained and best is not None:
        best = _within(sought, loops, best, plants, say)
        if best is None or _only_integrates(sought, best.plant, edge):
            return None
    words: tuple[str, ...] = (f"controller taken as {IN_WORDS[kind]}", *sought.in_words)
    factors = None
    if kind == "continuous":
        factors = _by_factors(sought, loops, plants, best, choose)
    if factors is not None:
        (loops, best), told = factors
        words = (told, *words)
    else:
        loops, best = _by_root(sought, loops, parts, best, choose, say)
    if best is None or not best.still:
        return None
    if not (begun or best.plant.poles.real.max() > -edge):
        return None
    # the errors of a predictor that runs off have no scale
    told_apart = np.diag(best.cov)[np.any(best.plant.free, axis=1)]
    if not best.variance > 0.0 or not np.all((told_apart > 0.0) & np.isfinite(told_apart)):
        return None
    if factors is None:
        best = _grown(loops, best, choose, say)
    found = estimate_of(asked, loops, best, words)
    # its criterion is that of the mirrored predictor's errors
    mirrored = 2.0 * found.n_samples * float(np.log(best.amplification))
    return NotStable(
        replace(found, route="reference"),
        found.aicc - mirrored,
        _follows(loops, best),
        _is_unseen(best, edge),
        best.errors,
    )


def _plant_of(model: TransferFunction, zeros: Sequence[int]) -> Plant:
    """A model of one output whose inputs share their denominator, with so many zeros."""
    padded = [
        np.append(np.zeros(m + 1), one)[-m - 1 :]
        for m, one in zip(zeros, model.num[0], strict=True)
    ]
    return Plant(np.array(model.den[0][0][1:]), tuple(padded))


def _by_factors(
    sought: Sought,
    loops: Sequence[Loop],
    plants: Sequence[Plant],
    best: Found | None,
    choose: Callable[[Sequence[Array]], Array] | None,
) -> tuple[tuple[Sequence[Loop], Found], str] | None:
    """What coprime factors say, and how it is told; None where they do not apply.

    They begin at the root, where there is one, and may not leave clearly more of the output.
    """
    if best is not None and best.still:
        plants = [best.plant]
    factors = coprime_root(loops, plants, choose)
    if factors is None:
        return None
    described = [
        replace(loop, driven=part) for loop, part in zip(loops, factors.fit.parts(), strict=True)
    ]
    plain = at_plant(described, factors.plant, factors.cov, None)
    if best is not None and best.still and not plain.deviance <= best.deviance + AS_LIKELY:
        return None
    found = at_plant(described, factors.plant, factors.cov, choose)
    if sought.structure.bounds and sought.exceeded(found):
        return None
    order = factors.fit.factors.x.shape[1] - 1
    return (described, found), f"by coprime factors, the controller of order {order}"


def _by_root(
    sought: Sought,
    loops: Sequence[Loop],
    parts: Sequence[Driven],
    best: Found | None,
    choose: Callable[[Sequence[Array]], Array] | None,
    say: Callable[[str], None],
) -> tuple[Sequence[Loop], Found | None]:
    """The root in its own noise, within bounds."""
    sampled = loops[0].sampling == "sampled"
    if not sampled:
        loops, best = _beside_what_is_left(loops, parts, best, say)
    if choose is not None and best is not None and best.still:
        best = root(loops, [best.plant], choose, say)
    if choose is not None and best is not None and sampled and _follows(loops, best):
        best = _forecast(sought, loops, best, choose)
    if best is not None and best.still and sought.structure.bounds:
        best = _within_bounds(sought, loops, best, choose, say)
    return loops, best


def _grown(
    loops: Sequence[Loop],
    best: Found,
    choose: Callable[[Sequence[Array]], Array] | None,
    say: Callable[[str], None],
) -> Found:
    """A root with the covariance of all that is uncertain about it."""
    if loops[0].sampling == "sampled":
        return with_fall(loops, best)
    if choose is not None:
        best = with_added_up(loops, best)
    grown = with_fall(loops, best)
    return replace(grown, cov=grown.cov + _spread_between(loops, best, choose, say))


def _beside_what_is_left(
    loops: Sequence[Loop], parts: Sequence[Driven], best: Found | None, say: Callable[[str], None]
) -> tuple[Sequence[Loop], Found | None]:
    """The root with the driven input fitted beside the noise that the root before has left."""
    for _ in range(MORE_ROUNDS):
        if best is None or not best.still:
            break
        renewed = [
            replace(loop, driven=beside_noise(part, left[:, None]))
            for loop, part, left in zip(loops, parts, best.errors, strict=True)
        ]
        following = root(renewed, [best.plant], None, say)
        if following is None or not following.still:  # it leads astray: what was there is a root
            break
        loops, best = renewed, following
    return loops, best


def _forecast(
    sought: Sought,
    loops: Sequence[Loop],
    best: Found,
    choose: Callable[[Sequence[Array]], Array],
) -> Found:
    """The likelier of a root and of those from plants of a long past, each in its own noise."""
    plants = plants_of_forecast(loops, sought.poles, sought.zeros)
    if sought.structure.constrained:
        known = sought.known(best.plant.scale)
        plants = [sought.within(one, None, known) for one in plants]
    other = root_in_noise(loops, plants, choose)
    return best if other is None or other.deviance >= best.deviance else other


def _within(
    sought: Sought,
    loops: Sequence[Loop],
    free: Found,
    plants: Sequence[Plant],
    say: Callable[[str], None],
) -> Found | None:
    """The root along what is known, from the free one and from where that came from."""
    known = sought.known(free.plant.scale)
    if known.n_free == known.origin.size:
        return free
    begun = [sought.within(free.plant, free.cov, known)] if free.still else []
    return root(loops, [*begun, *(sought.within(one, None, known) for one in plants)], None, say)


def _within_bounds(
    sought: Sought,
    loops: Sequence[Loop],
    best: Found,
    choose: Callable[[Sequence[Array]], Array] | None,
    say: Callable[[str], None],
) -> Found | None:
    """The root with every bound that it would exceed as an equality."""
    reached: dict[str, float] = {}
    found: Found | None = best
    while found is not None and found.still and (more := sought.exceeded(found)):
        reached |= more
        known = sought.known(found.plant.scale, reached)
        found = root(loops, [sought.within(found.plant, found.cov, known)], choose, say)
    return found


def _only_integrates(sought: Sought, plant: Plant, edge: float) -> bool:
    """Whether poles at zero are known, and no other pole is there: as of a stable plant."""
    known = sought.known(plant.scale)
    others = np.roots(np.append(1.0, plant.a[: plant.a.size - known.integrators])).real
    return bool(known.integrators) and not bool(np.any(others > -edge))


def _follows(loops: Sequence[Loop], best: Found) -> bool:
    """Whether the references explain more of the errors at a root than chance does."""
    basis = driven_basis(loops, best.noise)
    if basis is None:
        return False
    size = merit(linear_errors(loops, best.plant, best.noise), basis)
    # not the ratio: the errors of a predictor that runs off have no scale
    by_chance = float(chdtri(max(basis.shape[1] - best.plant.theta.size, 1), MISSED))
    return size > by_chance * best.variance


def _is_unseen(best: Found, edge: float) -> bool:
    """Whether a pole that does not decay within the record may have no part in the response."""
    plant, den = best.plant, np.append(1.0, best.plant.a)
    for pole in plant.poles[plant.poles.real > -edge]:
        # a coefficient of the denominator moves the pole, and with it what a numerator is there
        powers = pole ** np.arange(den.size - 1)[::-1]
        steps = -powers / np.polyval(np.polyder(den), pole)
        places = den.size - 1 + np.cumsum([0, *(one.size for one in plant.b)])
        clear = False
        for at, num in zip(places, plant.b, strict=False):
            slopes = np.zeros(plant.theta.size, dtype=np.complex128)
            slopes[: powers.size] = np.polyval(np.polyder(num), pole) * steps
            slopes[at : at + num.size] = pole ** np.arange(num.size)[::-1]
            error = float(np.sqrt((slopes @ best.cov @ slopes.conj()).real))
            clear = clear or float(abs(np.polyval(num, pole))) > UNSEEN * error
        if not clear:
            return True
    return False


def leaves_more(found: Estimate, other: Estimate) -> bool:
    """Whether a plant that is not stable leaves clearly more of the output than a stable one."""
    return other.status is Status.CONVERGED and worse_by(found, other) > AS_LIKELY


def worse_by(found: Estimate, other: Estimate) -> float:
    """Rise of ``-2 log L`` of what is left of the output, from another estimate to this one."""
    left, less = (100.0 - float(one.fit[0]) for one in (found, other))
    return found.n_samples * 2.0 * float(np.log(left / less)) if less > 0.0 else np.inf


def _spread_between(
    loops: Sequence[Loop],
    best: Found,
    choose: Callable[[Sequence[Array]], Array] | None,
    say: Callable[[str], None],
) -> Array:
    """(n, n) what other descriptions of what lies between the samples add to the covariance."""
    n = best.plant.theta.size
    spread = np.zeros((n, n))
    fitted = [one.driven for one in loops if isinstance(one.driven, Driven)]
    for parts in zip(*(described_otherwise(one) for one in fitted), strict=True):
        others = [replace(one, driven=part) for one, part in zip(loops, parts, strict=True)]
        found = root(others, [best.plant], choose, say)
        # the errors of a predictor that runs off have no scale
        if found is not None and found.still and found.variance > 0.0:
            away = found.plant.theta - best.plant.theta
            spread += np.outer(away, away)
    return spread


def without_controller(
    asked: Request, coloured: bool, say: Callable[[str], None]
) -> tuple[Sequence[Loop], Found] | None:
    """Where Step 4 ends for a plant with a pole to the right of zero and no controller.

    The mirrored predictor is well-behaved wherever it begins. At its end the errors of the output
    themselves are minimised, as the record of an unstable plant is short, and the mirrored ones
    have forgotten what its last samples say. Where these are worse, the output did not grow as the
    plant does: something held it.

    Parameters
    ----------
    asked : Request
    coloured : bool
        Whether the noise may have a model.
    say : callable
        Is told what is going on.

    Returns
    -------
    tuple of the records and what was found, or None
        None where this route does not apply, or leads to no pole there.
    """
    orders = orders_of(asked.records, asked.structure)
    if orders is None:
        return None
    say("a plant that is not stable")
    loops = open_loops(asked.records)
    best = root(loops, starting_plants(loops, *orders), None, say)
    if best is None or not best.plant.poles.real.max() > 0.0:
        return None
    rounding = ROUNDING * float(np.nanstd(np.concatenate([one.y for one in asked.records])))
    if best.variance < rounding**2:
        return loops, best  # steps on what rounding left lead nowhere
    choose = autoregressive if coloured else None
    direct = root(loops, [best.plant], choose, say, fed_back=False)
    if direct is None or not (direct.still and direct.plant.poles.real.max() > 0.0):
        return None
    if direct.deviance > best.deviance + AS_LIKELY:
        return None
    return loops, direct


def open_loops(records: Sequence[Record]) -> list[Loop]:
    """Records without a controller, as the predictor sees them."""
    return [
        Loop(AsRecorded(one), "sampled" if one.behaviour == "zoh" else "continuous")
        for one in records
    ]


def orders_of(
    records: Sequence[Record], structure: Structure
) -> tuple[int, tuple[int, ...]] | None:
    """Poles and zeros of what this route can do; None for anything else.

    That is one output, one shared denominator, no delay, nothing known beforehand, uniform time.
    """
    first = records[0]
    if (
        first.n_outputs != 1
        or not structure.shared
        or structure.constrained
        or structure.drift is True
        or structure.delay == "free"
        or np.any(structure.delay_matrix(1, first.n_inputs))
        or any(record.dt is None for record in records)
    ):
        return None
    zeros = structure.zeros_matrix(1, first.n_inputs)[0]
    return structure.common_poles, tuple(int(m) for m in zeros)


def estimate_of(
    asked: Request, loops: Sequence[Loop], found: Found, words: Sequence[str]
) -> Estimate:
    """The estimate of a plant that is not stable.

    Its fit is that of the predictor's errors, as those of the noise of the output; its start and
    offset are those at which the predictor began.
    """
    plant, names = found.plant, asked.records[0]
    zero = np.zeros(1)
    nuisance, n = [], plant.a.size
    levels = found.levels or tuple(np.zeros(one.record.n_inputs) for one in loops)
    for loop, terms, level in zip(loops, found.nuisance, levels, strict=True):
        record = loop.record
        seen = np.flatnonzero(np.isfinite(record.y[:, 0]))
        base = float(recorded_base(loop) if not seen.size or seen[0] else record.y[0, 0])
        predictor = Predictor(plant, float(record.dt or 0.0), slowest(loops))
        nuisance.append(
            Nuisance(
                input_reference=np.array(record.u[0] - level),
                offset=np.array([terms[n] + base]),
                drift=terms[n + 1 :] / record.duration if loop.drift else zero,
                free_response=(terms[:n] * predictor.start_numerators)[None, :],
                offset_std=zero,
                drift_std=zero,
                initial_state="free",
                t0=float(record.t[0]),
            )
        )
    variance = found.variance / found.amplification**2
    left = np.concatenate(found.errors) / found.amplification
    y = np.concatenate([r.y[:, 0] - np.nanmean(r.y[:, 0]) for r in asked.records])
    fit = 100.0 * (1.0 - np.sqrt(np.nansum(left**2) / np.nansum(y**2)))
    rates = ", ".join(f"{pole.real:.4g}" for pole in plant.poles if pole.real > -slowest(loops))
    of_the_predictor = (
        f"not stable, or nearly so: a pole with real part {rates} rad/s",
        "fit and noise are those of the predictor's errors",
    )
    told = (
        *([f"by the mirrored predictor: {found.steps} steps"] if found.steps else []),
        *(of_the_predictor if rates else ()),
        *words,
    )
    count = float(sum(np.isfinite(one).sum() for one in found.errors))
    k = plant.free.shape[1] + sum(one.size for one in found.nuisance) + 1.0 + found.noise.size
    delay = np.asarray(asked.structure.delay_matrix(1, len(plant.b)), dtype=float)
    solved = Solved(
        structure=replace(asked.structure, offset=True, drift=loops[0].drift, initial_state="free"),
        model=TransferFunction(
            [[one for one in plant.b]],
            [[np.concatenate([[1.0], plant.a])] * len(plant.b)],
            delay=delay,
            input_names=names.input_names,
            output_names=names.output_names,
        ),
        theta=plant.theta,
        cov=found.cov,
        noise_variance=np.array([variance]),
        fit=np.array([fit]),
        status=Status.CONVERGED,
        trace=Trace((), decisions=told, stopped="the coefficients stand still"),
        nuisance=tuple(nuisance),
        degrees_of_freedom=found.freedom,
        cost=float(np.nanmean(left**2)),
        aicc=count * float(np.log(found.variance * found.freedom / count)) + aicc_price(k, count),
        condition=found.condition,
        gradient=0.0,
        noise_model=(found.noise,) if found.noise.size else (),
    )
    taken = LoopTaken(loops[0].sampling, mirrored=True)
    return replace(assemble(asked, solved), loop=taken)


def recorded_base(loop: Loop) -> float:
    """What the first output counts as where it was not recorded."""
    return float(loop.fitted.outputs[0, 0])
