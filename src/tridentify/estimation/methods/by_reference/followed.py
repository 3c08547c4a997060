"""What follows the references in a residual: what chance leaves there, and what it says of a loop.

The residual at the true coefficients is the noise, which no reference drives. So what of it lies
along the columns that the references drive (`closed_loop.driven`), whitened as the noise is, is
chance: a sum of squares of as many variances as there are columns. More than that speaks against
the kind of controller that was taken, or the order; less in a recorded input than chance leaves,
against the reference.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from tridentify.estimation.answer.finding import Finding
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.driven import COARSE, Driven, driven, widest
from tridentify.estimation.methods.by_reference.passes import Rooted, residuals
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import fit_autoregression, whiten

MOST_NOISE = 20
"""Coefficients of the noise's model beside which that is asked, at most."""
DRIVEN = 10.0
"""Times chance that references explain of an input beside what they leave, from which they drive
it: sines do 67 and more (101 random loops), three in four references that drive nothing less."""
DIGITS = 1e-6
"""Share of an output below which what is left of it is none: that is how well an input is known
between its samples where nothing else is in the way."""
MISSED = 1e-3
"""Probability of taking noise for what is left of the response."""


class Following(NamedTuple):
    """What follows the references in a residual, in variances of the noise, and what chance leaves.

    ``size`` is a sum of squares along ``freedom`` directions.
    """

    size: float
    freedom: int

    @property
    def excess(self) -> float:
        """Beyond what chance leaves."""
        return self.size - self.freedom

    @property
    def is_chance(self) -> bool:
        """Whether noise alone may be that."""
        return not self.freedom or self.size <= float(chdtri(self.freedom, MISSED))


def wider(mine: Rooted, other: Rooted) -> list[Array]:
    """What the references drive, by the richer of two descriptions, record by record."""
    parts = ((_widest(one), _widest(two)) for one, two in zip(mine.loops, other.loops, strict=True))
    return [max(pair, key=lambda part: part.order).columns for pair in parts]


def _widest(loop: Loop) -> Driven:
    part = loop.driven if isinstance(loop.driven, Driven) else driven(loop.record)
    return widest(part.record, part.rate, part.before)


def left_over(white: Rooted) -> list[Array]:
    """Of every record; missing where they are no more than `DIGITS` of an output."""
    left = residuals(white.loops, white.estimate)
    moving = (np.nanstd(np.asarray(loop.record.y), axis=0) for loop in white.loops)
    return [
        np.where(np.nanstd(one, axis=0) > DIGITS * size, one, np.nan)
        for one, size in zip(left, moving, strict=True)
    ]


def follows(white: Rooted) -> bool:
    """Whether the residual of a root for white noise follows the references."""
    return not followed(*_left(white)).is_chance


def driving_findings(parts: Sequence[Driven]) -> tuple[Finding, ...]:
    """What is to be said of references that drive no input.

    Parameters
    ----------
    parts : sequence of Driven
        Per experiment.
    """
    inputs, columns = [np.asarray(one.record.u) for one in parts], [one.columns for one in parts]
    # whitening by itself takes sines out of an input, and its rest holds what chance has fitted
    own = followed(inputs, columns)
    beside = followed(inputs, columns, [one.record.u - one.inputs for one in parts])
    if not own.freedom or not own.is_chance or beside.size > DRIVEN * beside.freedom:
        return ()
    return (
        Finding(
            "loop-not-excited",
            "warning",
            f"The reference ({', '.join(parts[0].record.reference_names)}) explains no more of the "
            "input than chance does: it drives nothing, and what is found from it means nothing.",
            "Check that it is what the controller followed, on the same clock; or leave it out.",
        ),
    )


def following_findings(white: Rooted) -> tuple[Finding, ...]:
    """What is to be said where the residual of a continuous loop follows the reference.

    It is looked for under white weights: a model of the noise gives fast motion more weight, where
    what is not known between the samples is largest, and the coefficients then make up for it.

    Parameters
    ----------
    white : Rooted
        The root before the noise is modelled.
    """
    if white.loops[0].sampling == "sampled":
        return ()
    left = followed(*_left(white))
    if left.is_chance:
        return ()
    return (
        Finding(
            "intersample",
            "warning",
            "The controller is continuous, and the residual follows the reference: "
            f"{left.size / left.freedom:.1f} times what chance leaves. What the input does between "
            "the samples is not known well enough, or the order is too low; the standard errors "
            "allow for part of it.",
            "Sample faster, by five times if possible, or try a higher order.",
        ),
    )


def coarse_findings(best: Rooted) -> tuple[Finding, ...]:
    """What is to be said of a continuous controller in a loop that is fast for its sampling.

    A model of the noise takes up what noise makes of the input between the samples.

    Parameters
    ----------
    best : Rooted
    """
    loops = best.loops
    steps = [float(np.median(np.diff(one.record.t))) for one in loops]
    fastest = max(one.driven.rate * step for one, step in zip(loops, steps, strict=True))
    allowed = any(one.size for one in best.estimate.noise_model)
    if loops[0].sampling == "sampled" or fastest <= COARSE or allowed:
        return ()
    return (
        Finding(
            "intersample",
            "warning",
            f"The controller is continuous and the loop fast for the sampling ({fastest:.2g} "
            "rad a step): what noise makes of the input between the samples is not recorded, "
            "and without a model of the noise the standard errors do not allow for it.",
            "Use noise='auto', or sample faster, by five times if possible.",
        ),
    )


def _left(white: Rooted) -> tuple[list[Array], list[Array]]:
    return left_over(white), [_widest(one).columns for one in white.loops]


def followed(
    signals: Sequence[Array], basis: Sequence[Array], noises: Sequence[Array] | None = None
) -> Following:
    """What follows the references in some signals, whitened one by one as their noises are."""
    size, freedom = 0.0, 0
    for left, columns, quiet in zip(signals, basis, noises or signals, strict=True):
        for series, own in zip(left.T, quiet.T, strict=True):
            if np.isfinite(series).sum() >= 2 * columns.shape[1]:
                along = _along(columns, own, series)
                size += float(np.sum(along**2))
                freedom += len(along)
    return Following(size, freedom)


def _along(columns: Array, own: Array, *signals: Array) -> Array:
    """(n_columns, n_signals) of signals along columns, whitened as a noise is, in its deviations.

    Parameters
    ----------
    columns : (n_samples, n_columns) array
    own : (n_samples,) array
        The noise, with more in it.
    *signals : (n_samples,) arrays
        Missing where the first is; what that leaves beside the columns is the noise.
    """
    seen = np.isfinite(signals[0])
    noise = fit_autoregression([own - np.mean(own[seen])], MOST_NOISE)
    table = np.column_stack([columns, *signals]).T
    white = np.column_stack([whiten(np.where(seen, one, np.nan), noise)[0] for one in table])
    white, count = white[seen], columns.shape[1]
    along = np.linalg.qr(white[:, :count])[0].T @ white[:, count:]
    rest = white[:, count] @ white[:, count] - along[:, 0] @ along[:, 0]
    return np.asarray(along / np.sqrt(max(rest / (len(white) - count), 1e-300)))


def held_for(mine: Rooted, other: Rooted, basis: Sequence[Array]) -> float:
    """Share of an interval for which the input of a controller may be held that counts as moving.

    A computer of ``m`` steps a sample is late by half a step, as one of a single step is by half a
    sample: so what it leaves lies ``1 / m`` of the way from what a continuous controller leaves to
    what a sampled one does. Its least squares, and their error, say how far.

    Parameters
    ----------
    mine, other : Rooted
        As continuous, and as sampled.
    basis : sequence of arrays
        What the references drive, record by record.
    """
    ends = [
        _along(columns, one, one, two)
        for lefts in zip(*(left_over(one) for one in (mine, other)), basis, strict=True)
        for one, two, columns in _outputs(*lefts)
    ]
    if not ends:
        return 0.0
    here, there = np.vstack(ends).T
    way = there - here
    share = max(float(-here @ way / (way @ way)), 0.0)
    return float(min(np.hypot(share, 1.0 / np.linalg.norm(way)), 1.0))


def _outputs(left: Array, right: Array, columns: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Residuals of every output under both kinds, where both are there."""
    for one, two in zip(left.T, right.T, strict=True):
        if np.isfinite(one).sum() >= 2 * columns.shape[1] and np.isfinite(two).any():
            yield one, two, columns
