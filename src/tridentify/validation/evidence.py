"""Every test of one output's residual, each allowing for what the others found.

All tests but those of distribution and scale are score tests of added columns
(`numerics.lagrange`) on samples that are whitened by a model of the noise; the columns are those of
`validation.columns`. Two things need care.

*The noise.* An estimate that takes the noise for white may be right about the system and wrong about
the noise. So the noise is looked at where it cannot be confused with a response that the model misses:
in what is left after past inputs and slow drifts have been fitted along. If that is not white, an
autoregressive model is fitted to it, allowing for what the columns took (`numerics.autoregression`),
and the tests of added columns are made on samples whitened by that model.

*Confusion.* A drift may look like a late response to a step, and missing dynamics like a change of
the coefficients. Where both drift and past inputs are called for, each is tested again beside the
other. Later tests are made beside whatever was found before: feedback beside past inputs, changed
coefficients and squares beside both. And where a remedy was found (`validation.remedies`), all but
the past inputs is tested on what that leaves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from tridentify.estimate import Estimate
from tridentify.numerics.autoregression import fit_autoregression, most_coefficients
from tridentify.numerics.lagrange import added, span
from tridentify.numerics.portmanteau import (
    Autocorrelation,
    Portmanteau,
    autocorrelation_of_fit,
    portmanteau,
)
from tridentify.validation import columns
from tridentify.validation.distribution import distribution
from tridentify.validation.result import Normality
from tridentify.validation.view import Output, View

Array = NDArray[np.float64]

PRETEST = 0.05
ROUNDS = 2
CALLED = 0.001
PER_STRETCH = 25
MOST_STRETCHES = 8
FARTHEST = 4.0
HEAVY = 0.9


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was found about one output.

    Attributes
    ----------
    autocorrelation : Autocorrelation
        Under the estimate's own model of the noise.
    whiteness : Portmanteau
    coloured : float
        p-value of what is left after past inputs and drifts being white.
    noise : (p,) array
        The model of the noise that the other tests use.
    past, level, feedback, later, squares, scale : float
        p-values.
    by_input : tuple of float
        p-values of the past of each input beside that of the others.
    lags : tuple of int
        At which past inputs were looked for [samples].
    normality : Normality
    edges, scales : array
        See `result.Stationarity`.
    innovations : tuple of (n_samples,) arrays
        Under the estimate's own model of the noise, of variance one.
    """

    autocorrelation: Autocorrelation
    whiteness: Portmanteau
    coloured: float
    noise: Array
    past: float
    level: float
    feedback: float
    later: float
    squares: float
    scale: float
    by_input: tuple[float, ...]
    lags: tuple[int, ...]
    normality: Normality
    edges: Array
    scales: Array
    innovations: tuple[Array, ...]


def examine(
    view: View, index: int, estimate: Estimate, n_lags: int, rate: float
) -> Evidence:
    """Make all tests of one output.

    Parameters
    ----------
    view : View
    index : int
        Of the output.
    estimate : Estimate
    n_lags : int
        Of the autocorrelation.
    rate : float
        Probability of a false outlier.
    """
    output = view.outputs[index]
    fitted = tuple(
        np.hstack(pair) for pair in zip(output.coefficients, output.nuisance, strict=True)
    )
    lags = columns.past_lags(view, output)
    everyone = range(view.records[0].n_inputs)
    past = columns.responses(view, everyone, lags)
    wave = columns.waves(view)
    own = _white(output, output.noise, fitted)
    found = _autocorrelation(output, own, n_lags)
    whiteness = portmanteau(found, output.noise)
    larger = tuple(np.hstack(three) for three in zip(fitted, past, wave, strict=True))
    coloured, noise = _noise(output, larger)
    e, basis = _white(output, noise, fitted)
    n = output.count
    p_past, z = _past(output, noise, past, basis, e, len(lags))
    slow = span(output.white(wave, noise), basis)
    level = added(e, basis, slow, n).p_value
    if p_past < CALLED and level < CALLED:
        p_past, level = _told_apart(output, noise, (past, wave), (basis, e), len(lags), p_past)
    by_input = tuple(
        _beside(output, noise, view, j, lags, basis, e) if p_past < CALLED else 1.0
        for j in everyone
    )
    wide = np.hstack([basis, z])
    beside = wide if p_past < CALLED else basis
    if level < CALLED:
        slow = span(output.white(wave, noise), beside)
        beside = np.hstack([beside, slow])
        wide = np.hstack([wide, span(output.white(wave, noise), wide)])
    coming = columns.responses(view, everyone, lags[: max(len(lags) // 2, 2)], coming=True)
    feedback = added(e, wide, span(output.white(coming, noise), wide), n).p_value
    half = columns.later(view, output)
    later = added(e, beside, span(output.white(half, noise), beside), n).p_value
    square = columns.squares(view, index, estimate)
    squares = added(e, wide, span(output.white(square, noise), wide), n).p_value
    plain = _studentised(output, e, beside)
    times = tuple(record.t for record in view.records)
    normality = distribution(output.name, plain, times, rate)
    scale, edges, scales = _scale(output, plain, own[0])
    return Evidence(
        found,
        whiteness,
        coloured,
        noise,
        p_past,
        level,
        feedback,
        later,
        squares,
        scale,
        by_input,
        tuple(lags),
        normality,
        edges,
        scales,
        _studentised(output, *own),
    )


def beside_remedy(first: Evidence, second: Evidence) -> Evidence:
    """What was found, but for what a missing response alone made of it.

    Parameters
    ----------
    first : Evidence
        With a response missing.
    second : Evidence
        With the best remedy that was tried. Where it leaves a response missing too, what would
        follow from that is not judged.
    """
    if second.past < CALLED:
        nothing = dict.fromkeys(("level", "feedback", "later", "squares", "scale"), np.nan)
        return replace(first, coloured=np.nan, **nothing)  # type: ignore[arg-type]
    return replace(
        first,
        coloured=second.coloured,
        level=second.level,
        feedback=second.feedback,
        later=second.later,
        squares=second.squares,
        scale=second.scale,
        normality=second.normality,
        scales=second.scales,
        noise=second.noise,
    )


def _white(output: Output, noise: Array, fitted: tuple[Array, ...]) -> tuple[Array, Array]:
    """The residual, whitened and free of all that a fit takes, and a basis of that."""
    basis = span(output.white(fitted, noise))
    e = output.white(tuple(np.nan_to_num(one) for one in output.residual), noise)
    return np.asarray(e - basis @ (basis.T @ e)), basis


def _split(output: Output, stacked: Array) -> list[Array]:
    ends = np.cumsum([one.size for one in output.residual])[:-1]
    return np.split(stacked, ends)


def _autocorrelation(
    output: Output, own: tuple[Array, Array], n_lags: int
) -> Autocorrelation:
    seen = [one.astype(np.float64) for one in output.seen]
    return autocorrelation_of_fit(
        _split(output, own[0]), seen, _split(output, own[1]), n_lags
    )


def _noise(output: Output, larger: tuple[Array, ...]) -> tuple[float, Array]:
    """Whether what no column explains is white under the estimate's model, and a model of it.

    The estimate's own model may have taken a missed response for noise, so that of the tests begins
    with white noise.
    """
    most = most_coefficients(output.count)
    n_lags = max(most, output.noise.size + 4)
    white = np.zeros(0)
    e, basis = _white(output, white, larger)
    free = portmanteau(_autocorrelation(output, (e, basis), n_lags), white).p_value
    own = free
    if output.noise.size:
        found = _autocorrelation(output, _white(output, output.noise, larger), n_lags)
        own = portmanteau(found, output.noise).p_value
    noise = white
    if free <= PRETEST and most:
        for _ in range(ROUNDS):
            noise = _modelled(output, larger, noise, most)
    return own, noise


def _modelled(output: Output, larger: tuple[Array, ...], noise: Array, most: int) -> Array:
    """A model of what no column explains, the columns fitted under the model before."""
    stacked = [np.where(s[:, None], c, 0.0) for s, c in zip(output.seen, larger, strict=True)]
    raw = np.vstack(stacked)
    norms = np.sqrt(np.einsum("ij,ij->j", raw, raw))
    norms = np.where(norms > 0, norms, 1.0)
    scaled = output.white(tuple(one / norms for one in larger), noise)
    white = output.white(tuple(np.nan_to_num(one) for one in output.residual), noise)
    u, s, vt = np.linalg.svd(scaled, full_matrices=False)
    kept = s > 1e-6 * s[0]
    root = (vt[kept].T / s[kept]) / norms[:, None]
    along = u[:, kept].T @ white
    freedom = max(output.count - int(kept.sum()), 1)
    spread = np.sqrt(max(float(white @ white - along @ along), 0.0) / freedom)
    joined = np.concatenate([np.nan_to_num(one) for one in output.residual])
    left, took = joined - raw @ (root @ along), spread * (raw @ root)
    series, taken = [], []
    pieces = zip(output.seen, _split(output, left), _split(output, took), strict=True)
    for there, r, t in pieces:
        series.append(np.where(there, r, np.nan))
        taken += [np.where(there, t[:, k], np.nan) for k in range(t.shape[1])]
    return fit_autoregression(series, most, taken=taken)


def _past(
    output: Output,
    noise: Array,
    past: tuple[Array, ...],
    basis: Array,
    e: Array,
    n_lags: int,
) -> tuple[float, Array]:
    """Test of past inputs, at the first few lags and at all of them; and their basis."""
    white = output.white(past, noise)
    first = np.arange(white.shape[1]) % n_lags < columns.SHORT
    n = output.count
    z = span(white, basis)
    short = added(e, basis, span(white[:, first], basis), n).p_value
    return min(1.0, 2.0 * min(short, added(e, basis, z, n).p_value)), z


def _told_apart(
    output: Output,
    noise: Array,
    both: tuple[tuple[Array, ...], tuple[Array, ...]],
    fitted: tuple[Array, Array],
    n_lags: int,
    p_past: float,
) -> tuple[float, float]:
    """p-values of past inputs beside a drift, and of a drift beside past inputs."""
    past, wave = both
    basis, e = fitted
    with_wave = np.hstack([basis, span(output.white(wave, noise), basis)])
    p_beside = _past(output, noise, past, with_wave, e, n_lags)[0]
    with_past = np.hstack([basis, span(output.white(past, noise), basis)])
    slow = span(output.white(wave, noise), with_past)
    level = added(e, with_past, slow, output.count).p_value
    if min(p_beside, level) > CALLED:
        # either alone explains the other; the response is the simpler cause
        return p_past, level
    return p_beside, level


def _beside(
    output: Output,
    noise: Array,
    view: View,
    j: int,
    lags: list[int],
    basis: Array,
    e: Array,
) -> float:
    """Test of one input's past, beside that of the others."""
    others = [k for k in range(view.records[0].n_inputs) if k != j]
    if others:
        theirs = output.white(columns.responses(view, others, lags), noise)
        basis = np.hstack([basis, span(theirs, basis)])
    mine = output.white(columns.responses(view, [j], lags), noise)
    return _past_of(output, mine, basis, e)


def _past_of(output: Output, white: Array, basis: Array, e: Array) -> float:
    n = output.count
    short = added(e, basis, span(white[:, : columns.SHORT], basis), n).p_value
    return min(1.0, 2.0 * min(short, added(e, basis, span(white, basis), n).p_value))


def _studentised(output: Output, e: Array, basis: Array) -> tuple[Array, ...]:
    """The residual over the standard deviation that it has at each sample."""
    left = e - basis @ (basis.T @ e)
    freedom = max(output.count - basis.shape[1], 1)
    spread = np.sqrt(left @ left / freedom)
    kept = 1.0 - np.einsum("ij,ij->i", basis, basis)
    there = np.concatenate(output.seen) & (kept > 1.0 - HEAVY)
    scale = spread * np.sqrt(np.where(there, kept, 1.0))
    found = np.where(there, left / np.where(scale > 0, scale, 1.0), np.nan)
    return tuple(_split(output, found))


def _scale(
    output: Output, plain: tuple[Array, ...], own: Array
) -> tuple[float, Array, Array]:
    """Whether the size of the noise changes from stretch to stretch (Brown & Forsythe 1974).

    The absolute values are compared by their analysis of variance, gross outliers cut off.
    """
    joined = np.concatenate(plain)
    count = int(np.clip(output.count // PER_STRETCH, 2, MOST_STRETCHES))
    edges = np.linspace(0, joined.size, count + 1).round().astype(int)
    parts, scales = [], []
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        one = joined[a:b]
        seen = one[np.isfinite(one)]
        scales.append(float(np.sqrt(np.mean(own[a:b] ** 2))) if seen.size else np.nan)
        if seen.size > 2:
            parts.append(np.minimum(np.abs(seen), FARTHEST))
    n, k = sum(one.size for one in parts), len(parts)
    if k < 2 or n <= k:
        return 1.0, edges.astype(np.float64), np.array(scales)
    # the square root brings the absolute value of a Gaussian near a Gaussian
    parts = [np.sqrt(one) for one in parts]
    mean = sum(float(one.sum()) for one in parts) / n
    between = sum(one.size * (float(one.mean()) - mean) ** 2 for one in parts) / (k - 1)
    within = sum(float(np.sum((one - one.mean()) ** 2)) for one in parts) / (n - k)
    p_value = float(fdtrc(k - 1, n - k, between / within)) if within > 0 else 1.0
    return p_value, edges.astype(np.float64), np.array(scales)
