"""Random control loops, simulated exactly: plants that are stable or not, controllers of all kinds.

Plants of order 1 to 3, stable, integrating or unstable; controllers P, PI, lead, and state feedback
with an observer (sampled LQG), sampled with or without one sample of delay, or continuous. What
moves the loop is a reference (steps or PRBS), a dither at the plant's input, or nothing. Noise at
the sensor is white or autoregressive.

Between two instants of the grid everything that enters is held, so that one matrix exponential
gives the next instant without error. With a sampled controller the grid is that of the samples;
with a continuous one it is `FINE` times finer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm, solve_discrete_are
from scipy.signal import lfilter, tf2ss

from tridentify import Record, Structure, TransferFunction, simulate

Array = NDArray[np.float64]

FINE = 10
"""Steps of the grid a sample where the controller is continuous."""
EXCITATIONS = ("steps", "prbs", "dither", "none")
CONTROLLERS = ("P", "PI", "lead", "LQG")
COLOUR = 0.7
"""Coefficient of the autoregressive noise."""
STABLE = -0.02
"""Real part of the rightmost pole below which a plant is stable in a record of this length."""
NOTHING = 1e-9
"""Size below which a coefficient has no relative error."""
MOST_TRIES = 200
"""Gains that are tried before another controller is drawn."""


@dataclass(frozen=True, eq=False)
class System:
    """A state-space system; sampled where a step is meant, else continuous.

    Attributes
    ----------
    a, b, c, d : array
        (n, n), (n, n_inputs), (n_outputs, n), (n_outputs, n_inputs).
    """

    a: Array
    b: Array
    c: Array
    d: Array

    @classmethod
    def of(cls, num: Array | list[float], den: Array | list[float]) -> System:
        """Of one transfer function."""
        if len(den) == 1:
            empty = np.zeros((0, 0))
            gain = np.atleast_2d(np.asarray(num, dtype=float)[-1] / den[0])
            return cls(empty, np.zeros((0, 1)), np.zeros((1, 0)), gain)
        return cls(*(np.asarray(one, dtype=float) for one in tf2ss(num, den)))


@dataclass(frozen=True, eq=False)
class Controller:
    """What acts on ``r - y``.

    Attributes
    ----------
    system : System
        From the control error to the plant's input; in discrete time where it is sampled.
    sampled : bool
    delay : int
        Samples until a sampled controller acts: 0 or more.
    limit : float
        Largest input that a sampled controller gives.
    """

    system: System
    sampled: bool = True
    delay: int = 0
    limit: float = np.inf


def held(a: Array, b: Array, step: float) -> tuple[Array, Array]:
    """Transition and input matrix over a step, the input held."""
    n, m = b.shape
    grown = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * step)
    return grown[:n, :n], grown[:n, n:]


def run(
    plant: System,
    controller: Controller,
    reference: Array,
    noise: Array,
    dither: Array,
    dt: float,
    fine: int = FINE,
) -> tuple[Array, Array]:
    """Input and measured output of a loop at the samples, from rest.

    Parameters
    ----------
    plant : System
        Continuous and strictly proper.
    controller : Controller
    reference : (n, n_outputs) array
        One row a sample, held.
    noise : (n, n_outputs) or (n * fine, n_outputs) array
        At the sensor, held over each step of the grid; the longer one with a continuous controller.
    dither : (n, n_inputs) array
        Added to the plant's input, held.
    dt : float
        Sampling interval [s].
    fine : int
        Steps of the grid a sample, with a continuous controller.

    Returns
    -------
    u, y : (n, n_inputs), (n, n_outputs) array
    """
    if controller.sampled:
        return _sampled(plant, controller, reference, noise, dither, dt)
    return _continuous(plant, controller.system, reference, noise, dither, dt, fine)


def _sampled(
    plant: System, controller: Controller, r: Array, v: Array, w: Array, dt: float
) -> tuple[Array, Array]:
    law, late = controller.system, controller.delay
    a, b = held(plant.a, plant.b, dt)
    n, x, z = r.shape[0], np.zeros(plant.a.shape[0]), np.zeros(law.a.shape[0])
    u, y, wanted = np.empty((n, w.shape[1])), np.empty_like(r), np.zeros((n + late, w.shape[1]))
    for k in range(n):
        y[k] = plant.c @ x + v[k]
        error = r[k] - y[k]
        wanted[k + late] = law.c @ z + law.d @ error
        z = law.a @ z + law.b @ error
        u[k] = np.clip(wanted[k] + w[k], -controller.limit, controller.limit)
        x = a @ x + b @ u[k]
    return u, y


def _continuous(
    plant: System, law: System, r: Array, v: Array, w: Array, dt: float, fine: int
) -> tuple[Array, Array]:
    a = np.block(
        [
            [plant.a - plant.b @ law.d @ plant.c, plant.b @ law.c],
            [-law.b @ plant.c, law.a],
        ]
    )
    b = np.block(
        [
            [plant.b @ law.d, plant.b],
            [law.b, np.zeros((law.a.shape[0], plant.b.shape[1]))],
        ]
    )
    step, by = held(a, b, dt / fine)
    out = np.hstack([-law.d @ plant.c, law.c])
    x, u, y = np.zeros(a.shape[0]), [], []
    n_plant = plant.a.shape[0]
    for k in range(r.shape[0] * fine):
        error, own = r[k // fine] - v[k], w[k // fine]
        if k % fine == 0:
            y.append(plant.c @ x[:n_plant] + v[k])
            u.append(out @ x + law.d @ error + own)
        x = step @ x + by @ np.concatenate([error, own])
    return np.array(u), np.array(y)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A random loop, or an open-loop record beside it.

    Attributes
    ----------
    record : Record
        Input and measured output; the reference is beside it.
    reference, dither : (n,) array
    structure : Structure
        Of the plant.
    theta : (n_coefficients,) array
        True coefficients.
    poles : complex array
        Of the plant [rad/s].
    controller : str
        One of `CONTROLLERS`.
    excitation : str
        One of `EXCITATIONS`.
    sampled : bool
    delay : int
        Of the controller [samples].
    snr : float
        Of what the excitation makes of the output over the noise [dB]; nan without an excitation.
    coloured : bool
    """

    record: Record
    reference: Array
    dither: Array
    structure: Structure
    theta: Array
    poles: NDArray[np.complex128]
    controller: str
    excitation: str
    sampled: bool
    delay: int
    snr: float
    coloured: bool


def polynomials(rng: np.random.Generator) -> tuple[Array, Array]:
    """Numerator and denominator of a random plant, time in units of its fastest mode."""
    order = int(rng.integers(1, 4))
    kind = rng.choice(["stable", "stable", "integrating", "unstable"])
    poles: list[complex] = []
    if kind == "integrating":
        poles = [0.0]
    elif kind == "unstable":
        poles = [rng.uniform(0.1, 0.5)]
    while len(poles) < order:
        w = rng.uniform(0.3, 1.0)
        if order - len(poles) > 1 and rng.random() < 0.6:
            z = rng.uniform(0.15, 0.9)
            poles += [w * complex(-z, s * np.sqrt(1 - z * z)) for s in (1.0, -1.0)]
        else:
            poles.append(-w)
    den = np.real(np.poly(poles))
    zeros = [-rng.uniform(0.5, 2.0)] if order > 1 and rng.random() < 0.4 else []
    num = np.real(np.poly(zeros)) if zeros else np.ones(1)
    size = np.abs(np.polyval(num, 0.5j) / np.polyval(den, 0.5j))
    return num / size * rng.uniform(0.5, 2.0), den


def controller_of(
    rng: np.random.Generator, kind: str, plant: System, dt: float, sampled: bool, delay: int
) -> Controller | None:
    """A controller of a kind that stabilises the plant, not too well; None where none was found."""
    if kind == "LQG":
        return Controller(lqg(rng, plant, dt, delay), True, delay)
    for _ in range(MOST_TRIES):
        gain = 10.0 ** rng.uniform(-0.7, 1.0)
        if kind == "P":
            num, den = [gain], [1.0]
        elif kind == "PI":
            num, den = [gain, gain * rng.uniform(0.05, 0.5)], [1.0, 0.0]
        else:
            zero = rng.uniform(0.3, 1.0)
            pole = zero * rng.uniform(3.0, 8.0)
            num, den = [gain * pole / zero, gain * pole], [1.0, pole]
        law = System.of(num, den)
        if sampled:
            law = tustin(law, dt)
        made = Controller(law, sampled, delay if sampled else 0)
        if settles(plant, made, dt):
            return made
    return None


def tustin(law: System, dt: float) -> System:
    """A continuous controller, sampled by the trapezoidal rule."""
    n = law.a.shape[0]
    if n == 0:
        return law
    inverse = np.linalg.inv(np.eye(n) - 0.5 * dt * law.a)
    a = inverse @ (np.eye(n) + 0.5 * dt * law.a)
    b, c = inverse @ law.b * dt, law.c @ inverse
    return System(a, b, c, law.d + 0.5 * law.c @ inverse @ law.b * dt)


def lqg(rng: np.random.Generator, plant: System, dt: float, delay: int) -> System:
    """State feedback on a one-step observer, sampled; it acts on ``r - y``.

    With a delay the held inputs that have not yet acted are states of the plant.
    """
    a, b = held(plant.a, plant.b, dt)
    c = plant.c
    for _ in range(delay):
        n, m = b.shape
        a = np.block([[a, b], [np.zeros((m, n + m))]])
        b = np.vstack([np.zeros((n, m)), np.eye(m)])
        c = np.hstack([c, np.zeros((c.shape[0], m))])
    small = 1e-6 * np.eye(a.shape[0])
    weight = 10.0 ** rng.uniform(-1.0, 1.0)
    p = solve_discrete_are(a, b, c.T @ c + small, weight * np.eye(b.shape[1]))
    gain = np.linalg.solve(weight * np.eye(b.shape[1]) + b.T @ p @ b, b.T @ p @ a)
    rough = 10.0 ** rng.uniform(-1.0, 1.0)
    s = solve_discrete_are(a.T, c.T, b @ b.T + small, rough * np.eye(c.shape[0]))
    observer = a @ s @ c.T @ np.linalg.inv(c @ s @ c.T + rough * np.eye(c.shape[0]))
    # driven by r - y: the observer sees the error, and steers it to zero
    return System(a - b @ gain - observer @ c, observer, gain, np.zeros((b.shape[1], c.shape[0])))


def settles(plant: System, controller: Controller, dt: float) -> bool:
    """Whether the loop is stable, with some damping."""
    law = controller.system
    if not controller.sampled:
        a = np.block(
            [
                [plant.a - plant.b @ law.d @ plant.c, plant.b @ law.c],
                [-law.b @ plant.c, law.a],
            ]
        )
        poles = np.linalg.eigvals(a)
        return bool(np.all(poles.real < -0.1 * np.abs(poles)) and np.all(poles.real < -0.02))
    a, b = held(plant.a, plant.b, dt)
    n, m, z = a.shape[0], b.shape[1], law.a.shape[0]
    whole = block_diag(a, law.a, np.zeros((m * controller.delay,) * 2))
    whole[n : n + z, :n] = -law.b @ plant.c
    acting = np.hstack([-law.d @ plant.c, law.c, np.zeros((m, m * controller.delay))])
    for k in range(controller.delay):
        own = n + z + k * m
        if k + 1 < controller.delay:
            whole[own : own + m, own + m : own + 2 * m] = np.eye(m)
        else:
            whole[own : own + m] = acting
    if controller.delay:
        whole[:n, n + z : n + z + m] = b
    else:
        whole[:n] += b @ acting
    sizes = np.abs(np.linalg.eigvals(whole))
    return bool(np.all(sizes < np.exp(-0.02 * dt)) and np.sum(sizes > 0.97) <= 1)


def noise_of(rng: np.random.Generator, n: int, coloured: bool) -> Array:
    """Of variance one."""
    white = rng.standard_normal(n + 100)
    if coloured:
        white = np.sqrt(1.0 - COLOUR**2) * lfilter([1.0], [1.0, -COLOUR], white)
    return np.asarray(white[100:])


def moved_by(rng: np.random.Generator, kind: str, n: int, dt: float) -> tuple[Array, Array]:
    """Reference and dither."""
    hold = max(int(rng.uniform(1.0, 4.0) / dt), 2)
    nothing = np.zeros(n)
    if kind == "steps":
        long = 6 * hold
        return np.repeat(rng.choice([-1.0, 0.0, 1.0, 2.0], n // long + 1), long)[:n], nothing
    if kind == "prbs":
        return np.repeat(rng.choice([-1.0, 1.0], n // hold + 1), hold)[:n], nothing
    if kind == "dither":
        every = max(hold // 2, 1)
        return nothing, np.repeat(rng.standard_normal(n // every + 1), every)[:n]
    return nothing, nothing


def draw(
    seed: int,
    *,
    n: int | None = None,
    snr: float | None = None,
    excitation: str | None = None,
    moving: bool = False,
    keep: Callable[[Drawn], bool] = lambda _: True,
    of: Callable[[Controller, str], bool] = lambda law, kind: True,
) -> Drawn:
    """A random loop.

    Parameters
    ----------
    seed : int
    n : int, optional
        Samples; by default 200 to 2000.
    snr : float, optional
        [dB]; by default 5 to 30.
    excitation : str, optional
        One of `EXCITATIONS`; by default one that moves the loop.
    moving : bool
        Whether the noise of a continuous loop moves between the samples, as that of a plant does;
        by default it is held, as by a converter.
    keep : callable, optional
        Which loops to take; others are drawn again.
    of : callable, optional
        The same by the controller and its kind alone: others are not simulated.
    """
    rng = np.random.default_rng([seed, 18])
    while True:
        found = _drawn(rng, n, snr, excitation, moving, of)
        if found is not None and keep(found):
            return found


def _drawn(
    rng: np.random.Generator,
    n: int | None,
    snr: float | None,
    excitation: str | None,
    moving: bool,
    of: Callable[[Controller, str], bool],
) -> Drawn | None:
    count = int(10.0 ** rng.uniform(np.log10(200), np.log10(2000)))
    level, moved = float(rng.uniform(5.0, 30.0)), str(rng.choice(EXCITATIONS[:3]))
    count, level = n or count, level if snr is None else snr
    moved = excitation or moved
    num, den = polynomials(rng)
    plant = System.of(num, den)
    dt = 2 * np.pi / rng.uniform(12.0, 40.0)
    kind, sampled = str(rng.choice(CONTROLLERS)), bool(rng.random() < 0.7)
    sampled = sampled or kind == "LQG"
    delay = int(rng.integers(0, 2)) if sampled else 0
    coloured = bool(rng.random() < 0.5)
    law = controller_of(rng, kind, plant, dt, sampled, delay)
    if law is None or not settles(plant, law, dt):
        return None
    r, w = moved_by(rng, moved, count, dt)
    w = w * 10.0 ** rng.uniform(-0.5, 0.5)
    if not of(law, kind):  # its noise is drawn all the same, so that the next loop stays what it is
        _noise(rng, law, r.size, coloured, moving)
        return None
    return _recorded(
        rng, (num, den), law, (r, w), dt, level,
        (kind, moved, coloured), moving,
    )  # fmt: skip


def _noise(
    rng: np.random.Generator, law: Controller, n: int, coloured: bool, moving: bool
) -> Array:
    v = noise_of(rng, n, coloured)
    if law.sampled:
        return v
    # the sensor holds what it measured, or the noise is that of a process
    return _moving_noise(rng, n, coloured) if moving else np.repeat(v, FINE)


def _recorded(
    rng: np.random.Generator,
    system: tuple[Array, Array],
    law: Controller,
    moved: tuple[Array, Array],
    dt: float,
    snr: float,
    words: tuple[str, str, bool],
    moving: bool,
) -> Drawn | None:
    (num, den), (r, w), (kind, excitation, coloured) = system, moved, words
    plant, n = System.of(num, den), r.size
    v = _noise(rng, law, n, coloured, moving)
    silent = run(plant, law, r[:, None], np.zeros((v.size, 1)), w[:, None], dt)[1]
    size = float(np.std(silent))
    v = v * (size * 10.0 ** (-snr / 20.0) if size > 0 else 0.1)
    u, y = run(plant, law, r[:, None], v[:, None], w[:, None], dt)
    if not (np.all(np.isfinite(y)) and np.ptp(u) > 0):
        return None
    record = Record(u, y, dt=dt, intersample="zoh" if law.sampled else "auto")
    gain = num / den[0]
    structure = Structure(den.size - 1, gain.size - 1)
    theta = np.concatenate([den[1:] / den[0], gain])
    return Drawn(
        record, r, w, structure, theta, np.roots(den), kind, excitation, law.sampled, law.delay,
        snr if size > 0 else np.nan, coloured,
    )  # fmt: skip


def _moving_noise(rng: np.random.Generator, n: int, coloured: bool) -> Array:
    """(n * FINE,) of variance one; time constant a third of a sample, or 0.5 to 10 of them."""
    samples = 10.0 ** rng.uniform(-0.3, 1.0) if coloured else 0.3
    pole = np.exp(-1.0 / (FINE * samples))
    driving, settled = rng.standard_normal(n * FINE + 2000), 2000
    return np.asarray(lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], driving)[settled:])


def opened(drawn: Drawn, seed: int) -> Drawn:
    """The same plant, stable, without a controller: an input of one of `OPEN` moves it.

    Parameters
    ----------
    drawn : Drawn
        Gives plant, sampling, length and noise.
    seed : int

    Raises
    ------
    ValueError
        The plant is not stable.
    """
    if np.any(drawn.poles.real > STABLE):
        raise ValueError("found a plant that is not stable; expected one")
    rng = np.random.default_rng([seed, 19])
    dt, n = float(drawn.record.dt or 0.0), drawn.record.n_samples
    kind = str(rng.choice(list(OPEN)))
    fine, held_ = OPEN[kind](rng, n, dt)
    model = TransferFunction(
        drawn.theta[drawn.poles.size :], np.append(1.0, drawn.theta[: drawn.poles.size])
    )
    finer = Record(fine, fine, dt=dt / FINE, intersample="zoh" if held_ else "foh")
    y = simulate(model, finer)[::FINE, 0]
    snr = drawn.snr if np.isfinite(drawn.snr) else 20.0
    y = y + float(np.std(y)) * 10.0 ** (-snr / 20.0) * noise_of(rng, n, drawn.coloured)
    record = Record(fine[::FINE], y, dt=dt, intersample="zoh" if held_ else "auto")
    return replace(drawn, record=record, controller="", excitation=kind)


Made = tuple[Array, bool]
"""Input on the grid, and whether it is held over the samples."""


def _levels(rng: np.random.Generator, n: int, dt: float) -> Made:
    """Steps or a PRBS."""
    kind = EXCITATIONS[int(rng.integers(0, 2))]
    return np.repeat(moved_by(rng, kind, n, dt)[0], FINE), True


def _white(rng: np.random.Generator, n: int, dt: float) -> Made:
    """Another value at every sample."""
    return np.repeat(rng.standard_normal(n), FINE), True


def _wandering(rng: np.random.Generator, n: int, dt: float) -> Made:
    """Another value at every sample, near the last one."""
    pole = np.exp(-dt / rng.uniform(0.5, 5.0))
    return np.repeat(lfilter([1.0], [1.0, -pole], rng.standard_normal(n)), FINE), True


def _actuator(rng: np.random.Generator, n: int, dt: float) -> Made:
    """A PRBS behind a first-order lag, measured."""
    pole = np.exp(-dt / FINE / rng.uniform(0.2, 1.0))
    return lfilter([1.0 - pole], [1.0, -pole], _levels(rng, n, dt)[0]), False


def _operator(rng: np.random.Generator, n: int, dt: float) -> Made:
    """Pushes by hand, smooth and of any size, with rests and a hand that trembles."""
    fine, t = np.zeros(n * FINE), np.arange(n * FINE) * dt / FINE
    for _ in range(max(int(t[-1] / 12.0), 3)):
        start, width = rng.uniform(0.0, t[-1]), rng.uniform(0.5, 4.0)
        x = np.clip((t - start) / width, 0.0, 1.0)
        fine = fine + rng.standard_normal() * np.sin(np.pi * x) ** 2
    pole = np.exp(-dt / FINE / 0.2)
    hand = lfilter([1.0 - pole], [1.0, -pole], rng.standard_normal(n * FINE))
    return fine + rng.choice([0.0, 0.3]) * hand, False


def _tones(rng: np.random.Generator, n: int, dt: float) -> Made:
    """Several tones."""
    t = np.arange(n * FINE) * dt / FINE
    tones = zip(rng.uniform(0.1, 3.0, 8), rng.uniform(0.0, 2 * np.pi, 8), strict=True)
    return np.sum([np.sin(w * t + phase) for w, phase in tones], axis=0), False


OPEN: dict[str, Callable[[np.random.Generator, int, float], Made]] = {
    "levels": _levels,
    "white levels": _white,
    "wandering levels": _wandering,
    "actuator, measured": _actuator,
    "operator, measured": _operator,
    "tones, measured": _tones,
}
"""Inputs of open-loop records."""
