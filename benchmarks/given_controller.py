"""What a controller that is given is worth: the reference route without it and with it.

Three plants in loops with a PI controller, sampled (by trapezoids) or continuous, 150 and 3,000
samples at 10 dB, and two of them at 0 dB; noise white, or ARMA. With the controller given the
estimate is the maximum of the likelihood of the loop's own noise, if the record does not speak
against it (`estimation.closed_loop.innovations`). RMSE is printed over two bounds:

- of the reference: that of `closed_loop.py`, the information in what follows the reference;
- of the noise: the Cramer-Rao bound of the loop's innovations, which counts what the noise drives
  too. It is computed here from the definition alone: the innovations of moved coefficients, for the
  loop without noise and for one sample of noise, by transforms. Where the noise is coloured and its
  colour unknown, what it drives tells nothing (any such response may be part of the colour), and
  only what follows the reference counts.

For a sampled controller the first bound divided by the second is what the recorded input is worth
beyond its driven part; the controller itself adds nothing. For a continuous one the first bound
is that of an input known at its samples, whose driven part follows the model between them.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import argparse
import json
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from closed_loop import AR, MA, MOVED, Array, Loop, binary, blind, demo, divided, kind
from loops import Controller, System, run
from machine import HERE, keep
from scipy.signal import lfilter

from tridentify import Structure, ThreeModel, TransferFunction, TridentifyError

TAKEN = "likeliest"
"""In the trace, where the likelihood's maximum was taken."""


@dataclass(frozen=True, eq=False)
class Case:
    """A loop and its noise.

    Attributes
    ----------
    loop : Loop
    snr : float
        [dB].
    """

    loop: Loop
    snr: float

    @property
    def name(self) -> str:
        """In words."""
        return f"{self.loop.name}, {len(self.loop.reference)} samples, {self.snr:.0f} dB"


def lag(sampled: bool, coloured: bool, dt: float, n: int) -> Loop:
    """A first-order lag, its set point moved."""
    return Loop(
        f"lag, {kind(sampled, coloured)}, {dt} s",
        Structure(1, 0),
        np.array([0.5, 1.0]),
        lambda t: System.of(t[1:], np.r_[1.0, t[:1]]),
        System.of([2.0, 1.0], [1.0, 0.0]),
        TransferFunction([2.0, 1.0], [1.0, 0.0]),
        sampled, coloured, dt, binary(n, round(1.5 / dt)), False,
    )  # fmt: skip


def resonant(sampled: bool, coloured: bool, dt: float, n: int) -> Loop:
    """A lightly damped plant without a zero, its set point moved."""
    return Loop(
        f"resonant, {kind(sampled, coloured)}, {dt} s",
        Structure(2, 0),
        np.array([0.6, 4.0, 4.0]),
        lambda t: System.of(t[2:], np.r_[1.0, t[:2]]),
        System.of([0.2, 0.3], [1.0, 0.0]),
        TransferFunction([0.2, 0.3], [1.0, 0.0]),
        sampled, coloured, dt, binary(n, round(3.0 / dt)), False,
    )  # fmt: skip


def innovations(loop: Loop, theta: Array, u: Array, y: Array, *, quiet: bool) -> Array:
    """(n, 1) what coefficients leave of input and output, the loop between the samples followed.

    Parameters
    ----------
    loop : Loop
    theta : array
    u, y : (n, 1) arrays
    quiet : bool
        Whether no reference drives the loop.
    """
    moved = replace(loop, theta=theta)
    plant, zeros = loop.plant(theta), np.zeros_like(y)
    own = replace(moved, reference=np.zeros_like(loop.reference)) if quiet else moved
    u_r, y_r = own.simulated(plant, loop.controller, zeros)
    held = run(plant, Controller(blind(1, 1)), zeros, zeros, u - u_r, loop.dt)[1]
    left = y - y_r - held
    return left if loop.sampled else divided(left[:, :, None], moved.around())[:, :, 0]


def scores(loop: Loop, u: Array, y: Array, *, quiet: bool) -> Array:
    """(n, n_coefficients) derivatives of the innovations."""
    columns = []
    for k, value in enumerate(loop.theta):
        ends = []
        for sign in (1.0, -1.0):
            moved = loop.theta.copy()
            moved[k] += sign * MOVED * abs(value)
            ends.append(innovations(loop, moved, u, y, quiet=quiet)[:, 0])
        columns.append((ends[0] - ends[1]) / (2.0 * MOVED * abs(value)))
    return np.column_stack(columns)


def bound(loop: Loop, size: Array) -> Array:
    """Standard errors by the loop's innovations."""
    zeros = np.zeros((len(loop.reference), 1))
    true = loop.plant(loop.theta)
    z = scores(loop, *loop.simulated(true, loop.controller, zeros), quiet=False)
    one = np.ones((len(z), 1))
    if loop.coloured:
        z, one = (np.asarray(lfilter(AR, MA, table, axis=0)) for table in (z, one))
    one = np.linalg.qr(one)[0]
    z = z - one @ (one.T @ z)
    driving = loop.noise(np.random.default_rng(0), size)[1]
    information = z.T @ z / driving**2
    if not loop.coloured:
        pulse = zeros.copy()
        pulse[0] = 1.0
        still = replace(loop, reference=np.zeros_like(loop.reference))
        own = scores(loop, *still.simulated(true, loop.controller, pulse), quiet=True)
        counts = np.arange(len(own), 0, -1)[:, None]
        information = information + (own * counts).T @ own
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information))))


def row(case: Case, method: ThreeModel, seeds: range, size: Array) -> dict[str, Any]:
    """What a method makes of all records."""
    loop, errors, sizes, taken, begun = case.loop, [], [], 0, time.process_time()
    for seed in seeds:
        try:
            found = method.estimate([loop.record(seed, size)], loop.structure)
        except TridentifyError:
            continue
        if found.status.ok:
            errors.append(found.theta - loop.theta)
            sizes.append(found.std)
            taken += any(TAKEN in one for one in found.trace.decisions)
    e, s = np.array(errors), np.array(sizes)
    rmse = np.sqrt(np.mean(e**2, axis=0))
    z = np.abs(e.mean(axis=0)) / (e.std(axis=0, ddof=1) / np.sqrt(len(e)))
    return {
        "z": float(z.max()),
        "of_the_reference": (rmse / loop.bound(size, of_the_samples=not loop.sampled)).tolist(),
        "of_the_noise": (rmse / bound(loop, size)).tolist(),
        "cover": np.mean(np.abs(e) < 1.96 * s, axis=0).tolist(),
        "taken": taken,
        "failed": len(seeds) - len(e),
        "seconds": (time.process_time() - begun) / len(seeds),
    }


def text(name: str, one: dict[str, Any]) -> str:
    """A row as text."""
    first, second = (
        f"{min(one[key]):5.2f} - {max(one[key]):5.2f}"
        for key in ("of_the_reference", "of_the_noise")
    )
    held = f"{100 * min(one['cover']):4.0f} - {100 * max(one['cover']):4.0f}"
    return (
        f"  {name:14s} {one['z']:7.1f}   {first}   {second}   {held}"
        f" {one['taken']:6d} {one['failed']:6d} {one['seconds']:8.2f}"
    )


HEAD = (
    f"  {'':14s} {'max |z|':>7s}   {'RMSE / bound':>13s}   {'RMSE / bound':>13s}   {'95 %':>11s}"
    f" {'taken':>6s} {'failed':>6s} {'seconds':>8s}\n"
    f"  {'':14s} {'':7s}   {'of reference':>13s}   {'of the noise':>13s}   {'holds':>11s}"
)


def report(cases: dict[str, Any]) -> str:
    """All cases as text."""
    blocks = []
    for name, one in cases.items():
        share = f"bound of the noise {one['bounds']} of that of the reference"
        first = f"{name}: {one['draws']} draws; {share}"
        blocks.append("\n".join([first, HEAD, *(text(k, v) for k, v in one["rows"].items())]))
    return "\n\n".join(blocks)


MAKERS: list[Callable[[bool, bool, float, int], Loop]] = [demo, lag, resonant]
CASES = [
    *(Case(make(s, False, 0.1, 150), 10.0) for make in MAKERS for s in (True, False)),
    *(Case(make(s, False, 0.1, 3000), 10.0) for make in MAKERS for s in (True, False)),
    *(Case(make(s, False, 0.1, 3000), 0.0) for make in (demo, lag) for s in (True, False)),
    *(Case(demo(s, True, 0.1, 3000), 10.0) for s in (True, False)),
]


def stored() -> dict[str, Any]:
    """What earlier runs have kept."""
    path = HERE / "results" / "given_controller.json"
    return dict(json.loads(path.read_text())["data"]) if path.exists() else {}


def main() -> None:
    """Print the rows of every case."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--cases", nargs="*", default=[], help="parts of their names; default all")
    parser.add_argument("--save", action="store_true")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    kept: dict[str, Any] = stored() if given.save else {}
    for case in CASES:
        if given.cases and not any(one in case.name for one in given.cases):
            continue
        loop = case.loop
        size = loop.quiet().std(axis=0) * 10.0 ** (-case.snr / 20.0)
        share = bound(loop, size) / loop.bound(size, of_the_samples=not loop.sampled)
        noise: Any = "auto" if loop.coloured or not loop.sampled else "white"
        known = ThreeModel(noise=noise, controller=loop.control)
        unknown = replace(known, controller="sampled" if loop.sampled else "continuous")
        rows = {
            name: row(case, method, range(given.draws), size)
            for name, method in (("without", unknown), ("given", known))
        }
        kept[case.name] = {
            "draws": given.draws,
            "bounds": f"{share.min():.2f} to {share.max():.2f}",
            "rows": rows,
        }
        print(report({case.name: kept[case.name]}), flush=True)
        if given.save:
            keep("given_controller", report(kept), kept)


if __name__ == "__main__":
    main()
