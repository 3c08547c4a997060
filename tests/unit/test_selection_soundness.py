"""A slow swing that a pole and a zero beside it describe is no mode of the plant."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.answer.cancelling import _close
from tridentify.judgement.selection.soundness import SWING, doubts

pytestmark = pytest.mark.unjudged

PLANT = [1.0, 0.056, 4.7e-4]


def dipole(pole, zero):
    """Numerator and denominator of a plant of order two with one pair beside it."""
    pair, other = (np.poly([z, np.conj(z)]).real for z in (pole, zero))
    return 1.2e-4 * other, np.polymul(PLANT, pair)


def test_a_swing_that_outlasts_the_record_beside_a_zero_is_told():
    # as a heated plate had it: three periods in the record, nearly undamped, a zero beside it
    num, den = dipole(-0.0009 + 0.0341j, -0.0022 + 0.0341j)
    assert _close(num, den, 571.0).sum() == 2


@pytest.mark.parametrize(
    ("pole", "zero", "why"),
    [
        (-0.0009 + 0.0341j, -0.0022 + 0.0380j, "a distance that three periods show"),
        (-0.0100 + 0.0341j, -0.0105 + 0.0341j, "a swing that is over: the errors tell"),
    ],
)
def test_a_mode_that_the_record_shows_is_none_of_these(pole, zero, why):
    assert not _close(*dipole(pole, zero), 571.0).any(), why


def test_a_longer_record_tells_them_apart():
    num, den = dipole(-0.0009 + 0.0341j, -0.0022 + 0.0341j)
    assert not _close(num, den, 4000.0).any()


def test_without_zeros_nothing_is_close():
    assert not _close(np.array([4.7e-4]), np.array(PLANT), 571.0).any()


@pytest.mark.parametrize(("seconds", "told"), [(25.0, True), (150.0, False)])
def test_a_swing_that_does_not_come_round_once_is_no_mode_beside_faster_ones(seconds, told):
    """Pitch angle by elevator: the short period, and a phugoid of 58 s."""
    den = np.polymul([1.0, 2.5, 6.6], [1.0, 0.06, 0.0125])
    pitch = TransferFunction([-6.8, -6.7, -0.12], den)
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 0.0, 1.0], int(seconds)), 10)
    y = simulate(pitch, Record(u, u, dt=0.1)) + 1e-3 * rng.standard_normal((u.size, 1))
    record = Record(u, y, dt=0.1, intersample="zoh")
    estimate = identify(record, Structure(4, 2, offset=False, initial_state="rest"))
    assert (SWING in doubts(estimate, [record])) is told
    # what all else rests on is no such thing
    alone = TransferFunction([1.0], [1.0, 0.06, 0.0125])
    y = simulate(alone, Record(u, u, dt=0.1)) + 1e-3 * rng.standard_normal((u.size, 1))
    slow = Record(u, y, dt=0.1, intersample="zoh")
    estimate = identify(slow, Structure(2, 0, offset=False, initial_state="rest"))
    assert SWING not in doubts(estimate, [slow])
