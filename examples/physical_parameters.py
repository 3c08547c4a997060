"""Physical parameters of a DC motor, and what a record says about them.

A voltage drives a motor; its speed is measured. The transfer function has three coefficients and
the motor five parameters, so two of them have to come from elsewhere: the resistance from an
ohmmeter (1 ohm, good to 2 percent) and the motor constant from its data sheet. With the current
measured as well, nothing else is needed.

    python examples/physical_parameters.py
"""

from __future__ import annotations

import numpy as np

from tridentify import Record, simulate
from tridentify.physical import PhysicalModel, dc_motor, estimate_physical

TRUTH = {"R": 1.0, "L": 1e-3, "K": 0.05, "J": 1e-4, "B": 2e-4}
STEP = 2e-4


def measure(motor: PhysicalModel, noise: float, seed: int) -> Record:
    """A record of the motor: voltage switched at random, noise on every sensor."""
    rng = np.random.default_rng(seed)
    voltage = np.sign(rng.standard_normal(60)).repeat(20)
    names = {"input_names": motor.input_names, "output_names": motor.output_names}
    blank = np.zeros((voltage.size, len(motor.output_names)))
    clean = simulate(motor.transfer_function(TRUTH), Record(voltage, blank, dt=STEP, **names))
    noisy = clean + noise * clean.std(axis=0) * rng.standard_normal(clean.shape)
    return Record(voltage, noisy, dt=STEP, **names)


def main() -> None:
    """Three estimates of the same motor."""
    speed = dc_motor()
    record = measure(speed, noise=0.02, seed=1)
    print(estimate_physical(speed, record).summary())
    print(estimate_physical(speed, record, known={"R": (1.0, 0.02), "K": 0.05}).summary())
    both = dc_motor("both")
    print(estimate_physical(both, measure(both, noise=0.02, seed=2)).summary())


if __name__ == "__main__":
    main()
