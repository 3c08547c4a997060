"""A gain that moves slowly over the record, with a speed, a temperature or a supply.

The output of a model is multiplied by straight lines between a few instants, which least squares
gives; the moves of the inputs are then multiplied by these, the model fitted to that, and so on
from there. A channel whose scale changes at one instant has to explain more than this.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from tridentify.judgement.causes.attempts.attempt import Attempt
from tridentify.judgement.causes.attempts.present import Present
from tridentify.judgement.causes.attempts.rivals import LONG_ENOUGH, Rival, one
from tridentify.judgement.causes.timing.shifts import quickly_fitted
from tridentify.numerics.arrays import Array
from tridentify.numerics.autoregression import whiten

KNOTS = (2, 3, 5, 8)
"""Of the gain: a ramp, an arch, and what is about as slow as a record."""

ROUNDS = 2
"""Fits and gains in turn."""

MOST = 5.0
"""Times its mean that a gain may be, and the same below: beyond, its sign is not determined."""


def gain_rivals(present: Present) -> Iterator[Rival]:
    """One gain that moves along straight lines, of the knots that explain most for their number.

    Parameters
    ----------
    present : Present
    """
    if len(present.records) > 1 or present.records[0].dt is None:
        return
    n = present.records[0].n_samples
    own = [_moving(present, k) for k in KNOTS if n > k * LONG_ENOUGH]
    found = [each for each in own if each is not None]
    if found:
        yield min(found, key=lambda pair: pair[0])[1]


def _moving(present: Present, knots: int) -> tuple[float, Rival] | None:
    """A rival, and its criterion under the noise model that is held."""
    (record,) = present.records
    places = np.linspace(0.0, record.n_samples - 1.0, knots)
    hats = np.stack([np.interp(np.arange(record.n_samples), places, row) for row in np.eye(knots)])
    gains, part, end = np.ones(knots), present, quickly_fitted(present, present.poles)
    for _ in range(ROUNDS):
        if end is None:
            return None
        gains = gains * _share(end, part, hats)
        gains = gains / (gains @ hats).mean()
        if not np.all(gains > 1.0 / MOST) or np.any(gains > MOST):
            return None
        about = record.u.mean(axis=0)
        u = about + (gains @ hats)[:, None] * (record.u - about)
        part = replace(present, records=(record._derive(u=u),))
        end = quickly_fitted(part, end.point.poles)
    if end is None:
        return None
    price = 2.0 * (knots - 1.0 + float(np.log(len(KNOTS))))
    at = ", ".join(f"{gain:.3g}" for gain in gains)
    what = (
        f"a gain that moves over the record, from {gains[0]:.3g} to {gains[-1]:.3g} times its mean"
        if knots == KNOTS[0]
        else f"a gain that moves over the record ({at} times its mean at even distances)"
    )
    found = one(
        "varying",
        part,
        what,
        "Find what moves it (speed, temperature, supply), and identify stretches where that is "
        "the same; or follow the coefficients with online.ThreeModel(forgetting=...).",
        refits=False,
    )
    return end.deviance + price, replace(found, starts=((end.point.poles,),), price=price)


def _share(end: Attempt, part: Present, hats: Array) -> Array:
    """What least squares makes of the gain at the knots, over all outputs."""
    (record,), noise = part.records, end.point.problem.noise
    rows, targets = [], []
    for i, f in enumerate(end.point.outputs()[0].T):
        a = noise[i] if noise else np.zeros(0)
        left = whiten(np.ascontiguousarray(record.y[:, i] - f), a)[0]
        seen = np.isfinite(left)
        every = [*(hats * (f - np.nanmean(f))), np.ones(f.size)]
        columns = [whiten(np.where(seen, each, np.nan), a)[0] for each in every]
        size = float(np.sqrt(np.mean(left[seen] ** 2))) or 1.0
        rows.append(np.stack(columns, axis=1)[seen] / size)
        targets.append(left[seen] / size)
    found = np.linalg.lstsq(np.vstack(rows), np.concatenate(targets))[0]
    return np.asarray(1.0 + found[: hats.shape[0]])
