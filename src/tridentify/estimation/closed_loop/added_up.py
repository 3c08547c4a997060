"""Errors of a plant that adds up what noise makes of its input between the samples.

A continuous controller answers noise between the samples too, and the input's mean over an interval
differs from the sample that it counts with. A plant that is not stable, or nearly so, adds up all
of these differences: what they make of the predictor's errors is weak and as slow as its poles, so
that neither tests of whiteness nor autoregressions of short records show it, and the slow
coefficients are off by two stated errors and more. But its shape is known: it is the response ``P``
of the predictor to its input. One part of the differences goes along with the noise ``v`` of the
sample, the other knows nothing of it, so that the errors are, from the start of the record on,

    e  =  (1 + c P) v  +  sqrt(l) P w,          v, w white and independent,

and their covariance is ``S = sigma^2 (H H' + c (P H' + H P') + (c^2 + l) P P')``, ``H`` the filter
that whitens the other noise, where there is one. A sum of noise grows with the record: it has no
spectrum, and a periodogram shows the jump between its ends. So ``S`` is that of time, on means over
pieces of the record, as all of it is slow.

Two numbers are to be told by the record, ``c`` and ``l``, and it hardly does: so their likelihood
weighs all of them, and ``S`` of the covariance ``(Z' T)^{-1} Z' S Z (Z' T)^{-T}`` is their mean. It
is the likelihood of what the fit cannot have taken (Patterson & Thompson 1971), which is as slow.
An autoregression was fitted to noise that may have been added up, and has taken part of it: whether
``H`` is that of white noise before the filter or after it, is weighed as well. No error becomes
smaller for all that: noise that is held between the samples has no such part.

Reference: H. Patterson & R. Thompson, Biometrika 58 (1971) 545-554.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.linear_errors import Foreseen, linear_errors
from tridentify.estimation.closed_loop.predictor import later
from tridentify.estimation.closed_loop.unstable import Found
from tridentify.numerics.arrays import Array

ALONG = np.concatenate([-np.geomspace(0.03, 0.3, 4)[::-1], [0.0], np.geomspace(0.1, 30.0, 10)])
"""Gains ``c |P(0)|`` that are tried: a controller takes the noise back with its sign reversed."""
APART = np.concatenate([[0.0], np.geomspace(0.01, 1e4, 19)])
"""Variances ``l sum P^2`` of what is added up, at the end of the record, that are tried: from a
hundredth of the noise's own to what a loop of high gain makes."""
HELD = float(np.log(APART.size - 1))
"""Log weight of none beside each of these: noise is as likely as not held between the samples."""
PIECES = 80
"""Of a record: what is faster is no sum."""
TOLD_APART = 1e-6
"""Part of what was taken that the rest of it does not make, from which it counts."""
LONGEST = 5000
"""Samples beyond which it is not looked at: so many tell the noise by themselves."""


@dataclass(frozen=True, eq=False)
class Series:
    """Errors of one output in one record.

    Attributes
    ----------
    left : (n_samples,) array
        In standard deviations; zero where nothing was recorded.
    instruments : (n_samples, k) array
    taken : (n_samples, m) array
        Columns of what the fit may have taken of it.
    shape : (n_samples,) array
        Response to a pulse at the input.
    noise : (p,) array
        Autoregressive coefficients by which all these are whitened, the shape apart.
    output : int
        Of which it is; those of one output have one ``c`` and ``l``.
    """

    left: Array
    instruments: Array
    taken: Array
    shape: Array
    noise: Array
    output: int = 0


def with_added_up(loops: Sequence[Loop], found: Found) -> Found:
    """A root with standard errors no smaller than in noise that the plant may have added up.

    Parameters
    ----------
    loops : sequence of Loop
        Of a continuous controller.
    found : Found
    """
    linear = linear_errors(loops, found.plant, found.noise)
    counts = [one.seen.size for one in linear.records]
    if sum(counts) > LONGEST:
        return found
    ends = np.cumsum(counts)[:-1]
    try:
        _, left, upper = linear.step()
        parts = zip(
            np.split(left / np.sqrt(found.variance), ends),
            np.split(linear.instruments, ends),
            np.split(np.hstack([linear.full, linear.rest]), ends),
            [_foreseen(one) for one in linear.records],
            strict=True,
        )
        middle = added_up([Series(*one, found.noise) for one in parts])
        along = found.plant.free
        back = along @ np.linalg.inv(upper)[: along.shape[1]]
    except np.linalg.LinAlgError:
        return found
    free = np.diag(found.cov) > 0.0
    sizes = np.ones(free.size)
    sizes[free] = np.diag(found.variance * back @ middle @ back.T)[free] / np.diag(found.cov)[free]
    if not np.isfinite(sizes).all():
        return found
    wider = np.sqrt(np.maximum(sizes, 1.0))
    return replace(found, cov=found.cov * np.outer(wider, wider))


def added_up(series: Sequence[Series]) -> Array:
    """(k, k) ``Z' S Z`` of orthonormal instruments.

    Parameters
    ----------
    series : sequence of Series
        Whose instruments, below each other, are orthonormal.
    """
    k = series[0].instruments.shape[1]
    middle = np.zeros((k, k))
    for output in sorted({one.output for one in series}):
        own = [one for one in series if one.output == output]
        filters = [[np.zeros(0)] * len(own)]
        if any(one.noise.size for one in own):
            filters.append([one.noise for one in own])
        middle += _mean([[_Piecewise(*pair) for pair in zip(own, f, strict=True)] for f in filters])
    return middle


@dataclass(frozen=True, eq=False)
class _Piecewise:
    """A series as its means over pieces show it, of white noise that a filter has coloured."""

    series: Series
    noise: Array

    @cached_property
    def response(self) -> Array:
        """``P`` as the errors are whitened, of unit sum of squares."""
        found = _filtered(self.series.shape, self.series.noise)
        return np.asarray(found / (np.linalg.norm(found) + 1e-300))

    @property
    def gain(self) -> float:
        """Of the response, at rest."""
        return max(abs(float(self.response.sum())), 1e-300)

    def _ahead(self, columns: Array) -> tuple[Array, Array]:
        """``H'`` and ``P'`` of columns, whose products are those of the covariance."""
        own = np.append(1.0, self.noise)
        pulse = np.zeros(len(self.response))
        pulse[: own.size] = own[: pulse.size]
        return _back(pulse, columns), _back(self.response, columns)

    def products(self, columns: Array) -> tuple[Array, Array, Array]:
        """What columns see of ``H H'``, ``P H' + H P'`` and ``P P'``."""
        white, added = self._ahead(columns)
        both = added.T @ white
        return white.T @ white, both + both.T, added.T @ added

    @cached_property
    def pieces(self) -> Array:
        """(n_samples, n_pieces) orthonormal means."""
        count = len(self.series.left)
        which = np.arange(count) * min(PIECES, count) // count
        table = (which[:, None] == np.arange(which[-1] + 1)).astype(np.float64)
        return np.asarray(table / np.linalg.norm(table, axis=0))


def _mean(models: Sequence[Sequence[_Piecewise]]) -> Array:
    """``Z' S Z`` of all ``c`` and ``l`` and models of the other noise, weighed by likelihood."""
    levels, found = [], []
    for model in models:
        seen = [_Seen.of(one) for one in model]
        z = [one.products(one.series.instruments) for one in model]
        gain = float(np.mean([one.gain for one in model]))
        for c in ALONG / gain:
            likelihoods, variances = _likelihoods(seen, float(c))
            likelihoods[0] += HELD
            levels.append(likelihoods)
            own = sum(a + c * b + c * c * p for a, b, p in z)
            added = sum(p for _, _, p in z)
            found += [v * (own + apart * added) for v, apart in zip(variances, APART, strict=True)]
    level = np.concatenate(levels)
    weights = np.exp(level - level.max())
    return np.asarray(np.tensordot(weights / weights.sum(), np.array(found), 1))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Means of the errors and of what was taken of them, and products of their covariance."""

    left: Array
    taken: Array
    products: tuple[Array, Array, Array]

    @classmethod
    def of(cls, one: _Piecewise) -> _Seen:
        means = one.pieces.T
        taken = one.series.taken / (np.linalg.norm(one.series.taken, axis=0) + 1e-300)
        return cls(means @ one.series.left, means @ taken, one.products(one.pieces))


def _likelihoods(seen: Sequence[_Seen], c: float) -> tuple[Array, Array]:
    """Of one ``c`` and every ``l``, and the variance that suits each best."""
    level = np.zeros(APART.size)
    rows, weights = [], []
    for one in seen:
        white, both, added = one.products
        upper = cholesky(white + c * both + c * c * added)
        half = solve_triangular(upper, added, trans="T")
        values, turned = np.linalg.eigh(solve_triangular(upper, half.T, trans="T"))
        table = np.column_stack([one.left, one.taken])
        rows.append(turned.T @ solve_triangular(upper, table, trans="T"))
        each = 1.0 / (1.0 + APART[:, None] * np.maximum(values, 0.0))
        weights.append(each)
        level += 2.0 * np.sum(np.log(np.diag(upper))) - np.sum(np.log(each), axis=1)
    table, each = np.vstack(rows), np.hstack(weights)
    variances = np.empty(APART.size)
    for j, own in enumerate(each):
        # the triangle of both: what of the errors is left beside what was taken stands last
        weighed = np.sqrt(own)[:, None] * np.roll(table, -1, axis=1)
        sizes = np.abs(np.diag(np.linalg.qr(weighed)[1]))
        told_apart = sizes[:-1] > TOLD_APART * np.max(sizes[:-1], initial=1e-300)
        freedom = max(len(table) - int(told_apart.sum()), 1)
        variances[j] = max(sizes[-1] ** 2 / freedom, 1e-300)
        level[j] += freedom * np.log(variances[j])
        level[j] += 2.0 * np.sum(np.log(sizes[:-1][told_apart]))
    return -0.5 * level, variances


def _filtered(series: Array, noise: Array) -> Array:
    return np.convolve(series, np.append(1.0, noise))[: len(series)]


def _back(response: Array, columns: Array) -> Array:
    """Columns times the transpose of a convolution from the start of the record on."""
    length = 2 * len(response)
    seen = np.fft.rfft(response, length).conj()[:, None] * np.fft.rfft(columns, length, axis=0)
    return np.asarray(np.fft.irfft(seen, length, axis=0)[: len(response)])


def _foreseen(one: Foreseen) -> Array:
    """A predictor's response to a pulse."""
    u = pulse(one.loop)
    whole = later(one.loop, replace(one.signals, u=u, y=np.zeros_like(one.signals.y)))
    return np.asarray(one.predictor.errors(whole))


def pulse(loop: Loop) -> Array:
    """(n_samples, n_inputs) of inputs that move as much as what no reference drives of them."""
    u = np.zeros_like(np.asarray(loop.record.u))
    u[0] = np.std(loop.record.u - loop.driven.inputs, axis=0)
    return u
