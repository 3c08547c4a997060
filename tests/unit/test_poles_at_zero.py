"""What is said of poles that cannot be told from zero, of a plant that a loop holds."""

from dataclasses import replace

import numpy as np
import pytest

from tridentify import Record, Structure, ThreeModel, TransferFunction, simulate
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.judgement.cautions.coefficients import coefficient_findings


@pytest.fixture(scope="module")
def held():
    """An estimate of second order, as of a loop of 100 s, and its record."""
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 20), 10)
    y = simulate(TransferFunction([1.0], [1.0, 1.4, 1.0]), Record(u, u, dt=0.5))
    record = Record(u, y, dt=0.5, intersample="zoh")
    found = ThreeModel(noise="white").estimate([record], Structure(2, 0))
    return replace(found, route="reference", loop=LoopTaken("sampled", mirrored=True)), record


def all_said(held, a1, a0, std_a1, std_a0):
    estimate, record = held
    model = TransferFunction([1.0], [1.0, a1, a0])
    own = replace(
        estimate,
        model=model,
        theta=np.array([a1, a0, 1.0]),
        cov=np.diag([std_a1, std_a0, 0.01]) ** 2,
    )
    return coefficient_findings(own, [record])


def said(*how):
    return {one.code: one.message for one in all_said(*how)}


@pytest.mark.parametrize("a0", [1e-3, -1e-3], ids=["left", "right"])
def test_an_integrator_is_told_once_whatever_the_sign_of_its_pole(held, a0):
    (told,) = all_said(held, 1.0, a0, 1e-3, 2e-3)
    assert told.severity == "note"
    assert "integrates" in told.message
    assert "+/-" in told.message


@pytest.mark.parametrize(
    ("a1", "a0"), [(-1e-6, 1e-5), (1e-6, 1e-5), (-1e-4, -1e-5)], ids=["right", "left", "both sides"]
)
def test_of_a_double_integrator_both_are_told_and_its_coefficients_not_again(held, a1, a0):
    told = said(held, a1, a0, 1e-3, 1e-4)
    assert "integrates" in told["unstable"]
    assert "not-determined" not in told


def test_a_pair_that_is_faster_than_the_record_does_not_integrate(held):
    told = said(held, -1e-3, 4.0, 1e-2, 1e-2)
    assert "hardly damped" in told["unstable"]


def test_coefficients_that_move_poles_into_the_record_are_not_determined(held):
    told = said(held, -1e-3, 4e-4, 1e-2, 1e-3)
    assert "a0" in told["not-determined"]


def test_a_pair_to_the_right_is_surely_there(held):
    told = said(held, -0.5, 4.0, 1e-2, 1e-2)
    assert told["unstable"].startswith("The plant is not stable: ")
