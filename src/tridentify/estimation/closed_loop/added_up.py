"""Errors of a plant that adds up what noise makes of its input between the samples.

A continuous controller answers noise between the samples too, and the input's mean over an interval
differs from the sample that it counts with. A plant that is not stable, or nearly so, adds up all
of these differences: what they make of the predictor's errors is weak and as slow as its poles, so
that neither tests of whiteness nor autoregressions of short records show it, and the slow
coefficients are off by two stated errors and more. But its shape is known: it is the response ``P``
of the predictor to its input. One part of the differences goes along with the noise ``v`` of the
sample, the other knows nothing of it, so that the errors are

    e  =  (1 + c P) v  +  sqrt(l) P w,          v, w white and independent,

with the spectrum ``sigma^2 (|1 + c P|^2 + l |P|^2)``. Two numbers are to be told by the record,
``c`` and ``l``, and it hardly does: so their likelihood (Whittle 1953) weighs the spectra of all of
them, and ``S`` of the covariance ``(Z' T)^{-1} Z' S Z (Z' T)^{-T}`` is that of their mean. What the
fit took of the noise, which is slow as the instruments are, is added to what it left. No error
becomes smaller for it: noise that is held between the samples has no such part.

Reference: P. Whittle, Arkiv for Matematik 2 (1953) 423-434.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.linear_errors import Foreseen, linear_errors
from tridentify.estimation.closed_loop.predictor import later
from tridentify.estimation.closed_loop.unstable import Found, seen_by
from tridentify.numerics.arrays import Array, Complex

ALONG = np.concatenate([-np.geomspace(0.03, 0.3, 4)[::-1], [0.0], np.geomspace(0.1, 30.0, 10)])
"""Gains ``c |P(0)|`` that are tried: a controller takes the noise back with its sign reversed."""
APART = np.concatenate([[0.0], np.geomspace(0.3, 3000.0, 13)])
"""Powers ``l |P(0)|^2`` that are tried: from a third of the noise's own at rest to what a loop of
high gain makes."""
TURNS = 12
"""Of the spectrum and of what the fit took of it."""
LONGEST = 5000
"""Samples beyond which it is not looked at: so many tell the noise by themselves."""
UNLIKELY = 1e-6
"""Weight of a spectrum that adds nothing to the mean."""


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
    try:
        _, left, upper = linear.step()
        series = np.split(left / np.sqrt(found.variance), np.cumsum(counts)[:-1])
        shapes = [_foreseen(one) for one in linear.records]
        middle = added_up(linear.instruments, series, shapes, [0] * len(series))
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


def added_up(
    z: Array, series: Sequence[Array], shapes: Sequence[Array], outputs: Sequence[int]
) -> Array:
    """``Z' S Z`` of orthonormal instruments.

    Parameters
    ----------
    z : (n, k) array
        Rows of all series below each other.
    series : sequence of (n_samples,) arrays
        What the fit has left, in standard deviations; zero where nothing was recorded.
    shapes : sequence of (n_samples,) arrays
        Response of each to a pulse at the input.
    outputs : sequence of int
        Of which each is; those of one output have one ``c`` and ``l``.
    """
    ends = np.cumsum([one.size for one in series])[:-1]
    transforms = [_over_its_gain(one) for one in shapes]
    left, took = np.concatenate(series), z
    for _ in range(TURNS):
        powers = [
            np.sum([_power(column) for column in part.T], axis=0)
            for part in np.split(np.column_stack([left, took]), ends)
        ]
        spectra: list[Array] = [np.zeros(0)] * len(powers)
        for output in set(outputs):
            own = [k for k, one in enumerate(outputs) if one == output]
            mean = _mean_spectra([transforms[k] for k in own], [powers[k] for k in own])
            for k, one in zip(own, mean, strict=True):
                spectra[k] = one
        # what noise of these spectra has in the directions that are fitted, given what is left
        back = seen_by(z, [_lags(1.0 / one) for one in spectra])
        weighed = [
            _through(1.0 / s, one) for s, one in zip(spectra, np.split(left, ends), strict=True)
        ]
        left = left - z @ np.linalg.solve(back, z.T @ np.concatenate(weighed))
        took = z @ np.linalg.cholesky(np.linalg.inv(back))
    return seen_by(z, [_lags(one) for one in spectra])


def _lags(spectrum: Array) -> Array:
    """(n_samples,) autocovariances."""
    return np.asarray(np.fft.irfft(spectrum)[: spectrum.size - 1])


def _through(spectrum: Array, series: Array) -> Array:
    """A series weighed by the autocovariances of a spectrum."""
    n = series.size
    return np.asarray(np.fft.irfft(spectrum * np.fft.rfft(series, 2 * n))[:n])


def _power(series: Array) -> Array:
    """Periodogram, of a series followed by as many zeros."""
    return np.asarray(np.abs(np.fft.rfft(series, 2 * series.size)) ** 2 / series.size)


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


def _over_its_gain(response: Array) -> Complex:
    """The transform of a response followed by as many zeros, one at rest."""
    found = np.fft.rfft(response, 2 * response.size)
    return np.asarray(found / max(abs(found[0]), 1e-300))


def _mean_spectra(shapes: Sequence[Complex], powers: Sequence[Array]) -> list[Array]:
    """The spectra of all ``c`` and ``l``, weighed by their likelihoods."""
    pairs = [(c, apart) for c in ALONG for apart in APART]
    likelihoods = np.array([_fitted(*pair, shapes, powers)[0] for pair in pairs])
    weights = np.exp(likelihoods - likelihoods.max())
    mean = [np.zeros(p.size) for p in shapes]
    for weight, pair in zip(weights / weights.sum(), pairs, strict=True):
        if weight > UNLIKELY:
            spectra = _fitted(*pair, shapes, powers)[1]
            mean = [a + weight * b for a, b in zip(mean, spectra, strict=True)]
    return mean


def _fitted(
    c: float, apart: float, shapes: Sequence[Complex], powers: Sequence[Array]
) -> tuple[float, list[Array]]:
    """The likelihood of one ``c`` and ``l`` at the variance that suits them best, and spectra."""
    spectra = [np.abs(1.0 + c * p) ** 2 + apart * np.abs(p) ** 2 for p in shapes]
    counts = [one.size - 1 for one in powers]
    terms = zip(counts, powers, spectra, strict=True)
    total = float(sum(counts))
    variance = sum(n * float(np.mean(x / s)) for n, x, s in terms) / total
    level = sum(n * float(np.mean(np.log(s))) for n, s in zip(counts, spectra, strict=True))
    return -0.5 * (total * float(np.log(variance)) + level), [variance * s for s in spectra]
