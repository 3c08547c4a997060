"""The ends of a search for plant and noise: which are known, and what they add to the errors."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tridentify.estimation.closed_loop.settled import LEAST_WEIGHT, _added, _spread


def end(criterion: float, order: int = 1, *, moved: float = 0.0, at: float = 0.0) -> Any:
    """Where steps ended: AICc, coefficients of the noise, the last step, the plant there."""
    theta = np.array([at, 2.0 * at])
    place = SimpleNamespace(
        criterion=criterion, noise=np.zeros(order), plant=SimpleNamespace(theta=theta)
    )
    return SimpleNamespace(place=place, moved=moved, still=moved <= 0.05, step=np.zeros(2))


def test_a_minimum_that_another_plant_led_to_is_known_and_leads_no_further() -> None:
    known = (end(10.0),)
    ends = list(known)
    assert not _added(end(10.0 + 1e-3), known, ends)
    assert ends == list(known)


@pytest.mark.parametrize(
    "other",
    [end(10.1), end(10.0, order=2), end(10.0, moved=1.0)],
    ids=["likelier or less likely", "other noise", "no minimum yet"],
)
def test_what_is_another_end_is_added(other: Any) -> None:
    known = (end(10.0),)
    ends = list(known)
    assert _added(other, known, ends)
    assert ends[-1] is other


def test_an_end_that_was_none_makes_no_other_known() -> None:
    ends = [end(10.0, moved=1.0)]
    assert _added(end(10.0), tuple(ends), ends)
    assert len(ends) == 2


def test_steps_that_ran_off_lead_on_and_are_no_end() -> None:
    ends: list[Any] = []
    assert _added(end(10.0, moved=np.inf), (), ends)
    assert ends == []


def test_ends_count_by_their_weight_and_each_minimum_once() -> None:
    best, twin = end(10.0), end(10.0 + 1e-3, at=5.0)
    other = end(12.0, order=2, at=1.0)
    far = end(10.0 - 2.0 * np.log(LEAST_WEIGHT) + 1.0, order=3, at=100.0)
    weight = np.exp(-1.0)
    expected = weight / (1.0 + weight) * np.outer([1.0, 2.0], [1.0, 2.0])
    np.testing.assert_allclose(_spread(best, [far, other, twin, best]), expected)


def test_a_step_that_was_left_joins_the_errors() -> None:
    best = end(10.0, moved=1.0)
    best.step = np.array([0.5, -1.0])
    np.testing.assert_allclose(_spread(best, [best]), np.outer(best.step, best.step))
