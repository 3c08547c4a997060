"""Maximum of the likelihood of a loop's innovations, near a consistent estimate.

Of the innovations ``v`` (`innovations`), white or autoregressive, ``sum e^2`` with ``e = A(q) v``
is minimised over the coefficients, start and offset by Gauss-Newton, and ``A`` fitted to ``v``, in
turn. In a loop the derivatives of ``e`` by the plant hold past noise, as those by ``A`` do: the
covariance of the plant's coefficients is a block of the inverse of the information on all of them.

Reference: L. Ljung, *System Identification*, 2nd ed., section 9.4 (1999).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tridentify.errors import TridentifyError
from tridentify.estimation.closed_loop.innovations import Innovations
from tridentify.estimation.closed_loop.linear_errors import stacked
from tridentify.numerics.arrays import Array, Flags
from tridentify.numerics.autoregression import fit_autoregression, whiten
from tridentify.transfer_function import TransferFunction

MOST_STEPS = 30
"""Of Gauss-Newton; it begins within a few standard errors, and needs three to six."""
STILL = 1e-3
"""Standard errors that the coefficients move by in the last step."""
HALVINGS = 8
"""Of a step that does not lower the sum of squares."""
MOVED = 1e-3
"""By which coefficients are moved for a derivative [standard errors of the start]."""
MOST_MODELS = 12
"""Models of the noise and descents in turn."""


@dataclass(frozen=True, eq=False)
class Likeliest:
    """Where the steps ended.

    Attributes
    ----------
    theta : (n,) array
    cov : (n, n) array
    noise : (p,) array
        Autoregressive coefficients of the innovations.
    variance : float
    errors : tuple of (n_samples,) arrays
        Innovations of the experiments, before ``A``.
    still : bool
    """

    theta: Array
    cov: Array
    noise: Array
    variance: float
    errors: tuple[Array, ...]

    @property
    def std(self) -> Array:
        """Standard errors."""
        return np.asarray(np.sqrt(np.diag(self.cov)))


@dataclass(frozen=True, eq=False)
class _Place:
    """Errors at coefficients and noise, start and offset at their best."""

    theta: Array
    noise: Array
    plant: TransferFunction
    errors: tuple[Array, ...]
    rest: tuple[Array, ...]
    columns: Array
    white: Array

    @property
    def size(self) -> float:
        """Sum of squares."""
        total = float(self.white @ self.white)
        return total if np.isfinite(total) else np.inf


@dataclass(frozen=True, eq=False)
class Likelihood:
    """What is minimised.

    Attributes
    ----------
    loops : sequence of Innovations
    model : callable
        From all coefficients to the plant.
    free : (n,) bool array
        Coefficients that are estimated.
    scale : (n,) array
        Standard errors at the start.
    """

    loops: Sequence[Innovations]
    model: Callable[[Array], TransferFunction]
    free: Flags
    scale: Array

    def maximum(self, theta: Array, choose: Callable[[Sequence[Array]], Array]) -> Likeliest | None:
        """The likeliest coefficients near given ones; None where the steps lead nowhere.

        Parameters
        ----------
        theta : (n,) array
        choose : callable
            Gives the autoregressive coefficients of innovations.
        """
        with np.errstate(all="ignore"):
            noise = choose(self._place(theta, np.zeros(0)).errors)
            for _ in range(MOST_MODELS):
                place = self._descended(self._place(theta, noise))
                if place is None:
                    return None
                found, theta, before = self._told(place), place.theta, theta
                noise = _anew(found.errors, noise)
                moved = np.abs(theta - before)[self.free] / found.std[self.free]
                if not noise.size or np.max(moved) <= STILL:
                    return found
        return None

    def rests(self, theta: Array) -> tuple[Array, ...]:
        """Weights of start and offset of every loop, for white innovations."""
        with np.errstate(all="ignore"):
            return self._place(theta, np.zeros(0)).rest

    def _place(self, theta: Array, noise: Array) -> _Place:
        plant = self.model(theta)
        begun, own = [], []
        for loop in self.loops:
            columns = loop.columns(plant)
            begun.append(loop.errors(plant, np.zeros(columns.shape[1])))
            own.append(columns)
        first = np.concatenate([_white(one, noise) for one in begun])
        wide = [_whitened(part, noise) for part in own]
        whole = stacked([one[:, :0] for one in wide], wide)
        if not (np.isfinite(first).all() and np.isfinite(whole).all()):
            return _Place(theta, noise, plant, tuple(begun), (), whole, np.full(1, np.inf))
        norms = np.linalg.norm(whole, axis=0) + 1e-300
        weights = np.linalg.lstsq(whole / norms, first, rcond=1e-12)[0] / norms
        rest = np.split(weights, np.cumsum([one.shape[1] for one in own])[:-1])
        errors = tuple(e - c @ w for e, c, w in zip(begun, own, rest, strict=True))
        return _Place(theta, noise, plant, errors, tuple(rest), whole, first - whole @ weights)

    def _slopes(self, place: _Place) -> Array:
        """(n, n_free) minus the derivatives of the white errors, less those of start and offset."""
        blocks = []
        for loop, rest in zip(self.loops, place.rest, strict=True):
            columns = []
            for j in np.flatnonzero(self.free):
                step = np.zeros(place.theta.size)
                step[j] = MOVED * self.scale[j]
                ends = [loop.errors(self.model(place.theta + s * step), rest) for s in (-1.0, 1.0)]
                columns.append(_white((ends[0] - ends[1]) / (2.0 * step[j]), place.noise))
            blocks.append(np.column_stack(columns))
        return _beside(np.vstack(blocks), place.columns)

    def _descended(self, place: _Place) -> _Place | None:
        """Where Gauss-Newton steps end for a model of the noise."""
        for _ in range(MOST_STEPS):
            slopes = self._slopes(place) if np.isfinite(place.size) else np.full((1, 1), np.nan)
            if not np.isfinite(slopes).all():
                return None
            inverse, q = _solver(slopes)
            change = inverse @ (q.T @ place.white)
            size = np.sqrt(np.sum(inverse**2, axis=1) * place.size / len(slopes))
            if np.max(np.abs(change) / size) <= STILL:
                return place
            following = self._lower(place, change)
            if following is None:
                return None
            place = following
        return None

    def _lower(self, place: _Place, change: Array) -> _Place | None:
        share = 1.0
        for _ in range(HALVINGS):
            theta = place.theta.copy()
            theta[self.free] += share * change
            try:
                found = self._place(theta, place.noise)
            except (TridentifyError, np.linalg.LinAlgError):
                found = None
            if found is not None and found.size <= place.size:
                return found
            share *= 0.5
        return None

    def _told(self, place: _Place) -> Likeliest:
        """With the covariance: the information on the noise's coefficients is taken off."""
        n, p = int(self.free.sum()), place.noise.size
        past = [
            np.column_stack(
                [np.concatenate([np.zeros(lag), one[:-lag]]) for lag in range(1, p + 1)]
                or [np.zeros((one.size, 0))]
            )
            for one in place.errors
        ]
        slopes = np.hstack([self._slopes(place), _beside(np.vstack(past), place.columns)])
        inverse = _solver(slopes)[0][:n]
        freedom = max(len(slopes) - slopes.shape[1] - place.columns.shape[1], 1)
        variance = place.size / freedom
        cov = np.zeros((place.theta.size,) * 2)
        cov[np.ix_(self.free, self.free)] = variance * inverse @ inverse.T
        return Likeliest(place.theta, cov, place.noise, variance, place.errors)


def _white(series: Array, noise: Array) -> Array:
    return whiten(series, noise)[0] if noise.size else series


def _whitened(table: Array, noise: Array) -> Array:
    return np.array([_white(one, noise) for one in table.T]).reshape(table.T.shape).T


def _anew(errors: Sequence[Array], noise: Array) -> Array:
    """Coefficients of the same order for other innovations."""
    if not noise.size:
        return noise
    return fit_autoregression(list(errors), noise.size, noise.size)


def _beside(table: Array, columns: Array) -> Array:
    own = np.linalg.qr(columns)[0]
    return np.asarray(table - own @ (own.T @ table))


def _solver(slopes: Array) -> tuple[Array, Array]:
    """``R^{-1}`` and ``Q`` of columns, scaled before they are decomposed."""
    norms = np.linalg.norm(slopes, axis=0) + 1e-300
    q, r = np.linalg.qr(slopes / norms)
    return np.linalg.pinv(r) / norms[:, None], q
