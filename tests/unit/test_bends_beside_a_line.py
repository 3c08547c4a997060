"""A power of a signal is a bend only as far as no straight line is one."""

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate, validate
from tridentify.judgement.causes.attempts.rivals import _bent, _scheduled


def test_two_levels_have_no_bend_and_three_have_one() -> None:
    rng = np.random.default_rng(0)
    two, three = rng.choice([-1.0, 2.0], 200), rng.choice([-1.0, 0.0, 1.0], 200)
    assert _bent([two], 2) is None
    assert _bent([two], 3) is None
    (bent,) = _bent([three], 2) or ()
    line = np.column_stack([np.ones(200), three])
    # no line is left in it, and it begins without a jump
    assert abs(np.linalg.lstsq(line, bent)[0][1]) < 1e-9
    assert bent[0] == 0.0
    assert _bent([np.zeros(5)], 2) is None


def test_a_gain_that_changes_counts_from_the_means_and_begins_without_a_jump() -> None:
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((2, 50))
    record = Record(u, y, dt=0.1)
    (here,) = _scheduled([record], [y[:, None]], 0, 0)
    (moved,) = _scheduled([Record(u + 3.0, y, dt=0.1)], [y[:, None] - 7.0], 0, 0)
    assert np.allclose(here, moved)
    assert here[0] == 0.0
    assert np.allclose(np.diff(here), np.diff((u - u.mean()) * (y - y.mean())))


@pytest.mark.slow
def test_a_drift_under_an_input_of_two_levels_is_no_bend() -> None:
    rng = np.random.default_rng(2)
    u = np.repeat(rng.choice([-1.0, 1.0], 60), 8)
    y = simulate(TransferFunction([4.0], [1.0, 1.2, 4.0]), Record(u, u, dt=0.1))[:, 0]
    x = np.linspace(0.0, 1.0, u.size)
    slow = 0.5 * np.std(y) * (x**2 + 0.5 * np.sin(4 * x))
    record = Record(u, y + slow + 0.1 * rng.standard_normal(u.size), dt=0.1)
    asked = Structure(2, 0, offset=False, initial_state="rest")
    found = validate(identify(record, asked), record).findings
    assert found[0].code == "drift"
