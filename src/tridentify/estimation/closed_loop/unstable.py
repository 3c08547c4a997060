"""Steps 1, 2 and 4 for a plant that may be unstable or integrate, from what a reference drives.

*Step 1* is `driven`: ``u_M`` and ``y_M`` are bounded, whatever the plant, as the loop is stable.

*Step 2* is `unstable_starts`, the equation error of the two.

*Step 4* is the root of ``sum Z e = 0`` with the errors ``e`` of the mirrored predictor and their
driven derivatives ``Z`` (`predictor`): steps ``(Z' Z)^{-1} Z' e``, halved while they do not bring
the driven part of ``e`` down. Start and offset are columns beside ``Z``; where the noise is
coloured all of them are whitened. ``sigma^2 (Z' Z)^{-1}`` is the covariance
(`methods.reference`, eq. 2).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.linear_errors import (
    Linear,
    driven_basis,
    linear_errors,
    merit,
    slowest,
)
from tridentify.estimation.closed_loop.predictor import Plant, Predictor
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import fit_autoregression, most_coefficients

MOST_STEPS = 60
"""Of Step 4; five to ten are usual."""
STILL = 1e-4
"""Standard errors that the coefficients move by in the last step."""
SCATTER = 4.0
"""Times its expectation that the driven part of the errors may be without telling of a wrong plant:
a root of as many equations as unknowns does not minimise it."""
HALVINGS = 8
"""Of a step that does not lower the driven error: 1/256 of it is none."""
MOST_NOISE_ROUNDS = 4
"""Fits of the noise model and of the coefficients in turn."""


@dataclass(frozen=True, eq=False)
class Found:
    """Where Step 4 ended.

    Attributes
    ----------
    plant : Plant
    cov : (n, n) array
        Of its coefficients.
    errors : tuple of (n_samples,) arrays
        ``e`` less start and offset, per experiment; ``nan`` where nothing was recorded.
    noise : (p,) array
        Autoregressive coefficients of ``e``; empty where it is white.
    variance : float
        Of the innovations of ``e``.
    amplification : float
        Of the output's noise in ``e``, in standard deviations.
    nuisance : tuple of arrays
        Per experiment: initial state, offset [output units].
    freedom : int
        Samples less unknowns.
    condition : float
        Of ``Z`` with unit columns.
    steps : int
    moved : float
        By the last step [standard errors].
    """

    plant: Plant
    cov: Array
    errors: tuple[Array, ...]
    noise: Array
    variance: float
    amplification: float
    nuisance: tuple[Array, ...]
    freedom: int
    condition: float
    steps: int
    moved: float

    @property
    def still(self) -> bool:
        """Whether it is a root."""
        return self.moved <= STILL

    def driven_share(self, loops: Sequence[Loop]) -> float:
        """Mean square of what the references explain of the errors, over its expectation."""
        total, columns = 0.0, 0
        for loop, left in zip(loops, self.errors, strict=True):
            seen = np.isfinite(left)
            q = np.linalg.qr(loop.fitted.columns[seen])[0]
            total += float(np.sum((q.T @ left[seen]) ** 2)) / float(np.mean(left[seen] ** 2))
            columns += q.shape[1]
        return total / columns


def root(
    loops: Sequence[Loop],
    plants: Sequence[Plant],
    choose_noise: Callable[[Sequence[Array]], Array] | None,
    say: Callable[[str], None],
) -> Found | None:
    """Step 4 from several plants, the one first of which the references explain least.

    Parameters
    ----------
    loops : sequence of Loop
    plants : sequence of Plant
    choose_noise : callable, optional
        Gives the autoregressive coefficients for the errors of the experiments; white without it.
    say : callable
        Is told what is going on.

    Returns
    -------
    Found or None
        None where no start leads anywhere.
    """
    noise = np.zeros(0)
    basis = driven_basis(loops)
    sound = [one for one in plants if linear_errors(loops, one, noise).is_finite]
    found = None
    for plant in sorted(sound, key=lambda one: merit(linear_errors(loops, one, noise), basis)):
        found = _descended(loops, plant, noise, basis)
        if found.still:
            break
    for _ in range(MOST_NOISE_ROUNDS if found is not None and found.still else 0):
        if choose_noise is None or found is None:
            break
        following = choose_noise(found.errors)
        if following.size == noise.size and np.allclose(following, noise, atol=1e-4):
            break
        say("coloured noise")
        noise = following
        found = _descended(loops, found.plant, noise, basis)
    return found


def autoregressive(errors: Sequence[Array]) -> Array:
    """A model of the errors' colour, of the order of lowest AICc."""
    fewest = min(int(np.isfinite(one).sum()) for one in errors)
    return fit_autoregression(list(errors), most_coefficients(fewest))


def _descended(loops: Sequence[Loop], plant: Plant, noise: Array, basis: Array) -> Found:
    moved = np.inf
    linear = linear_errors(loops, plant, noise)
    for steps in range(1, MOST_STEPS + 1):  # noqa: B007 - counts after the loop
        change, left, upper = linear.step()
        n = plant.theta.size
        size = _deviation(upper, left, linear.count, n)
        moved = float(np.max(np.abs(change[:n]) / size))
        noise_level = SCATTER * basis.shape[1] * float(left @ left) / linear.count
        allowed, share = max(merit(linear, basis), noise_level), 1.0
        for _ in range(HALVINGS):
            following = plant.with_theta(plant.theta + share * change[:n])
            new = linear_errors(loops, following, noise)
            if new.is_finite and merit(new, basis) <= allowed * (1 + 1e-9):
                break
            share *= 0.5
        else:
            moved = np.inf
            break
        plant, linear = following, new
        if moved <= STILL:
            break
    return _found(loops, plant, noise, linear, (steps, moved))


def _deviation(upper: Array, left: Array, count: int, n: int) -> Array:
    variance = float(left @ left) / max(count - upper.shape[1], 1)
    inverse = np.linalg.pinv(upper)
    return np.asarray(np.sqrt(variance * np.sum(inverse[:n] ** 2, axis=1)) + 1e-300)


def _found(
    loops: Sequence[Loop], plant: Plant, noise: Array, linear: Linear, walked: tuple[int, float]
) -> Found:
    change, left, upper = linear.step()
    n = plant.theta.size
    freedom = max(linear.count - upper.shape[1] - noise.size, 1)
    variance = float(left @ left) / freedom
    inverse = np.linalg.pinv(upper)
    columns = upper[:, :n] / np.linalg.norm(upper[:, :n], axis=0)
    rest = np.split(change[n:], len(loops))
    plain = linear_errors(loops, plant, np.zeros(0))
    whole = plain.errors - plain.rest @ change[n:]
    errors = np.split(whole, np.cumsum([loop.record.n_samples for loop in loops])[:-1])
    seen = [np.isfinite(loop.record.y[:, 0]) for loop in loops]
    step = float(loops[0].record.dt or 0.0)
    return Found(
        plant,
        variance * inverse[:n] @ inverse[:n].T,
        tuple(np.where(s, e, np.nan) for s, e in zip(seen, errors, strict=True)),
        noise,
        variance,
        Predictor(plant, step, slowest(loops)).amplification,
        tuple(rest),
        freedom,
        float(np.linalg.cond(columns)),
        *walked,
    )
