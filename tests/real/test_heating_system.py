"""A halogen lamp over a steel plate: voltage to temperature, 801 samples at 2 s.

What a linear model can do: two poles and a zero follow the half they were identified on within two
percent and the other half within ten. What it cannot: the plate loses heat by radiation, so that
time constants and gain depend on the level. The coefficients of the first half and of the whole
record differ by far more than noise explains, and the slow pole by a factor of ten; the standard
errors, which see the misfit in either part, allow for that.
"""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Structure, ThreeModel, identify, read_record
from tridentify.errors import UnsupportedOrderError
from tridentify.estimation.likelihood import curvature

pytestmark = pytest.mark.unjudged

PLAIN = ThreeModel(noise="white", finish="likelihood")


def structure(poles, zeros):
    return Structure(poles, zeros, offset=True, initial_state="free")


@pytest.fixture(scope="module")
def record(folder):
    path = folder("heating-system") / "data.csv"
    return read_record(path, time="t", inputs=["u"], outputs=["y"], intersample="zoh")


@pytest.mark.parametrize(
    ("poles", "zeros", "own", "other"), [(1, 0, 92.7, 79.3), (2, 1, 98.0, 90.4)]
)
def test_first_half_predicts_the_second(record, judged, poles, zeros, own, other):
    first, second = record.split(800.0)
    estimate = identify(first, structure(poles, zeros), PLAIN)
    assert estimate.fit[0] == pytest.approx(own, abs=0.2)
    assert judged(estimate.model, second)[0] == pytest.approx(other, abs=0.3)


def test_poles_are_those_of_a_rough_fit(record):
    first, _ = record.split(800.0)
    poles = np.sort(identify(first, structure(2, 1), PLAIN).model.poles.real)
    assert np.allclose(poles, [-0.0338, -0.0044], rtol=0.02)


@pytest.mark.slow
def test_the_first_half_and_the_whole_agree_within_errors_that_allow_for_the_misfit(
    record, monkeypatch
):
    first, _ = record.split(800.0)

    def pair():
        return tuple(identify(r, structure(2, 1), PLAIN) for r in (first, record))

    def apart(one, whole):
        return np.abs(one.theta - whole.theta) / np.hypot(one.std, whole.std)

    one, whole = pair()
    assert whole.fit[0] == pytest.approx(91.9, abs=0.2)
    assert one.errors == whole.errors == "scores"
    assert np.max(apart(one, whole)) < 3.0
    # not for want of saying anything: in the half every coefficient is there
    assert np.all(np.abs(one.theta) > 3.0 * one.std)
    # and what they allow for is there: by errors that know of noise alone no coefficient agrees
    monkeypatch.setattr(curvature, "scatter_of_scores", lambda *_: None)
    assert np.min(apart(*pair())) > 10.0
    slow = [np.max(estimate.model.poles.real) for estimate in (one, whole)]
    assert slow[0] / slow[1] > 5.0


@pytest.mark.slow
def test_two_poles_without_a_zero_are_refused(record):
    """The second pole runs away from the record: the data do not ask for it."""
    first, _ = record.split(800.0)
    with pytest.raises(UnsupportedOrderError):
        identify(first, structure(2, 0), PLAIN)


@pytest.mark.judged
@pytest.mark.slow
def test_a_lamp_that_heats_a_plate_is_not_said_to_do_nothing(record):
    """The fit with coloured noise ends in a valley where noise alone does as well."""
    estimate = identify(record, Structure(2, 1), throw=False)
    assert "no-response" not in [f.code for f in estimate.findings]
