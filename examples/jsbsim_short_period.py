"""Make the demonstration record: a short-period manoeuvre flown by JSBSim.

JSBSim is an independent, non-linear flight dynamics engine with six degrees of freedom. This script
trims one of its aircraft, drives the elevator through a 3-2-1-1 and its mirror image, writes the
record with measurement noise to ``short_period.csv``, and beside it ``short_period.json``: the
linearised truth and all that is needed to make it again. The same command gives the same bytes.

    pip install jsbsim scipy
    python examples/jsbsim_short_period.py [--out DIRECTORY]

* The aircraft is loaded from a private temporary copy in which the outputs of its flight control
  system are detached, so that what is set at the surface stays there: no actuator, no damper.
* The elevator is constant between two rows, so the recorded column *is* the input (zero-order
  hold). All four integrators are third-order Adams-Bashforth at 0.1 ms (the default is first order
  at 1/120 s). They run half a frame ahead of a jump of the input, which b1 = Z_de feels (error
  b0 dt / 2); half of the jump applied in the frame where it happens takes that out.
* The truth comes from central differences of the engine's own accelerations at trim. Each is
  evaluated several times, because the aerodynamics use the alpha rate of the evaluation before.

Angles are absolute. Elevator positive is trailing edge down: its gains to alpha and q are negative.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jsbsim
import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from scipy.optimize import least_squares

Array = npt.NDArray[np.float64]

FOOT, SLUG, POUND_PER_SQUARE_FOOT = 0.3048, 14.593902937206364, 47.88025898033584  # m, kg, Pa
ADAMS_BASHFORTH_3 = {
    f"simulation/integrator/{level}/{motion}": 4.0
    for level in ("rate", "position")
    for motion in ("rotational", "translational")
}
STATES = ("V", "alpha", "q", "theta", "h")
# Central-difference steps; the result is the same for steps ten times larger or smaller.
STATE_STEPS, ELEVATOR_STEP = (0.1, 1e-4, 1e-4, 1e-4, 1.0), 1e-4
# A manoeuvre and its mirror image: what is even in the amplitude nearly cancels over the record,
# so that a two-pole linear model is closer to the truth than with either half alone.
NOSE_UP_FIRST = ((3, -1), (2, 1), (1, -1), (1, 1))
MANOEUVRE = (*NOSE_UP_FIRST, (2, 0), *((length, -sign) for length, sign in NOSE_UP_FIRST))
COLUMNS = ("t", "delta_e", "alpha", "q", "alpha_true", "q_true")
UNITS = {
    "t": "s", "delta_e": "rad", "alpha": "rad", "q": "rad/s", "alpha_true": "rad",
    "q_true": "rad/s", "V": "m/s", "theta": "rad", "h": "m", "throttle": "1", "mach": "1",
    "dynamic_pressure": "Pa", "mass": "kg", "a1": "1/s", "a0": "1/s^2", "b1": "1/s",
    "b0": "1/s^2", "c1": "1/s^2", "c0": "1/s^3", "natural_frequency": "rad/s", "damping": "1",
}  # fmt: skip
FLIGHT_UNITS = {
    "speed": "m/s, true", "altitude": "m", "amplitude": "deg", "unit": "s", "start": "s",
    "duration": "s", "rate": "1/s", "frame": "s", "alpha_noise": "deg", "q_noise": "deg/s",
}  # fmt: skip
DEFAULT_OUT = Path(__file__).resolve().parents[1] / "src" / "tridentify" / "data"


@dataclass(frozen=True)
class Flight:
    """What is flown: aircraft, condition, manoeuvre, rates and noise."""

    aircraft: str = "A4"
    speed: float = 200.0
    altitude: float = 5000.0
    amplitude: float = 1.0  # below the trim elevator: the drag table has a kink at zero elevator
    unit: float = 0.4  # length of the "1" of the 3-2-1-1
    start: float = 1.0
    duration: float = 10.0
    rate: float = 50.0
    frame: float = 1e-4
    alpha_noise: float = 0.25
    q_noise: float = 0.2
    seed: int = 2026


@dataclass(frozen=True)
class Trim:
    """Steady straight and level flight; SI units, angles in rad, V and h those of the flight."""

    V: float
    alpha: float
    q: float
    theta: float
    h: float
    delta_e: float
    throttle: float
    mach: float
    dynamic_pressure: float
    mass: float

    @property
    def state(self) -> Array:
        """The state (5,)."""
        return np.array([getattr(self, name) for name in STATES])


class Aircraft:
    """A JSBSim aircraft in straight flight over the equator, heading north, surfaces detached.

    Its empty centre of gravity may be moved aft [in].
    """

    def __init__(self, name: str, aft: float = 0.0) -> None:
        logger = jsbsim.DefaultLogger()
        logger.set_min_level(jsbsim.LogLevel.ERROR)
        jsbsim.set_logger(logger)
        root = Path(jsbsim.get_default_root_dir())
        self.source = root / "aircraft" / name / f"{name}.xml"
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / name / self.source.name
            copy.parent.mkdir()
            text = _balance(_detach(self.source.read_text(encoding="utf-8")), aft)
            copy.write_text(text, encoding="utf-8")
            self.engine = jsbsim.FGFDMExec(f"{root}/")
            self.engine.set_debug_level(0)
            loaded = self.engine.load_model_with_paths(
                name, folder, str(root / "engine"), str(root / "systems"), True
            )
        if not loaded:
            raise RuntimeError(f"found no loadable aircraft {name!r}; expected one of JSBSim's own")
        # On the equator and heading north Earth rotation is along the path: no side force.
        self._set({"ic/lat-gc-deg": 0.0, "ic/long-gc-deg": 0.0, "ic/psi-true-rad": 0.0})
        self._place((200.0, 0.0, 0.0, 0.0, 1000.0))
        self._set({"propulsion/set-running": -1.0, "propulsion/fuel_freeze": 1.0})

    def _set(self, values: Mapping[str, float]) -> None:
        for name, value in values.items():
            # JSBSim ignores an unknown property without a word.
            if not self.engine.get_property_manager().hasNode(name):
                raise KeyError(name)
            self.engine[name] = value

    def _place(self, state: Sequence[float] | Array) -> None:
        speed, alpha, q, theta, altitude = (float(value) for value in state)
        self._set({
            "ic/h-sl-ft": altitude / FOOT,
            "ic/phi-rad": 0.0, "ic/theta-rad": theta,
            # After the attitude: from here on the body-axis velocity is what is kept.
            "ic/u-fps": speed * math.cos(alpha) / FOOT,
            "ic/v-fps": 0.0, "ic/w-fps": speed * math.sin(alpha) / FOOT,
            "ic/p-rad_sec": 0.0, "ic/q-rad_sec": q, "ic/r-rad_sec": 0.0,
        })  # fmt: skip
        if not self.engine.run_ic():
            raise RuntimeError("JSBSim refused the initial condition")

    def settle(self, state: Sequence[float] | Array, elevator: float, throttle: float) -> None:
        """Put the aircraft into a state, engine at steady power, all rates consistent."""
        self._set({
            "fcs/left-aileron-pos-rad": 0.0, "fcs/right-aileron-pos-rad": 0.0,
            "fcs/rudder-pos-rad": 0.0, "fcs/elevator-pos-rad": elevator,
            "gear/gear-pos-norm": 0.0,
        })  # fmt: skip
        for number in range(self.engine.get_propulsion().get_num_engines()):
            names = (f"fcs/throttle-{kind}-norm[{number}]" for kind in ("cmd", "pos"))
            self._set(dict.fromkeys(names, throttle))
        self._place(state)
        self.engine.suspend_integration()
        self.engine.run()
        self.engine.get_propulsion().get_steady_state()
        # The aerodynamics of one evaluation use the alpha rate of the one before.
        for _ in range(8):
            self.engine.run()
        self.engine.resume_integration()

    def rates(self, state: Sequence[float] | Array, elevator: float, throttle: float) -> Array:
        """Time derivative (5,) of (V, alpha, q, theta, h)."""
        self.settle(state, elevator, throttle)
        read = self.engine
        u, w, u_rate, w_rate = (
            FOOT * read[name]
            for name in ("velocities/u-fps", "velocities/w-fps",
                         "accelerations/udot-ft_sec2", "accelerations/wdot-ft_sec2")
        )  # fmt: skip
        speed = math.hypot(u, w)
        return np.array([
            (u * u_rate + w * w_rate) / speed,
            (u * w_rate - w * u_rate) / speed**2,
            read["accelerations/qdot-rad_sec2"],
            read["velocities/thetadot-rad_sec"],
            read["velocities/h-dot-fps"] * FOOT,
        ])  # fmt: skip

    def trim(self, speed: float, altitude: float) -> Trim:
        """Find steady straight and level flight: no acceleration on any axis."""

        def rates(unknown: Array) -> Array:
            alpha, elevator, throttle = unknown.tolist()
            return self.rates((speed, alpha, 0.0, alpha, altitude), elevator, throttle)

        solution = least_squares(
            rates, [0.05, -0.03, 0.3],
            xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac",
        )  # fmt: skip
        alpha, elevator, throttle = solution.x.tolist()
        residual = rates(solution.x).tolist()
        lateral = ("vdot-ft_sec2", "pdot-rad_sec2", "rdot-rad_sec2")
        residual += [self.engine[f"accelerations/{name}"] for name in lateral]
        worst = float(np.abs(residual).max())
        if worst > 1e-7:
            raise RuntimeError(f"found a trim residual of {worst:.1e}; expected below 1e-7")
        return Trim(
            V=speed, alpha=alpha, q=0.0, theta=alpha, h=altitude,
            delta_e=elevator, throttle=throttle,
            mach=self.engine["velocities/mach"],
            dynamic_pressure=self.engine["aero/qbar-psf"] * POUND_PER_SQUARE_FOOT,
            mass=self.engine["inertia/mass-slugs"] * SLUG,
        )  # fmt: skip

    def linearise(self, trim: Trim, scale: float = 1.0) -> tuple[Array, Array]:
        """State matrix (5, 5) and elevator column (5,) by central differences of the rates."""

        def difference(step: Array, elevator_step: float) -> Array:
            plus = self.rates(trim.state + step, trim.delta_e + elevator_step, trim.throttle)
            minus = self.rates(trim.state - step, trim.delta_e - elevator_step, trim.throttle)
            return (plus - minus) / (2.0 * (float(step.sum()) + elevator_step))

        steps = np.diag(STATE_STEPS) * scale
        a_matrix = np.column_stack([difference(step, 0.0) for step in steps])
        return a_matrix, difference(np.zeros(5), ELEVATOR_STEP * scale)

    def fly(self, trim: Trim, elevator: Array, interval: float, frame: float) -> Array:
        """Fly a piecewise constant elevator (n,) [rad]; alpha [rad] and q [rad/s], (n, 2)."""
        # Twice: the integrators' past is filled by run_ic(), whose alpha rate is the one before it.
        for _ in range(2):
            self.settle(trim.state, trim.delta_e, trim.throttle)
        self._set(ADAMS_BASHFORTH_3)
        self.engine.set_dt(frame)
        n_frames = round(interval / frame)
        output = np.empty((elevator.size, 2))
        # A run() integrates over the frame with the rates at its start, then evaluates the rates
        # at its end: so the surface is set for the end of the frame.
        following = np.append(elevator[1:], elevator[-1])
        for row, (now, after) in enumerate(zip(elevator, following, strict=True)):
            output[row] = self.engine["aero/alpha-rad"], self.engine["velocities/q-rad_sec"]
            self.engine["fcs/elevator-pos-rad"] = now
            for _ in range(n_frames - 1):
                self.engine.run()
            self.engine["fcs/elevator-pos-rad"] = 0.5 * (now + after)
            self.engine.run()
        return output


def _detach(aircraft: str) -> str:
    """Rename the outputs of the flight control system, so that nothing overwrites a surface."""
    output = r"<output>\s*((?:fcs|gear)/[\w-]+)\s*</output>"
    detached, count = re.subn(output, r"<output>detached/\1</output>", aircraft)
    if count == 0:
        raise RuntimeError("found no flight control output; expected at least the elevator's")
    return detached


def _balance(aircraft: str, aft: float) -> str:
    """Move the empty centre of gravity aft [in]."""
    place = r'(<location name="CG" unit="IN">\s*<x>)\s*([-+.\d]+)\s*(</x>)'
    moved, count = re.subn(
        place, lambda found: f"{found[1]} {float(found[2]) + aft} {found[3]}", aircraft
    )
    if count != 1:
        raise RuntimeError(f"found {count} centres of gravity in inches; expected one")
    return moved


def elevator_input(flight: Flight, trim_elevator: float) -> tuple[Array, Array]:
    """Times (n,) [s] and elevator (n,) [rad] of a 3-2-1-1, nose up first, and its mirror image."""
    elevator = np.full(round(flight.duration * flight.rate) + 1, trim_elevator)
    position = round(flight.start * flight.rate)
    for length, sign in MANOEUVRE:
        stop = position + round(length * flight.unit * flight.rate)
        elevator[position:stop] += sign * np.radians(flight.amplitude)
        position = stop
    return np.arange(elevator.size) / flight.rate, as_written(elevator)


def as_written(values: Array) -> Array:
    """Round to what the file holds, so that the recorded elevator is exactly the one flown."""
    return np.array([float(f"{value:.12f}") for value in values])


def short_period(a_matrix: Array, elevator_column: Array) -> dict[str, float]:
    """Transfer function coefficients with V, theta and h frozen."""
    (za, zq), (ma, mq) = a_matrix[1:3, 1:3]
    zde, mde = elevator_column[1:3]
    a1, a0 = -(za + mq), za * mq - zq * ma
    values = {
        "a1": a1, "a0": a0,
        "b1": zde, "b0": zq * mde - mq * zde,
        "c1": mde, "c0": ma * zde - za * mde,
        "natural_frequency": np.sqrt(a0), "damping": a1 / (2.0 * np.sqrt(a0)),
    }  # fmt: skip
    return {name: float(value) for name, value in values.items()}


def fast_pair(a_matrix: Array) -> dict[str, float]:
    """Coefficients of s^2 + a1 s + a0 for the fastest pair of the five-state model."""
    eigenvalues = np.linalg.eigvals(a_matrix)
    fastest = eigenvalues[np.argmax(np.abs(eigenvalues))]
    return {"a1": float(-2.0 * fastest.real), "a0": float(abs(fastest) ** 2)}


def second_order_response(a: Array, numerators: Array, elevator: Array, interval: float) -> Array:
    """Exact response (n, n_outputs) from rest to a piecewise constant input (n,)."""
    step = expm(np.array([[-a[0], -a[1], 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) * interval)
    state, states = np.zeros(3), np.empty((elevator.size, 2))
    for row, value in enumerate(elevator):
        states[row] = state[:2]
        state[2] = value
        state = step @ state
    return states @ numerators.T


def output_error(
    elevator: Array, outputs: Array, noise: Array, interval: float, start: Array
) -> dict[str, Any]:
    """Weighted output-error fit: one denominator, an offset for each output, at rest in trim.

    ``outputs`` is (n, n_outputs); the standard deviations ``noise`` (n_outputs,) weigh them and
    give the standard errors; ``start`` is a1, a0, then two numerator coefficients an output.
    """
    n_outputs = outputs.shape[1]
    deviation = elevator - elevator[0]
    level = outputs[0]

    def residual(theta: Array) -> Array:
        numerators = theta[2:-n_outputs].reshape(n_outputs, 2)
        model = second_order_response(theta[:2], numerators, deviation, interval)
        return np.asarray((model + level + theta[-n_outputs:] - outputs) / noise).ravel()

    solution = least_squares(
        residual, np.concatenate([start, np.zeros(n_outputs)]),
        jac="3-point", x_scale="jac", xtol=1e-12, ftol=1e-14, gtol=1e-12,
    )  # fmt: skip
    jacobian = np.asarray(solution.jac)
    std = np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    left = (solution.fun.reshape(-1, n_outputs) * noise).T
    return {
        "coefficients": solution.x[:-n_outputs].tolist(),
        "standard_error_at_stated_noise": std[:-n_outputs].tolist(),
        "offset": (solution.x[-n_outputs:] + level).tolist(),
        "residual_rms": [float(np.sqrt(np.mean(channel**2))) for channel in left],
    }


def reference_fits(
    elevator: Array, outputs: Array, noise: Array, interval: float, truth: dict[str, float]
) -> dict[str, Any]:
    """Output-error fits of alpha, of q and of both together; the truth is only the start."""
    channels = {
        "alpha": ([0], ("a1", "a0", "b1", "b0")),
        "q": ([1], ("a1", "a0", "c1", "c0")),
        "alpha_and_q": ([0, 1], ("a1", "a0", "b1", "b0", "c1", "c0")),
    }
    fits: dict[str, Any] = {}
    for name, (columns, names) in channels.items():
        start = np.array([truth[key] for key in names])
        fit = output_error(elevator, outputs[:, columns], noise[columns], interval, start)
        for key in ("coefficients", "standard_error_at_stated_noise"):
            fit[key] = dict(zip(names, fit[key], strict=True))
        fits[name] = fit
    return fits


def provenance(flight: Flight, aircraft: Aircraft) -> dict[str, str]:
    """Where the numbers come from."""
    return {
        "script": "examples/jsbsim_short_period.py",
        "engine": "JSBSim",
        "engine_version": jsbsim.__version__,
        "numpy_version": np.__version__,
        "aircraft": flight.aircraft,
        "aircraft_file_sha256": hashlib.sha256(aircraft.source.read_bytes()).hexdigest(),
        "aircraft_file_licence": "none stated in the file; the file is not included here",
        "integration": "third-order Adams-Bashforth on all four integrators",
    }


def record_text(times: Array, elevator: Array, noisy: Array, clean: Array) -> str:
    """The record as comma-separated text, with Unix line ends."""
    rows = zip(times, elevator, *noisy.T, *clean.T, strict=True)
    lines = [",".join(COLUMNS)]
    lines += [f"{t:.2f}," + ",".join(f"{value:.12f}" for value in row) for t, *row in rows]
    return "\n".join(lines) + "\n"


def make(flight: Flight) -> tuple[str, dict[str, Any]]:
    """Fly and linearise; the text of the record and the content of its description."""
    aircraft = Aircraft(flight.aircraft)
    trim = aircraft.trim(flight.speed, flight.altitude)
    a_matrix, elevator_column = aircraft.linearise(trim)
    truth = short_period(a_matrix, elevator_column)
    interval = 1.0 / flight.rate
    times, elevator = elevator_input(flight, trim.delta_e)
    clean = aircraft.fly(trim, elevator, interval, flight.frame)
    noise = np.radians([flight.alpha_noise, flight.q_noise])
    noisy = clean + noise * np.random.default_rng(flight.seed).standard_normal(clean.shape)
    text = record_text(times, elevator, noisy, clean)
    return text, {
        "schema": 1,
        "record": {
            "file": "short_period.csv",
            "sha256": hashlib.sha256(text.encode()).hexdigest(),
            "n_samples": len(times),
            "sample_interval": interval,
            "intersample": "zoh",
            "units": {name: UNITS[name] for name in COLUMNS},
        },
        "provenance": provenance(flight, aircraft),
        "flight": asdict(flight),
        "flight_units": FLIGHT_UNITS,
        "manoeuvre": {
            "description": "3-2-1-1, nose up first, then its mirror image, elevator at the surface",
            "steps": [{"units": length, "sign": sign} for length, sign in MANOEUVRE],
        },
        "trim": asdict(trim),
        "noise": {
            "distribution": "white, Gaussian, independent",
            "std": {"alpha": float(noise[0]), "q": float(noise[1])},
            "seed": flight.seed,
            "generator": "numpy.random.default_rng(seed).standard_normal((n_samples, 2))",
        },
        "short_period": truth,
        "short_period_form": {
            "alpha/delta_e": "(b1 s + b0) / (s^2 + a1 s + a0)",
            "q/delta_e": "(c1 s + c0) / (s^2 + a1 s + a0)",
            "frozen": ["V", "theta", "h"],
        },
        "five_state_model": {
            "states": list(STATES),
            "A": a_matrix.tolist(),
            "B": elevator_column.tolist(),
            "fast_pair": fast_pair(a_matrix),
        },
        "units": {name: unit for name, unit in UNITS.items() if not name.endswith("_true")},
        "noise_free_reference": reference_fits(elevator, clean, noise, interval, truth),
        "noisy_reference": reference_fits(elevator, noisy, noise, interval, truth),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the record and its description."""
    parser = argparse.ArgumentParser(description="Make the demonstration record with JSBSim.")
    parser.add_argument("--out", type=Path, default=DEFAULT_OUT, help="folder (default: package)")
    options = parser.parse_args(arguments)
    record, description = make(Flight())
    text = json.dumps(description, indent=1) + "\n"
    options.out.mkdir(parents=True, exist_ok=True)
    for name, content in (("short_period.csv", record), ("short_period.json", text)):
        (options.out / name).write_text(content, encoding="utf-8", newline="\n")
        print(f"wrote {options.out / name}: {len(content)} bytes")


if __name__ == "__main__":
    main()
