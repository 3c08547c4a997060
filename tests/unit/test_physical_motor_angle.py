"""A motor whose angle is measured: one pole at the origin, known."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, TransferFunction, simulate
from tridentify.physical import dc_motor, estimate_physical

TRUE = {"R": 1.2, "L": 0.03, "K": 0.4, "J": 0.005, "B": 0.01}


def turned() -> Record:
    rng = np.random.default_rng(4)
    u = 6.0 * np.repeat(rng.choice([-1.0, 0.0, 1.0], 80), 10)
    j_l = TRUE["J"] * TRUE["L"]
    a1 = (TRUE["J"] * TRUE["R"] + TRUE["B"] * TRUE["L"]) / j_l
    a0 = (TRUE["B"] * TRUE["R"] + TRUE["K"] ** 2) / j_l
    speed = TransferFunction([TRUE["K"] / j_l], [1.0, a1, a0])
    fine = Record(np.repeat(u, 20), np.zeros(16_000), dt=2.5e-4)
    w = simulate(speed, fine)[:, 0]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1])) * 2.5e-4])[::20]
    return Record(
        u,
        angle + 2e-3 * rng.standard_normal(800),
        dt=5e-3,
        input_names=["voltage"],
        output_names=["angle"],
    )


def test_angle_gives_the_same_motor_as_speed():
    speed, angle = dc_motor("speed"), dc_motor("angle")
    assert angle.theta(TRUE)[[0, 1, 3]] == pytest.approx(speed.theta(TRUE))
    assert angle.theta(TRUE)[2] == 0.0


def test_parameters_from_the_angle_with_two_of_them_known():
    found = estimate_physical(dc_motor("angle"), turned(), known={"R": TRUE["R"], "L": TRUE["L"]})
    for name in ("K", "J", "B"):
        parameter = found.parameters[name]
        assert parameter.std > 0
        assert abs(parameter.value - TRUE[name]) < 4.0 * parameter.std, name
        assert parameter.std < 0.3 * TRUE[name], name
