"""What is slow in noise of the kind of 1/f is noise; ramps, warm-ups and steps in level are not."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.numerics.slow_spectrum import slow_chance

N = 400
CALLED = 0.001


def noise(seed: int, slope: float, n: int = N) -> np.ndarray:
    rng = np.random.default_rng([seed, 12])
    f = np.fft.rfftfreq(4 * n)
    f[0] = f[1]
    found = np.fft.irfft(np.fft.rfft(rng.standard_normal(4 * n)) / f ** (slope / 2))[:n]
    return (found - found.mean()) / np.std(found)


@pytest.mark.parametrize("slope", [0.0, 0.5, 1.0])
def test_noise_is_called_as_seldom_as_said(slope: float) -> None:
    chances = [slow_chance(noise(seed, slope)) for seed in range(200)]
    assert sum(one < 0.01 for one in chances) <= 20
    assert sum(one < CALLED for one in chances) <= 6


@pytest.mark.parametrize("slope", [0.0, 1.0])
@pytest.mark.parametrize("kind", ["ramp", "warm-up", "step", "sine"])
def test_what_moves_the_level_stands_out(slope: float, kind: str) -> None:
    t = np.arange(N) / N
    slow = {
        "ramp": t,
        "warm-up": 1.0 - np.exp(-t / 0.2),
        "step": np.where(t > 0.4, 1.0, 0.0),
        "sine": np.sin(9.0 * t),
    }[kind]
    slow = (slow - slow.mean()) / np.std(slow)
    size = 3.0 if slope else 1.2
    told = [slow_chance(noise(seed, slope) + size * slow) < CALLED for seed in range(40)]
    assert sum(told) >= 38


def test_a_missing_offset_and_a_short_series_are_not_judged() -> None:
    assert slow_chance(noise(1, 0.0) + 0.5) == 0.0
    assert slow_chance(np.ones(20)) == 0.0


@pytest.mark.slow
def test_right_records_in_such_noise_are_not_told_of_a_drift() -> None:
    told, drifting = 0, 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 13])
        n = 600
        u = np.repeat(rng.choice([-1.0, 1.0], n // 12), 12)
        clean = simulate(TransferFunction([9.0], [1.0, 1.2, 9.0]), Record(u, u, dt=0.1))[:, 0]
        y = clean + 0.2 * np.std(clean) * noise(seed, 1.0, n)
        ramp = y + 1.5 * np.std(clean) * np.arange(n) / n
        for one, drifts in ((y, False), (ramp, True)):
            found = identify(Record(u, one, dt=0.1), Structure(2, 0), throw=False)
            codes = {own.code for own in found.findings if own.matters}
            told += not drifts and "drift" in codes
            drifting += drifts and "drift" in codes
    assert told <= 1
    assert drifting >= 5
