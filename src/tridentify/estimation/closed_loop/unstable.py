"""Steps 1, 2 and 4 for a plant that may be unstable or integrate, from what a reference drives.

*Step 1* is `driven`: ``u_M`` and ``y_M`` are bounded, whatever the plant, as the loop is stable.

*Step 2* is `unstable_starts`, the equation error of the two.

*Step 4* is the root of ``sum Z e = 0`` with the errors ``e`` of the mirrored predictor and their
driven derivatives ``Z`` (`predictor`): steps ``(Z' Z)^{-1} Z' e``, halved while they do not bring
the driven part of ``e`` down. Start and offset are columns beside ``Z``; where the noise is
coloured all of them are whitened. ``sigma^2 (Z' T)^{-1} Z' Z (Z' T)^{-T}`` is the covariance, with
``T`` the derivatives of all of ``e`` (`methods.by_reference.returned_errors`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.fall import farther
from tridentify.estimation.closed_loop.linear_errors import (
    Linear,
    driven_basis,
    linear_errors,
    merit,
    slowest,
)
from tridentify.estimation.closed_loop.predictor import Plant, Predictor, observed
from tridentify.numerics.arrays import Array, Complex
from tridentify.numerics.autoregression import fit_autoregression, most_coefficients, whiten
from tridentify.numerics.information import aicc_price
from tridentify.numerics.levinson import autocovariance
from tridentify.numerics.whiteness import is_white

MOST_STEPS = 60
"""Of Step 4; five to ten are usual."""
STILL = 1e-4
"""Standard errors that the coefficients move by in the last step."""
NEARLY = 0.03
"""The same after all steps."""
FLOOR = 1e-8
"""Of the coefficients' natural sizes, added to their standard errors: the derivatives by difference
are not known better, and without noise there is no error to compare with."""
SCATTER = 4.0
"""Times its expectation that the driven part of the errors may be without telling of a wrong plant:
a root of as many equations as unknowns does not minimise it."""
NEAR = 5.0
"""Standard errors from the root within which a whole step is taken, with references: what they
explain is no measure there of coloured noise, whose slow part they explain by chance."""
FOLLOWED = 20
"""Steps after each of which the predictor's poles follow the plant's, with references. In a step
they stay: the driven part of the errors is zero at the plant whatever they are, and near two poles
at zero they have no derivative."""
HALVINGS = 8
"""Of a step that does not lower the driven error: 1/256 of it is none."""
MOST_GROWTH = 1.0 / float(np.finfo(float).eps)
"""Of a plant in a sampling interval, up to which its predictor's errors are more than rounding:
beyond it they are zero at whatever it is, and an end there is no root."""
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
    levels : tuple of arrays
        Per experiment: of the inputs, on top of their first samples; empty where they are zero.
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
    levels: tuple[Array, ...] = ()

    @property
    def still(self) -> bool:
        """Whether it is a root."""
        return self.moved <= NEARLY

    @property
    def deviance(self) -> float:
        """Minus two log likelihood of the noise of the output, with AICc's price of its model."""
        seen = float(sum(np.isfinite(one).sum() for one in self.errors))
        with np.errstate(divide="ignore"):  # there may be no noise
            level = float(np.log(self.variance * self.freedom / seen))
        least = level - 2.0 * float(np.log(self.amplification))
        return seen * least + aicc_price(self.noise.size + 1.0, seen)


def root(
    loops: Sequence[Loop],
    plants: Sequence[Plant],
    choose_noise: Callable[[Sequence[Array]], Array] | None,
    say: Callable[[str], None],
    *,
    fed_back: bool = True,
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
    fed_back : bool
        As of the `Predictor`.

    Returns
    -------
    Found or None
        None where no start leads anywhere.
    """
    noise = np.zeros(0)
    basis = driven_basis(loops, noise)
    begun = []
    for one in plants:
        # two poles that look alike at the samples have no predictor, nor have those beside them
        with contextlib.suppress(np.linalg.LinAlgError):
            linear = linear_errors(loops, one, noise, fed_back=fed_back)
            if linear.is_finite:
                begun.append((one, linear))
    sound = [(merit(linear, basis), k) for k, (_, linear) in enumerate(begun)]
    found = None
    lowest = (True, np.inf)
    for _, k in sorted(sound):
        try:
            ended = _descended(loops, *begun[k], basis, fed_back)
        except np.linalg.LinAlgError:  # a plant without a response, or beyond all bounds
            continue
        if basis is not None:
            found = ended
            if ended.still:
                break
        elif (not ended.still, ended.deviance) < lowest:
            found, lowest = ended, (not ended.still, ended.deviance)
    for _ in range(MOST_NOISE_ROUNDS if found is not None and found.still else 0):
        if choose_noise is None or found is None:
            break
        following = choose_noise(found.errors)
        if following.size == noise.size and np.allclose(following, noise, atol=1e-4):
            break
        say("coloured noise")
        noise = following
        start = linear_errors(loops, found.plant, noise, fed_back=fed_back)
        try:
            whitened = _descended(loops, found.plant, start, driven_basis(loops, noise), fed_back)
        except np.linalg.LinAlgError:  # beyond all bounds
            whitened = None
        if whitened is not None and not whitened.amplification < MOST_GROWTH:
            return whitened
        if whitened is None or not whitened.still:
            return found if found.noise.size else _in_coloured_noise(loops, found, noise)
        found = whitened
    return found


def at_plant(
    loops: Sequence[Loop],
    plant: Plant,
    cov: Array,
    choose_noise: Callable[[Sequence[Array]], Array] | None,
) -> Found:
    """A plant that was found by other means, with the errors and the noise that it leaves.

    Parameters
    ----------
    loops : sequence of Loop
    plant : Plant
    cov : (n, n) array
        Of its coefficients.
    choose_noise : callable, optional
        As of `root`.
    """
    none = np.zeros(0)
    found = _found(loops, plant, linear_errors(loops, plant, none), (0, 0.0), True, None)
    noise = none if choose_noise is None else choose_noise(found.errors)
    if noise.size:
        found = _found(loops, plant, linear_errors(loops, plant, noise), (0, 0.0), True, None)
    return replace(found, cov=cov)


def root_in_noise(
    loops: Sequence[Loop],
    plants: Sequence[Plant],
    choose_noise: Callable[[Sequence[Array]], Array],
) -> Found | None:
    """Step 4 from several plants, each with its own noise from the first step on; the likeliest.

    White weights lead away from a plant whose noise is slow and large.

    Parameters
    ----------
    loops : sequence of Loop
    plants : sequence of Plant
    choose_noise : callable
        As of `root`.
    """
    ends = []
    for plant in plants:
        found = _beside_its_noise(loops, plant, choose_noise)
        ends += [found] if found is not None and found.still else []
    return min(ends, key=lambda one: one.deviance, default=None)


def _beside_its_noise(
    loops: Sequence[Loop], plant: Plant, choose_noise: Callable[[Sequence[Array]], Array]
) -> Found | None:
    best = None
    counts = [loop.record.n_samples for loop in loops]
    for _ in range(MOST_NOISE_ROUNDS):
        try:
            plain = linear_errors(loops, plant, np.zeros(0))
            errors = np.split(plain.step()[1], np.cumsum(counts)[:-1])
            noise = choose_noise(errors)
            start = linear_errors(loops, plant, noise)
            found = _descended(loops, plant, start, driven_basis(loops, noise), True)
        except np.linalg.LinAlgError:  # beyond all bounds
            break
        if not found.still or (best is not None and found.deviance >= best.deviance):
            break
        best, plant = found, found.plant
    return best


def _in_coloured_noise(loops: Sequence[Loop], found: Found, noise: Array) -> Found:
    """A root for white noise with its covariance in coloured noise.

    With ``S`` the covariance of the errors a root of ``Z' e = 0`` has the covariance ``(Z' Z)^{-1}
    Z' S Z (Z' Z)^{-1}`` (Soderstrom & Stoica 1983), whatever ``S`` is.
    """
    linear = linear_errors(loops, found.plant, np.zeros(0))
    own = np.linalg.qr(linear.rest)[0]
    q, r = np.linalg.qr(linear.slopes - own @ (own.T @ linear.slopes))
    left = [whiten(one, noise)[0] for one in found.errors]
    variance = float(np.nanmean(np.concatenate(left) ** 2))
    middle = seen_by(q, [autocovariance(noise, one.size - 1) for one in found.errors])
    back = found.plant.free @ np.linalg.pinv(r)
    return replace(found, cov=variance * back @ middle @ back.T)


def seen_by(q: Array, lags: Sequence[Array]) -> Array:
    """``q' S q`` of columns, ``S`` of the autocovariances of one experiment after the other.

    Parameters
    ----------
    q : (n_samples, k) array
        Experiments below each other.
    lags : sequence of (n_samples,) arrays
        Per experiment.
    """
    middle, at = np.zeros((q.shape[1],) * 2), 0
    for own in lags:
        part = q[at : at + own.size]
        # a Toeplitz matrix is the corner of a circulant one, which Fourier's transform multiplies
        circle = np.fft.rfft(np.concatenate([own, [0.0], own[:0:-1]]))
        whole = np.fft.irfft(circle[:, None] * np.fft.rfft(part, 2 * own.size, axis=0), axis=0)
        middle += part.T @ whole[: own.size]
        at += own.size
    return middle


def autoregressive(errors: Sequence[Array]) -> Array:
    """A model of the errors' colour, of lowest AICc; none where they pass for white."""
    if is_white(errors):
        return np.zeros(0)
    fewest = min(int(np.isfinite(one).sum()) for one in errors)
    return fit_autoregression(list(errors), most_coefficients(fewest))


@np.errstate(over="ignore", invalid="ignore")  # plants that run off are no ends
def _descended(
    loops: Sequence[Loop], plant: Plant, linear: Linear, basis: Array | None, fed_back: bool
) -> Found:
    """Where the steps from a plant end, given its errors whitened by the model of the noise."""
    moved, noise, edge = np.inf, linear.noise, slowest(loops)
    before, last = np.zeros(plant.theta.size), 1.0
    held: Complex | None = None
    for steps in range(1, MOST_STEPS + 1):
        if basis is not None and steps <= FOLLOWED:
            held = Predictor(plant, 0.0, edge).mirrored
            linear = linear_errors(loops, plant, noise, fed_back=fed_back, held=held)
        change, left, upper = linear.step()
        along = plant.free
        size = _deviation(upper, left, linear.count, along) + FLOOR * plant.scale
        whole = along @ change[: along.shape[1]]
        moved = float(np.max(np.abs(whole) / size))
        # without a reference a root is a minimum, and every step goes down
        columns = 0 if basis is None else basis.shape[1]
        noise_level = SCATTER * columns * float(left @ left) / linear.count
        allowed, share = max(merit(linear, basis), noise_level), 1.0
        if basis is None:
            share = _turning(whole / size, before, last)
        if basis is not None and moved <= NEAR:
            allowed = np.inf
        for _ in range(HALVINGS):
            following = plant.with_theta(plant.theta + share * whole)
            new = linear_errors(loops, following, noise, fed_back=fed_back, held=held)
            lower = new.is_bounded and merit(new, basis) <= allowed * (1 + 1e-9)
            if lower and new.is_finite:
                break
            share *= 0.5
        else:
            moved = np.inf
            break
        plant, linear, before, last = following, new, whole / size, share
        if moved <= STILL or not _growth(loops, plant, fed_back) < MOST_GROWTH:
            break
    found = _found(loops, plant, linear, (steps, moved), fed_back, held)
    return found if found.amplification < MOST_GROWTH else replace(found, moved=np.inf)


def _growth(loops: Sequence[Loop], plant: Plant, fed_back: bool) -> float:
    """Of the output's noise in a predictor's errors: what the plant grows by in an interval."""
    step = float(loops[0].record.dt or 0.0)
    return Predictor(plant, step, slowest(loops), fed_back).amplification


def _turning(change: Array, before: Array, share: float) -> float:
    """Share of a step that goes against the one before: where a line between the two is zero.

    Gauss-Newton steps in a curved valley go to and fro: with ``d_k = (1 - s (1 + c)) d_{k-1}``
    after a share ``s`` of the step before, the share that ends it is ``1 / (1 + c)`` (Aitken).
    """
    along, size = float(change @ before), float(before @ before)
    if along >= 0.0 or not size > 0.0:
        return 1.0
    return share / (1.0 - along / size)


def _deviation(upper: Array, left: Array, count: int, along: Array) -> Array:
    variance = float(left @ left) / max(count - upper.shape[1], 1)
    inverse = along @ np.linalg.pinv(upper)[: along.shape[1]]
    return np.asarray(np.sqrt(variance * np.sum(inverse**2, axis=1)) + 1e-300)


def _found(
    loops: Sequence[Loop],
    plant: Plant,
    linear: Linear,
    walked: tuple[int, float],
    fed_back: bool,
    held: Complex | None,
) -> Found:
    change, left, upper = linear.step()
    n, noise = plant.free.shape[1], linear.noise
    freedom = max(linear.count - upper.shape[1] - noise.size, 1)
    variance = float(left @ left) / freedom
    inverse = plant.free @ np.linalg.pinv(upper)[:n]
    # squares of what grows over the record may be too large for a number
    columns = upper[:, :n] / (np.max(np.abs(upper[:, :n]), axis=0) + 1e-300)
    columns = columns / (np.linalg.norm(columns, axis=0) + 1e-300)
    rest = np.split(change[n:], len(loops))
    plain = linear_errors(loops, plant, np.zeros(0), fed_back=fed_back, held=held)
    whole = plain.errors - plain.rest @ change[n:]
    errors = np.split(whole, np.cumsum([loop.record.n_samples for loop in loops])[:-1])
    seen = [observed(loop) for loop in loops]
    return Found(
        plant,
        variance * inverse @ inverse.T,
        tuple(np.where(s, e, np.nan) for s, e in zip(seen, errors, strict=True)),
        noise,
        variance,
        _growth(loops, plant, fed_back),
        tuple(rest),
        freedom,
        float(np.linalg.cond(columns)),
        *walked,
    )


@dataclass(frozen=True, eq=False)
class _Along:
    """What the references explain of the errors at a plant, with what it changes by (`fall`)."""

    loops: Sequence[Loop]
    plant: Plant
    linear: Linear
    basis: Array

    @property
    def innovations(self) -> Array:
        return self._seen(self.linear.errors[:, None])[:, 0]

    @property
    def columns(self) -> Array:
        return self._seen(self.linear.full)

    @property
    def size(self) -> float:
        return merit(self.linear, self.basis)

    def moved(self, change: Array) -> _Along | None:
        plant = self.plant.with_theta(self.plant.theta + self.plant.free @ change)
        linear = linear_errors(self.loops, plant, self.linear.noise)
        return replace(self, plant=plant, linear=linear) if linear.is_bounded else None

    def _seen(self, table: Array) -> Array:
        own = np.linalg.qr(self.linear.rest)[0]
        return np.asarray(self.basis.T @ (table - own @ (own.T @ table)))


def with_fall(loops: Sequence[Loop], found: Found) -> Found:
    """A root with a covariance that grows where what the references explain falls less (`fall`)."""
    basis = driven_basis(loops, found.noise)
    linear = linear_errors(loops, found.plant, found.noise)
    if basis is None or not (linear.is_finite and np.isfinite(linear.full).all()):
        return found
    here = _Along(loops, found.plant, linear, basis)
    along = found.plant.free
    back = np.linalg.pinv(along)
    added = farther(here, back @ found.cov @ back.T, along.shape[1])
    return replace(found, cov=found.cov + along @ added @ along.T)
