"""Tracking, bias and change detection of the on-line methods, for `online.py`."""

from __future__ import annotations

import sys
import zlib
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from changing import (
    DURATION,
    TIME_STEP,
    TRUTH,
    VARIANCE,
    check_drifting,
    drifting,
    drifting_input,
    scaled,
    stepped,
)
from matplotlib.figure import Figure
from numpy.typing import NDArray
from plants import ARMA, LIGHT, RAO_GARNIER, SECOND, SECOND_ARMA, WHITE, Cell, Noise, Plant, prbs

from tridentify import Record, Structure, online
from tridentify.plots.style import BLACK, BLUE, ORANGE, SKY, dress

Array = NDArray[np.float64]
SETTLED, EVERY = 50.0, 20.0
MEMORIES, CLOCK = (5.0, 10.0, 25.0), 5.0
DRIFTS = (0.003, 0.01, 0.03)
TRACKING_DRAWS, BIAS_DRAWS = 5, 60
SPAN = 1.959964


def structure(plant: Plant) -> Structure:
    return Structure(len(plant.a), len(plant.b) - 1, offset=False, initial_state="rest")


# ------------------------------------------------------------------------------------- tracking
def trackers() -> dict[str, Any]:
    """Methods and memories [s]."""
    found: dict[str, Any] = {}
    for seconds in MEMORIES:
        factor = 1.0 - TIME_STEP / seconds
        found[f"ThreeModel, memory {seconds:g} s"] = online.ThreeModel(
            forgetting=factor, on_change="flag", clock=CLOCK
        )
        found[f"RecursiveLeastSquares, memory {seconds:g} s"] = online.RecursiveLeastSquares(
            forgetting=factor, on_change="flag"
        )
    for drift in DRIFTS:
        found[f"Kalman, drift {drift:g}"] = online.Kalman(drift=drift)
    found["Gradient"] = online.Gradient()
    factor = 1.0 - TIME_STEP / 10.0
    found |= {
        "ThreeModel, memory 10 s, directional": online.ThreeModel(
            forgetting=factor, forget="directional", on_change="flag", clock=CLOCK
        ),
        "ThreeModel, memory 10 s, restart": online.ThreeModel(forgetting=factor, clock=CLOCK),
    }
    return found


def tracking(quick: bool) -> dict[str, Any]:
    """Errors on the time-varying plant, relative to the truth."""
    draws = 1 if quick else TRACKING_DRAWS
    u = drifting_input()
    clean = drifting(u)
    checked = check_drifting(u, clean)
    if quick:
        u, clean = u[:10_000], clean[:10_000]
    rest = Structure(2, 0, offset=False, initial_state="rest")
    rows: dict[str, Any] = {name: {"rms": [], "inside": [], "changes": []} for name in trackers()}
    shown = {}
    for draw in range(draws):
        noise = np.sqrt(VARIANCE) * np.random.default_rng(draw).standard_normal(u.size)
        one = Record(u, clean + noise, dt=TIME_STEP)
        for name, method in trackers().items():
            run = online.run(method, one, rest, every=EVERY)
            truth = np.column_stack([TRUTH[key](run.time) for key in run.names])
            late = run.time >= SETTLED
            late &= np.all(np.isfinite(run.theta), axis=1)
            error = (run.theta - truth)[late] / truth[late]
            z = (run.theta - truth)[late] / run.std[late]
            rows[name]["rms"].append(np.sqrt(np.mean(error**2, axis=0)).tolist())
            rows[name]["inside"].append(np.mean(np.abs(z) < SPAN, axis=0).tolist())
            rows[name]["changes"].append(len(run.state.changes))
            if draw == 0:
                shown[name] = [run.time.tolist(), run.theta.tolist(), run.std.tolist()]
        print(f"tracking: draw {draw + 1} of {draws}", file=sys.stderr, flush=True)
    t = np.arange(SETTLED, DURATION, 0.5)
    constant = [float(np.std(f(t)) / np.sqrt(np.mean(f(t) ** 2))) for f in TRUTH.values()]
    snr = 10 * np.log10(np.var(clean) / VARIANCE)
    return {
        "rows": rows, "names": list(TRUTH), "checked": checked, "snr": snr, "draws": draws,
        "constant": constant, "shown": {k: v for k, v in shown.items() if k in PICTURED},
    }  # fmt: skip


PICTURED = ("ThreeModel, memory 10 s", "RecursiveLeastSquares, memory 10 s")


def tracking_table(data: dict[str, Any]) -> list[str]:
    """RMS errors in percent."""
    names = data["names"]
    lines = [
        f"tracking: y'' + a1(t) y' + a0(t) y = 200 u over {DURATION:g} s at {TIME_STEP:g} s, noise "
        f"variance {VARIANCE:g} ({data['snr']:.1f} dB), {data['draws']} draws",
        f"RMS of the relative error from {SETTLED:g} s on where there is an estimate [%], over the "
        "draws (largest of one); points in the 95 % band [%]; changes reported in a record",
        f"{'':40s}" + "".join(f"{name:>18s}" for name in names) + f"{'in the band':>20s}"
        f"{'changes':>9s}",
    ]
    for name, row in data["rows"].items():
        rms = 100 * np.array(row["rms"], dtype=np.float64)
        total, most = np.sqrt(np.mean(rms**2, axis=0)), np.max(rms, axis=0)
        inside = 100 * np.mean(np.array(row["inside"], dtype=np.float64), axis=0)
        cells = "".join(f"{a:9.2f} ({b:6.2f})" for a, b in zip(total, most, strict=True))
        bands = " ".join(f"{value:5.0f}" for value in inside)
        lines.append(f"{name:40s}{cells}{bands:>20s}{np.mean(row['changes']):9.1f}")
    constant = "".join(f"{100 * value:9.2f}         " for value in data["constant"])
    lines.append(f"{'the best constant, known afterwards':40s}{constant}".rstrip())
    lines.append(f"simulated output against an integrator: {data['checked']:.0e} of its size")
    return lines


def picture(data: dict[str, Any]) -> Figure:
    """Trajectories beside the truth, and error against memory."""
    figure = Figure(figsize=(10.4, 7.2), layout="constrained")
    grid = figure.subplots(3, 2, gridspec_kw={"width_ratios": [2.0, 1.0]})
    units = ("1/s", "1/s$^2$", "1/s$^2$")
    for k, name in enumerate(data["names"]):
        left, right = grid[k]
        _courses(left, data, k)
        dress(left, ylabel=f"{name} [{units[k]}]", xlabel="time [s]" if k == 2 else "")
        _against_memory(right, data["rows"], k)
        last = "memory [s]" if k == 2 else ""
        dress(right, ylabel=f"RMS error of {name} [%]", xlabel=last)
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=4, fontsize=8, frameon=False)
    grid[0, 1].legend(fontsize=8, frameon=False)
    return figure


def _courses(ax: Any, data: dict[str, Any], k: int) -> None:
    colours = dict(zip(PICTURED, (BLUE, ORANGE), strict=True))
    for name in reversed(PICTURED):
        time, theta, std = (np.array(one, dtype=np.float64) for one in data["shown"][name])
        if colours[name] == BLUE:
            low, high = theta[:, k] - SPAN * std[:, k], theta[:, k] + SPAN * std[:, k]
            ax.fill_between(time, low, high, color=SKY, alpha=0.5, linewidth=0, label="95 % band")
        ax.plot(time, theta[:, k], color=colours[name], linewidth=0.9, label=name)
    truth = list(TRUTH.values())[k](time)
    ax.plot(time, truth, color=BLACK, linewidth=1.2, linestyle="--", label="truth")
    spread = np.ptp(truth) or truth[0]
    ax.set_ylim(truth.min() - 0.5 * spread, truth.max() + 0.5 * spread)


def _against_memory(ax: Any, rows: dict[str, Any], k: int) -> None:
    for colour, marker, method in (
        (BLUE, "o", "ThreeModel"),
        (ORANGE, "s", "RecursiveLeastSquares"),
    ):
        rms = [
            np.sqrt(np.mean(np.square(rows[f"{method}, memory {m:g} s"]["rms"]), axis=0))[k]
            for m in MEMORIES
        ]
        ax.plot(MEMORIES, 100 * np.array(rms), color=colour, marker=marker, label=method)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xticks(MEMORIES, [f"{m:g}" for m in MEMORIES])
    ax.set_yticks((5, 10, 20, 50), ("5", "10", "20", "50"))
    ax.minorticks_off()


# ----------------------------------------------------------------------------------------- bias
def bias_cells() -> list[Cell]:
    """The second-order plant of the field for 100 s, white and coloured noise."""
    u = np.resize(prbs(7, (7, 6), 8), 2000)
    return [
        Cell("3/(s^2+4s+3), 100 s, white 10 dB", SECOND, u, 0.05, ("snr", 10)),
        Cell("2/(s^2+4s+3), 100 s, ARMA 15 dB", SECOND_ARMA, u, 0.05, ("snr", 15), ARMA),
    ]


def unbiased() -> dict[str, Any]:
    return {
        "ThreeModel": online.ThreeModel(),
        "RecursiveLeastSquares": online.RecursiveLeastSquares(),
        "Gradient": online.Gradient(),
    }


def bias(quick: bool) -> dict[str, Any]:
    """Estimates at the end of each record."""
    draws = 5 if quick else BIAS_DRAWS
    found: dict[str, Any] = {"draws": draws, "cells": {}}
    for cell in bias_cells():
        rows: dict[str, Any] = {}
        for name, method in unbiased().items():
            theta, std = [], []
            for draw in range(draws):
                one = cell.record(0, draw)
                end = online.run(method, one, structure(cell.plant), every=1e9).estimate
                nothing = [np.nan] * cell.plant.theta.size
                theta.append(nothing if end is None else end.theta.tolist())
                std.append(nothing if end is None else end.std.tolist())
            rows[name] = {"theta": theta, "std": std}
            print(f"bias: {cell.name}, {name}", file=sys.stderr, flush=True)
        found["cells"][cell.name] = {
            "truth": cell.plant.theta.tolist(), "bound": cell.bound.tolist(),
            "names": cell.plant.names, "rows": rows,
        }  # fmt: skip
    return found


def bias_table(data: dict[str, Any]) -> list[str]:
    """Bias in percent and in bounds, RMSE over the bound, coverage."""
    lines = [
        f"bias at the end of 100 s (2000 samples), {data['draws']} draws; sampling error of a bias "
        f"in bounds about {1 / np.sqrt(data['draws']):.2f}"
    ]
    for title, cell in data["cells"].items():
        truth, bound = np.array(cell["truth"]), np.array(cell["bound"])
        lines.append(
            f"{title:34s}" + "".join(f"{name:>33s}" for name in cell["names"]) + "   in 95 % band"
        )
        lines.append(f"{'':34s}" + "     bias %   bounds  RMSE/bound" * truth.size)
        for name, row in cell["rows"].items():
            theta, std = (np.array(row[key], dtype=np.float64) for key in ("theta", "std"))
            given = np.all(np.isfinite(theta), axis=1)
            error, std = (theta - truth)[given], std[given]
            mean, rmse = error.mean(axis=0), np.sqrt(np.mean(error**2, axis=0))
            cells = "".join(
                f"{100 * m / t:11.2f}{m / b:9.2f}{r / b:12.2f} "
                for m, r, t, b in zip(mean, rmse, truth, bound, strict=True)
            )
            inside = 100 * np.mean(np.abs(error) < SPAN * std, axis=0)
            missing = int(np.sum(~given))
            lines.append(
                f"  {name:32s}{cells}  "
                + " ".join(f"{v:4.0f}" for v in inside)
                + (f"   without an estimate: {missing}" if missing else "")
            )
    return lines


# -------------------------------------------------------------------------------------- changes
LONG, SETTLING, LISTENING, CHANGE_DRAWS, WORKERS = 100_000, 3000, 3000, 12, 2
STEPS = (("a0", 1.5), ("a0", 1.2), ("b0", 1.5))


def change_cells() -> list[tuple[Plant, float, float, Noise, str]]:
    """Plant, sample interval [s], dB, noise."""
    return [
        (plant, dt, decibel, noise, f"{plant.name} {decibel:g} dB {label}")
        for plant, dt in ((SECOND, 0.05), (LIGHT, 0.05), (RAO_GARNIER, 0.01))
        for decibel, noise, label in (
            (20.0, WHITE, "white"),
            (5.0, WHITE, "white"),
            (10.0, ARMA, "ARMA"),
        )
    ]


def watchers() -> dict[str, Any]:
    return {
        "ThreeModel": online.ThreeModel(),
        "RecursiveLeastSquares": online.RecursiveLeastSquares(),
        "Kalman": online.Kalman(drift=0.001),
        "Gradient": online.Gradient(),
    }


def _signal(name: str, draw: int, count: int) -> tuple[Array, np.random.Generator]:
    rng = np.random.default_rng([zlib.crc32(name.encode()), draw])
    return rng.choice([-1.0, 1.0], -(-count // 8)).repeat(8)[:count], rng


def _noisy(plants: tuple[Plant, Plant], cell: Any, draw: int, count: int, change: int) -> Record:
    _, dt, decibel, noise, name = cell
    u, rng = _signal(name, draw, count)
    clean = stepped(*plants, u, dt, change)
    std = np.std(clean[:change]) * 10 ** (-decibel / 20)
    return Record(u, clean + std * noise.draw(rng, count), dt=dt)


def changes(quick: bool) -> dict[str, Any]:
    """False alarms on stationary samples, and delays after a step of one coefficient."""
    long, draws = (6000, 1) if quick else (LONG, CHANGE_DRAWS)
    count = len(change_cells())
    with ProcessPoolExecutor(WORKERS) as pool:
        rows = dict(pool.map(_changes_of, range(count), [long] * count, [draws] * count))
    return {"long": long, "draws": draws, "rows": rows}


def _changes_of(place: int, long: int, draws: int) -> tuple[str, dict[str, Any]]:
    """Name of a cell, and what all methods tell of it."""
    cell = change_cells()[place]
    plant, name = cell[0], cell[-1]
    still = _noisy((plant, plant), cell, 0, long, long)
    row: dict[str, Any] = {}
    for method_name, method in watchers().items():
        state = online.run(method, still, structure(plant), every=long * cell[1]).state
        found: dict[str, Any] = {"false": len(state.changes), "steps": {}}
        for which, factor in STEPS:
            other = scaled(plant, which, factor)
            delays, early = [], 0
            for draw in range(1, draws + 1):
                moved = _noisy((plant, other), cell, draw, SETTLING + LISTENING, SETTLING)
                state = online.run(method, moved, structure(plant), every=1e9).state
                after = [at - SETTLING for at in state.changes if at >= SETTLING]
                early += sum(at < SETTLING for at in state.changes)
                delays.append(after[0] if after else None)
            found["steps"][f"{which} x {factor:g}"] = {"delays": delays, "early": early}
        row[method_name] = found
    print(f"changes: {name}", file=sys.stderr, flush=True)
    return name, row


def changes_table(data: dict[str, Any]) -> list[str]:
    """False alarms per million samples; delays."""
    kinds = [f"{which} x {factor:g}" for which, factor in STEPS]
    lines = [
        f"changes: alarms on {data['long']:,d} stationary samples, per million; then a step of one "
        f"coefficient after {SETTLING} samples, {data['draws']} draws:",
        f"median delay to the alarm [samples] (9 in 10 within), found within {LISTENING} [%]",
        f"{'':58s}{'false':>7s}" + "".join(f"{kind:>24s}" for kind in kinds),
    ]
    for name, row in data["rows"].items():
        for method, found in row.items():
            cells = "".join(f"{_delay(found['steps'][kind]['delays']):>24s}" for kind in kinds)
            false = 1e6 * found["false"] / data["long"]
            lines.append(f"{name:36s}{method:22s}{false:7.0f}{cells}")
    return lines


def _delay(delays: list[int | None]) -> str:
    there = np.array([np.inf if d is None else d for d in delays])
    share = 100 * np.mean(np.isfinite(there))

    def shown(value: float) -> str:
        return f"{value:.0f}" if np.isfinite(value) else "-"

    median, most = (float(np.quantile(there, q, method="higher")) for q in (0.5, 0.9))
    return f"{shown(median)} ({shown(most)}) {share:.0f} %"
