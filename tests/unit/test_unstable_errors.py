"""Errors of a plant that is not stable, in a loop whose input is mostly noise."""

from __future__ import annotations

import numpy as np
import pytest

from oracles import sampled_loop
from tridentify import Record
from tridentify.estimation.closed_loop import unstable
from tridentify.estimation.closed_loop.between_samples import Loop
from tridentify.estimation.closed_loop.driven import driven
from tridentify.estimation.closed_loop.linear_errors import linear_errors
from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.estimation.closed_loop.unstable import root

DT, COUNT, NOISE = 0.1, 300, 0.4
TRUTH = np.array([0.2, -1.2, 2.0])


def silent(_: str) -> None:
    pass


def found_of(seed: int):
    """A root: poles at 1 and -1.2, a sampled controller with a derivative, a set point."""
    rng = np.random.default_rng(seed)
    r, last = np.repeat(rng.choice([-1.0, 1.0], COUNT // 20), 20), [0.0]

    def control(k, y):
        slope, last[0] = (y[0] - last[0]) / DT, y[0]
        return 2.5 * r[k] - 3.0 * y[0] - 0.8 * slope

    plant = ([TRUTH[2]], [1.0, *TRUTH[:2]])
    noise = NOISE * rng.standard_normal((COUNT, 1))
    u, y = sampled_loop([[plant]], control, noise, DT)
    loops = [Loop(driven(Record(u, y, dt=DT, reference=r)), "sampled")]
    return loops, root(loops, [Plant(TRUTH[:2], (TRUTH[2:],))], None, silent)


def test_errors_are_those_of_the_record():
    """With the derivatives of the whole error, by differences, beside the driven ones."""
    loops, found = found_of(102)
    held = linear_errors(loops, found.plant, np.zeros(0))
    columns = []
    for h in np.diag(1e-4 * np.sqrt(np.diag(found.cov))):
        ends = [
            linear_errors(loops, found.plant.with_theta(found.plant.theta + s * h), np.zeros(0))
            for s in (1.0, -1.0)
        ]
        # beside start and offset where they suit best
        left = [e.errors - e.rest @ np.linalg.lstsq(e.rest, e.errors, rcond=None)[0] for e in ends]
        columns.append((left[1] - left[0]) / (2.0 * h.sum()))
    own = np.linalg.qr(held.rest)[0]
    z = held.slopes - own @ (own.T @ held.slopes)
    back = np.linalg.inv(z.T @ np.column_stack(columns))
    cov = found.variance * back @ (z.T @ z) @ back.T
    np.testing.assert_allclose(np.sqrt(np.diag(found.cov)), np.sqrt(np.diag(cov)), rtol=0.03)
    alone = np.sqrt(found.variance * np.diag(np.linalg.inv(z.T @ z)))
    assert np.max(np.abs(np.sqrt(np.diag(found.cov)) / alone - 1.0)) > 0.1


def test_a_plant_beyond_the_most_growth_is_no_root(monkeypatch: pytest.MonkeyPatch):
    """Beyond rounding the errors are zero whatever the plant is; here a tenth in an interval."""
    loops, found = found_of(102)
    assert found.still
    assert found.amplification < 1.2
    monkeypatch.setattr(unstable, "MOST_GROWTH", 1.01)
    beyond = root(loops, [found.plant], None, silent)
    assert not beyond.still


@pytest.mark.filterwarnings("error")
def test_without_noise_its_likelihood_has_no_bound():
    plant, none = Plant(TRUTH[:2], (TRUTH[2:],)), np.zeros(0)
    found = unstable.Found(
        plant, np.eye(3), (np.zeros(9),), none, 0.0, np.inf, (none,), 5, 1.0, 1, 0.0
    )
    assert found.deviance == -np.inf
