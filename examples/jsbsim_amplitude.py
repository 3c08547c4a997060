"""How large should a manoeuvre be? Three aircraft of JSBSim, the amplitude swept, one gyro for all.

The larger the elevator moves, the less the noise of the gyro matters, and the less the aircraft is
a linear one: the spread of the estimates falls, their bias grows, and in between the error is
least. Where that is depends on the estimator. Three see the same records of pitch rate:

* *Step 2 alone*: least squares of the series-parallel model on the recorded output, with the
  paper's filter scaled to the short period of each aircraft;
* *output error* from a start of its own;
* *the strategy*, ``ThreeModel()``.

Each aircraft, trimmed, flies a 3-2-1-1 that fits its short period, the elevator moved at the
surface. The truth is the engine's own: its accelerations linearised at trim. All errors are
relative, root mean squares over the four coefficients: *bias* of the median over the draws of
the noise, *spread* half the distance of their 16 and 84 % quantiles (estimates from small
manoeuvres have heavy tails), *total* the root of the sum of squares; *without noise* is what one
record without noise gives.

    pip install "tridentify[jsbsim]" matplotlib
    python examples/jsbsim_amplitude.py [--draws N] [--amplitudes A,B,...] [--out DIRECTORY]

writes ``jsbsim_amplitude.json`` and ``jsbsim_amplitude.png``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jsbsim_short_period import Aircraft, Array, short_period

from tridentify import OutputError, Record, Structure, ThreeModel, TridentifyError
from tridentify.excitation import three_two_one_one
from tridentify.identify import search
from tridentify.studies.step_2_alone import step_2_alone

RATE_NOISE = 0.2
"""Of the gyro [deg/s], at every amplitude."""
AMPLITUDES = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Of the elevator [deg]."""
TAIL = 3.0
"""Rest after the manoeuvre, in its units: with a longer one the phugoid enters."""
FRAME = 1e-3
"""Of the engine [s]."""
STRUCTURE = Structure(2, 1, offset=False, initial_state="rest")
PAPER_FILTER, PAPER_CORNER = (1.0, 5.0, 6.0, 7.0), np.sqrt(3.0)
NAMES = ("a1", "a0", "c1", "c0")
"""Of the truth, in the order of the estimates."""


@dataclass(frozen=True)
class Case:
    """An aircraft in level flight, and how often it is sampled."""

    aircraft: str
    speed: float
    """[m/s]."""
    altitude: float
    """[m]."""
    interval: float
    """[s]."""


CASES = (
    Case("A4", 200.0, 5000.0, 0.02),
    Case("T37", 90.0, 1500.0, 0.02),
    Case("MD11", 230.0, 3000.0, 0.1),
)


class Manoeuvre:
    """An aircraft in trim, its truth, and records of any amplitude."""

    def __init__(self, case: Case) -> None:
        self.case, self.aircraft = case, Aircraft(case.aircraft)
        self.trim = self.aircraft.trim(case.speed, case.altitude)
        found = short_period(*self.aircraft.linearise(self.trim))
        self.truth = np.array([found[name] for name in NAMES])
        self.frequency = found["natural_frequency"]

    def fly(self, amplitude: float) -> Record:
        """Elevator and pitch rate about trim, without noise; nose up first [deg]."""
        tail = TAIL * 1.6 / self.frequency
        plan = three_two_one_one(
            -np.radians(amplitude), dt=self.case.interval, for_frequency=self.frequency, tail=tail
        )
        elevator = plan.u[:, 0]
        flown = self.aircraft.fly(
            self.trim, self.trim.delta_e + elevator, self.case.interval, FRAME
        )
        return Record(elevator, flown[:, 1], dt=self.case.interval, intersample="zoh")

    def ways(self) -> dict[str, Callable[[Record], Array]]:
        """Estimators: coefficients from a record."""
        factor = self.frequency / PAPER_CORNER
        filter_ = [value * factor**k for k, value in enumerate(PAPER_FILTER)]
        return {
            "Step 2 alone": lambda record: step_2_alone(record, 2, 1, filter_),
            "output error": lambda record: _identified(record, OutputError()),
            "the strategy": lambda record: _identified(record, ThreeModel()),
        }


def _identified(record: Record, method: Any) -> Array:
    """The search alone: a hundred times nobody reads the findings."""
    return np.asarray(search(record, STRUCTURE, method).estimate.theta)


def noisy(record: Record, draw: int) -> Record:
    """The same record with a draw of the noise: the same draw at every amplitude."""
    noise = np.radians(RATE_NOISE) * np.random.default_rng(draw).standard_normal(record.y.shape)
    return Record(record.u, record.y + noise, dt=record.dt, intersample="zoh")


def relative(estimate: Callable[[Record], Array], record: Record, truth: Array) -> Array:
    """Relative errors of the coefficients (4,); nan where there is no answer."""
    try:
        return (estimate(record) - truth) / np.abs(truth)
    except TridentifyError:
        return np.full(truth.size, np.nan)


def rms(values: Array) -> float:
    """Root mean square over the coefficients."""
    return float(np.sqrt(np.mean(values**2)))


def summed_up(errors: Array, clean: Array) -> dict[str, float]:
    """Bias, spread and total of relative errors (n_draws, 4)."""
    low, middle, high = np.nanquantile(errors, [0.16, 0.5, 0.84], axis=0)
    bias, spread = rms(middle), rms((high - low) / 2)
    return {
        "bias": bias,
        "spread": spread,
        "total": float(np.hypot(bias, spread)),
        "without_noise": rms(clean),
        "no_answer": int(np.sum(~np.isfinite(errors).all(axis=1))),
    }


def study(case: Case, amplitudes: tuple[float, ...], draws: int) -> dict[str, Any]:
    """Errors of all estimators at all amplitudes."""
    flown = Manoeuvre(case)
    found: dict[str, list[dict[str, float]]] = {way: [] for way in flown.ways()}
    for amplitude in amplitudes:
        clean = flown.fly(amplitude)
        records = [noisy(clean, draw) for draw in range(draws)]
        for way, estimate in flown.ways().items():
            errors = np.array([relative(estimate, record, flown.truth) for record in records])
            found[way].append(summed_up(errors, relative(estimate, clean, flown.truth)))
    return {
        "case": asdict(case),
        "truth": dict(zip(NAMES, flown.truth.tolist(), strict=True)),
        "amplitudes": list(amplitudes),
        "errors": found,
    }


def best(rows: list[dict[str, float]], amplitudes: list[float]) -> tuple[float, float]:
    """Amplitude with the least total error, and that error."""
    k = int(np.nanargmin([row["total"] for row in rows]))
    return amplitudes[k], rows[k]["total"]


def table(found: dict[str, Any]) -> list[str]:
    """Bias, spread and total in per cent, by estimator and amplitude."""
    case, amplitudes = found["case"], found["amplitudes"]
    lines = [
        f"{case['aircraft']} at {case['speed']:g} m/s and {case['altitude']:g} m; errors in %",
        "  elevator [deg]        " + "".join(f"{value:8g}" for value in amplitudes),
    ]
    for way, rows in found["errors"].items():
        for key in ("without_noise", "bias", "spread", "total"):
            told = "".join(f"{100 * row[key]:8.2f}" for row in rows)
            label = way if key == "without_noise" else ""
            lines.append(f"  {label:13s}{key.split('_')[0]:11s}{told}")
        amplitude, error = best(rows, amplitudes)
        missing = sum(row["no_answer"] for row in rows)
        lines.append(
            f"  {'':13s}least total error {100 * error:.2f} % at {amplitude:g} deg"
            + (f"; {missing} without an answer" if missing else "")
        )
    return lines


def draw(studies: list[dict[str, Any]]) -> Any:
    """Bias and spread beside the total, over the amplitude, a panel for each aircraft."""
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter, StrMethodFormatter

    figure, panels = plt.subplots(
        1, len(studies), figsize=(9.0, 3.6), sharey=True, constrained_layout=True
    )
    for ax, found in zip(np.atleast_1d(panels), studies, strict=True):
        x = found["amplitudes"]
        colours = ("tab:red", "tab:orange", "tab:blue")
        for (way, rows), colour in zip(found["errors"].items(), colours, strict=True):
            for key, style, width in (("bias", ":", 1.0), ("spread", "--", 1.0), ("total", "-", 2)):
                y = [100 * row[key] for row in rows]
                label = way if key == "total" else None
                ax.loglog(x, y, style, color=colour, lw=width, label=label)
            amplitude, error = best(rows, x)
            ax.plot(amplitude, 100 * error, "o", color=colour, ms=6)
        for axis in (ax.xaxis, ax.yaxis):
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
        ax.set_title(found["case"]["aircraft"])
        ax.set_xlabel("elevator [deg]")
    first = np.atleast_1d(panels)[0]
    first.set_ylabel("error of the coefficients [%]\n(dotted: bias, dashed: spread)")
    first.legend(fontsize=8)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("build/examples"))
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--amplitudes", default=",".join(map(str, AMPLITUDES)), help="[deg]")
    given = parser.parse_args()
    amplitudes = tuple(float(value) for value in given.amplitudes.split(","))
    studies = []
    for case in CASES:
        studies.append(study(case, amplitudes, given.draws))
        print("\n".join(table(studies[-1])), flush=True)
    given.out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(
        {"draws": given.draws, "rate_noise": RATE_NOISE, "studies": studies}, indent=1
    )
    (given.out / "jsbsim_amplitude.json").write_text(text + "\n")
    draw(studies).savefig(given.out / "jsbsim_amplitude.png", dpi=130)


if __name__ == "__main__":
    main()
