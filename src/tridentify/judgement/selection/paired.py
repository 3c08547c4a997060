r"""Two candidates on the same held-out samples, and whether one predicts better than the other.

*Fair terms.* A slow pole with a free initial state follows a drift, and predicts it, whatever the
input does: the more such poles, the better. So two candidates are also compared on errors from
which offset, drift and free responses of *both* are taken away: what one of them gets from there is
nobody's merit.

*Equal evidence.* Errors of neighbouring samples know each other, and a manoeuvre happens in a part
of the record only; over blocks of equal length nearly all of a difference falls into one of them,
which then looks like scatter. Here the samples are divided, along the time, into a few groups in
each of which the two predictions differ equally much (the sum of squares of their difference). If
one candidate is right where the other is wrong, it wins all of the groups alike; if the larger one
has only followed what happened by chance, it wins some and loses others. Where a few samples hold
most of the difference (an output that jumps), groups cannot be equal: each counts by what is won in
it over how much the two differ there, and those without a sample do not count.

*Few groups.* The groups are long, so their sums depend on each other little, and may have different
variances: Student's t over their mean is then conservative (Ibragimov & Mueller, Journal of
Business & Economic Statistics 28, 2010, 453-468: at levels up to 8 percent whatever the variances).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import stdtrit

from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten
from tridentify.numerics.kept import cached_property

GROUPS = 5
"""Groups of equal evidence. Fewer have no power, more are no longer independent: the slowest time
constant that a record shows is about a fifth of it."""

LEVEL = 0.01
"""Probability that a candidate which predicts as well as another is passed over for it. Ten
candidates are compared with the best of them, so that the level of each is a tenth of the usual."""
ONE_OF_TWO = 0.1
"""The same where two are compared that stand there for other reasons: the usual level."""

RANK = 1e-9
"""Singular value over the largest below which a nuisance term is no term of its own."""

LEAST_ROOM = 0.5
"""Least share of a sample that offset and initial state may leave: the very first samples fix a
fast initial state alone and would otherwise count many times over."""


@dataclass(frozen=True, eq=False)
class Unseen:
    """A candidate's errors on samples that it has not seen.

    Attributes
    ----------
    errors : tuple of (n_samples, n_outputs) arrays
        One for each record, each output over its spread: the sum of all squares is the share of
        the outputs that is not predicted.
    terms : tuple of tuples of (n_samples, k) arrays
        For each record and output, what offset, drift and initial state may add.
    noise : tuple of (p,) arrays
        Of each output: the errors count after whitening by it; empty for white.
    compared : dict
        What `contrasts` found: one and the same pair is asked for by many rules.
    """

    errors: tuple[Array, ...] = ()
    terms: tuple[tuple[Array, ...], ...] = ()
    noise: tuple[Array, ...] = ()
    compared: dict[Unseen, tuple[Contrast, Contrast]] = field(
        default_factory=dict, init=False, repr=False
    )

    @cached_property
    def loss(self) -> float:
        """Sum of the squares of all errors; infinite where there are none."""
        if not self.errors:
            return math.inf
        return float(sum(np.nansum(one**2) for one in self.errors))


@dataclass(frozen=True)
class Contrast:
    """Losses of two candidates on the same terms, and their difference over its scatter."""

    own: float
    other: float
    t: float
    groups: int = GROUPS

    @property
    def as_good(self) -> bool:
        """Whether the first one predicts no worse than the second, within the scatter."""
        return self.is_within(LEVEL)

    def is_within(self, level: float) -> bool:
        """The same at another level."""
        if self.own <= self.other or self.groups < 2:
            return True
        return self.t <= float(stdtrit(self.groups - 1, 1.0 - level))

    @property
    def points(self) -> float:
        """How far the fit of the first lies below that of the second [percent].

        Less one standard error of that: the rule of Breiman, Friedman, Olshen & Stone
        (*Classification and Regression Trees*, 1984, section 3.4.3).
        """
        apart = 100.0 * (math.sqrt(self.own) - math.sqrt(self.other))
        if self.groups < 2 or apart <= 0 or self.t <= 0:
            return apart
        return apart * max(1.0 - 1.0 / self.t, 0.0)


def contrasts(own: Unseen, other: Unseen) -> tuple[Contrast, Contrast]:
    """Compare two candidates as they are, and on fair terms.

    Parameters
    ----------
    own, other : Unseen
        Of the same records.

    Returns
    -------
    tuple of two Contrast

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> y, e = np.sin(0.1 * np.arange(300))[:, None], 0.1 * rng.standard_normal((300, 1))
    >>> bare = ((np.ones((300, 1)),),)
    >>> poor, good, same = (Unseen((one,), bare) for one in (y + e, e, e[::-1]))
    >>> [one.as_good for one in contrasts(poor, good)], contrasts(same, good)[0].as_good
    ([False, False], True)
    """
    if other not in own.compared:
        cleaned = (tuple(_cleaned(one, own, other)) for one in (own, other))
        plain = _contrast(own, other, own.errors, other.errors)
        own.compared[other] = plain, _contrast(own, other, *cleaned)
    return own.compared[other]


def _contrast(
    own: Unseen, other: Unseen, first: Sequence[Array], second: Sequence[Array]
) -> Contrast:
    """From errors: losses, and t over groups in which the predictions differ equally much."""
    one, two = _series(first, own.noise), _series(second, own.noise)
    apart = np.sum((one - two) ** 2, axis=1)
    excess = np.sum(one**2 - two**2, axis=1)
    losses = float(np.sum(one**2)), float(np.sum(two**2))
    total = float(apart.sum())
    if total == 0:
        return Contrast(*losses, 0.0)
    places = ((np.cumsum(apart) - 0.5 * apart) * (GROUPS / total)).astype(np.intp)
    places = np.minimum(places, GROUPS - 1)
    sizes = np.bincount(places, weights=apart, minlength=GROUPS)
    won = np.bincount(places, weights=excess, minlength=GROUPS)[sizes > 0] / sizes[sizes > 0]
    if won.size < 2:
        return Contrast(*losses, 0.0, 1)
    scatter = float(np.std(won, ddof=1)) / math.sqrt(won.size)
    mean = float(won.mean())
    t = mean / scatter if scatter > 0 else math.copysign(math.inf, mean)
    return Contrast(*losses, t, won.size)


def _series(errors: Sequence[Array], noise: Sequence[Array]) -> Array:
    """(n_samples, n_outputs) errors of all records on end, whitened; 0 where there is none."""
    found = []
    for one in errors:
        columns = [
            whiten(np.ascontiguousarray(one[:, i]), noise[i])[0]
            if i < len(noise) and noise[i].size
            else one[:, i]
            for i in range(one.shape[1])
        ]
        found.append(np.nan_to_num(np.column_stack(columns)))
    return np.concatenate(found)


def _cleaned(one: Unseen, own: Unseen, other: Unseen) -> list[Array]:
    """Errors of one candidate without what the terms of both explain."""
    found = []
    for error, *terms in zip(one.errors, own.terms, other.terms, strict=True):
        left = error.copy()
        for i, (first, second) in enumerate(zip(*terms, strict=True)):
            left[:, i] = without(np.column_stack([first, second]), error[:, i])
        found.append(left)
    return found


def without(columns: Array, error: Array) -> Array:
    """What columns leave of an error; each sample as if they were fitted without it.

    Parameters
    ----------
    columns : (n_samples, k) array
    error : (n_samples,) array
        ``nan`` marks a missing sample.

    Returns
    -------
    (n_samples,) array

    Examples
    --------
    >>> without(np.ones((4, 1)), np.array([1.0, 1.0, 1.0, 2.0])).round(3).tolist()
    [-0.333, -0.333, -0.333, 1.0]
    """
    seen = np.isfinite(error)
    kept = columns[seen]
    kept = kept[:, np.all(np.isfinite(kept), axis=0)]
    norms = np.linalg.norm(kept, axis=0)
    kept = kept[:, norms > 0] / norms[norms > 0]
    if not kept.size:
        return error
    basis, sizes, _ = np.linalg.svd(kept, full_matrices=False)
    basis = basis[:, sizes > RANK * sizes[0]]
    left = np.full(error.shape, np.nan)
    own = error[seen] - basis @ (basis.T @ error[seen])
    left[seen] = own / np.maximum(1.0 - np.sum(basis**2, axis=1), LEAST_ROOM)
    return left
