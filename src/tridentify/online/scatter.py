"""Standard errors that hold when the noise is not white.

With sensitivities ``g`` and innovations ``v`` the estimate moves by ``M^{-1} sum g v``, where ``M``
is ``sum g g'``. White noise of variance ``s^2`` gives it the covariance ``s^2 M^{-1}``, any other

    M^{-1} B M^{-1},  B = cov sum g v,

and ``B`` is the sum of ``S S'`` over blocks, ``S`` the sum of ``g v`` over a block, once blocks are
long beside the memory of ``g v`` (batch means; White 1980, Newey & West 1987). The sample loop
keeps ``M`` and, for blocks of 1, 4, 16 ... times the shortest length, ``B`` (`intake.scatter`).

*Which blocks.* Long ones have little bias, many have little scatter. Of the levels with at least
twenty blocks, or two a direction and no less than six, that of the largest ``tr(M^{-1} B)`` is
taken, with the errors of the t distribution that they leave: what a model misses of the response
has scores that scatter more the longer the blocks are. Where a longer level of six blocks has a
larger trace, the covariance grows by the ratio of the two. What a block loses at its two ends falls
with its length, so a trace that grew from one level to the next goes on growing by a third of that
step, as blocks are four times as long each time (Vats & Flegal 2022). A few blocks tell the trace,
but hardly one direction from another: to ``B`` come as many blocks as there are directions, in
which all scatter alike. Where samples are forgotten, blocks of falling weights ``w`` count as
``(sum w)^2 / sum w^2``, and the covariance as that for white noise has the share of the weights.
*Whether.* Under white noise
``tr(M^{-1} B) / (k s^2)`` is one with the variance ``2 / (r blocks)``, where ``r`` of the ``k``
directions are spanned by a block; only if it is three standard deviations above that on a level, or
six below, as errors that are too small do more harm, is the sandwich used, so that nothing is lost
where the noise is white. The scores are of innovations over
the scale of the noise, a median, and cut at three; their own mean square stands for ``s^2``.

References
----------
H. White, Econometrica 48 (1980), 817-838.
W. K. Newey, K. D. West, Econometrica 55 (1987), 703-708.
D. Vats, J. M. Flegal, Lugsail lag windows for estimating time-average covariance matrices,
Biometrika 109 (2022), 735-750.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, stdtrit

from tridentify.numerics.arrays import Array, Flags, Indices
from tridentify.online.kernels import slots
from tridentify.online.layout import Blueprint, watch_of

FEWEST, FEWEST_USUAL = 20.0, 2.0
"""Blocks of a level from which its scatter is known, to 30 % for one number; and those from which
what is usual begins."""
FEW = 6.0  # blocks that tell one number
PER_DIRECTION = 2.0  # blocks that tell directions apart
SPANNED = 2.0
"""Directions that a block of the shortest length spans, a few times the memory of the response: its
scores are of few motions, so that the trace scatters more than if every block spanned all (1.6
times as much of five directions, in 24 streams of white noise)."""
COVERED = 0.975  # quantile at which Student's and the Gaussian's ends are compared
CLEARLY_LARGER, CLEARLY_SMALLER = (3.0, 6.0)
"""Standard deviations by which scores must scatter more, or less, than innovations say before
standard errors follow: larger ones are the cautious side."""
WONTED = 1.5  # by how much the scores that are usual grow with a false alarm at least


class Scatter(NamedTuple):
    """What the sample loop has gathered for one output.

    Attributes
    ----------
    power : float
        Mean square of the scaled innovations.
    information : (k, k) array
        ``M``.
    blocks : (l,) array
        On each level.
    products : (l, k, k) array
        ``B`` on each level.
    """

    power: float
    information: Array
    blocks: Array
    products: Array


def scatter_of(blueprint: Blueprint, x: Array, output: int) -> Scatter:
    """Read it out of the vector of an estimator.

    Parameters
    ----------
    blueprint : Blueprint
    x : array
    output : int
    """
    ints = blueprint.ints
    k = int(ints[slots.DIRECTIONS])
    width = k * (k + 1) // 2
    own = _own(blueprint, x, output)
    levels = own[slots.HEADER + width :].reshape(slots.LEVELS, k + 2 + width)
    products = np.array([_square(one, k) for one in levels[:, k + 2 :]])
    power = float(own[slots.POWER] / max(own[slots.NUMBER], 1.0))
    information = _square(own[slots.HEADER : slots.HEADER + width], k)
    return Scatter(power, information, levels[:, k + 1].copy(), products)


def _own(blueprint: Blueprint, x: Array, output: int) -> Array:
    ints = blueprint.ints
    at = int(ints[slots.AT_SCATTER] + output * ints[slots.SCATTER])
    return x[at : at + int(ints[slots.SCATTER])]


def _square(lower: Array, k: int) -> Array:
    found = np.zeros((k, k))
    found[np.tril_indices(k)] = lower
    return found + np.tril(found, -1).T


def take_scatter(old: Blueprint, was: Array, new: Blueprint, x: Array) -> None:
    """Copy it from one vector to another, where both follow the same directions."""
    a, b = old.ints, new.ints
    if a[slots.SCATTER] == b[slots.SCATTER]:
        size = int(a[slots.OUTPUTS] * a[slots.SCATTER])
        at, to = int(a[slots.AT_SCATTER]), int(b[slots.AT_SCATTER])
        x[to : to + size] = was[at : at + size]


def mean_of_scores(blueprint: Blueprint, w: int, scale: int) -> int:
    """Where the judgement keeps the long mean of a scale, less one (`intake.judge`)."""
    k = int(blueprint.ints[slots.DIRECTIONS])
    width = k + k * (k + 1) // 2
    return w + slots.SCORES + k + scale * (width + slots.SUMS) + width + 1


def keep_expected(old: Blueprint, was: Array, new: Blueprint, x: Array) -> None:
    """The measure for changes goes over from one vector to another with the same directions."""
    if old.ints[slots.DIRECTIONS] == new.ints[slots.DIRECTIONS]:
        for i in range(int(new.ints[slots.OUTPUTS])):
            for scale in range(slots.SCALES):
                before = mean_of_scores(old, watch_of(old, i), scale)
                x[mean_of_scores(new, watch_of(new, i), scale)] = was[before]


def wonted(blueprint: Blueprint, x: Array) -> None:
    """What led to a false alarm becomes usual, so that the next one must be stronger.

    As no other plant was found, the scores so far are those of noise, and their scatter is known at
    once; the long mean of the judgement, with its memory of `slots.BLOCKS_USUAL` blocks, would take
    one false alarm after the other to get there.
    """
    places = [
        mean_of_scores(blueprint, watch_of(blueprint, i), scale)
        for i in range(int(blueprint.ints[slots.OUTPUTS]))
        for scale in range(slots.SCALES)
    ]
    grown = (1.0 + x[places]) * WONTED - 1.0
    expect_scatter(blueprint, x)
    x[places] = np.maximum(x[places], grown)


def expect_scatter(blueprint: Blueprint, x: Array) -> None:
    """What the scatter says is usual becomes the measure for changes (`intake.judge`).

    Otherwise coloured noise, whose scores are larger than those of white noise, looks like a change
    until the long mean of the judgement has caught up. A scale without blocks of its length takes
    the ratio of the longest that there are.
    """
    ints = blueprint.ints
    step = round(math.log(slots.PER_SCALE, slots.PER_LEVEL))
    for i in range(int(ints[slots.OUTPUTS])):
        seen = scatter_of(blueprint, x, i)
        live = np.diagonal(seen.information) > 0.0
        if not live.any() or seen.power <= 0.0:
            continue
        unit = 1.0 / np.sqrt(np.diagonal(seen.information)[live])
        scaled = unit[:, None] * seen.information[np.ix_(live, live)] * unit
        inverse = np.linalg.pinv(scaled, rcond=1e-9, hermitian=True)
        w, ratio = watch_of(blueprint, i), 1.0
        for scale in range(slots.SCALES):
            level = step * scale
            if level < slots.LEVELS and seen.blocks[level] >= FEWEST_USUAL:
                sums = unit[:, None] * seen.products[level][np.ix_(live, live)] * unit
                found = float(np.sum(inverse * sums)) / live.sum()
                doubt = math.sqrt(2.0 / (live.sum() * seen.blocks[level]))
                ratio = found if found > 1.0 + CLEARLY_LARGER * doubt else ratio
            x[mean_of_scores(blueprint, w, scale)] = max(ratio - 1.0, 0.0)


def turn_scatter(blueprint: Blueprint, x: Array, own: list[Indices], move: Array) -> None:
    """Go over to other directions.

    Parameters
    ----------
    blueprint : Blueprint
    x : array
        Is written to.
    own : list of int arrays, one for each output
        Coefficient of each of its directions; -1 for one that is no coefficient.
    move : (n, n) array
        The old unknowns by the new ones.
    """
    ints = blueprint.ints
    k = int(ints[slots.DIRECTIONS])
    width, lower = k * (k + 1) // 2, np.tril_indices(k)
    for i, places in enumerate(own):
        mine = np.flatnonzero(places >= 0)
        turn = np.eye(k)
        turn[np.ix_(mine, mine)] = move[np.ix_(places[mine], places[mine])]
        found, vector = scatter_of(blueprint, x, i), _own(blueprint, x, i)
        vector[slots.HEADER : slots.HEADER + width] = (turn.T @ found.information @ turn)[lower]
        levels = vector[slots.HEADER + width :].reshape(slots.LEVELS, -1)
        levels[:, :k] = levels[:, :k] @ turn
        for level, one in zip(levels, found.products, strict=True):
            level[k + 2 :] = (turn.T @ one @ turn)[lower]


def with_scatter(
    blueprint: Blueprint, x: Array, cov: Array, variance: Array, own: list[Indices], map_: Array
) -> Array:
    """The covariance of the coefficients, as the scatter of the scores shows it.

    Parameters
    ----------
    blueprint : Blueprint
    x : array
    cov : (n, n) array
        For white noise.
    variance : (n_outputs,) array
        Of the noise.
    own : list of int arrays, one for each output
        Coefficient of each of its directions; -1 for one that is no coefficient.
    map_ : (n, n) array
        The coefficients by the unknowns that the directions belong to.

    Returns
    -------
    (n, n) array
        ``cov`` where the scores do not contradict it.
    """
    n = cov.shape[0]
    scores = _scores_of(blueprint, x, variance, own, n)
    if scores is None:
        return cov
    live, unit, inverse, sums, blocks = scores
    size = int(live.sum())
    ratios = np.einsum("ij,lji->l", inverse, sums) / size
    beyond = np.append(0.0, np.maximum(np.diff(ratios), 0.0)) / (slots.PER_LEVEL - 1.0)
    spanned = np.minimum(SPANNED * float(slots.PER_LEVEL) ** np.arange(blocks.size), size)
    off = (ratios - 1.0) * np.sqrt(0.5 * spanned * blocks)
    last = int(np.flatnonzero(blocks >= FEW)[-1])
    longest = float(ratios[last] + beyond[last]) if off[last] > CLEARLY_LARGER else 1.0
    many = np.flatnonzero(blocks >= FEWEST)
    if not np.any((off[many] > CLEARLY_LARGER) | (off[many] < -CLEARLY_SMALLER)):
        return cov * longest
    enough = np.flatnonzero(blocks >= np.clip(PER_DIRECTION * size, FEW, FEWEST))
    level = int(enough[np.argmax(ratios[enough])]) if np.any(off[many] > 0.0) else int(many[-1])
    # few blocks leave a t distribution
    tails = (stdtrit(blocks[level], COVERED) / ndtri(COVERED)) ** 2
    first = np.cumsum(live)[:n] - 1
    bread = (unit[:, None] * inverse * unit)[np.ix_(first, first)]
    # few blocks do not tell directions apart: as if as many more had shown the same of all
    told = blocks[level] / (blocks[level] + size)
    spread = told * inverse @ sums[level] @ inverse + (1.0 - told) * ratios[level] * inverse
    middle = unit[:, None] * spread * unit
    left = np.linalg.solve(bread, np.linalg.solve(map_, cov)).T
    # for white noise it is to be ``cov``, whatever part of the weights the scores have
    part = float(np.trace(np.linalg.solve(map_.T, left.T))) / n
    found = left @ middle[np.ix_(first, first)] @ left.T * (tails / part)
    reached = max(float(ratios[level] + beyond[level]), longest)
    found = found * max(reached / max(float(ratios[level]), 1e-12), 1.0)
    return np.asarray(0.5 * (found + found.T))


def tells(blueprint: Blueprint, x: Array) -> bool:
    """Whether there are blocks enough to say whether noise is white."""
    own = [scatter_of(blueprint, x, i).blocks for i in range(int(blueprint.ints[slots.OUTPUTS]))]
    return bool(_independent(np.min(own, axis=0), _kept(blueprint))[0] >= FEWEST)


class _Scores(NamedTuple):
    """Of all outputs: which directions were seen, their units, and matrices in these."""

    live: Flags
    unit: Array
    inverse: Array
    sums: Array
    blocks: Array


def _scores_of(
    blueprint: Blueprint, x: Array, variance: Array, own: list[Indices], n: int
) -> _Scores | None:
    """The scatter of all outputs together; None where it does not tell yet."""
    others = n
    places = []
    for one in own:
        place = one.copy()
        place[one < 0] = others + np.arange(np.sum(one < 0))
        others += int(np.sum(one < 0))
        places.append(place)
    total = np.zeros((others, others))
    products = np.zeros((slots.LEVELS, others, others))
    blocks = np.full(slots.LEVELS, np.inf)
    for i, place in enumerate(places):
        seen = scatter_of(blueprint, x, i)
        if not (seen.power > 0.0 and variance[i] > 0.0):
            return None
        at = np.ix_(place, place)
        total[at] += seen.information / variance[i]
        products[:, at[0], at[1]] += seen.products / (seen.power * variance[i])
        blocks = np.minimum(blocks, seen.blocks)
    blocks = _independent(blocks, _kept(blueprint))
    live = np.diagonal(total) > 0.0
    if not np.any(blocks >= FEW) or not np.all(live[:n]):
        return None
    unit = 1.0 / np.sqrt(np.diagonal(total)[live])
    scaled = unit[:, None] * total[np.ix_(live, live)] * unit
    eigenvalues, vectors = np.linalg.eigh(scaled)
    if eigenvalues[0] < 1e-10 * eigenvalues[-1]:
        return None
    inverse = (vectors / eigenvalues) @ vectors.T
    sums = unit[:, None] * products[:, live][:, :, live] * unit
    return _Scores(live, unit, inverse, sums, blocks)


def _kept(blueprint: Blueprint) -> Array:
    """(l,) weight of a block of each level over that of the one after it."""
    one = float(blueprint.constants[slots.FORGETTING] ** blueprint.ints[slots.BLOCK])
    return np.asarray(one ** float(slots.PER_LEVEL) ** np.arange(slots.LEVELS))


def _independent(blocks: Array, kept: Array) -> Array:
    """Blocks of equal weight that tell as much as those of weights that fall, ``blocks`` in sum.

    Examples
    --------
    >>> import numpy as np
    >>> weights = 0.5 ** np.arange(3)
    >>> found = _independent(np.array([weights.sum(), 4.0]), np.array([0.5, 1.0]))
    >>> bool(np.allclose(found, [weights.sum() ** 2 / np.sum(weights**2), 4.0]))
    True
    """
    lost = 1.0 - kept
    oldest = np.clip(1.0 - blocks * lost, 0.0, 1.0)
    return np.asarray(blocks * (1.0 + kept) / (1.0 + oldest))


def widened(
    blueprint: Blueprint, x: Array, cov: Array, variance: Array, own: list[Indices]
) -> Array:
    """A covariance that is not of all samples, with the standard errors widened as theirs would be.

    Parameters
    ----------
    blueprint : Blueprint
    x : array
    cov : (n, n) array
        Of the unknowns that the directions belong to, for white noise.
    variance : (n_outputs,) array
        Of the noise.
    own : list of int arrays, one for each output
        Coefficient of each of its directions; -1 for one that is no coefficient.

    Returns
    -------
    (n, n) array
        ``cov``, each standard error as many times larger as the scatter of the scores makes that
        of least squares over all samples; none becomes smaller.
    """
    n = cov.shape[0]
    scores = _scores_of(blueprint, x, variance, own, n)
    if scores is None:
        return cov
    first = np.cumsum(scores.live)[:n] - 1
    white = scores.unit[:, None] * scores.inverse * scores.unit
    white = white[np.ix_(first, first)]
    found = with_scatter(blueprint, x, white, variance, own, np.eye(n))
    ratio = np.sqrt(np.maximum(np.diagonal(found) / np.diagonal(white), 1.0))
    return np.asarray(ratio[:, None] * cov * ratio)
