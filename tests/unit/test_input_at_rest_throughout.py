"""An input that never moves: that is said, and nothing that only a moving one could show."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.errors import ConstantInputError


def still(seed, count=300):
    rng = np.random.default_rng(seed)
    y = np.zeros(count)
    for k in range(1, count):
        y[k] = 0.9 * y[k - 1] + 0.1 * rng.standard_normal()
    return Record(np.full(count, 5.0), y, dt=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_the_first_finding_is_that_the_input_does_not_move(seed):
    codes = [one.code for one in identify(still(seed), Structure(1, 0), throw=False).findings]
    assert codes[0] in ("constant-input", "not-converged")
    assert "constant-input" in codes
    assert not {"feedback", "nonlinear", "no-response"} & set(codes)


def test_its_delay_is_refused_in_these_words():
    with pytest.raises(ConstantInputError, match="stays at 5 together"):
        identify(still(14), Structure(1, 0, delay="free"))


def test_switched_on_at_the_first_sample_it_has_a_response():
    u = np.full(200, 2.0)
    y = simulate(TransferFunction([3.0], [2.0, 1.0]), Record(u, u, dt=0.1))[:, 0]
    y = y + 0.05 * np.random.default_rng(15).standard_normal(200)
    estimate = identify(Record(u, y, dt=0.1), Structure(1, 0, initial_state="rest"))
    assert estimate.model.dc_gain[0, 0] == pytest.approx(3.0, rel=0.05)
    assert [one.code for one in estimate.findings][:1] == ["constant-input"]
