"""The records that every package gets, and the Cramer-Rao bound of each.

Every case has one input, held between the samples, and one output; all start at rest without an
offset. The noise is white and Gaussian; draw ``k`` of case ``c`` has a generator of its own, so
that more draws change none of those before.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tridentify import Record, TransferFunction, simulate
from tridentify.studies.cramer_rao import cramer_rao_covariance, output_sensitivities

Array = NDArray[np.float64]
SEED = 20260

AIRCRAFT = TransferFunction([0.5], [1.0, 1.0, 3.0])
RAO_GARNIER = TransferFunction([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0])


@dataclass(frozen=True, eq=False)
class Case:
    """A noise-free record, the noise to add, and what an estimate is compared with.

    Attributes
    ----------
    truth : (poles + zeros + 1,) array
        ``a_{n-1} .. a_0, b_m .. b_0``.
    sigma : float
        Standard deviation of the noise.
    shipped : (n_samples,) array or None
        A noisy output that exists already: the first draw.
    """

    name: str
    title: str
    poles: int
    zeros: int
    dt: float
    u: Array
    clean: Array
    truth: Array
    sigma: float
    shipped: Array | None = None

    @property
    def names(self) -> list[str]:
        """Names of the coefficients, in the order of ``truth``."""
        down = [f"a{k}" for k in reversed(range(self.poles))]
        return down + [f"b{k}" for k in reversed(range(self.zeros + 1))]

    @property
    def model(self) -> TransferFunction:
        """The truth as a transfer function."""
        return TransferFunction(self.truth[self.poles :], [1.0, *self.truth[: self.poles]])

    def output(self, draw: int) -> Array:
        """The noisy output of one draw."""
        if self.shipped is not None:
            if draw == 0:
                return self.shipped
            draw -= 1
        key = [SEED, *self.name.encode(), draw]
        return self.clean + self.sigma * np.random.default_rng(key).standard_normal(self.u.size)

    def bound(self, free_numerator: bool = False) -> Array:
        """Smallest standard deviations of unbiased estimates of ``truth``.

        Parameters
        ----------
        free_numerator : bool
            Whether a numerator of degree ``poles - 1`` has to be estimated, as every sampled model
            of the system does.
        """
        columns = output_sensitivities(self.model, self.u, self.dt)
        n = columns.shape[1]
        if free_numerator:
            record = Record(self.u, self.clean, dt=self.dt)
            more = []
            for power in range(self.zeros + 1, self.poles):
                above = TransferFunction([1.0, *[0.0] * power], [1.0, *self.truth[: self.poles]])
                more.append(simulate(above, record).ravel())
            columns = np.column_stack([columns, *more])
        scale = np.linalg.norm(columns, axis=0)
        variances = np.diag(cramer_rao_covariance(columns / scale, self.sigma**2))
        return np.asarray((np.sqrt(variances) / scale)[:n])


def shift_register(stages: int, taps: tuple[int, int], length: int, hold: int) -> Array:
    """Levels +-1 of a maximum-length shift register, each held ``hold`` samples."""
    bits, levels = [1] * stages, []
    for _ in range(-(-length // hold)):
        levels.append(2.0 * bits[-1] - 1.0)
        bits = [bits[taps[0] - 1] ^ bits[taps[1] - 1], *bits[:-1]]
    return np.repeat(levels, hold)[:length]


def _made(
    name: str, title: str, model: TransferFunction, dt: float, u: Array, *, ratio: float, of: str
) -> Case:
    """A simulated case; ``ratio`` is the noise over the ``of`` ("rms" or "std") of the output."""
    clean = simulate(model, Record(u, np.zeros_like(u), dt=dt)).ravel()
    size = float(np.std(clean) if of == "std" else np.sqrt(np.mean(clean**2)))
    den, num = model.den[0][0], model.num[0][0]
    truth = np.concatenate([den[1:], num])
    return Case(name, title, den.size - 1, num.size - 1, dt, u, clean, truth, ratio * size)


def _flight() -> Case:
    """Elevator to pitch rate of the demonstration record, as changes from the trim."""
    folder = Path(__import__("tridentify").__file__).parent / "data"
    facts = json.loads((folder / "short_period.json").read_text())
    with (folder / "short_period.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    column = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    reference = facts["noise_free_reference"]["q"]["coefficients"]
    return Case(
        "flight",
        "JSBSim A-4, elevator to pitch rate, 3-2-1-1 twice, N = 501, noise 0.2 deg/s",
        2,
        1,
        facts["record"]["sample_interval"],
        column["delta_e"] - facts["trim"]["delta_e"],
        column["q_true"],
        np.array([reference[key] for key in ("a1", "a0", "c1", "c0")]),
        facts["noise"]["std"]["q"],
        column["q"],
    )


def all_cases() -> Iterator[Case]:
    """The cases in the order of the table."""
    step = np.ones
    yield _made(
        "step-5s", "0.5/(s^2 + s + 3), step, 5 s, N = 100, noise 50 % of rms",
        AIRCRAFT, 0.05, step(100), ratio=0.5, of="rms",
    )  # fmt: skip
    yield _made(
        "step-50s", "0.5/(s^2 + s + 3), step, 50 s, N = 1000, noise 50 % of rms",
        AIRCRAFT, 0.05, step(1000), ratio=0.5, of="rms",
    )  # fmt: skip
    yield _made(
        "binary", "0.5/(s^2 + s + 3), pseudo-random binary, 12.5 s, N = 250, noise 10 %",
        AIRCRAFT, 0.05, shift_register(7, (7, 6), 250, 7), ratio=0.1, of="std",
    )  # fmt: skip
    long = shift_register(10, (10, 7), 7161, 7)
    for size in (7161, 1000):
        yield _made(
            f"rao-garnier-{size}", f"Rao and Garnier, N = {size}, dt = 0.01 s, 10 dB",
            RAO_GARNIER, 0.01, long[:size], ratio=10**-0.5, of="std",
        )  # fmt: skip
    yield _flight()


def write(case: Case, draws: int, folder: Path) -> list[Path]:
    """Record files of one case: columns ``t,u,y`` with all their digits."""
    folder.mkdir(parents=True, exist_ok=True)
    t = case.dt * np.arange(case.u.size)
    files = []
    for draw in range(draws):
        path = folder / f"{draw:04d}.csv"
        table = np.column_stack([t, case.u, case.output(draw)])
        np.savetxt(path, table, fmt="%.17g", delimiter=",", header="t,u,y", comments="")
        files.append(path)
    return files
