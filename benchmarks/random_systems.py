"""Random systems, manoeuvres and records, each reproducible from its number alone.

Order, input, noise level and length go round in turn (60 cells), so that any run of records is
balanced; all else is drawn from ``SeedSequence(seed, spawn_key=(number,))``.

- Poles: 2 to 4, sizes log-uniform over 1.5 decades, real ones and pairs of damping 0.05 to 0.9.
- Zeros: 0 to n - 1, sizes log-uniform from half the slowest to twice the fastest pole, real ones
  and pairs, each in the left or the right half plane.
- The whole system runs between 1e-3 and 1e3 rad/s.
- Sampling: every 0.05 to 0.1 of the fastest time (of a real pole its time constant, of a pair the
  shorter of time constant and period), longer where the slowest pole would not settle to 5 %
  within the record otherwise, but never above 0.25; poles that do not allow that are drawn anew.
- Noise: white and Gaussian, ``std(y) 10^(-SNR/20)``.

Output and sensitivities come by companion form and matrix exponential in units of the system's
own time; the package has no part in it. With ``x = (1, p, .., p^{n-1}) u / a`` and
``z = (1, p, .., p^{n-1}) y_0 / a``: ``y_0 = b x``, ``dy_0/db_j = x_j``, ``dy_0/da_i = -z_i``.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import butter, lfilter, max_len_seq

from tridentify import Record, Structure

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

SEED = 20261121
ORDERS = (2, 3, 4)
INPUTS = ("prbs", "noise", "step", "doublet", "3-2-1-1")
SNRS = (20, 5)
LENGTHS = (300, 1500)
DECADES = 1.5
DAMPING = (0.05, 0.9)
OVERSAMPLED = (0.05, 0.1)
COARSEST = 0.25
SETTLED = 3.0
WEAK = 0.5


class Drawn(NamedTuple):
    """One record with its truth; `theta` and `sensitivities` in 1/s, as the package counts."""

    number: int
    order: int
    zeros: int
    input: str
    snr: int
    record: Record
    poles: Complex
    zero_values: Complex
    theta: Array
    sensitivities: Array
    noise_std: float

    @property
    def structure(self) -> Structure:
        """What is asked of every method."""
        return Structure(self.order, self.zeros, offset=False, initial_state="rest")

    @property
    def bound(self) -> Array:
        """(k, k) Cramer-Rao bound of the covariance of ``a_{n-1} .. a_0, b_m .. b_0``."""
        norms = np.linalg.norm(self.sensitivities, axis=0)
        _, s, vt = np.linalg.svd(self.sensitivities / norms, full_matrices=False)
        root = (vt.T / np.maximum(s, 1e-300)) / norms[:, None]
        return np.asarray(self.noise_std**2 * root @ root.T)

    @property
    def weakest(self) -> float:
        """Largest bound of a standard error relative to what is estimated.

        For ``a_i`` that is ``a_i`` itself. A ``b_j`` may be near zero without being badly known, so
        its error is compared with the length of all of ``b``, each ``b_j`` counted as ``b_j w^j``
        with ``w`` the geometric mean of the pole sizes (which gives them one unit).
        """
        std = np.sqrt(np.diag(self.bound))
        n = self.order
        w = abs(self.theta[n - 1]) ** (1.0 / n)
        power = w ** np.arange(self.zeros, -1.0, -1.0)
        length = np.linalg.norm(self.theta[n:] * power)
        relative = np.concatenate([std[:n] / np.abs(self.theta[:n]), std[n:] * power / length])
        return float(relative.max())

    @property
    def identifiable(self) -> bool:
        """Whether no coefficient's bound is above half of it."""
        return self.weakest < WEAK


def draw(number: int, seed: int = SEED, lengths: Sequence[int] = LENGTHS) -> Drawn:
    """Record ``number``; two ``lengths`` in turn."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    cell = np.unravel_index(number % 60, (5, 3, 2, 2))
    kind, order, snr, n_samples = (
        INPUTS[cell[0]], ORDERS[cell[1]], SNRS[cell[2]], lengths[cell[3]],
    )  # fmt: skip
    poles, dt = _poles_and_step(rng, order, n_samples)
    zeros = _zeros(rng, poles)
    a = np.poly(poles).real
    b = np.atleast_1d(np.poly(zeros).real)
    b = b * rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-1, 1) * a[-1] / np.abs(b[-1])
    intersample = "foh" if kind == "noise" else "zoh"
    u = _input(rng, kind, poles, dt, n_samples)
    y, by_a, by_b = respond(a, b, u, dt, intersample)
    std = float(np.std(y)) * 10.0 ** (-snr / 20)
    measured = y + std * rng.standard_normal(n_samples)
    rate = 10.0 ** rng.uniform(-3, 3 - DECADES)
    m = zeros.size
    powers_a = rate ** np.arange(1.0, order + 1)
    powers_b = rate ** np.arange(order - m, order + 1.0)
    theta = np.concatenate([a[1:] * powers_a, b * powers_b])
    return Drawn(
        number,
        order,
        m,
        kind,
        snr,
        Record(u, measured, dt=dt / rate, intersample=intersample),
        poles * rate,
        zeros * rate,
        theta,
        np.column_stack([by_a / powers_a, by_b / powers_b]),
        std,
    )


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** rng.uniform())


def _pair(size: float, damping: float) -> list[complex]:
    pole = size * complex(-damping, np.sqrt(1 - damping**2))
    return [pole, pole.conjugate()]


def fastest_time(poles: Complex) -> float:
    """Time constant of a real pole, of a pair the shorter of time constant and period."""
    times = [-1.0 / p.real for p in poles]
    times += [2 * np.pi / p.imag for p in poles if p.imag > 0]
    return float(min(times))


def _poles_and_step(rng: np.random.Generator, order: int, n_samples: int) -> tuple[Complex, float]:
    while True:
        pairs = int(rng.integers(0, order // 2 + 1))
        found: list[complex] = []
        for _ in range(pairs):
            size = _log_uniform(rng, 1.0, 10.0**DECADES)
            found += _pair(size, _log_uniform(rng, *DAMPING))
        while len(found) < order:
            found.append(complex(-_log_uniform(rng, 1.0, 10.0**DECADES)))
        poles = np.array(found)
        fastest = fastest_time(poles)
        settling = SETTLED / float(np.min(-poles.real))
        dt = max(_log_uniform(rng, *OVERSAMPLED) * fastest, settling / n_samples)
        if dt <= COARSEST * fastest:
            return poles, dt


def _zeros(rng: np.random.Generator, poles: Complex) -> Complex:
    m = int(rng.integers(0, poles.size))
    low, high = 0.5 * np.abs(poles).min(), 2.0 * np.abs(poles).max()
    found: list[complex] = []
    while len(found) < m:
        side = rng.choice([-1.0, 1.0])
        size = _log_uniform(rng, low, high)
        if m - len(found) >= 2 and rng.uniform() < 0.5:
            found += [side * z for z in _pair(size, _log_uniform(rng, *DAMPING))]
        else:
            found.append(complex(side * size))
    return np.array(found, dtype=np.complex128)


def _input(rng: np.random.Generator, kind: str, poles: Complex, dt: float, n_samples: int) -> Array:
    """The manoeuvre; the times come from where the poles lie, as an experimenter would guess."""
    sizes = np.abs(poles)
    amplitude = 10.0 ** rng.uniform(-1, 1)
    if kind == "prbs":
        shortest, middle = 0.5 * fastest_time(poles), 1.0 / np.sqrt(sizes.min() * sizes.max())
        clock = _log_uniform(rng, min(shortest, middle), max(shortest, middle))
        hold = max(1, round(clock / dt))
        bits = max(6, int(np.ceil(np.log2(n_samples / hold + 2))))
        state = rng.integers(0, 2, bits)
        state[0] = 1
        sequence = 2.0 * max_len_seq(bits, state=state)[0] - 1.0
        return np.asarray(amplitude * np.repeat(sequence, hold)[:n_samples])
    if kind == "noise":
        cut = min(_log_uniform(rng, 0.5, 1.5) * sizes.max() * dt / np.pi, 0.8)
        numerator, denominator = butter(2, cut)
        shaped = lfilter(numerator, denominator, rng.standard_normal(n_samples))
        return np.asarray(amplitude * shaped / np.std(shaped))
    aimed = _log_uniform(rng, sizes.min(), sizes.max())
    pattern, width = {
        "step": (np.ones(n_samples), dt),
        "doublet": (np.array([1.0, -1.0]), 2.3 / aimed),
        "3-2-1-1": (np.array([1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0]), 1.6 / aimed),
    }[kind]
    before = int(rng.integers(1, n_samples // 20))
    longest = n_samples if kind == "step" else n_samples // 2
    hold = min(max(1, round(width / dt)), longest // pattern.size)
    u = np.zeros(n_samples)
    shape = np.repeat(pattern, hold)[: n_samples - before]
    u[before : before + shape.size] = amplitude * shape
    return u


def respond(
    a: Array, b: Array, u: Array, dt: float, intersample: str
) -> tuple[Array, Array, Array]:
    """Output from rest, and its derivatives by ``a_{n-1} .. a_0`` and by ``b_m .. b_0``."""
    n, m = a.size - 1, b.size - 1
    companion = np.diag(np.ones(n - 1), 1)
    companion[-1] = -a[:0:-1]
    into = np.zeros(n)
    into[-1] = 1.0
    out = np.concatenate([b[::-1], np.zeros(n - m - 1)])
    both = np.block([[companion, np.zeros((n, n))], [np.outer(into, out), companion]])
    drive = np.concatenate([into, np.zeros(n)])
    whole = np.zeros((2 * n + 2, 2 * n + 2))
    whole[: 2 * n, : 2 * n] = both * dt
    whole[: 2 * n, 2 * n] = drive * dt
    whole[2 * n, 2 * n + 1] = 1.0
    power = expm(whole)
    step, held, ramp = power[: 2 * n, : 2 * n], power[: 2 * n, 2 * n], power[: 2 * n, 2 * n + 1]
    if intersample == "zoh":
        ramp = np.zeros_like(ramp)
    state = np.zeros(2 * n)
    states = np.zeros((u.size, 2 * n))
    for k in range(u.size - 1):
        state = step @ state + (held - ramp) * u[k] + ramp * u[k + 1]
        states[k + 1] = state
    x, z = states[:, :n], states[:, n:]
    return x @ out, -z[:, ::-1], x[:, m::-1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--records", type=int, default=600)
    parser.add_argument("--seed", type=int, default=SEED)
    options = parser.parse_args()
    found = [draw(k, options.seed) for k in range(options.records)]
    print(f"{len(found)} records; identifiable:")
    for name in ("order", "zeros", "input", "snr"):
        total = Counter(getattr(one, name) for one in found)
        good = Counter(getattr(one, name) for one in found if one.identifiable)
        told = ", ".join(f"{key}: {good[key] / total[key]:.0%}" for key in sorted(total))
        print(f"  by {name:8s} {told}")
    lengths = Counter(one.record.n_samples for one in found if one.identifiable)
    print("  by samples ", dict(lengths), "in all", sum(one.identifiable for one in found))
    quantiles = (0, 10, 50, 90, 100)
    for name, values in {
        "samples per fastest time": [fastest_time(o.poles) / o.record.dt for o in found],
        "slowest time constants in the record": [
            np.min(-o.poles.real) * o.record.dt * o.record.n_samples for o in found
        ],
        "fastest / slowest pole": [np.ptp(np.log10(np.abs(o.poles))) for o in found],
        "largest relative bound": [one.weakest for one in found],
    }.items():
        print(f"  {name}: " + ", ".join(f"{q:.3g}" for q in np.percentile(values, quantiles)))


if __name__ == "__main__":
    main()
