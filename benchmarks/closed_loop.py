"""Closed loops: bias, efficiency and coverage of the reference route, and of its rivals beside it.

The demo of the CONTSID toolbox, ``G = (s + 1) / (s^2 + 0.5 s + 1)`` with ``C = (10 s + 15) / s``
and a binary reference at the plant's input, at 10 dB: controller continuous or sampled, noise white
or ARMA, fine and coarse samples; and a loop with two inputs and two outputs, two PI controllers on
a coupled plant. The loops are simulated exactly (`loops.run`).

The bound is that of the reference as an instrument, ``sigma^2 (sum Z Z')^-1``: `Z` are derivatives
of the model's output with respect to its coefficients, for the input as it would be without noise,
whitened with the true filter of the noise, an offset projected out. They come from the loop itself,
with a second plant beside the one that is controlled, whose coefficients are moved. What a
continuous controller does between the samples is not recorded. What it makes of the noise there
colours what any model leaves (`Loop.around`). What it makes of the reference there follows from a
model alone, so that it moves with the coefficients (`Loop.followed`), which mostly takes
information away: that of a direct gain in a fast loop. The bound is that of samples with this
colour and these derivatives. How many times that of a recorded input it is, is printed beside it.

For each coefficient: `|z|` of the mean error (its size in standard errors of the mean; the largest
over the coefficients is shown), RMSE over the bound and share of 95 % intervals that hold the truth
(both as the range over the coefficients). Failed: refused, or without a usable status.
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
from loops import Controller, System, run, tustin
from machine import HERE, keep
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.signal import lfilter

from tridentify import (
    ClosedLoopRefinedInstrumentalVariable,
    Projection,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    TridentifyError,
    TwoStage,
)

Array = NDArray[np.float64]

SNR = 10.0
"""Of the noise-free output in the loop over the noise [dB]."""
AR, MA = [1.0, -1.0, 0.2], [1.0, 0.9]
"""Denominator and numerator of the coloured noise."""
SETTLED = 200
"""Samples after which the coloured noise has forgotten its start."""
HOLD = 2.5
"""Time that the reference of the demo holds a value [s]."""
UNLIKE = 0.01
"""Share by which two bounds may differ and be called one."""
MOVED = 1e-4
"""By which a coefficient is moved for a derivative, relative."""


@dataclass(frozen=True, eq=False)
class Loop:
    """One kind of records.

    Attributes
    ----------
    name : str
    structure : Structure
    theta : (n_coefficients,) array
        True ones.
    plant : callable
        From coefficients to the plant.
    law : System
        Continuous controller from the control error to the plant's input.
    control : TransferFunction
        The same.
    sampled, coloured : bool
    dt : float
        [s].
    reference : (n, n_references) array
    at_input : bool
        Where the reference enters: at the plant's input, or at the set point.
    """

    name: str
    structure: Structure
    theta: Array
    plant: Callable[[Array], System]
    law: System
    control: TransferFunction
    sampled: bool
    coloured: bool
    dt: float
    reference: Array
    at_input: bool

    @property
    def controller(self) -> Controller:
        """As `loops.run` takes it."""
        return Controller(tustin(self.law, self.dt) if self.sampled else self.law, self.sampled)

    def simulated(self, plant: System, law: Controller, noise: Array) -> tuple[Array, Array]:
        """Input and output; reference and noise have zeros for outputs beyond those controlled."""
        nothing = np.zeros((len(self.reference), plant.b.shape[1]))
        dither = self.reference if self.at_input else nothing
        point = np.zeros_like(noise)
        if not self.at_input:
            point[:, : self.reference.shape[1]] = self.reference
        return run(plant, law, point, noise, dither, self.dt, fine=1)

    def scores(self) -> list[Array]:
        """(n, n_coefficients) per output: derivatives of the output for the noise-free input."""
        true, law = self.plant(self.theta), self.controller
        count = len(true.c)
        half = System(
            law.system.a,
            np.hstack([law.system.b, np.zeros((len(law.system.a), count))]),
            law.system.c,
            np.hstack([law.system.d, np.zeros((len(law.system.d), count))]),
        )
        columns = []
        for k, value in enumerate(self.theta):
            ends = []
            for sign in (1.0, -1.0):
                moved = self.theta.copy()
                moved[k] += sign * MOVED * abs(value)
                beside = beside_each_other(true, self.plant(moved))
                seen = Controller(half, law.sampled)
                quiet = np.zeros((len(self.reference), 2 * count))
                ends.append(self.simulated(beside, seen, quiet)[1][:, count:])
            columns.append((ends[0] - ends[1]) / (2.0 * MOVED * abs(value)))
        return [np.column_stack([one[:, i] for one in columns]) for i in range(count)]

    def followed(self) -> list[Array]:
        """`scores` where the driven input is known at its samples alone, and follows the model."""
        true, law = self.plant(self.theta), self.controller
        quiet = np.zeros((len(self.reference), len(true.c)))
        recorded, columns = self.simulated(true, law, quiet)[0], []
        held = Controller(blind(recorded.shape[1], len(true.c)))
        for k, value in enumerate(self.theta):
            ends = []
            for sign in (1.0, -1.0):
                moved = self.theta.copy()
                moved[k] += sign * MOVED * abs(value)
                plant = self.plant(moved)
                u, y = self.simulated(plant, law, quiet)
                ends.append(y + run(plant, held, quiet, quiet, recorded - u, self.dt, fine=1)[1])
            columns.append((ends[0] - ends[1]) / (2.0 * MOVED * abs(value)))
        return [np.column_stack([one[:, i] for one in columns]) for i in range(len(true.c))]

    def noise(self, rng: np.random.Generator, sizes: Array) -> tuple[Array, Array]:
        """(n, n_outputs) noise, and the standard deviation of what drives it."""
        e = rng.standard_normal((len(self.reference) + SETTLED, len(sizes)))
        gain = 1.0
        if self.coloured:
            e = np.asarray(lfilter(MA, AR, e, axis=0))
            impulse = lfilter(MA, AR, np.eye(1, SETTLED)[0])
            gain = float(np.linalg.norm(impulse))
        return e[SETTLED:] / gain * sizes, sizes / gain

    def quiet(self) -> Array:
        """(n, n_outputs) noise-free output."""
        plant = self.plant(self.theta)
        return self.simulated(
            plant, self.controller, np.zeros((len(self.reference), len(plant.c)))
        )[1]

    def around(self) -> Array:
        """(n, n_outputs, n_outputs) what one sample of noise leaves where the input counts as held.

        Output after output: the noise itself, and what the controller makes of it between samples.
        """
        plant, count = self.plant(self.theta), self.quiet().shape[1]
        still = replace(self, reference=np.zeros_like(self.reference))
        found = np.empty((len(self.reference), count, count))
        for i in range(count):
            pulse = np.zeros((len(self.reference), count))
            pulse[0, i] = 1.0
            u, y = still.simulated(plant, self.controller, pulse)
            law = Controller(blind(u.shape[1], count))
            zeros = np.zeros_like(pulse)
            found[:, :, i] = y - run(plant, law, zeros, zeros, u, self.dt, fine=1)[1]
        return found

    def bound(self, sizes: Array, *, of_the_samples: bool = False) -> Array:
        """Standard errors of the reference-instrument estimate.

        Parameters
        ----------
        sizes : (n_outputs,) array
            Of the noise.
        of_the_samples : bool
            Whether the input is known at its samples alone, so that what a continuous controller
            makes of the noise between them colours it (`around`), and what it makes of the
            reference follows the model (`followed`).
        """
        driving = self.noise(np.random.default_rng(0), sizes)[1]
        scores = np.stack(self.followed() if of_the_samples else self.scores(), axis=1)
        steady = np.broadcast_to(np.eye(len(sizes)), (len(scores), len(sizes), len(sizes)))
        table = np.concatenate([scores, steady], axis=2)
        if self.coloured:
            table = lfilter(AR, MA, table, axis=0)
        if of_the_samples:
            table = divided(table, self.around())
        table = (table / driving[None, :, None]).reshape(-1, table.shape[2])
        z, one = table[:, : self.theta.size], np.linalg.qr(table[:, self.theta.size :])[0]
        z = z - one @ (one.T @ z)
        return np.asarray(np.sqrt(np.diag(np.linalg.inv(z.T @ z))))

    def record(self, seed: int, sizes: Array) -> Record:
        """A record of the loop."""
        noise = self.noise(np.random.default_rng(seed), sizes)[0]
        u, y = self.simulated(self.plant(self.theta), self.controller, noise)
        return Record(u, y, dt=self.dt, reference=self.reference)


def blind(n_inputs: int, n_outputs: int) -> System:
    """A controller that does nothing."""
    return System(
        np.zeros((0, 0)), np.zeros((0, n_outputs)), np.zeros((n_inputs, 0)),
        np.zeros((n_inputs, n_outputs)),
    )  # fmt: skip


def divided(table: Array, around: Array) -> Array:
    """Columns whitened by the colour of `Loop.around`, by transforms of twice the length."""
    length = 2 * len(table)
    colour = np.fft.rfft(around, length, axis=0)
    found = np.linalg.solve(colour, np.fft.rfft(table, length, axis=0))
    return np.asarray(np.fft.irfft(found, length, axis=0)[: len(table)])


def beside_each_other(one: System, other: System) -> System:
    """Two plants with the same input; the outputs of the first, then those of the other."""
    return System(
        block_diag(one.a, other.a),
        np.vstack([one.b, other.b]),
        block_diag(one.c, other.c),
        np.zeros((len(one.c) + len(other.c), one.b.shape[1])),
    )


def binary(n: int, hold: int, count: int = 1) -> Array:
    """(n, count) maximum-length sequence of 15 values, each column a third of a period later."""
    stages, values = [1, 1, 1, 1], []
    while len(values) * hold < n + 10 * hold * count:
        values.append(2.0 * stages[-1] - 1.0)
        stages = [stages[3] ^ stages[2], *stages[:3]]
    whole = np.repeat(values, hold)
    return np.column_stack([whole[5 * k * hold :][:n] for k in range(count)])


def kind(sampled: bool, coloured: bool) -> str:
    """In words."""
    return f"{'sampled' if sampled else 'continuous'}, {'ARMA' if coloured else 'white'}"


def demo(sampled: bool, coloured: bool, dt: float, n: int) -> Loop:
    """The demo of the CONTSID toolbox."""
    return Loop(
        f"demo, {kind(sampled, coloured)}, {dt} s",
        Structure(2, 1),
        np.array([0.5, 1.0, 1.0, 1.0]),
        lambda t: System.of(t[2:], np.r_[1.0, t[:2]]),
        System.of([10.0, 15.0], [1.0, 0.0]),
        TransferFunction([10.0, 15.0], [1.0, 0.0]),
        sampled,
        coloured,
        dt,
        binary(n, round(HOLD / dt)),
        True,
    )


def coupled_plant(theta: Array) -> System:
    """Two inputs and two outputs on one denominator of second order, in observer form."""
    own = np.array([[-theta[0], 1.0], [-theta[1], 0.0]])
    numerators = theta[2:].reshape(2, 2, 2)
    rows = [np.column_stack([numerators[i, j] for j in range(2)]) for i in range(2)]
    seen = np.array([[1.0, 0.0]])
    return System(block_diag(own, own), np.vstack(rows), block_diag(seen, seen), np.zeros((2, 2)))


def coupled(sampled: bool, coloured: bool) -> Loop:
    """Two PI controllers, each on its own output, on a coupled plant; two set points."""
    law = System(np.zeros((2, 2)), np.eye(2), np.diag([1.0, 1.5]), np.diag([2.0, 3.0]))
    control = TransferFunction(
        [[[2.0, 1.0], [0.0]], [[0.0], [3.0, 1.5]]], [[[1.0, 0.0], [1.0, 0.0]]] * 2
    )
    theta = np.array([1.2, 1.0, 1.0, 0.8, 0.3, 0.4, -0.2, 0.5, 1.0, 1.2])
    name = f"2 x 2, {kind(sampled, coloured)}, 0.05 s"
    return Loop(
        name, Structure(2, 1), theta, coupled_plant, law, control, sampled, coloured, 0.05,
        binary(3000, 40, 2), False,
    )  # fmt: skip


LOOPS = [
    *(
        demo(sampled, coloured, dt, n)
        for dt, n in ((0.1, 3000), (0.005, 7501))
        for sampled in (True, False)
        for coloured in (False, True)
    ),
    *(coupled(sampled, coloured) for coloured in (False, True) for sampled in (True, False)),
]


def methods(loop: Loop) -> dict[str, Any]:
    """Name -> method."""
    # a continuous controller colours even white noise, where its input counts at the samples alone
    noise: Any = "auto" if loop.coloured or not loop.sampled else "white"
    works: Any = "sampled" if loop.sampled else "continuous"
    known: dict[str, Any] = {"CLSRIVC": ClosedLoopRefinedInstrumentalVariable(loop.control)}
    if not loop.sampled:
        known["  controller given"] = ThreeModel(noise=noise, controller=loop.control)
    return {
        "reference route": ThreeModel(noise=noise, controller=works),
        "  controller unknown": ThreeModel(noise=noise),
        "open loop": ThreeModel(noise=noise, route="open-loop", finish="likelihood"),
        "direct, AR noise": ThreeModel(route="direct", finish="likelihood"),
        "two-stage": TwoStage(),
        "projection": Projection(),
        **(known if loop.control.is_siso else {}),
    }


def row(loop: Loop, method: Any, records: list[Record], bound: Array) -> dict[str, Any]:
    """What a method makes of all records."""
    errors, held, failed, begun = [], [], 0, time.process_time()
    for record in records:
        try:
            found = method.estimate([record], loop.structure)
        except TridentifyError:
            failed += 1
            continue
        if not found.status.ok:
            failed += 1
            continue
        error = found.theta - loop.theta
        errors.append(error)
        held.append(np.abs(error) < 1.96 * found.std)
    spent = (time.process_time() - begun) / len(records)
    if len(errors) < 2:
        return {"failed": failed, "seconds": spent}
    e = np.array(errors)
    z = np.abs(e.mean(axis=0)) / (e.std(axis=0, ddof=1) / np.sqrt(len(e)))
    return {
        "z": z.tolist(),
        "ratio": (np.sqrt(np.mean(e**2, axis=0)) / bound).tolist(),
        "cover": np.mean(held, axis=0).tolist(),
        "failed": failed,
        "seconds": spent,
    }


def case(loop: Loop, draws: int, wanted: list[str], save: Callable[[dict[str, Any]], None]) -> None:
    """Rows of one loop, kept as they come."""
    size = loop.quiet().std(axis=0) * 10.0 ** (-SNR / 20.0)
    bound = loop.bound(size, of_the_samples=not loop.sampled)
    records = [loop.record(seed, size) for seed in range(draws)]
    told = {
        "samples": len(loop.reference),
        "bound": bound.tolist(),
        "of_a_recorded_input": (bound / loop.bound(size)).tolist(),
    }
    for name, method in methods(loop).items():
        if wanted and not any(one in name for one in wanted):
            continue
        found = {"draws": draws, **row(loop, method, records, bound)}
        print(line(name, found), flush=True)
        save({**told, "rows": {name: found}})


def line(name: str, found: dict[str, Any]) -> str:
    """A row as text."""
    end = f"{found['draws']:6d}{found['failed']:7d}  {found['seconds']:7.2f}"
    if "z" not in found:
        return f"  {name:24s} {'-':>7s}  {'-':>13s}  {'-':>11s}{end}"
    low, high = min(found["ratio"]), max(found["ratio"])
    few, many = 100 * min(found["cover"]), 100 * max(found["cover"])
    ranges = f"{low:5.2f} - {high:5.2f}  {few:4.0f} - {many:4.0f}"
    return f"  {name:24s} {max(found['z']):7.1f}  {ranges}{end}"


def report(cases: dict[str, Any]) -> str:
    """All cases as text."""
    titles = f"{'max |z|':>7s}  {'RMSE / bound':>13s}  {'95 % holds':>11s}"
    head = f"  {'':24s} {titles} draws failed  seconds"
    blocks = []
    for name, one in cases.items():
        first = f"{name}: {one['samples']} samples, {SNR:.0f} dB"
        more = one["of_a_recorded_input"]
        if max(more) > 1.0 + UNLIKE or min(more) < 1.0 - UNLIKE:
            first += f"; bound {min(more):.2f} to {max(more):.2f} times that of a recorded input"
        blocks.append("\n".join([first, head, *(line(k, v) for k, v in one["rows"].items())]))
    return "\n\n".join(blocks)


def stored() -> dict[str, Any]:
    """What earlier runs have kept."""
    path = HERE / "results" / "closed_loop.json"
    return dict(json.loads(path.read_text())["data"]) if path.exists() else {}


def main() -> None:
    """Print the rows of every loop."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--loops", nargs="*", default=[], help="parts of their names; default all")
    parser.add_argument("--methods", nargs="*", default=[], help="parts of their names")
    parser.add_argument("--save", action="store_true", help="also keep; other loops stay as kept")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    cases = stored() if given.save else {}
    for loop in LOOPS:
        if given.loops and not any(one in loop.name for one in given.loops):
            continue
        print(f"{loop.name}: {given.draws} draws", flush=True)

        def save(found: dict[str, Any], name: str = loop.name) -> None:
            rows = cases.get(name, {}).get("rows", {}) | found["rows"]
            cases[name] = {**found, "rows": rows}
            if given.save:
                keep("closed_loop", report(cases), cases)

        case(loop, given.draws, given.methods, save)


if __name__ == "__main__":
    main()
