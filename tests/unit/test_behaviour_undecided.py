"""What the input does between its samples, where the record cannot say and a zero hangs on it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Estimate, Record, Structure, TransferFunction, identify, simulate

MODEL = TransferFunction([2.0, 6.0], [1.0, 2.0, 4.0])
N, DT, FINE = 500, 0.1, 10


def asked(seed: int, intersample: str, held: bool = False) -> Estimate:
    """An input that moves at every sample, smooth between them or held, and coloured noise."""
    rng = np.random.default_rng(seed)
    u = lfilter([0.05], [1.0, -0.95], np.repeat(rng.standard_normal(N // 10), 10 * FINE))
    if held:
        u = np.repeat(u[::FINE], FINE)
    y = simulate(MODEL, Record(u, u, dt=DT / FINE))[::FINE, 0]
    noise = lfilter([np.sqrt(1 - 0.49)], [1.0, -0.7], rng.standard_normal(N))
    record = Record(u[::FINE], y + 0.15 * y.std() * noise, dt=DT, intersample=intersample)
    return identify(record, Structure(2, 1))


@pytest.mark.parametrize(
    ("seed", "intersample"),
    [(0, "auto"), pytest.param(1, "zoh", marks=pytest.mark.slow)],
)
def test_an_open_question_that_a_coefficient_hangs_on_is_told(seed, intersample) -> None:
    estimate = asked(seed, intersample)
    told = [one for one in estimate.findings if one.code == "intersample"]
    assert [one.severity for one in told] == ["warning"]
    assert "does not tell" in told[0].message
    assert "b1 from" in told[0].effect
    # the zero is where the answers differ: by more than its standard error admits
    assert abs(estimate.parameters["b1"].value - 2.0) > 3.0 * estimate.parameters["b1"].std


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3))])
def test_an_input_that_was_held_as_stated_is_left_alone(seed) -> None:
    estimate = asked(seed, "zoh", held=True)
    assert "intersample" not in [one.code for one in estimate.findings if one.matters]
