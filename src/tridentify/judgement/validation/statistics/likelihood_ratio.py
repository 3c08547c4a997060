"""Whether further columns belong into a model whose noise was fitted to the same samples.

Under the model of the noise that belongs to the added columns the score test rejects too easily,
under one that was fitted without them too seldom: it may have taken them for noise. Where the first
rejects, the likelihood ratio decides, each side with a noise model of its own of the same order, in
F form.

That ratio is too large itself where the noise has a memory and the record few of its lengths: what
the coefficients of the noise are off by favours the larger side. Its mean under noise alone is
known from a few draws of the smaller side's noise, on the same samples and columns, and the ratio,
in F form, is divided by what that mean is too large by (Bartlett 1937, by draws: Rocke 1989), up to
a limit. The draws are made only where they can matter: where the ratio rejects as it is and would
not, divided by that limit.

References: M. Bartlett, Proc. Royal Soc. London A 160 (1937) 268-282. D. Rocke, J. American
Statistical Association 84 (1989) 598-601.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_banded
from scipy.special import fdtrc

from tridentify.judgement.validation.residuals import Output
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import fit_autoregression, most_coefficients, whiten
from tridentify.numerics.kept import cached_property
from tridentify.numerics.lagrange import span
from tridentify.numerics.least_squares import column_norms, triangle

CALLED = 0.001
"""p-value from which something is called wrong: several tests of each output together call about
one right model in a hundred wrong (benchmarks, validation)."""
ROUNDS = 2
"""Turns of columns and noise model: the second one has the right weights."""
WORTH_CHECKING = 0.02
"""p-value of a score test above which the dearer likelihood ratio is not made: it could not fall
below `CALLED`."""
LONG = 20_000
"""Samples from which the score test is left as it is: the likelihood ratio takes several fits, and
differs from it where samples are few."""
WORTH_DRAWING = 0.005
"""p-value of a likelihood ratio above which its mean is not worked out."""
OVERFLOWS = 1e100
"""A whitened residual that large is none: the noise was filtered until some frequencies are empty,
and its model amplifies rounding without bound. White weights are taken then."""
DRAWS, BATCH = 40, 10
"""Of noise, for the mean of a likelihood ratio, at most and at a time: all together are good to a
tenth for four columns."""
SURE = 2.0
"""Standard errors of that mean within which what is said has to be the same, for no more draws."""
MOST_TOO_LARGE = 1.6
"""By which factor such a mean may be too large, at most. Of 300 samples of autoregressive noise
(0.7) it was so by 1.1 to 1.5; where the smaller side's noise is what the columns explain its draws
wander and the factor has no bound."""
SETTLED = 500
"""Samples after which noise that was drawn has forgotten its start, at least."""


def joined(*several: tuple[Array, ...]) -> tuple[Array, ...]:
    """Columns of several kinds side by side, experiment by experiment."""
    return tuple(np.hstack(one) for one in zip(*several, strict=True))


class Fitted:
    """Columns that are fitted to residuals with the same samples missing, over their noise."""

    def __init__(self, output: Output, columns: tuple[Array, ...]) -> None:
        self.columns = columns
        columns = tuple(output.over_noise(columns))
        pairs = zip(output.seen, columns, strict=True)
        raw = np.vstack([np.where(seen[:, None], one, 0.0) for seen, one in pairs])
        self._raw, self._norms = raw, column_norms(raw)

    @cached_property
    def plain(self) -> Array:
        """(n, k) orthonormal basis, where the noise is white."""
        return self.basis(triangle(self._raw / self._norms))[0]

    def basis(self, r: Array) -> tuple[Array, Array]:
        """Combinations whose whitened ones are orthonormal, and these in the triangle's rows."""
        u, s, vt = np.linalg.svd(r[:, : self._norms.size], full_matrices=False)
        kept = s > 1e-6 * s[0]
        return self._raw @ ((vt[kept].T / s[kept]) / self._norms[:, None]), u[:, kept]

    def left(self, output: Output, noise: Array) -> tuple[Array, Array]:
        """What is left of the residual, and what the fit takes of noise, a column a direction."""
        residual = np.concatenate([np.nan_to_num(one) for one in output.standardised])
        if noise.size:
            beside = zip(self.columns, split(output, residual), strict=True)
            both = output.white([np.column_stack([c / self._norms, r]) for c, r in beside], noise)
            # the triangle of the columns and the residual beside them is all that is needed
            r, white = triangle(both), both[:, -1]
            if not np.isfinite(r).all():
                # noise that was filtered until hardly anything is left of some frequencies
                return self.left(output, noise[:0])
            own, rows = self.basis(r)
            along = rows.T @ r[:, -1]
        else:
            own, white = self.plain, residual
            along = own.T @ white
        freedom = max(output.count - along.size, 1)
        spread = np.sqrt(max(float(white @ white - along @ along), 0.0) / freedom)
        return residual - own @ along, spread * own


class Known:
    """Columns that are fitted before others are tested beside them; several tests ask the same."""

    def __init__(self, output: Output, columns: tuple[Array, ...], noise: Array) -> None:
        self.output, self.columns, self.noise = output, columns, noise
        self._fitted = Fitted(output, columns)
        self.most = most_coefficients(output.count)
        self._drawn: list[tuple[Output, float]] = []

    @cached_property
    def basis(self) -> Array:
        """Of the columns, whitened."""
        return span(self.output.white(self.columns, self.noise))

    @cached_property
    def order(self) -> int:
        """Of the noise model that is theirs alone, at least that of the noise."""
        alone = modelled(self.output, self._fitted, np.zeros(0), self.most, 0)
        return max(alone.size, self.noise.size)

    @cached_property
    def deviance(self) -> tuple[float, int]:
        """As `_deviance`, with a noise model of that order."""
        return _deviance(self.output, self._fitted, self.order, self.most)

    @cached_property
    def _draws(self) -> Iterator[Output]:
        noise = modelled(self.output, self._fitted, np.zeros(0), self.most, 0, self.order)
        return _draws(self.output, noise)

    def drawn(self, number: int) -> tuple[Output, float]:
        """Noise of such a model in place of the residual, and its deviance."""
        while len(self._drawn) <= number:
            one = next(self._draws)
            self._drawn.append((one, _deviance(one, self._fitted, self.order, self.most)[0]))
        return self._drawn[number]


def checked(known: Known, extra: tuple[Array, ...], p: float, level: float = CALLED) -> float:
    """A p-value that holds although the noise's model was fitted to the same samples.

    Parameters
    ----------
    known : Known
    extra : tuple of (n_samples, k) arrays
        The further columns, per experiment, not whitened.
    p : float
        Of the score test.
    level : float
        p-value from which something is called wrong: less where it is one of several tests.

    Returns
    -------
    float
        The larger of that and the p-value of the likelihood ratio; without a model of the noise
        the two are the same test.
    """
    output = known.output
    if p > WORTH_CHECKING or not known.most or output.count > LONG:
        return p
    order = known.order
    if order == 0:
        return p
    before, rank = known.deviance
    both = Fitted(output, joined(known.columns, extra))
    after, larger = _deviance(output, both, order, known.most)
    k, freedom = larger - rank, output.count - larger - order
    if k < 1 or freedom < 1:
        return 1.0

    def f_of(ratio: float) -> float:
        return float(np.expm1(max(ratio, 0.0) / output.count)) * freedom / k

    def of_draw(number: int) -> float:
        one, smaller = known.drawn(number)
        return f_of(smaller - _deviance(one, both, order, known.most)[0])

    f = f_of(before - after)
    if fdtrc(k, freedom, f) < WORTH_DRAWING and fdtrc(k, freedom, f / MOST_TOO_LARGE) > level:
        usual = freedom / max(freedom - 2.0, 1.0)
        ratios: list[float] = []
        while len(ratios) < DRAWS:
            next_ones = range(len(ratios), len(ratios) + BATCH)
            ratios += [of_draw(number) / usual for number in next_ones]
            mean, error = np.mean(ratios), np.std(ratios) / np.sqrt(len(ratios))
            ends = np.clip(mean + SURE * error * np.array([-1.0, 1.0]), 1.0, MOST_TOO_LARGE)
            if len(set(fdtrc(k, freedom, f / ends) > level)) == 1:
                break  # further draws would not change what is said
        f /= float(np.clip(mean, 1.0, MOST_TOO_LARGE))
    return max(p, float(fdtrc(k, freedom, f)))


def _draws(output: Output, noise: Array) -> Iterator[Output]:
    """Noise of a model in place of the residual; always the same draws."""
    rng = np.random.default_rng(0)
    for _ in range(DRAWS):
        residual = []
        for one in output.residual:
            e = rng.standard_normal(one.size + SETTLED)
            bands = np.repeat(np.append(1.0, noise)[:, None], e.size, axis=1)
            v = solve_banded((noise.size, 0), bands, e)[SETTLED:]
            residual.append(np.where(np.isfinite(one), v, np.nan))
        sizes = output.scale or (1.0,) * len(residual)
        residual = [one * size for one, size in zip(residual, sizes, strict=True)]
        yield replace(output, residual=tuple(residual))


def least_checked(known: Known, by_score: list[tuple[float, tuple[Array, ...]]]) -> float:
    """The least of several `checked`, that it is the least of so many allowed for (Bonferroni).

    A check only ever makes a p-value larger, so that those of the score come first, and what cannot
    be the least is not worked out.
    """
    least, many = math.inf, len(by_score)
    for p, extra in sorted(by_score, key=lambda one: one[0]):
        if p >= least:
            break
        least = min(least, checked(known, extra, p, CALLED / many))
    return min(1.0, many * least)


def _deviance(output: Output, fitted: Fitted, order: int, most: int) -> tuple[float, int]:
    """``-2 log L`` with columns and a noise model of given order, and the rank of the columns."""
    noise = np.zeros(0)
    for _ in range(ROUNDS):
        noise = modelled(output, fitted, noise, most, 0, order)
    e, basis = whitened(output, noise, fitted.columns)
    if not np.abs(e).max(initial=0.0) < OVERFLOWS:
        noise = noise[:0]
        e, basis = whitened(output, noise, fitted.columns)
    scale = sum(whiten(one, noise)[1] for one in output.residual)
    n = output.count
    return n * float(np.log(max(float(e @ e) / n, 1e-300))) + scale, basis.shape[1]


def whitened(output: Output, noise: Array, fitted: tuple[Array, ...]) -> tuple[Array, Array]:
    """The residual, whitened and free of all that a fit takes, and a basis of that."""
    basis = span(output.white(fitted, noise))
    e = output.white(output.residual, noise)
    return np.asarray(e - basis @ (basis.T @ e)), basis


def modelled(
    output: Output, larger: Fitted, noise: Array, most: int, fewest: int, order: int | None = None
) -> Array:
    """A model of what no column explains, the columns fitted under the model before."""
    left, took = larger.left(output, noise)
    series, taken = [], []
    pieces = zip(output.seen, split(output, left), split(output, took), strict=True)
    for there, r, t in pieces:
        series.append(np.where(there, r, np.nan))
        # one direction after the other, each with a gap behind it
        apart = np.full((t.shape[1], t.shape[0] + 1), np.nan)
        apart[:, :-1] = np.where(there, t.T, np.nan)
        taken += [apart.ravel()[:-1]] if apart.size else []
    return fit_autoregression(series, most, order, fewest, taken)


def split(output: Output, stacked: Array) -> list[Array]:
    """What stands experiment below experiment, by itself again."""
    ends = np.cumsum([one.size for one in output.residual])[:-1]
    return np.split(stacked, ends)
