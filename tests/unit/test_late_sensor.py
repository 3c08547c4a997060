"""A sensor that is late makes all inputs late at once: that is one cause, and named as one."""

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate, validate

LATE = 0.4
DT = 0.1


def two_inputs(seed: int, late: float) -> Record:
    """Two test signals to one output, both seen late, in noise of three percent."""
    rng = np.random.default_rng(seed)
    n = 400
    u = np.column_stack([np.repeat(rng.choice([-1.0, 1.0], n // k), k) for k in (4, 5)])
    den = [1.0, 2.4, 4.0]
    plant = TransferFunction([[[4.0], [-3.0]]], [[den, den]], delay=[[late, late]])
    y = simulate(plant, Record(u, np.zeros(n), dt=DT))[:, 0]
    return Record(u, y + 0.03 * np.std(y) * rng.standard_normal(n), dt=DT)


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3))])
@pytest.mark.slow
def test_one_delay_of_all_inputs_is_named_first(seed: int) -> None:
    record = two_inputs(seed, LATE)
    first = validate(identify(record, Structure(2, 0)), record).findings[0]
    assert first.code == "delay"
    assert "every input" in first.message
    told = float(first.message.split("a delay of about ")[1].split(" s ")[0])
    assert told == pytest.approx(LATE, abs=0.3 * DT)


@pytest.mark.slow
def test_inputs_that_are_not_late_are_not_called_so() -> None:
    record = two_inputs(4, 0.0)
    assert not any(f.code == "delay" for f in identify(record, Structure(2, 0)).findings)
