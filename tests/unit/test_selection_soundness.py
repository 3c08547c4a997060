"""A slow swing that a pole and a zero beside it describe is no mode of the plant."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.judgement.selection.soundness import _close

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
