"""Two controllers on JSBSim's A-4 in gusts: what open loop says of the aircraft, and what is true.

* **damper**: ``elevator = stick + K q``, the gyro's noise and what gusts do to the pitch rate
  included. The reference is the stick.
* **hold**: the centre of gravity 20 in further aft, where the aircraft is statically unstable: left
  alone, a disturbance doubles in a second. An attitude hold flies it; the reference is the pitch
  attitude it is told to take.

Pitch rate from elevator is identified from each flight three times: by the reference, by open-loop
output error, which takes the noise for white, and in open loop with a noise model. The truth is
the engine's own, its accelerations linearised at trim.

    pip install "tridentify[jsbsim]" matplotlib
    python examples/jsbsim_loops.py [--draws N] [--seconds T] [--out DIRECTORY]

writes ``jsbsim_loops.json`` and ``jsbsim_loops.png``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jsbsim_short_period import (
    ADAMS_BASHFORTH_3,
    FOOT,
    Aircraft,
    Array,
    Trim,
    short_period,
)
from scipy.linalg import expm, solve_continuous_lyapunov

from tridentify import Estimate, Record, Structure, ThreeModel, TridentifyError, identify
from tridentify.uncertainty import poles

RATE_NOISE, ATTITUDE_NOISE = 0.2, 0.05
"""Of the sensors of pitch rate [deg/s] and pitch attitude [deg]."""
GUST_LENGTH = 533.0
"""Of the vertical gusts of MIL-F-8785C above 2000 ft [m]."""
INTERVAL, FRAME = 0.02, 1e-3
"""Of samples and controller, and of the engine [s]."""
STRUCTURE = Structure(2, 1, offset=True)
NAMES = {"a1": "a1", "a0": "a0", "b1": "c1", "b0": "c0"}
"""Coefficient of the estimate: its name in the truth."""
WAYS = {
    "reference": ThreeModel(controller="sampled"),
    "open loop, white noise": ThreeModel(route="open-loop", noise="white"),
    "open loop, noise model": ThreeModel(route="open-loop"),
}


@dataclass(frozen=True)
class Case:
    """A flight: where the centre of gravity is, the controller, the reference and the gusts."""

    name: str
    aft: float
    """[in]."""
    amplitude: float
    """Of the reference [deg]."""
    pieces: tuple[float, float]
    """Shortest and longest of them [s]."""
    rate_gain: float
    """[s]."""
    attitude_gain: float = 0.0
    gusts: float = 2.0
    """Root mean square of the vertical ones [m/s]."""
    duration: float = 60.0
    speed: float = 200.0
    altitude: float = 5000.0


CASES = {
    "damper": Case("damper", aft=0.0, amplitude=0.7, pieces=(0.3, 1.2), rate_gain=0.3),
    "hold": Case(
        "hold", aft=20.0, amplitude=1.5, pieces=(0.4, 2.4), rate_gain=0.3, attitude_gain=0.6,
        gusts=1.0,
    ),
}  # fmt: skip


class Loop:
    """An aircraft in trim, its truth, and how it is flown."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.aircraft = Aircraft("A4", case.aft)
        self.trim: Trim = self.aircraft.trim(case.speed, case.altitude)
        a_matrix, column = self.aircraft.linearise(self.trim)
        with np.errstate(invalid="ignore"):  # an unstable aircraft has no damping ratio
            values = short_period(a_matrix, column)
        self.truth = {name: values[true] for name, true in NAMES.items()}
        self.growth = float(np.linalg.eigvals(a_matrix).real.max())
        """Real part of the rightmost of all five poles [1/s]."""

    def fly(self, seed: int) -> Record:
        """A record of elevator and pitch rate with its reference."""
        rng, case = np.random.default_rng(seed), self.case
        count = round(case.duration / INTERVAL)
        wanted = steps(rng, count, case)
        gust = gusts(rng, count, case) if case.gusts else np.zeros(count)
        noise = np.radians([RATE_NOISE, ATTITUDE_NOISE]) * rng.standard_normal((count, 2))
        return self.record(wanted, gust, noise)

    def record(self, wanted: Array, gust: Array, noise: Array) -> Record:
        """Of a flight with these references [rad], gusts [m/s] and noise [rad/s, rad]."""
        case = self.case

        def law(k: int, q: float, theta: float) -> float:
            attitude = case.attitude_gain
            asked = attitude * (theta - wanted[k]) if attitude else wanted[k]
            return asked + case.rate_gain * q

        u, y = self._run(law, gust, noise)
        names = {"input_names": ["elevator"], "output_names": ["q"]}
        units = {"elevator": "rad", "q": "rad/s"}
        return Record(u, y, dt=INTERVAL, reference=wanted, units=units, **names)

    def _run(
        self, law: Callable[[int, float, float], float], gust: Array, noise: Array
    ) -> tuple[Array, Array]:
        """Elevator from its trim and measured pitch rate, the controller's output held."""
        trim, engine = self.trim, self.aircraft.engine
        for _ in range(2):
            self.aircraft.settle(trim.state, trim.delta_e, trim.throttle)
        for name, value in ADAMS_BASHFORTH_3.items():
            engine[name] = value
        engine.set_dt(FRAME)
        u, y = np.empty(len(gust)), np.empty(len(gust))
        for k in range(len(gust)):
            y[k] = engine["velocities/q-rad_sec"] + noise[k, 0]
            theta = engine["attitude/theta-rad"] - trim.theta + noise[k, 1]
            u[k] = law(k, y[k], theta)
            engine["atmosphere/gust-down-fps"] = gust[k] / FOOT
            engine["fcs/elevator-pos-rad"] = trim.delta_e + u[k]
            for _ in range(round(INTERVAL / FRAME)):
                engine.run()
        engine["atmosphere/gust-down-fps"] = 0.0
        return u, y


def steps(rng: np.random.Generator, count: int, case: Case) -> Array:
    """Doublets of random length and sign after a second of rest [rad].

    What goes up comes down for as long: otherwise the aircraft gains speed and is another one.
    """
    wanted, k = np.zeros(count), round(1.0 / INTERVAL)
    shortest, longest = (round(length / INTERVAL) for length in case.pieces)
    while k < count:
        length = int(rng.integers(shortest, longest))
        sign = np.radians(case.amplitude) * rng.choice([-1.0, 1.0])
        wanted[k : k + length] = sign
        wanted[k + length : k + 2 * length] = -sign
        k += 2 * length
    return wanted


def gusts(rng: np.random.Generator, count: int, case: Case) -> Array:
    """Vertical gusts with Dryden's spectrum, (1 + sqrt(3) T s) / (1 + T s)^2 of white noise."""
    time = GUST_LENGTH / case.speed
    a, b = np.array([[-2.0 / time, -1.0 / time**2], [1.0, 0.0]]), np.array([1.0, 0.0])
    row = np.array([np.sqrt(3.0) * time, 1.0])
    variance = solve_continuous_lyapunov(a, -np.outer(b, b))
    step = expm(a * INTERVAL)
    drive = np.linalg.cholesky(variance - step @ variance @ step.T)
    state = np.linalg.cholesky(variance) @ rng.standard_normal(2)
    found = np.empty(count)
    for k in range(count):
        found[k] = row @ state
        state = step @ state + drive @ rng.standard_normal(2)
    return case.gusts / np.sqrt(row @ variance @ row) * found


def rightmost(estimate: Estimate) -> tuple[float, float]:
    """Real part of the rightmost pole and its standard error [1/s]."""
    found = poles(estimate)
    k = int(np.argmax(found.roots.real))
    return float(found.roots[k].real), float(np.sqrt(found.cov[k, 0, 0]))


def study(case: Case, draws: int) -> dict[str, Any]:
    """Estimates of all ways from some flights, and the truth."""
    loop = Loop(case)
    rows: dict[str, list[Estimate]] = {way: [] for way in WAYS}
    for seed in range(draws):
        record = loop.fly(seed)
        for way, method in WAYS.items():
            try:
                rows[way].append(identify(record, STRUCTURE, method, throw=False))
            except TridentifyError as refused:
                print(f"{case.name}, flight {seed}, {way}: no estimate: {refused}")
    return {"loop": loop, "estimates": rows}


def table(found: dict[str, Any]) -> list[str]:
    """Mean of the estimates over the flights, and what one flight tells of its error."""
    loop: Loop = found["loop"]
    head = "".join(f"{name:>18s}" for name in NAMES)
    lines = [f"{loop.case.name:24s}{head}{'rightmost pole':>18s}"]
    told = "".join(f"{value:18.3f}" for value in loop.truth.values())
    # of a stable aircraft the rightmost pole is the phugoid's, which two poles do not have
    end = f"{loop.growth:18.3f}" if loop.growth > 0.0 else ""
    lines.append(f"{'  truth':24s}{told}{end}")
    for way, estimates in found["estimates"].items():
        if not estimates:
            continue
        cells = ""
        for name in NAMES:
            rows = [one.parameters[name] for one in estimates]
            mean, error = np.mean([r.value for r in rows]), np.median([r.std for r in rows])
            cells += f"{mean:10.3f} +- {error:<5.2f}"[:18].rjust(18)
        ends = [rightmost(one) for one in estimates]
        end = f"{np.mean([e[0] for e in ends]):.3f} +- {np.median([e[1] for e in ends]):.3f}"
        lines.append(f"  {way:22s}{cells}{end:>18s}")
    return lines


def draw(studies: dict[str, dict[str, Any]]) -> Any:
    """The damper's Bode magnitude and the unstable pole: by each way, and in truth."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter, StrMethodFormatter

    figure, (bode, pole) = plt.subplots(1, 2, figsize=(9.0, 3.4), constrained_layout=True)
    colours = dict(zip(WAYS, ("tab:blue", "tab:red", "tab:orange"), strict=True))
    found, omega = studies["damper"], np.geomspace(0.3, 20.0, 120)
    for way, estimates in reversed(found["estimates"].items()):
        for k, one in enumerate(estimates):
            size = np.abs(one.model.frequency_response(omega)[:, 0, 0])
            bode.loglog(omega, size, color=colours[way], lw=1.0, label=way if not k else None)
    s, truth = 1j * omega, found["loop"].truth
    true = (truth["b1"] * s + truth["b0"]) / (s**2 + truth["a1"] * s + truth["a0"])
    bode.loglog(omega, np.abs(true), color="black", lw=2.0, ls="--", label="truth")
    for axis in (bode.xaxis, bode.yaxis):
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())
    bode.set_yticks([0.5, 1.0, 2.0, 5.0])
    bode.set_xlabel("frequency [rad/s]")
    bode.set_ylabel("pitch rate / elevator [1/s]")
    bode.set_title("Pitch damper in gusts")
    bode.legend(fontsize=8)
    for row, (way, estimates) in enumerate(studies["hold"]["estimates"].items()):
        for k, one in enumerate(estimates):
            value, error = rightmost(one)
            bar = 1.96 * error if np.isfinite(error) else 0.0
            place = row + 0.5 * (k / max(len(estimates) - 1, 1) - 0.5)
            pole.errorbar(value, place, xerr=bar, fmt="o", ms=4, color=colours[way])
    pole.axvline(studies["hold"]["loop"].growth, color="black", lw=2.0, ls="--")
    pole.axvline(0.0, color="0.7", lw=0.8)
    pole.invert_yaxis()
    pole.set_yticks(range(len(WAYS)), [way.replace(", ", ",\n") for way in WAYS])
    pole.set_xlabel("rightmost pole with 95 % interval [1/s]")
    pole.set_title("Statically unstable, attitude held")
    return figure


def stored(found: dict[str, Any]) -> dict[str, Any]:
    """What of a study is written down."""
    loop: Loop = found["loop"]
    numbers = {
        way: [
            {n: [one.parameters[n].value, one.parameters[n].std] for n in NAMES}
            | {"rightmost": list(rightmost(one)), "route": one.route}
            for one in estimates
        ]
        for way, estimates in found["estimates"].items()
    }
    return {
        "case": asdict(loop.case), "truth": loop.truth, "rightmost": loop.growth,
        "estimates": numbers,
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("build/examples"))
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=Case.duration, help="of every flight")
    given = parser.parse_args()
    cases = {name: replace(case, duration=given.seconds) for name, case in CASES.items()}
    studies = {name: study(case, given.draws) for name, case in cases.items()}
    for found in studies.values():
        print("\n".join(table(found)), flush=True)
    given.out.mkdir(parents=True, exist_ok=True)
    kept = {name: stored(found) for name, found in studies.items()}
    (given.out / "jsbsim_loops.json").write_text(json.dumps(kept, indent=1) + "\n")
    draw(studies).savefig(given.out / "jsbsim_loops.png", dpi=130)


if __name__ == "__main__":
    main()
