"""Causes beside the order: play in a valve, and a voltage that drifts."""

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, select_structure, simulate
from tridentify.judgement.causes.system.backlash import play

DT, COUNT = 0.2, 600


def valve(seed: int) -> Record:
    """One or two lags behind a valve with a little play, read in steps of a converter."""
    rng = np.random.default_rng([51, seed])
    command = np.repeat(rng.uniform(-1.0, 1.0, COUNT // 15), 15)
    moved = play(command, np.array([rng.uniform(0.03, 0.07)]), np.nan)[:, 0]
    one = TransferFunction([0.7], [1.0, 0.5])
    two = TransferFunction([0.9], np.polymul([1.0, 0.5], [1.0, 1.2]))
    flow = simulate(two if seed % 2 else one, Record(moved, moved, dt=DT, intersample="zoh"))[:, 0]
    y = flow + 0.004 * rng.standard_normal(COUNT)
    return Record(command, 0.015 * np.round(y / 0.015), dt=DT, intersample="zoh")


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", [1, 6, 10])
def test_no_pole_or_zero_stands_for_play(seed: int) -> None:
    found = select_structure(valve(seed), [(1, 0), (2, 0), (2, 1), (3, 1), (3, 2)])
    assert found.recommended is not None
    assert found.recommended.label == ("2, 0" if seed % 2 else "1, 0")
    assert "play or dry friction" in found.reason
    assert found.recommended.estimate is not None
    assert found.recommended.estimate.findings[0].code == "nonlinear"


def battery(seed: int) -> Record:
    """A lag beside a resistance, and a voltage that falls all the time."""
    rng = np.random.default_rng([52, seed])
    current = np.repeat(rng.choice([-2.0, 0.0, 1.0, 3.0], 40), 15)
    cell = TransferFunction([-0.02, -0.003], [1.0, 1.0 / 12.0])
    y = simulate(cell, Record(current, current, dt=1.0, intersample="zoh"))[:, 0]
    y = y + 0.0005 * rng.standard_normal(y.size) - 0.05 * np.linspace(0.0, 1.0, y.size)
    return Record(current, 3.7 + y, dt=1.0, intersample="zoh")


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", range(2))
def test_a_line_is_no_pole(seed: int) -> None:
    found = select_structure(battery(seed), [(1, 0), (1, 1)], integrators=True).recommended
    assert found is not None
    assert found.label == "1, 1, drift"
    assert found.estimate is not None
    value = found.estimate.parameters["a0"]
    assert abs(value.value - 1.0 / 12.0) < 4.0 * value.std


def test_a_drift_is_said_of_a_structure() -> None:
    from tridentify.judgement.selection.orders import order_label
    from tridentify.judgement.selection.words import named

    drifting = Structure(2, 1, drift=True)
    assert order_label(drifting) == "2, 1, drift"
    assert named(drifting) == "2 poles and 1 zero with a drift"
