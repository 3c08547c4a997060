"""Whether a pole that is not stable may have no part in a response, and what is taken then."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from tridentify import Status
from tridentify.estimation.closed_loop.predictor import Plant
from tridentify.estimation.closed_loop.unstable import Found
from tridentify.estimation.closed_loop.unstable_answer import NotStable, _is_unseen


def found(poles, num, errors):
    plant = Plant(np.poly(poles)[1:], (np.array(num),))
    return Found(
        plant, np.diag(np.square(errors)), (np.zeros(9),), np.zeros(0), 1.0, 1.0,
        (np.zeros(4),), 9, 1.0, 4, 0.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("pole", "num", "unseen"),
    [
        (0.007, [0.6, 0.003], True),  # a zero upon it
        (0.007, [0.6, 0.9], False),
        (0.4, [0.6, -0.24], True),
        (-0.5, [0.6, 0.3], False),  # it decays, and is not asked about
    ],
)
def test_a_pole_with_a_zero_upon_it_is_unseen(pole, num, unseen):
    plant = found([-0.5 + 0.3j, -0.5 - 0.3j, pole], num, [0.05, 0.03, 0.01, 0.03, 0.03])
    assert _is_unseen(plant, 0.02) is unseen


def answer(aicc, status=Status.CONVERGED, left=10.0):
    return SimpleNamespace(
        aicc=aicc, status=status, fit=np.array([100.0 - left]), n_samples=500,
        noise_model=(np.array([-0.8]),),
    )  # fmt: skip


def test_a_stable_plant_is_taken_where_it_is_likelier_and_the_pole_unseen():
    own, near, far = answer(-1000.0), answer(-1003.0), answer(-1030.0)
    assert NotStable(own, -1000.0, False, True).or_stable(near) is near
    assert NotStable(own, -1000.0, True, False).or_stable(near) is own
    assert NotStable(own, -1000.0, True, False).or_stable(far) is far
    weak = answer(-1003.0, Status.WEAKLY_IDENTIFIABLE)
    assert NotStable(own, -1000.0, False, True).or_stable(weak) is weak
    assert NotStable(own, -1000.0, True, False).or_stable(weak) is own


def test_slow_noise_is_no_larger_for_being_left_by_another_plant():
    """What is left is compared as the model of the noise sees it, not by its size."""
    own, other = answer(-1000.0, left=15.0), answer(-200.0, left=11.0)
    assert NotStable(own, -1000.0, True, True).or_stable(other) is own
