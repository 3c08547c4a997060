"""Unstable plants in a loop: are they found, how far off, and do the intervals hold?

Ten plants ``2 / ((s - p)(s + q))`` with a pole ``p`` in the right half plane of a quarter to a half
of the loop's bandwidth, a lead controller around each, a binary test signal at the plant's input,
1000 samples, 20 dB. The loop is simulated exactly. *Found*: the status is usable, a pole lies in
the right half plane, and it is within a fifth of the true one. `|z|`: size of the mean error in
standard errors of the mean, the largest over the coefficients.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import argparse
import time

import numpy as np
from loops import Controller, System, run, tustin
from machine import keep
from numpy.typing import NDArray

from tridentify import Record, Structure, ThreeModel, TridentifyError, identify

Array = NDArray[np.float64]
N, HOLD = 1000, 20
SNR = 20.0
"""[dB]."""
PLANTS = [(1.0, q, w) for w in (2.0, 2.5, 3.0, 3.5, 4.0) for q in (1.2, 3.0)]
"""Unstable pole, stable one, bandwidth [rad/s]."""


def record(plant: tuple[float, float, float], seed: int, sampled: bool) -> Record:
    """One record of a loop around a plant."""
    p, q, w = plant
    rng = np.random.default_rng(seed)
    dt = 0.2 / w
    lead = [(1.4 * w - (q - p)) / 2.0, (w * w + p * q) / 2.0]
    law = System.of(lead, [1.0 / (8.0 * w), 1.0])
    law = tustin(law, dt) if sampled else law
    shake = np.repeat(rng.choice([-1.0, 1.0], N // HOLD), HOLD)[:, None]
    quiet = np.zeros((N, 1))
    system = System.of([2.0], np.poly([p, -q]))
    clean = run(system, Controller(law, sampled), quiet, quiet, shake, dt, fine=1)[1]
    noise = rng.standard_normal((N, 1)) * clean.std() * 10.0 ** (-SNR / 20.0)
    u, y = run(system, Controller(law, sampled), quiet, noise, shake, dt, fine=1)
    return Record(u, y, dt=dt, reference=shake)


def row(plant: tuple[float, float, float], draws: int, sampled: bool) -> tuple[str, int]:
    """A line of the table, and how many were found."""
    p, q, w = plant
    truth = np.array([*np.poly([p, -q])[1:], 2.0])
    method = ThreeModel(controller="sampled" if sampled else "continuous")
    errors, scores, found, begun = [], [], 0, time.process_time()
    for seed in range(draws):
        try:
            estimate = identify(record(plant, seed, sampled), Structure(2, 0), method, throw=False)
        except TridentifyError:
            continue
        fastest = float(estimate.model.poles.real.max())
        if estimate.status.ok and abs(fastest - p) < 0.2 * p:
            found += 1
            errors.append(estimate.theta - truth)
            scores.append((estimate.theta - truth) / np.maximum(estimate.std, 1e-300))
    seconds = (time.process_time() - begun) / draws
    if len(errors) < 2:
        return f"{p:g}, {-q:g}; {w:g}      found {found}", found
    table = np.array(errors)
    z = np.abs(table.mean(axis=0)) / table.std(axis=0) * np.sqrt(len(table))
    held = 100.0 * np.mean(np.abs(np.array(scores)) < 1.96, axis=0)
    told = (
        f"{p:g}, {-q:>4g} {w:>9g} {found:>8} {z.max():>9.1f} {held.min():>7.0f} - {held.max():3.0f}"
    )
    return f"{told} {seconds:>8.2f}", found


def main() -> None:
    """Print the table, and store it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--save", action="store_true")
    asked = parser.parse_args()
    lines = []
    for sampled in (True, False):
        how = "sampled" if sampled else "continuous"
        lines.append(f"controller {how}, {asked.draws} draws a plant, {SNR:g} dB")
        lines.append("poles  bandwidth    found   max |z|  95 % holds  seconds")
        total = 0
        for plant in PLANTS:
            line, found = row(plant, asked.draws, sampled)
            print(line, flush=True)
            lines.append(line)
            total += found
        lines.append(f"found {total} of {asked.draws * len(PLANTS)}")
        print(lines[-1], flush=True)
    if asked.save:
        keep("unstable_plants", "\n".join(lines), lines)


if __name__ == "__main__":
    main()
