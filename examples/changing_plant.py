"""An aircraft whose short period changes in flight, identified while the data arrive.

The aircraft is the A-4 of the demonstration record: derivatives of its short period at 200 m/s and
5000 m as JSBSim gives them (`src/tridentify/data/README.md`). What happens to it is made up:

* its speed falls from 200 to 185 m/s in the first 30 s, and the derivatives with it: those of
  force and of damping with the speed, those of stability and of the elevator with its square
  (thin air of constant density; the Mach number is left out);
* at 30 s fuel is pumped aft, the centre of gravity with it, and half of the static stability
  ``M_alpha`` is gone within one sample.

The pilot flies a 3-2-1-1 at 2 s and at 36 s, and small doublets with pauses between them. Light
gusts shake the aircraft (angle of attack of a first-order spectrum), the pitch rate has measurement
noise, some of its samples are missing, and for half a second at 50 s the sensor hangs.

The model is ``q / elevator = (b1 s + b0) / (s^2 + a1 s + a0)``; old samples are forgotten.

    python examples/changing_plant.py [--out DIRECTORY] [--seed SEED] [--seconds T]
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from tridentify import Record, Structure, online
from tridentify.plots import plot_trajectory

Array = npt.NDArray[np.float64]

DT, DURATION, CHANGE = 0.02, 70.0, 30.0  # s
DERIVATIVES = {  # at 200 m/s
    "Z_alpha": -1.05470, "Z_delta": -0.05920, "M_alpha": -11.2524, "M_q": -0.98764,
    "M_delta": -11.9720,
}  # fmt: skip
WITH_SPEED = {"Z_alpha": 1, "Z_delta": 1, "M_alpha": 2, "M_q": 1, "M_delta": 2}
LEFT_OF_STABILITY = 0.5
UNIT, AMPLITUDE = 0.4, 1.0  # s, deg
GUST, GUST_TIME, NOISE = 0.05, 1.5, 0.1  # deg, s, deg/s
MISSING, HANGING = 0.01, (50.0, 50.5)  # share of the samples, s
MEMORY = 10.0  # s


def derivatives(t: float) -> dict[str, float]:
    """Stability and control derivatives at a time [1/s and 1/s^2]."""
    speed = 1.0 - 0.075 * min(t / CHANGE, 1.0)
    now = {name: value * speed ** WITH_SPEED[name] for name, value in DERIVATIVES.items()}
    if t >= CHANGE:
        now["M_alpha"] *= LEFT_OF_STABILITY
    return now


def coefficients(t: Array) -> dict[str, Array]:
    """Those of q / elevator at the times ``t`` (k,) [s]."""
    at = [derivatives(one) for one in t.tolist()]
    d = {name: np.array([one[name] for one in at]) for name in DERIVATIVES}
    return {
        "a1": -(d["Z_alpha"] + d["M_q"]),
        "a0": d["Z_alpha"] * d["M_q"] - d["M_alpha"],
        "b1": d["M_delta"],
        "b0": d["M_alpha"] * d["Z_delta"] - d["Z_alpha"] * d["M_delta"],
    }


def elevator() -> Array:
    """Deflections [deg]: two 3-2-1-1, doublets, pauses."""
    u = np.zeros(round(DURATION / DT))

    def pulses(start: float, widths: tuple[float, ...], amplitude: float) -> None:
        edges = start + UNIT * np.cumsum((0.0, *widths))
        for k, (first, last) in enumerate(itertools.pairwise(edges)):
            u[round(first / DT) : round(last / DT)] = amplitude * (-1) ** (k + 1)

    for start in (2.0, 36.0):
        pulses(start, (3, 2, 1, 1), AMPLITUDE)
    for k, start in enumerate(
        (8.0, 13.0, 18.0, 22.0, 26.0, 29.0, 32.0, 43.0, 48.0, 54.0, 60.0, 65.0)
    ):
        pulses(start, (1, 1), 0.5 * AMPLITUDE * (-1) ** k)
    return u


def fly(seed: int) -> tuple[Array, Array]:
    """Elevator [deg] and what the pitch-rate sensor says [deg/s]."""
    rng = np.random.default_rng(seed)
    u = elevator()
    state, gust, q = np.zeros(2), 0.0, np.zeros(u.size)
    keep = np.exp(-DT / GUST_TIME)
    for k in range(u.size):
        q[k] = state[1]
        d = derivatives((k + 0.5) * DT)
        rates = np.zeros((4, 4))
        rates[0] = d["Z_alpha"], 1.0, d["Z_delta"], d["Z_alpha"]
        rates[1] = d["M_alpha"], d["M_q"], d["M_delta"], d["M_alpha"]
        state = (expm(rates * DT) @ np.array([*state, u[k], gust]))[:2]
        gust = keep * gust + GUST * np.sqrt(1 - keep**2) * rng.standard_normal()
    q += NOISE * rng.standard_normal(q.size)
    q[rng.random(q.size) < MISSING] = np.nan
    first, last = (round(t / DT) for t in HANGING)
    q[first:last] = q[first]
    return u, q


def tell(estimate_time: float, estimate: object) -> None:
    """Coefficients with standard errors beside the truth."""
    truth = coefficients(np.array([estimate_time]))
    print(f"  at {estimate_time:5.2f} s" + "".join(f"{name:>18s}" for name in truth))
    rows = [estimate.parameters[name] for name in truth]  # type: ignore[attr-defined]
    print("    estimate " + "".join(f"{row.value:9.3f} +- {row.std:5.3f}" for row in rows))
    print("    truth    " + "".join(f"{value[0]:9.3f}         " for value in truth.values()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    folder = Path("build/examples")
    parser.add_argument("--out", type=Path, default=folder, help="folder of changing_plant.png")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=DURATION, help="of the flight")
    given = parser.parse_args()
    u, q = (samples[: round(given.seconds / DT)] for samples in fly(given.seed))
    method = online.ThreeModel(forgetting=1.0 - DT / MEMORY)
    structure = Structure(poles=2, zeros=1)
    names = {"input_names": ("elevator",), "output_names": ("q",)}
    state = method.init(structure, DT, units={"elevator": "deg", "q": "deg/s"}, **names)
    before = online.Flag(0)
    for k in range(u.size):
        state, _ = method.step(state, u[k], q[k])
        new = state.flags & ~before
        if new & (online.Flag.STUCK | online.Flag.NOT_EXCITED | online.Flag.CHANGED):
            print(f"{k * DT:6.2f} s  {new}")
        before = state.flags
        if k + 1 == round(CHANGE / DT):
            tell(k * DT, method.estimate(state))
    print(f"changes found at {[round(c * DT, 2) for c in state.changes]} s")
    tell((u.size - 1) * DT, method.estimate(state))
    record = Record(
        u,
        q,
        dt=DT,
        input_names=["elevator"],
        output_names=["q"],
        units={"elevator": "deg", "q": "deg/s"},
    )
    run = online.run(method, record, structure)
    axes = plot_trajectory(run, coefficients(run.time))
    given.out.mkdir(parents=True, exist_ok=True)
    axes.savefig(given.out / "changing_plant.png", dpi=130)


if __name__ == "__main__":
    main()
