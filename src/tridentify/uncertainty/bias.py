"""Correcting the bias that a bootstrap shows, in spite of heavy tails.

The textbook correction ``theta_hat - (mean(theta*) - theta_hat)`` fails on short noisy records: the
distribution of the copies has tails so heavy that its mean says nothing (a single copy with a mode
at the limit of the sampling moves it by thousands), and subtracting a bias as large as the
coefficient makes a damping negative. Two changes:

*Median for mean.* The median exists whatever the tails are, and it commutes with every monotone
change of scale: the correction makes the estimator median-unbiased to first order.

*A move that cannot leave the range.* What is corrected are, for every pair of poles, the
coefficients of ``s^2 + 2 z w s + w^2``; for every real pole, its rate; and the numerators divided
by ``a_0``. All of the first are positive exactly when the system is stable. With ``r = median(q*) /
q_hat``, a positive quantity ``q`` is corrected by

    q_corrected = q_hat / r         for r > 1 (on the scale of its logarithm),
    q_corrected = q_hat (2 - r)     for r < 1 (on its own scale):

the shorter way of the two, the same to first order. The corrected system is stable again, and no
correction more than doubles such a quantity. That matters where the estimate has run away: its
copies fall back towards the truth, and the scale of the logarithm would drive it off by the
same factor once more. The numerators over ``a_0`` are the static gain and its moments in time,
which the record knows far better than ``b``: ``b`` and ``a_0`` run away together when the mode that
they belong to does. They have no sign to keep and are corrected by difference.

Correcting costs scatter: where the bias is below a quarter of the spread it is better left alone
(Efron & Tibshirani 1993, sec. 10.6), and where the copies scatter by more than the coefficient
itself the corrected estimate has the larger mean-square error of the two. So it is offered beside
the estimate, never put in its place. And what no correction mends: a copy is simulated from the
estimate, and if that sits in the wrong valley of the cost, the copies show that valley's bias.

Coefficients of an estimate that is not stable itself are corrected by difference.

References: B. Efron & R. J. Tibshirani, *An Introduction to the Bootstrap* (1993), ch. 10; A. C.
Davison & D. V. Hinkley, *Bootstrap Methods and their Application* (1997), sec. 2.3 and 5.6.
"""

from __future__ import annotations

import numpy as np

from tridentify.estimation.answer.estimate import Estimate
from tridentify.numerics import delta_method
from tridentify.numerics.arrays import Array
from tridentify.numerics.root_draws import matched, stacked_roots
from tridentify.uncertainty.draws import denominators


def corrected(estimate: Estimate, theta: Array) -> Array:
    """Coefficients less the median bias of the draws.

    Parameters
    ----------
    estimate : Estimate
    theta : ndarray, shape (n_draws, n_parameters)
        Of the copies, finite.

    Returns
    -------
    ndarray, shape (n_parameters,)
        In the order of ``estimate.names``. Free delays are corrected as they are.
    """
    centre = np.asarray(estimate.theta, dtype=np.float64)
    result = 2.0 * centre - np.median(theta, axis=0)
    if not estimate.model.is_stable:
        return np.asarray(result)
    position = {name: k for k, name in enumerate(estimate.names)}
    dens: dict[tuple[int, int], Array] = {}
    for i, j in denominators(estimate):
        drawn = estimate.channel_draws(theta, i, j)[1]
        dens[i, j] = _denominator(estimate.model.den[i][j], drawn)
        _store(result, position, "a", _label(estimate, i, j), dens[i, j])
    for i in range(len(estimate.output_names)):
        for j in range(len(estimate.input_names)):
            num, den, _ = estimate.channel_draws(theta, i, j)
            own, reference = estimate.model.num[i][j], estimate.model.den[i][j]
            last = dens[(0, 0) if estimate.structure.shared else (i, j)][-1]
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                middle = np.nanmedian(num / den[:, -1:], axis=0)
            fixed = last * (2.0 * own / reference[-1] - middle)
            _store(result, position, "b", _label(estimate, i, j), fixed)
    return np.asarray(result)


def _label(estimate: Estimate, output: int, input_: int) -> str:
    return f"[{estimate.output_names[output]},{estimate.input_names[input_]}]"


def _store(
    result: Array, position: dict[str, int], letter: str, label: str, polynomial: Array
) -> None:
    """Put coefficients where their names stand; one that is not estimated has no place."""
    for power, value in enumerate(polynomial[::-1].tolist()):
        for name in (f"{letter}{power}{label}", f"{letter}{power}"):
            if name in position:
                result[position[name]] = value
                break


def _denominator(reference: Array, den: Array) -> Array:
    """Corrected denominator, descending powers, from the sections of the draws."""
    centre = delta_method.root_sensitivity(reference)[0]
    roots = matched(stacked_roots(den), centre)
    product = np.ones(1)
    for k, pole in enumerate(centre):
        if pole.imag < 0:
            continue
        pair = roots[:, k : k + 2] if pole.imag > 0 else roots[:, k : k + 1]
        damping = _positive(-pair.sum(axis=1).real, -float(pole.real) * pair.shape[1])
        section = [1.0, damping]
        if pole.imag > 0:
            section.append(_positive(pair.prod(axis=1).real, abs(pole) ** 2))
        product = np.convolve(product, section)
    return product


def _positive(values: Array, at: float) -> float:
    """A positive quantity less its median bias: positive still, and at most doubled.

    Examples
    --------
    >>> _positive(np.array([2.0]), 1.0), _positive(np.array([0.25]), 1.0)
    (0.5, 1.75)
    """
    ratio = float(np.median(values)) / at
    if not ratio > 0:
        return 2.0 * at
    return at / ratio if ratio > 1 else at * (2.0 - ratio)
