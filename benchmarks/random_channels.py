"""Random systems with a denominator, or a delay, for each input: lowest cost reached, and coverage.

Each record is drawn from its number and the seed alone: one or two inputs, orders 1 to 3 over 1.5
decades, switched or multi-step inputs, 20 and 5 dB, 800 samples from rest. The cost is compared
with that of output error started at the truth; a record counts where there every coefficient has a
standard error below half of its value.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from tridentify import (
    OutputError,
    Record,
    Structure,
    ThreeModel,
    TransferFunction,
    TridentifyError,
    identify,
    simulate,
)

Array = NDArray[np.float64]

DT, N = 0.05, 800
LONGEST = 3.0
SAME = 0.1
WEAK = 0.5


def channel(rng: np.random.Generator) -> tuple[Array, Array]:
    """Numerator and monic denominator."""
    n = int(rng.integers(1, 4))
    rates = 3.0 * 10.0 ** rng.uniform(-0.75, 0.75, n)
    poles: list[complex] = []
    while len(poles) < n:
        rate = rates[len(poles)]
        if n - len(poles) >= 2 and rng.random() < 0.6:
            damping = rng.uniform(0.1, 0.9)
            pole = rate * complex(-damping, np.sqrt(1.0 - damping**2))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(-rate)
    zeros = -3.0 * 10.0 ** rng.uniform(-0.75, 0.75, int(rng.integers(0, n)))
    den, num = np.real(np.poly(poles)), np.atleast_1d(np.poly(zeros))
    gain = 10.0 ** rng.uniform(-0.3, 0.3) * rng.choice([-1.0, 1.0])
    return np.asarray(num * gain * den[-1] / num[-1]), np.asarray(den)


def inputs(rng: np.random.Generator, count: int, stepped: bool) -> Array:
    """(N, count), switched at random or a few long steps."""
    hold = rng.integers(60, 160, count) if stepped else rng.integers(4, 14, count)
    levels = [-1.0, 0.0, 1.0] if stepped else [-1.0, 1.0]
    return np.column_stack([np.repeat(rng.choice(levels, N), h)[:N] for h in hold])


def judge(number: int, seed: int, count: int, delayed: bool) -> tuple[bool, bool, Array] | None:
    """Whether it counts, whether the lowest cost was reached, errors over standard errors."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    pairs = [channel(rng) for _ in range(count)]
    num, den = [b for b, _ in pairs], [a for _, a in pairs]
    delay = rng.uniform(0.0, LONGEST, count) if delayed else np.zeros(count)
    truth = TransferFunction([num], [den], delay=[delay.tolist()])
    u = inputs(rng, count, bool(number % 2))
    y = simulate(truth, Record(u, np.zeros((N, 1)), dt=DT))
    sigma = float(np.std(y)) * 10.0 ** (-(20, 5)[number // 2 % 2] / 20)
    record = Record(u, y + sigma * rng.standard_normal(y.shape), dt=DT)
    structure = Structure(
        [[a.size - 1 for a in den]],
        [[b.size - 1 for b in num]],
        offset=False,
        initial_state="rest",
        delay="free" if delayed else 0.0,
    )
    try:
        best = identify(record, structure, OutputError(start=truth), throw=False)
        method = ThreeModel(noise="white", finish="likelihood")
        found = identify(record, structure, method, throw=False)
    except TridentifyError as refusal:
        print(f"  {number}: {refusal}")
        return None
    theta = np.concatenate([np.concatenate([a[1:], b]) for b, a in pairs])
    theta = np.concatenate([theta, delay]) if delayed else theta
    counts = bool(np.all(best.std[: theta.size] < WEAK * np.abs(theta)))
    reached = bool(N * np.log(found.cost / best.cost) < SAME)
    if counts and not reached:
        print(f"  {number}: above the cost from the truth")
    return counts, reached, np.asarray((found.theta - theta) / found.std)


def main() -> None:
    """Print a line for each kind."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--records", type=int, default=40)
    parser.add_argument("--seed", type=int, default=20261121)
    given = parser.parse_args()
    for count, delayed in ((2, False), (1, True), (2, True)):
        kind = f"{count} input{'s' * (count > 1)}, {'free delays' if delayed else 'no delay'}"
        print(kind)
        drawn = [judge(k, given.seed, count, delayed) for k in range(given.records)]
        rows = [one for one in drawn if one is not None and one[0]]
        if not rows:
            continue
        z = np.concatenate([one[2][-count:] if delayed else one[2] for one in rows])
        what = "delays" if delayed else "coefficients"
        print(
            f"  lowest cost reached in {sum(one[1] for one in rows)} of {len(rows)} that count "
            f"(of {given.records}); 95 % intervals of the {what} hold "
            f"{100 * float(np.mean(np.abs(z) < 1.96)):.0f} %"
        )


if __name__ == "__main__":
    main()
