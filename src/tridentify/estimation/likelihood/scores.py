"""Standard errors that hold when the noise is not what it was taken for.

With ``g_t`` the derivatives of the outputs over the noise's standard deviation (whitened, where the
noise has a model) in coordinates in which ``sum g g' = I``, and ``e_t`` the innovations over the
same, the estimate moves by ``sum g e``. If the noise is what it was taken for this has the
covariance ``I``, else

    S = cov sum g e,

the sum of ``s s'`` over blocks, ``s`` the sum of ``g e`` over one, once blocks are long beside the
memory of ``g e`` (White 1980; Newey & West 1987). A disturbance that comes and goes, a drift that
wanders, and a response that the model misses all make the scores of a block larger than white noise
does; and the scores of a block are what its own estimate would differ by.

*Which blocks.* Stretches of time, and bands of frequency: the cosine transform keeps all products,
so white noise has scores of the same covariance there. Stretches see a disturbance that comes and
goes. A response that the model misses is the same in every stretch, and its scores cancel over the
record; over the bands they do not, as the model is too high in one and too low in the next, and
another input, which weighs the bands differently, would lead elsewhere. Bands also see the colour
of a stationary noise at its full length. Those that contradict more are taken. Blocks hold equal
shares of the information, so that a stretch at rest does not count as a witness. Long ones have
little bias, many have little scatter: of 8, 16, 32 and 64 blocks those with the largest scatter
count. With feedback the directions hold past noise, never that of the same
sample: the scores of a stretch have mean zero, those of a band do not, and are not asked.
*Small samples.* The scores add up to zero at the estimate, and a
block that holds much of the information pulls the estimate to itself. In these coordinates white
noise gives ``cov s = H (I - H)``, with ``H = sum g g'`` over the block, so ``(I - H)^{-1/2} s``
takes its place (Bell & McCaffrey 2002). The scatter of few blocks is itself uncertain: it is drawn
towards its mean over the directions, by the share that unknowns have in unknowns and blocks, and
the errors are those of the t distribution that the blocks leave. Directions that move coefficients
have a mean of their own: wild samples at the beginning contradict the free response, which takes
them up, and would lend their scatter to coefficients that they hardly touch.

*Whether.* Given ``H`` the mean and variance of ``sum |s|^2`` under white noise are known. Only
where it is larger than chance explains are these errors used, and they are then in no direction
smaller than those of the likelihood. So nothing is lost where the noise is what it was taken for.

References
----------
H. White, Econometrica 48 (1980), 817-838.
W. K. Newey, K. D. West, Econometrica 55 (1987), 703-708.
R. M. Bell, D. F. McCaffrey, Survey Methodology 28 (2002), 169-181.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.special import ndtri, stdtrit

from tridentify.estimation.likelihood.cost import Point
from tridentify.estimation.likelihood.shared_noise import no_smaller, shared_covariance
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import Whitener

BLOCKS = (64, 32, 16, 8)
"""Numbers of blocks that are looked at."""

FEWEST = 6
"""Samples that a block has at least, on the average."""

FALSE_ALARMS = 1e-3
"""Probability, over blocks of all numbers and both kinds, that white noise is taken for something
else."""

MOST_HELD = 0.8
"""Share of the information on one direction in one block above which it is not corrected for."""

LONGEST_SCORED = 200_000
"""Samples of all outputs beyond which the scores are not looked at."""

NO_MOVE = 1e-9
"""Share of the largest movement below which a direction moves no coefficient but by rounding."""

COVERED = 0.975
"""Quantile at which Student's and the Gaussian's ends are compared: that of an interval of 95 %."""


@dataclass(frozen=True, eq=False)
class ScoreScatter:
    """What the scores say of the covariance.

    Attributes
    ----------
    covariance : (k, k) array
        In the coordinates in which that of the likelihood is the identity; nowhere below it.
    blocks : int
        How many blocks it was taken from.
    ratio : float
        Mean of the scatter over what white noise gives, over what moves the coefficients.
    over : {"time", "frequency", "outputs"}
        What the blocks are stretches of; of outputs that share their noise there are none.
    shared : float
        Largest correlation of the noise of two outputs; zero where it does not matter.
    """

    covariance: Array
    blocks: int
    ratio: float
    over: Literal["time", "frequency", "outputs"] = "time"
    shared: float = 0.0

    @property
    def contradicts(self) -> bool:
        """Whether the noise over time is not what it was taken for."""
        return self.over != "outputs"

    def in_words(self) -> str:
        """Where the standard errors come from, and by how much they differ."""
        if not self.contradicts:
            return (
                f"standard errors allow for noise that outputs share (correlation {self.shared:.2f}"
                f"): {math.sqrt(self.ratio):.2g} times those of independent noise"
            )
        which = "blocks" if self.over == "time" else "bands of frequency"
        return (
            f"standard errors from the scatter of the scores over {self.blocks} {which}, "
            f"{math.sqrt(self.ratio):.2g} times those that the noise model gives: the disturbance "
            "is neither white nor autoregressive, or part of it follows the input"
        )


def scatter_of_scores(
    point: Point, root: Array, noise: Array, reacts: bool = False, along: Array | None = None
) -> ScoreScatter | None:
    """The covariance of the scores, where it is larger than the likelihood's.

    Parameters
    ----------
    point : Point
    root : (n_unknowns, k) array
        ``root root'`` is the covariance of the unknowns of `Point.jacobian`.
    noise : (n_outputs,) array
        Variance of the innovations.
    reacts : bool
        Whether the inputs hold past noise.
    along : (p, k) array, optional
        As of `judged_scatter`.

    Returns
    -------
    ScoreScatter or None
        None where the scores do not contradict the likelihood, or are too few to say.
    """
    if point.counts.sum() > LONGEST_SCORED or not np.all(noise > 0):
        return None
    directions, scores = zip(*_scores(point, root, noise), strict=True)
    return judged_scatter(directions, scores, reacts, along)


def _scores(point: Point, root: Array, noise: Array) -> list[tuple[Array, Array]]:
    """``g`` and ``e`` of every experiment."""
    experiments, outputs = point.problem.experiments, range(point.problem.n_outputs)
    moved = [
        [
            one / e.scale_of(i)
            for e, one in zip(experiments, point.sensitivities(root, i), strict=True)
        ]
        for i in outputs
    ]
    return whitened_scores(point.standardised(), moved, point.problem.noise, noise)


def whitened_scores(
    residuals: Sequence[Array],
    moved: Sequence[Sequence[Array]],
    models: Sequence[Array],
    noise: Array,
) -> list[tuple[Array, Array]]:
    """Derivatives and innovations over the noise's standard deviation, as `judged_scatter` asks.

    Parameters
    ----------
    residuals : sequence of (n_samples, n_outputs) arrays
        One for each experiment; ``nan`` marks a missing sample.
    moved : sequence of sequences of (n_samples, k) arrays
        For each output and experiment, the derivatives of the output.
    models : sequence of (p,) arrays
        Autoregression of each output; empty where all are white.
    noise : (n_outputs,) array
        Variance of the innovations.
    """
    outputs, found = noise.size, []
    models = models or (np.zeros(0),) * outputs
    for e, residual in enumerate(residuals):
        gs, es = [], []
        for i, a in enumerate(models):
            seen = np.isfinite(residual[:, i])
            rows = np.vstack([moved[i][e].T, residual[:, i]])
            if not seen.all():
                rows = np.where(seen, rows, 0.0)
            white = Whitener(a, rows.shape[0]).apply(rows, seen) if a.size else rows
            white = white / np.sqrt(noise[i])
            gs.append(white[:-1].T)
            es.append(white[-1])
        found.append((np.stack(gs, axis=1), np.stack(es, axis=1)))
    return found


def judged_scatter(
    directions: Sequence[Array],
    innovations: Sequence[Array],
    reacts: bool = False,
    along: Array | None = None,
) -> ScoreScatter | None:
    """As `scatter_of_scores`, for given directions and innovations.

    Parameters
    ----------
    directions : sequence of (n_samples, n_outputs, k) arrays
        ``g`` of every experiment; ``sum g g' = I``.
    innovations : sequence of (n_samples, n_outputs) arrays
        Of variance one if the noise is what it was taken for.
    reacts : bool
        Whether the directions hold past noise: then stretches of time alone are looked at.
    along : (p, k) array, optional
        How the coefficients move along the directions; without it all directions are theirs.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> g = np.linalg.qr(rng.standard_normal((800, 2)).cumsum(axis=0))[0]
    >>> white = rng.standard_normal(800)
    >>> slow = np.repeat(rng.standard_normal(20), 40)
    >>> left = [e - g @ (g.T @ e) for e in (white, white + slow)]
    >>> [judged_scatter([g[:, None]], [e[:, None]]) is None for e in left]
    [True, False]
    """
    turn, own = _own_first(along, directions[0].shape[-1])
    turned = [one @ turn for one in directions]
    found = _beside_shared(
        _largest_scatter(turned, innovations, reacts, own), turned, innovations, own
    )
    return found and replace(found, covariance=turn @ found.covariance @ turn.T)


def _beside_shared(
    found: ScoreScatter | None, directions: Sequence[Array], innovations: Sequence[Array], own: int
) -> ScoreScatter | None:
    """With what outputs share of their noise."""
    shared = shared_covariance(directions, innovations)
    if shared is None:
        return found
    covariance, correlation = shared
    if found is None:
        ratio = _mean(covariance[:own, :own])
        return ScoreScatter(covariance, 0, ratio, "outputs", correlation)
    wider = no_smaller(found.covariance, covariance)
    return replace(found, covariance=wider, shared=correlation)


def _own_first(along: Array | None, k: int) -> tuple[Array, int]:
    """Axes of which the first so many span what moves the coefficients.

    Each coefficient by its standard error, so that units are of no account.
    """
    if along is None:
        return np.eye(k), k
    size = np.linalg.norm(along, axis=1)
    if np.count_nonzero(size) >= k:  # without nuisance terms all axes are theirs
        return np.eye(k), k
    _, s, vt = np.linalg.svd(along[size > 0] / size[size > 0, None])
    return vt.T, max(int(np.sum(s > s.max(initial=0.0) * NO_MOVE)), 1)


def _largest_scatter(
    directions: Sequence[Array], innovations: Sequence[Array], reacts: bool, own: int
) -> ScoreScatter | None:
    """Over stretches of time, and over bands of frequency."""
    in_time = _scatter_along(_joined(directions), _joined(innovations), own)
    if reacts:
        return in_time
    together = [
        dct(np.concatenate([g, e[:, :, None]], axis=2), axis=0, norm="ortho")
        for g, e in zip(directions, innovations, strict=True)
    ]
    both = _joined(together)
    if len(together) > 1:
        sizes = [len(one) for one in together]
        order = np.argsort(np.concatenate([np.arange(n) / n for n in sizes]), kind="stable")
        both = both[order]
    in_bands = _scatter_along(both[:, :, :-1], both[:, :, -1], own)
    if in_bands is None or (in_time is not None and in_time.ratio >= in_bands.ratio):
        return in_time
    return replace(in_bands, over="frequency")


def _joined(series: Sequence[Array]) -> Array:
    """One after the other."""
    return series[0] if len(series) == 1 else np.vstack(series)


def _scatter_along(g: Array, innovations: Array, own: int) -> ScoreScatter | None:
    """The largest scatter over blocks of neighbouring rows; None where chance explains all."""
    from tridentify.estimation.likelihood.compiled.scatter import scatter_at

    weight = np.einsum("toi,toi->t", g, g)
    k, used = g.shape[2], int(np.count_nonzero(weight > 0))
    counts = [n for n in BLOCKS if n * FEWEST <= used]
    if not counts or k == 0:
        return None
    rate = FALSE_ALARMS / (2 * len(counts))
    table = scatter_at(g, innovations, np.array(counts, dtype=np.int64)).tolist()
    if not any(n > 1 and _is_more(total, mean, var, rate) for total, mean, var, n in table):
        return None
    scores = np.einsum("toi,to->ti", g, innovations)
    share = (np.cumsum(weight) - 0.5 * weight) / weight.sum()
    blocks = _Blocks.of(g, scores, _edges(share, counts[0]))
    found = None
    for n in counts:
        one = _on_blocks(blocks.joined(_edges(share, n)), own, rate)
        if one is not None and (found is None or one.ratio > found.ratio):
            found = one
    return found


class _Blocks(NamedTuple):
    """Sums of the scores over blocks, and of ``g g'``.

    Attributes
    ----------
    edges : (n,) array of int
        First samples.
    sums : (n, k) array
    held : (n, k, k) array
    """

    edges: NDArray[np.intp]
    sums: Array
    held: Array

    @classmethod
    def of(cls, g: Array, scores: Array, edges: NDArray[np.intp]) -> _Blocks:
        """Blocks that begin there."""
        width, k = g.shape[1:]
        rows = np.ascontiguousarray(g).reshape(-1, k)
        stops = np.append(edges[1:], len(g))
        pairs = zip((edges * width).tolist(), (stops * width).tolist(), strict=True)
        held = np.array([rows[a:b].T @ rows[a:b] for a, b in pairs])
        return cls(edges, np.add.reduceat(scores, edges, axis=0), held)

    def joined(self, edges: NDArray[np.intp]) -> _Blocks:
        """Blocks made of whole ones of these: of every second, fourth ... edge."""
        at = np.searchsorted(self.edges, edges)
        sums, held = (np.add.reduceat(one, at, axis=0) for one in (self.sums, self.held))
        return _Blocks(edges, sums, held)


def _edges(share: Array, count: int) -> NDArray[np.intp]:
    """First samples of about so many blocks of equal weight, of its share up to each sample."""
    edges = np.searchsorted(share, np.arange(count) / count)
    # where the last sample holds most of it, the last blocks would begin behind it
    kept = edges < share.size
    kept[1:] &= edges[1:] != edges[:-1]
    return np.asarray(edges[kept])


def _on_blocks(found: _Blocks, own: int, rate: float) -> ScoreScatter | None:
    """The scatter over some blocks; None where chance explains it."""
    edges, sums, held = found
    k, blocks = sums.shape[1], edges.size
    if blocks < 2:
        return None
    square = float(np.sum(held * held))
    # sum of h (1 - h) over the eigenvalues
    expected = float(np.einsum("bii->", held)) - square
    if not _is_more(float(np.sum(sums * sums)), expected, 2.0 * square, rate):
        return None
    values, vectors = np.linalg.eigh(held)
    shrink = np.sqrt(np.maximum(1.0 - np.minimum(values, MOST_HELD), 0.0))
    turned = np.einsum("bji,bj->bi", vectors, sums) / shrink
    adjusted = np.einsum("bij,bj->bi", vectors, turned)
    scatter = adjusted.T @ adjusted
    means = np.repeat([_mean(scatter[:own, :own]), _mean(scatter[own:, own:])], [own, k - own])
    towards = k / (k + blocks)
    scatter = (1.0 - towards) * scatter + towards * np.diag(means)
    few = float(stdtrit(blocks - 1.0, COVERED) / ndtri(COVERED)) ** 2
    size, axes = np.linalg.eigh(few * scatter)
    return ScoreScatter((axes * np.maximum(size, 1.0)) @ axes.T, blocks, float(means[0]))


def _is_more(statistic: float, expected: float, variance: float, rate: float) -> bool:
    """Whether a sum of squares is more than chance makes of that mean and variance."""
    # half of the degrees of freedom of the chi-square with that mean and variance
    freedom = 2.0 * expected**2 / max(variance, 1e-300)
    return statistic > expected * _largest(freedom, rate)


def _mean(scatter: Array) -> float:
    """Over the directions; of none zero."""
    return float(np.trace(scatter)) / max(len(scatter), 1)


def _largest(freedom: float, rate: float) -> float:
    """Quantile of a chi-square over its mean (Wilson & Hilferty 1931)."""
    spread = 2.0 / (9.0 * max(freedom, 1e-6))
    return float((1.0 - spread - ndtri(rate) * np.sqrt(spread)) ** 3)
