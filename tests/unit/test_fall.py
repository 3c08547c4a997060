"""Errors that allow for a likelihood which falls less on one side than its curvature says."""

from __future__ import annotations

from dataclasses import dataclass

import loops
import numpy as np
import pytest

from tridentify import Record, ThreeModel, identify
from tridentify.estimation.closed_loop.fall import MOST, farther

FAR = 4.0
"""Standard errors that no error of a record that shows its coefficients is beyond."""


@dataclass(frozen=True)
class Curve:
    """Errors of two unknowns, the first of which bends by so much."""

    at: np.ndarray
    bend: float

    @property
    def innovations(self):
        x, y = self.at
        return -np.array([x + self.bend * x * x, 3.0 * y + 0.5 * x])

    @property
    def size(self):
        return float(self.innovations @ self.innovations)

    @property
    def columns(self):
        return np.array([[1.0 + 2.0 * self.bend * self.at[0], 0.0], [0.5, 3.0]])

    def moved(self, change):
        return Curve(self.at + change, self.bend)


def end_of_fall(bend: float, axis: np.ndarray, side: float) -> float:
    """Steps along an axis to where the least size beside it is that of two standard errors."""
    steps = np.linspace(0.0, 2.0 * MOST, 2001)
    across = np.linspace(-12.0, 12.0, 4001)
    for step in steps:
        x = side * step * axis[0] + across * axis[1]
        # the second unknown is free: what it makes of its error is nothing where x asks for it
        y = (side * step - axis[0] * x) / axis[1]
        if np.min((x + bend * x * x) ** 2 + (3.0 * y + 0.5 * x) ** 2) >= 4.0:
            return step / 2.0
    return MOST


def longest(cov: np.ndarray) -> np.ndarray:
    """The combination of unknowns that is known least, over its standard error."""
    sizes = np.sqrt(np.diag(cov))
    values, turned = np.linalg.eigh(cov / np.outer(sizes, sizes))
    return turned[:, -1] / sizes / np.sqrt(values[-1])


def times(here: Curve) -> tuple[float, np.ndarray]:
    """By what the standard error of that combination grows."""
    cov = np.linalg.inv(here.columns.T @ here.columns)
    axis = longest(cov)
    return float(np.sqrt(axis @ (cov + farther(here, cov, 2)) @ axis)), axis


@pytest.mark.parametrize("bend", [0.0, 0.1, 0.5])
def test_an_axis_grows_to_where_the_likelihood_has_fallen_as_awaited(bend):
    grown, axis = times(Curve(np.zeros(2), bend))
    expected = max(end_of_fall(bend, axis, side) for side in (-1.0, 1.0))
    assert grown == pytest.approx(expected, rel=0.1)


def test_the_fall_is_counted_from_the_highest_likelihood():
    """Not from an estimate beside it, from where one side falls by less than nothing."""
    beside = np.array([0.5, 0.0])
    grown, axis = times(Curve(beside, 0.0))
    assert grown == pytest.approx(1.0 + 0.5 * abs(axis @ beside), abs=0.07)


def short_loop(seed: int, coloured: bool) -> tuple[Record, loops.Drawn]:
    """A short record of a random loop with its reference."""
    rng = np.random.default_rng([seed, 71])
    drawn = loops.draw(
        seed,
        n=int(rng.integers(120, 400)),
        excitation="prbs",
        of=lambda law, _: law.sampled,
        keep=lambda one: one.coloured == coloured and np.isfinite(one.snr),
    )
    seen = drawn.record
    return Record(seen.u, seen.y, dt=seen.dt, reference=drawn.reference), drawn


def scores(seed: int, coloured: bool) -> tuple[np.ndarray, bool]:
    """Errors over those that are stated, and whether `identify` says that they are not to be had.

    It is asked where an error is far above what is stated alone: where a pole nearly cancels with
    a zero, any pair of the two explains the record, of which a likelihood's end shows one.
    """
    record, drawn = short_loop(seed, coloured)
    method = ThreeModel(controller="sampled")
    found = method.estimate([record], drawn.structure)
    score = (found.theta - drawn.theta) / found.std
    if np.all(np.abs(score) < FAR):
        return score, False
    told = identify(record, drawn.structure, method, throw=False).findings
    return score, any(one.code == "not-determined" and one.matters for one in told)


@pytest.mark.slow
@pytest.mark.parametrize("coloured", [False, True])
def test_short_records_of_random_loops_are_covered(coloured):
    """Of 24 loops; with the curvature alone 65 to 80 in a hundred where the noise is coloured.

    Of the coefficients of 32 others in coloured noise 89.5 in a hundred were held: the bound lies
    two errors of sampling below.
    """
    found = [scores(91_000 + k, coloured) for k in range(24)]
    z = np.concatenate([score for score, _ in found])
    assert np.mean(np.abs(z) < 1.96) > 0.83
    sure = np.concatenate([score for score, told in found if not told])
    assert np.mean(np.abs(sure) < FAR) > 0.97
    assert sum(told for _, told in found) <= 2
