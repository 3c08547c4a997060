"""Physical parameters from estimated coefficients: the least distance, weighted by the covariance.

Given the estimate ``theta_hat`` with covariance ``V``, the parameters minimise

    (theta_hat - g(phi))' V^{-1} (theta_hat - g(phi)) + sum_j ((phi_j - m_j) / s_j)^2,

the second sum over parameters that are known to be ``m_j`` with standard deviation ``s_j``. Where
the map is one to one this solves ``g(phi) = theta_hat``; where there are more coefficients than
parameters it is asymptotically as good as maximum likelihood under the restriction, and the minimum
is chi-square distributed with as many degrees of freedom as there are restrictions if these are
true (Malinvaud 1970; Rothenberg 1973; Chamberlain 1984).

The search is a trust region in the coordinates of `model` (logarithms of what is positive), first
on relative deviations, then on weighted ones. It begins at the approximate inverse, at the guesses
and at scattered places, because a map can have several solutions: two stages of a circuit
exchanged, for instance. Of those that are equally good the nearest to the guesses is taken, and the
others are reported.

References: E. Malinvaud, *Statistical Methods of Econometrics*, 2nd ed. (1970), ch. 9;
T. J. Rothenberg, *Efficient Estimation with A Priori Information* (1973);
G. Chamberlain, in *Handbook of Econometrics*, vol. 2 (1984), ch. 22.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tridentify.errors import ConvergenceError
from tridentify.numerics.arrays import Array
from tridentify.physical.model import PhysicalModel

Known = Mapping[str, tuple[float, float]]

RELATIVE_FLOOR = 1e-12
"""Relative standard error a coefficient has at least: one without any would weigh infinitely."""
SINGULAR = 1e-13
"""Share of the largest eigenvalue of the correlation that every one has: what rounding leaves of
zero."""
SCATTERED = 18
"""Starts beside the inverse and the guesses: six at each width."""
WIDTHS = (1.0, 2.5, 5.0)
"""Standard deviations of the scatter, in logarithms: factors of 3, 12 and 150."""
SAME = 1e-4
"""Relative difference of two solutions that are one: the search ends to six digits."""
INDISTINGUISHABLE = 3.84
"""95 % point of chi-square of one degree of freedom."""
TIE = 1e-3
"""Distance within which two solutions explain the coefficients equally well."""


@dataclass(frozen=True, eq=False)
class Restriction:
    """A model, what is known of its parameters, and the coefficients to be met.

    Attributes
    ----------
    model : PhysicalModel
    theta : (n_coefficients,) array
    weight : (k, n_coefficients) array
        ``weight' weight`` is the inverse covariance of ``theta``.
    known : mapping of str to (value, std)
        A standard deviation of zero: held.
    """

    model: PhysicalModel
    theta: Array
    weight: Array
    known: Known

    @property
    def free(self) -> NDArray[np.bool_]:
        """(n_parameters,) which parameters are not held."""
        held = {name for name, (_, std) in self.known.items() if std == 0}
        return np.array([name not in held for name in self.model.names])

    @property
    def base(self) -> Array:
        """(n_parameters,) coordinates of the known values, and of the guesses elsewhere."""
        pairs = zip(self.model.names, self.model.guess.tolist(), strict=True)
        values = [self.known[name][0] if name in self.known else guess for name, guess in pairs]
        return self.model.coordinates(np.array(values))

    @property
    def informed(self) -> list[tuple[int, float, float]]:
        """(position, value, std) of what is known with an uncertainty."""
        rows = [(i, *self.known[n]) for i, n in enumerate(self.model.names) if n in self.known]
        return [row for row in rows if row[2] > 0]

    def prior(self, z: Array) -> Array:
        """Deviations of the parameters from what is known, in standard deviations."""
        values = self.model.values(z)
        return np.array([(values[i] - m) / s for i, m, s in self.informed])

    def prior_jacobian(self, z: Array) -> Array:
        """Derivatives of `prior` with respect to the coordinates."""
        table = np.zeros((len(self.informed), z.size))
        slope = self.model.slope(z)
        for row, (i, _, s) in enumerate(self.informed):
            table[row, i] = slope[i] / s
        return table

    def deviation(self, z: Array) -> Array:
        """Weighted deviations, those from what is known included."""
        return np.concatenate([self.weight @ (self.model.theta_at(z) - self.theta), self.prior(z)])

    def jacobian(self, z: Array) -> Array:
        """Derivatives of `deviation`."""
        return np.vstack([self.weight @ self.model.jacobian(z), self.prior_jacobian(z)])

    def rank(self, determined: int) -> int:
        """Independent functions that coefficients and knowledge determine, at most all free."""
        return min(int(self.free.sum()), determined + len(self.informed))


def weight_of(cov: Array, theta: Array) -> Array:
    """(n, n) root of the inverse covariance; coefficients without error weigh very much."""
    floor = RELATIVE_FLOOR * np.maximum(np.abs(theta), np.max(np.abs(theta)) * 1e-30)
    std = np.maximum(np.sqrt(np.maximum(np.diag(cov), 0.0)), np.where(floor > 0, floor, 1.0))
    correlation = cov / np.outer(std, std)
    np.fill_diagonal(correlation, 1.0)
    values, vectors = np.linalg.eigh(correlation)
    values = np.maximum(values, SINGULAR * values[-1])
    return np.asarray((vectors / np.sqrt(values)).T / std)


@dataclass(frozen=True, eq=False)
class Nearest:
    """The parameters of least distance.

    Attributes
    ----------
    z : (n_parameters,) array
        Coordinates.
    distance : float
        Squared, in standard deviations.
    others : tuple of (n_parameters,) arrays
        Coordinates of other solutions that are as good.
    """

    z: Array
    distance: float
    others: tuple[Array, ...]


def nearest(restriction: Restriction, *, unique: bool) -> Nearest:
    """Find the parameters of least distance.

    Parameters
    ----------
    restriction : Restriction
    unique : bool
        Whether the parameters are all determined, so that other solutions are worth a search.

    Returns
    -------
    Nearest

    Raises
    ------
    ConvergenceError
        The search ended nowhere, from no start.
    """
    found: list[tuple[float, Array]] = []
    for k, start in enumerate(_starts(restriction)):
        if not unique and found and k > 1:
            break
        z = _search(restriction, start)
        if z is not None:
            left = restriction.deviation(z)
            found.append((float(left @ left), z))
    if not found:
        raise ConvergenceError(
            f"found no parameters of {restriction.model.name} near the estimated coefficients; "
            "expected the map to reach them; check the map and the guesses"
        )
    lowest = min(distance for distance, _ in found)
    # of equally good ones the nearest to the guesses
    base = restriction.base
    found.sort(key=lambda pair: (pair[0] > lowest + TIE, float(np.linalg.norm(pair[1] - base))))
    best = found[0][1]
    others: list[Array] = []
    for distance, z in found[1:] if unique else []:
        apart = all(_apart(restriction, z, other) for other in (best, *others))
        if apart and distance < lowest + INDISTINGUISHABLE and np.isfinite(distance):
            others.append(z)
    return Nearest(best, lowest, tuple(others))


def _apart(restriction: Restriction, one: Array, other: Array) -> bool:
    a, b = restriction.model.values(one), restriction.model.values(other)
    return bool(np.any(np.abs(a - b) > SAME * np.maximum(np.abs(a), np.abs(b))))


def _starts(restriction: Restriction) -> Sequence[Array]:
    """Coordinates to begin at: the approximate inverse, the guesses, and around both."""
    model, base, free = restriction.model, restriction.base, restriction.free
    firsts = []
    if model.start is not None:
        given = zip(model.coefficient_names, restriction.theta.tolist(), strict=True)
        try:
            rough = dict(model.start(dict(given)))
        except (ArithmeticError, ValueError):
            rough = {}
        values = model.values(base)
        for i, name in enumerate(model.names):
            usable = np.isfinite(rough.get(name, np.nan)) and name not in restriction.known
            if usable and not (model.positive[i] and rough[name] <= 0):
                values[i] = rough[name]
        firsts.append(model.coordinates(values))
    firsts.append(base)
    rng, n = np.random.default_rng(11), len(firsts)
    for k in range(SCATTERED):
        wide = WIDTHS[k % len(WIDTHS)]
        move = rng.normal(size=base.size) * np.where(model.positive, wide, 1.0)
        centre = firsts[k % n]
        size = np.where(model.positive, 1.0, np.maximum(np.abs(centre), 1.0))
        firsts.append(np.where(free, centre + size * move, base))
    return firsts


def _search(restriction: Restriction, start: Array) -> Array | None:
    """Trust region on relative deviations, then on weighted ones."""
    free, model = restriction.free, restriction.model
    size = np.maximum(np.abs(restriction.theta), 1e-9 * np.abs(restriction.theta).max())
    relative = Restriction(
        model,
        restriction.theta,
        np.diag(1.0 / np.where(size > 0, size, 1.0)),
        restriction.known,
    )
    z = start.copy()
    for stage in (relative, restriction):

        def whole(w: Array, z: Array = z) -> Array:
            return np.where(free, _spread(w, free), z)

        def value(w: Array, stage: Restriction = stage, whole=whole) -> Array:  # type: ignore[no-untyped-def]
            return stage.deviation(whole(w))

        def slope(w: Array, stage: Restriction = stage, whole=whole) -> Array:  # type: ignore[no-untyped-def]
            return stage.jacobian(whole(w))[:, free]

        if not free.any():
            return z
        try:
            # slow to import, seldom needed
            from scipy.optimize import least_squares

            done = least_squares(
                value, z[free], slope, method="trf", xtol=1e-14, ftol=1e-14, gtol=1e-14,
                max_nfev=200,
            )  # fmt: skip
        except (ValueError, np.linalg.LinAlgError):
            return None
        z = whole(done.x)
    return z


def _spread(w: Array, free: NDArray[np.bool_]) -> Array:
    z = np.zeros(free.size)
    z[free] = w
    return z
