"""Which of the ends of a search for plant and noise is the answer, and how far off it may be.

*Ends.* Where several are nearly as likely (orders of the noise, other minima, of which weakly moved
loops have several), each counts with its Akaike weight, and their distances from the likeliest join
the covariance (Buckland, Burnham & Augustin 1997). Steps may end at a kink before the minimum,
mostly within one standard error or two of it; such ends count as others, with the step that was
left.

The fall of the likelihood on both sides joins it, too (`fall`).

*Rivals.* The noise of a held plant that wanders is no autoregression of finite order, and what that
costs is not the same for all plants: a difference of ten or fifteen in AICc between minima that are
many errors apart says no more than that the record hardly moved the input by itself. Where another
start ends so near, its distance counts in full.

Reference: S. Buckland, K. Burnham & N. Augustin, Biometrics 53 (1997) 603-618.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.fall import farther
from tridentify.estimation.closed_loop.joint import End, Together, descended, is_too_fast
from tridentify.estimation.closed_loop.predictor import STEP, Plant
from tridentify.estimation.closed_loop.unstable import Found
from tridentify.estimation.likelihood.thresholds import NEAR
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import fit_autoregression, most_coefficients

ORDERS = (0, 1, 2, 3, 4, 6, 8, 12, 16)
"""Of the noise, that are tried one after the other."""
IN_VAIN = 2
"""Orders in a row that are no better, beyond which none is tried."""
SHORT = 1.0
"""Standard errors that a last step may have been away from a minimum."""
MANY = 3.0
"""Standard errors between two plants from which they are told apart."""
LEAST_WEIGHT = 1e-3
"""Akaike weight from which an end counts: fourteen in AICc."""


@dataclass(frozen=True, eq=False)
class Settled:
    """Plant and noise of lowest AICc, and what else is nearly as likely.

    Attributes
    ----------
    found : Found
    spread : (n, n) array
        What other ends, a step that came to nothing, and a likelihood that falls less than its
        curvature says add to the covariance of the plant.
    criterion : float
        AICc of the innovations.
    rival : float
        Distance of a plant that another start leads to and that is nearly as likely
        [standard errors without it]; 0 for none.
    """

    found: Found
    spread: Array
    criterion: float
    rival: float = 0.0

    @property
    def errors(self) -> Array:
        """(n,) standard errors."""
        return np.asarray(np.sqrt(np.diag(self.found.cov + self.spread)))


def together(loops: Sequence[Loop], plants: Sequence[Plant]) -> Settled | None:
    """Plant and noise, from several plants; None where no start leads anywhere."""
    ends, likeliest = _all_ends(loops, plants)
    if not ends:
        return None
    best = _likeliest(ends)
    place = best.place
    grown = place.of_plant(farther(place, place.cov, place.n_free))
    found, spread = _found(best), _spread(best, ends) + grown
    away, rival = _farthest(best, likeliest, np.sqrt(np.diag(found.cov + spread)))
    return Settled(found, spread + np.outer(away, away), place.criterion, rival)


def nearest(loops: Sequence[Loop], plant: Plant) -> Together | None:
    """Where a plant leads to, without what else is nearly as likely; None for nowhere."""
    ends, _ = _all_ends(loops, [plant])
    return _likeliest(ends).place if ends else None


def _all_ends(loops: Sequence[Loop], plants: Sequence[Plant]) -> tuple[list[End], list[End]]:
    """Those of all orders, and the likeliest that each plant leads to."""
    ends: list[End] = []
    likeliest: list[End] = []
    for plant in _different([one for one in plants if not is_too_fast(one, loops)]):
        known = len(ends)
        try:
            with np.errstate(all="ignore"):  # plants that run off are no ends
                begun = Together.at(loops, plant, np.zeros(0))
                if np.isfinite(begun.size):
                    _over_orders(begun, ends)
        except np.linalg.LinAlgError:  # a plant without a response, or beyond all bounds
            continue
        likeliest += [_likeliest(ends[known:])] if len(ends) > known else []
    return ends, likeliest


def _different(plants: Sequence[Plant]) -> list[Plant]:
    """Those that are farther from each other than derivatives by difference look."""
    found: list[Plant] = []
    for plant in plants:
        apart = ((np.abs(plant.theta - one.theta), STEP * one.scale) for one in found)
        if not any(np.all(far <= step) for far, step in apart):
            found.append(plant)
    return found


def _over_orders(begun: Together, ends: list[End]) -> None:
    """From a plant: with the noise that its errors ask for, then with fewer and more of it.

    Where that leads to an end which another plant led to before, it leads on as from there.

    Parameters
    ----------
    begun : Together
    ends : list of End
        Those of other plants, to which its own are added.
    """
    fewest = min(int(one.seen.sum()) for one in begun.ahead)
    orders = [p for p in ORDERS if p <= most_coefficients(fewest)]
    first = fit_autoregression(begun.errors, orders[-1])
    middle = descended(begun.coloured(first))
    k = min(int(np.searchsorted(orders, first.size)), len(orders) - 1)
    if not (middle.still and first.size == orders[k]):
        middle = descended(_of_order(middle.place, orders[k]))
    known = tuple(ends)
    if not _added(middle, known, ends):
        return
    for others in (orders[k + 1 :], orders[:k][::-1]):
        last, lowest, vain = middle, middle.place.criterion, 0
        for order in others:
            last = descended(_of_order(last.place, order))
            if np.isfinite(last.moved):
                ends.append(last)
            vain = 0 if last.place.criterion < lowest else vain + 1
            lowest = min(lowest, last.place.criterion)
            if vain == IN_VAIN:
                break


def _added(one: End, known: Sequence[End], ends: list[End]) -> bool:
    """Whether an end is not one that other plants led to; it then stands among all ends."""
    if one.still and any(_is_same(one.place, other.place) for other in known if other.still):
        return False
    if np.isfinite(one.moved):
        ends.append(one)
    return True


def _of_order(here: Together, order: int) -> Together:
    """The same plant, its noise fitted anew, or with further coefficients of zero if better."""
    if order == here.noise.size:
        return here
    fitted = here.coloured(fit_autoregression(here.errors, order, order))
    if order < here.noise.size:
        return fitted
    grown = here.coloured(np.append(here.noise, np.zeros(order - here.noise.size)))
    return min(fitted, grown, key=lambda one: one.size)


def _spread(best: End, ends: Sequence[End]) -> Array:
    """Weighted squares of the distances of all ends that are nearly as likely as the best."""
    n = best.place.plant.theta.size
    least = best.place.criterion
    spread, total = np.zeros((n, n)), 0.0
    known: list[End] = []
    for one in sorted(ends, key=lambda end: end.place.criterion):
        weight = float(np.exp(-0.5 * (one.place.criterion - least)))
        if weight < LEAST_WEIGHT:
            break
        if any(_is_same(one.place, other.place) for other in known):
            continue
        known.append(one)
        away = one.place.plant.theta - best.place.plant.theta
        spread += weight * np.outer(away, away)
        total += weight
    return spread / total + np.outer(best.step, best.step)


def _likeliest(ends: Sequence[End]) -> End:
    return min(ends, key=lambda one: one.place.criterion)


def _farthest(best: End, likeliest: Sequence[End], errors: Array) -> tuple[Array, float]:
    """How far off the farthest rival is, and in how many errors; zero where there is none."""
    found, most = np.zeros(errors.size), 0.0
    for one in likeliest:
        if not (one.moved < SHORT and one.place.criterion < best.place.criterion + NEAR):
            continue
        away = one.place.plant.theta - best.place.plant.theta
        apart = float(np.max(np.abs(away) / np.maximum(errors, 1e-300)))
        if apart > max(most, MANY):
            found, most = away, apart
    return found, most


def _is_same(one: Together, other: Together) -> bool:
    """Whether two ends are one minimum."""
    return one.noise.size == other.noise.size and abs(one.criterion - other.criterion) < 1e-2


def _found(end: End) -> Found:
    here = end.place
    predictor = here.ahead[0].predictor
    table = here.columns[:, : here.n_free]
    table = table / (np.linalg.norm(table, axis=0) + 1e-300)
    freedom = max(here.count - here.unknowns, 1)
    width = here.plant.a.size + 1
    return Found(
        here.plant,
        here.of_plant(here.cov),
        tuple(here.errors),
        here.noise,
        here.size / freedom,
        predictor.amplification,
        tuple(one[:width] for one in here.start),
        freedom,
        float(np.linalg.cond(table)),
        end.steps,
        end.moved,
        tuple(one[width:] for one in here.start),
    )
