"""A residual that is the converter's rounding has no other cause."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate

STEPS = (0.1, 0.32)


def thermometer(seed: int, step: float, noise: float) -> Record:
    """A heater with a time constant of 150 s, in degrees."""
    rng = np.random.default_rng([seed, 52])
    u = np.zeros(900)
    for first, level in zip(np.sort(rng.integers(20, 860, 4)), (60, 20, 80, 40), strict=True):
        u[first:] = level
    plant = TransferFunction([0.6 / 150.0], [1.0, 1.0 / 150.0])
    y = 21.3 + simulate(plant, Record(u, np.zeros(900), dt=1.0))[:, 0]
    return Record(u, np.round(y / step + noise * rng.standard_normal(900)) * step, dt=1.0)


@pytest.mark.fast("0.32-0.1-3")
@pytest.mark.parametrize("seed", range(3, 9))
@pytest.mark.parametrize("noise", [0.0, 0.1])
@pytest.mark.parametrize("step", STEPS)
def test_quantisation_comes_first(seed: int, noise: float, step: float) -> None:
    found = identify(thermometer(seed, step, noise), Structure(1, 0)).findings
    assert [one.code for one in found if one.matters][:1] == ["quantisation"]


@pytest.mark.slow
def test_a_cause_beyond_the_steps_is_named_all_the_same() -> None:
    """A delay of six samples moves the output by more than a step."""
    record = thermometer(4, 0.1, 0.1)
    late = Record(record.u[6:], record.y[:-6], dt=1.0)
    found = identify(late, Structure(1, 0, initial_state="free", offset=True)).findings
    assert found[0].code == "delay"
