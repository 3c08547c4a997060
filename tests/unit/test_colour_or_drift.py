"""Noise that forgets slowly under white weights is coloured noise; a ramp beside it is a drift."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate

MODEL = TransferFunction([2.0], [1.0, 4.0, 3.0])
DT, SNR, SETTLING = 0.05, 15.0, 2000


def first_and_all(seed: int, n: int, root: float, ramp: float) -> tuple[str, list[str]]:
    """What is told first, and all that matters, of a model with white weights.

    The noise is ``1 / (1 - root / q)``; the ramp rises to `ramp` spreads of the output.
    """
    rng = np.random.default_rng([seed, n])
    u = np.repeat(rng.choice([-1.0, 1.0], n // 8 + 1), 8)[:n]
    clean = simulate(MODEL, Record(u, u, dt=DT))[:, 0]
    noise = lfilter([np.sqrt(1 - root**2)], [1.0, -root], rng.standard_normal(n + SETTLING))
    y = clean + np.std(clean) * (10 ** (-SNR / 20) * noise[SETTLING:] + ramp * np.arange(n) / n)
    structure = Structure(2, 0, offset=False, initial_state="rest")
    estimate = identify(Record(u, y, dt=DT), structure, ThreeModel(noise="white"), throw=False)
    found = [one.code for one in estimate.findings if one.matters]
    return (found[0] if found else ""), found


def test_a_short_record_tells_a_ramp_from_noise_that_forgets_slowly() -> None:
    assert first_and_all(1, 200, 0.0, 0.7)[0] == "drift"
    assert first_and_all(2, 200, 0.9, 0.0) == ("noise-model", ["noise-model"])


@pytest.mark.slow
def test_a_ramp_is_a_drift_and_colour_stays_told() -> None:
    first, found = first_and_all(1, 500, 0.0, 0.5)
    assert (first, "noise-model" in found) == ("drift", False)
    # with white weights the noise is as coloured beside the drift as it was without
    first, found = first_and_all(1, 500, 0.7, 0.7)
    assert (first, "noise-model" in found) == ("drift", True)


@pytest.mark.slow
def test_noise_that_forgets_slowly_is_no_drift() -> None:
    assert first_and_all(2, 400, 0.95, 0.0) == ("noise-model", ["noise-model"])


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize(("n", "root"), [(400, 0.9), (400, 0.97), (1000, 0.95)])
def test_both_kinds_are_named(n: int, root: float) -> None:
    stationary = [first_and_all(seed, n, root, 0.0) for seed in range(40, 60)]
    assert all("noise-model" in found for _, found in stationary)
    assert sum(first != "noise-model" for first, _ in stationary) <= 2
    assert sum("drift" in found for _, found in stationary) <= 1
    drifting = [first_and_all(seed, n, own, 0.7) for seed in range(60, 66) for own in (0.0, 0.7)]
    assert sum(first == "drift" for first, _ in drifting) >= 11
