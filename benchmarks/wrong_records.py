"""Records with one thing wrong in them, of random second-order systems, and right ones beside them.

Everything is simulated on a grid ten times finer than the samples, so that the input may do what it
likes between them and the system may be nonlinear or change. `draw` gives a record, the structure
that someone would ask for, what is true of the coefficients, and the codes of findings that name
the cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tridentify import Record, Structure

Array = NDArray[np.float64]
FINE = 10
"""Steps of the simulation a sample."""


@dataclass(frozen=True)
class Case:
    """One draw.

    Attributes
    ----------
    kind : str
        What is wrong.
    records : tuple of Record
    structure : Structure
    theta : array or None
        True coefficients where the structure has them.
    codes : tuple of str
        Findings that name the cause.
    """

    kind: str
    records: tuple[Record, ...]
    structure: Structure
    theta: Array | None
    codes: tuple[str, ...]


@dataclass(frozen=True)
class Plant:
    """``(b1 p + b0) / (p^2 + a1 p + a0)`` sampled every `dt`, with what may be wrong with it."""

    a1: float
    a0: float
    b1: float
    b0: float
    dt: float
    cubic: float = 0.0
    growth: float = 0.0
    delay: int = 0
    gain: float = 0.0

    @property
    def theta(self) -> Array:
        """In the order of `Structure.names`."""
        b = [self.b1, self.b0] if self.b1 else [self.b0]
        return np.array([self.a1, self.a0, *b])

    @property
    def structure(self) -> Structure:
        """Its orders."""
        return Structure(2, 1 if self.b1 else 0)


def plant_of(rng: np.random.Generator) -> Plant:
    """Natural frequency 1 to 10 rad/s, damping 0.15 to 0.9, 12 to 40 samples a period."""
    w, z = 10.0 ** rng.uniform(0.0, 1.0), rng.uniform(0.15, 0.9)
    gain = rng.uniform(0.5, 2.0) * rng.choice([-1.0, 1.0])
    b1 = gain * w * rng.uniform(0.3, 1.0) if rng.random() < 0.5 else 0.0
    return Plant(2 * z * w, w * w, b1, gain * w * w, 2 * np.pi / w / rng.uniform(12, 40))


def input_of(rng: np.random.Generator, n: int, plant: Plant) -> Array:
    """Input at the samples: held PRBS, random steps, doublets with rests, or levels at random."""
    period = 2 * np.pi / np.sqrt(plant.a0) / plant.dt
    hold = max(int(period / rng.uniform(3, 8)), 2)
    kind = rng.choice(["prbs", "steps", "doublets", "levels"])
    if kind == "prbs":
        return np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n]
    if kind == "levels":
        return np.repeat(rng.standard_normal(n // hold + 1), hold)[:n]
    if kind == "steps":
        return np.repeat(rng.choice([-1.0, 0.0, 1.0], n // (4 * hold) + 1), 4 * hold)[:n]
    one = np.repeat([0.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0], hold)
    return np.resize(one, n)


def run(plant: Plant, fine: Array, loop: Array | None = None) -> Array:
    """Output on the fine grid, by the implicit midpoint rule of the linear part.

    Parameters
    ----------
    plant : Plant
    fine : (n,) array
        Input, held over each fine step.
    loop : (n,) array, optional
        Noise at the sensor, constant over each sample, that feeds back with ``-gain``: what the
        controller sees at a sample acts until the next.
    """
    h, n = plant.dt / FINE, fine.size
    x, v = 0.0, 0.0
    y = np.empty(n)
    scale = max(plant.b0 * plant.b0 / plant.a0 / plant.a0, 1e-12)
    for k in range(n):
        y[k] = plant.b0 * x + plant.b1 * v
        u = fine[k]
        if plant.gain and loop is not None:
            u = u - plant.gain * (y[k - k % FINE] + loop[k - k % FINE])
            fine[k] = u
        a0 = plant.a0 * (1.0 + plant.growth * k / n)
        # velocity Verlet with damping: second order, stable at ten steps a sample
        a = u - plant.a1 * v - a0 * x - plant.cubic * plant.a0 * (plant.b0**2) * x**3 / scale
        w = v + 0.5 * h * a
        x = x + h * w
        a = u - plant.a1 * w - a0 * x - plant.cubic * plant.a0 * (plant.b0**2) * x**3 / scale
        v = w + 0.5 * h * a
    return y


def colour(rng: np.random.Generator, n: int, white: bool | None = None) -> Array:
    """White or autoregressive noise of variance one; which of them is drawn unless stated."""
    noise = rng.standard_normal(n + 100)
    drawn = rng.random() < 0.5
    if drawn if white is None else white:
        return noise[100:]
    return np.sqrt(1 - 0.49) * lfilter([1.0], [1.0, -0.7], noise)[100:]


def recorded(
    rng: np.random.Generator,
    plant: Plant,
    n: int,
    *,
    measured: bool = False,
    slower: float = 1.0,
) -> tuple[Array, Array, float]:
    """Input and noise-free output at the samples, and the standard deviation of the noise."""
    fine = np.repeat(input_of(rng, n, plant), FINE)
    if measured:
        pole = np.exp(-1.0 / (FINE * slower * rng.uniform(1.5, 4.0)))
        fine = lfilter([1 - pole], [1, -pole], fine)
    late = np.concatenate([np.full(plant.delay * FINE, fine[0]), fine])[: fine.size]
    y = run(plant, late)
    size = float(np.std(y[::FINE])) * 10.0 ** (-rng.uniform(10, 30) / 20.0)
    return fine[::FINE], y[::FINE], size


def draw(kind: str, seed: int) -> Case:
    """One record of a kind of `KINDS`."""
    rng = np.random.default_rng([seed, sorted(KINDS).index(kind)])
    return replace(KINDS[kind](rng, plant_of(rng), int(rng.integers(250, 1200))), kind=kind)


def right(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """Nothing wrong."""
    u, y, size = recorded(rng, plant, n)
    record = Record(u, y + size * colour(rng, n), dt=plant.dt)
    return Case("", (record,), plant.structure, plant.theta, ())


def right_measured(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """A measured input whose behaviour is left open."""
    u, y, size = recorded(rng, plant, n, measured=True, slower=3.0)
    record = Record(u, y + size * colour(rng, n), dt=plant.dt, intersample="auto")
    return Case("", (record,), plant.structure, plant.theta, ())


def right_twice(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """Two experiments of one plant and one noise, with an offset."""
    records, size, white = [], 0.0, bool(rng.random() < 0.5)
    for _ in range(2):
        u, y, own = recorded(rng, plant, n // 2)
        size = size or own
        records.append(Record(u, y + 0.3 + size * colour(rng, n // 2, white), dt=plant.dt))
    return Case("", tuple(records), plant.structure, plant.theta, ())


def hang(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """The sensor keeps its last value for 10 to 50 % of the record."""
    u, y, size = recorded(rng, plant, n)
    y = y + size * colour(rng, n)
    length = int(n * rng.uniform(0.1, 0.5))
    first = int(rng.integers(5, n - length))
    y[first : first + length] = y[first - 1]
    record = Record(u, y, dt=plant.dt)
    return Case("", (record,), plant.structure, plant.theta, ("stuck-sensor",))


def sine(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """A single sine, and four poles asked for."""
    w = np.sqrt(plant.a0) * rng.uniform(0.5, 1.5)
    fine = np.sin(w * np.arange(n * FINE) * plant.dt / FINE)
    u = np.repeat(fine[::FINE], FINE)
    y = run(plant, u.copy())[::FINE]
    size = float(np.std(y)) * 10.0 ** (-rng.uniform(10, 30) / 20.0)
    record = Record(u[::FINE], y + size * rng.standard_normal(n), dt=plant.dt)
    codes = ("order-high", "not-excited", "not-determined")
    return Case("", (record,), Structure(4, 2), None, codes)


def varying(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """The stiffness grows by 40 to 150 % over the record."""
    plant = replace(plant, growth=rng.uniform(0.4, 1.5))
    case = right(rng, plant, n)
    return replace(case, codes=("varying",))


def intersample(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """A measured input stated as held."""
    u, y, size = recorded(rng, plant, n, measured=True)
    record = Record(u, y + size * colour(rng, n), dt=plant.dt)
    return Case("", (record,), plant.structure, plant.theta, ("intersample", "delay"))


def delay(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """The input acts 1 to 8 samples later."""
    plant = replace(plant, delay=int(rng.integers(1, 9)))
    return replace(right(rng, plant, n), codes=("delay",))


def drift(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """A slow disturbance of the output: a random walk, smoothed, or a slow sine."""
    u, y, size = recorded(rng, plant, n)
    t = np.arange(n) / n
    slow = np.sin(2 * np.pi * (rng.uniform(0.3, 1.5) * t + rng.random()))
    if rng.random() < 0.5:
        slow = np.cumsum(rng.standard_normal(n)) / np.sqrt(n)
    y = y + slow * float(np.std(y)) * rng.uniform(0.3, 1.0)
    record = Record(u, y + size * colour(rng, n), dt=plant.dt)
    return Case("", (record,), plant.structure, plant.theta, ("drift", "noise-model"))


def lost_rows(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """Pieces of 1 to 30 rows are lost without a trace in the time stamps."""
    u, y, size = recorded(rng, plant, n)
    y = y + size * colour(rng, n)
    kept = np.ones(n, dtype=bool)
    for _ in range(int(rng.integers(1, 5))):
        first = int(rng.integers(0, n - 30))
        kept[first : first + int(rng.integers(1, 31))] = False
    record = Record(u[kept], y[kept], dt=plant.dt)
    codes = ("lost-rows", "bad-samples", "varying")
    return Case("", (record,), plant.structure, plant.theta, codes)


def clipped(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """The output is clipped at 40 to 70 % of its range, and noise is added after that."""
    u, y, size = recorded(rng, plant, n)
    limit = float(np.max(np.abs(y))) * rng.uniform(0.4, 0.7)
    record = Record(u, np.clip(y, -limit, limit) + size * colour(rng, n), dt=plant.dt)
    return Case("", (record,), plant.structure, plant.theta, ("saturation", "nonlinear"))


def feedback(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """A proportional controller at work, sampled with the record."""
    plant = replace(plant, gain=rng.uniform(0.3, 1.2) / abs(plant.b0 / plant.a0))
    reference = np.repeat(input_of(rng, n, plant), FINE)
    reference = reference * abs(plant.b0 / plant.a0) * plant.gain
    noise = colour(rng, n) * abs(plant.b0 / plant.a0) * rng.uniform(0.05, 0.4)
    signed = replace(plant, gain=plant.gain * np.sign(plant.b0))
    fine = reference.copy()
    y = run(signed, fine, np.repeat(noise, FINE))[::FINE]
    # the controller acts on samples: what it gave is held
    record = Record(fine[::FINE], y + noise, dt=plant.dt)
    return Case("", (record,), plant.structure, plant.theta, ("feedback",))


def cubic(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """A spring that hardens."""
    plant = replace(plant, cubic=rng.uniform(0.3, 1.5))
    return replace(right(rng, plant, n), codes=("nonlinear",))


def two_plants(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """Two experiments, the stiffness of the second 30 to 100 % higher, identified as one."""
    other = replace(plant, a0=plant.a0 * rng.uniform(1.3, 2.0))
    records, size, white = [], 0.0, bool(rng.random() < 0.5)
    for own in (plant, other):
        u, y, noise = recorded(rng, own, n // 2)
        size = size or noise
        records.append(Record(u, y + size * colour(rng, n // 2, white), dt=plant.dt))
    codes = ("disagreeing-experiments",)
    return Case("", tuple(records), plant.structure, plant.theta, codes)


def spikes(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """1 % of the samples far off, or the first three."""
    u, y, size = recorded(rng, plant, n)
    y = y + size * colour(rng, n)
    if rng.random() < 0.5:
        y[:3] += np.array([-1.0, 0.8, -0.4]) * 20 * size
    else:
        at = rng.choice(n, max(n // 100, 1), replace=False)
        y[at] += rng.choice([-1.0, 1.0], at.size) * rng.uniform(10, 30, at.size) * size
    record = Record(u, y, dt=plant.dt)
    return Case("", (record,), plant.structure, plant.theta, ("bad-samples",))


def low_order(rng: np.random.Generator, plant: Plant, n: int) -> Case:
    """One pole asked for where there are two."""
    return replace(
        right(rng, plant, n), structure=Structure(1, 0), theta=None, codes=("order-low",)
    )


KINDS: dict[str, Callable[[np.random.Generator, Plant, int], Case]] = {
    "right": right,
    "right, input measured": right_measured,
    "right, two experiments": right_twice,
    "sensor hangs": hang,
    "single sine, four poles": sine,
    "plant varies": varying,
    "input measured, stated held": intersample,
    "delay": delay,
    "slow disturbance": drift,
    "lost rows": lost_rows,
    "clipped, then noise": clipped,
    "feedback": feedback,
    "cubic spring": cubic,
    "two plants as one": two_plants,
    "spikes": spikes,
    "order too low": low_order,
}
