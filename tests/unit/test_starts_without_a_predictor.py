"""Starts of a plant that is not stable: one whose poles look alike at the samples leads nowhere."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record
from tridentify.estimation.closed_loop import unstable
from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.estimation.closed_loop.unstable_answer import open_loops


class _Beside:
    """Errors of a plant that has a predictor, beside plants that have none."""

    @property
    def is_finite(self) -> bool:
        raise np.linalg.LinAlgError("Singular matrix")


@pytest.mark.parametrize("itself", [True, False])
def test_the_others_are_still_tried(monkeypatch: pytest.MonkeyPatch, itself: bool) -> None:
    dt, n = 0.1, 120
    rng = np.random.default_rng(4)
    u = rng.choice([-1.0, 1.0], n)
    # y'' = 0.5 y' + u, held: by its exact recursion
    grown = np.exp(0.5 * dt)
    y, slope = np.zeros(n), 0.0
    for k in range(n - 1):
        y[k + 1] = y[k] + (grown - 1.0) / 0.5 * slope + ((grown - 1.0) / 0.25 - dt / 0.5) * u[k]
        slope = grown * slope + (grown - 1.0) / 0.5 * u[k]
    loops = open_loops([Record(u, y + 0.01 * rng.standard_normal(n), dt=dt, intersample="zoh")])
    alike = Plant(np.array([-0.2, 0.01 + (2.0 * np.pi / dt) ** 2]), (np.array([1.0]),))
    exact = unstable.linear_errors

    def failing(some, plant, *rest, **options):
        # whether rounding leaves its matrix singular is up to the machine
        if plant is alike and itself:
            raise np.linalg.LinAlgError("Singular matrix")
        if plant is alike:
            return _Beside()
        return exact(some, plant, *rest, **options)

    monkeypatch.setattr(unstable, "linear_errors", failing)
    good = Plant(np.array([-0.4, 0.01]), (np.array([0.9]),))
    found = unstable.root(loops, [alike, good], None, lambda _: None)
    assert found is not None
    assert found.still
    np.testing.assert_allclose(found.plant.theta, [-0.5, 0.0, 1.0], atol=0.05)
