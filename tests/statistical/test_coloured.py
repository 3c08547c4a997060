"""Coloured noise over many draws: spread against the bound, coverage, false alarms.

The bound comes from a simulation of its own and from the dense covariance matrix of the noise,
whose autocovariance is that of its impulse response. Slow; run by `make test-all`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve, toeplitz
from scipy.signal import lfilter

from oracles import by_modes
from tridentify import Record, Structure, ThreeModel, identify

DRAWS = 120
N, DT, SNR = 1016, 0.05, 15.0
THETA = np.array([4.0, 3.0, 2.0])
SETTLING = 3000


@dataclass(frozen=True)
class Noise:
    """``(numerator / denominator) e``, and how often it must be found coloured [least, most]."""

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    whitened: tuple[float, float]


NOISES = {
    "arma": Noise((1.0, 0.9), (1.0, -1.0, 0.2), (1.0, 1.0)),
    "ar(1) 0.95": Noise((1.0,), (1.0, -0.95), (1.0, 1.0)),
    # 1 percent, and three binomial standard deviations
    "white": Noise((1.0,), (1.0,), (0.0, 0.04)),
}


def respond(theta, u):
    return by_modes(theta[2:], np.append(1.0, theta[:2]), u, DT)


def register(length):
    """Levels +-1 of a 7-stage shift register, each held for 8 samples."""
    bits, out = [1] * 7, []
    for _ in range(-(-length // 8)):
        out.append(2.0 * bits[-1] - 1.0)
        bits = [bits[6] ^ bits[5], *bits[:-1]]
    return np.repeat(out, 8)[:length]


def scores_of(u):
    steps = 1e-5 * np.diag(THETA)
    return np.stack(
        [(respond(THETA + h, u) - respond(THETA - h, u)) / (2 * h.sum()) for h in steps], axis=1
    )


def spread_of_white_weights(u, noise, scale):
    """Standard deviations of plain output error: each estimate is a sum over the noise's source."""
    back = np.pad(np.linalg.pinv(scores_of(u))[:, ::-1], ((0, 0), (0, SETTLING)))
    return scale * np.linalg.norm(lfilter(noise.numerator, noise.denominator, back), axis=1)


def cramer_rao(u, noise, scale):
    scores = scores_of(u)
    impulse = lfilter(noise.numerator, noise.denominator, np.append(1.0, np.zeros(20_000)))
    covariance = toeplitz([impulse[: impulse.size - k] @ impulse[k:] for k in range(u.size)])
    information = scores.T @ cho_solve(cho_factor(scale**2 * covariance), scores)
    return np.sqrt(np.diag(np.linalg.inv(information)))


@pytest.fixture(scope="module", params=list(NOISES))
def draws(request):
    """(noise, bound, estimates, standard errors, share of draws with a noise model)."""
    noise = NOISES[request.param]
    u = register(N)
    clean = respond(THETA, u)
    impulse = lfilter(noise.numerator, noise.denominator, np.append(1.0, np.zeros(20_000)))
    scale = np.std(clean) * 10 ** (-SNR / 20) / np.sqrt(impulse @ impulse)
    structure = Structure(2, 0, offset=False, initial_state="rest")
    values, errors = np.empty((2, DRAWS, THETA.size))
    whitened = 0
    for k, seed in enumerate(np.random.SeedSequence(11).spawn(DRAWS)):
        e = np.random.default_rng(seed).standard_normal(N + SETTLING)
        y = clean + scale * lfilter(noise.numerator, noise.denominator, e)[SETTLING:]
        estimate = identify(Record(u, y, dt=DT), structure)
        assert estimate.status.ok, f"draw {k}: {estimate.status}"
        values[k], errors[k] = estimate.theta, estimate.std
        whitened += estimate.noise_model[0].size > 0
    return noise, cramer_rao(u, noise, scale), values, errors, whitened / DRAWS


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_spread_reaches_the_bound_of_coloured_noise(draws):
    _, bound, values, _, _ = draws
    rmse = np.sqrt(np.mean((values - THETA) ** 2, axis=0))
    sampling = 3.0 / np.sqrt(2.0 * DRAWS)
    assert np.all(rmse / bound < 1.1 + sampling), rmse / bound
    assert np.all(rmse / bound > 0.9 - sampling), rmse / bound


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_standard_errors_are_the_bound_of_coloured_noise(draws):
    _, bound, _, errors, _ = draws
    assert np.allclose(np.median(errors, axis=0), bound, rtol=0.1)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_intervals_cover(draws):
    _, _, values, errors, _ = draws
    inside = np.mean(np.abs(values - THETA) < 1.959963985 * errors, axis=0)
    slack = 3.0 * np.sqrt(0.95 * 0.05 / DRAWS)
    assert np.all(inside > 0.95 - slack), inside


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_noise_is_modelled_where_it_is_coloured(draws):
    noise, _, _, _, share = draws
    least, most = noise.whitened
    assert least <= share <= most


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_white_weights_cost_half_the_information_and_the_errors_say_so():
    """The same noise with white weights: wider errors, those of the scores, which hold."""
    noise = NOISES["ar(1) 0.95"]
    u = register(N)
    clean = respond(THETA, u)
    scale = np.std(clean) * 10 ** (-SNR / 20) * np.sqrt(1 - 0.95**2)
    structure = Structure(2, 0, offset=False, initial_state="rest")
    count = 40
    values, errors = np.empty((2, count, THETA.size))
    for k, seed in enumerate(np.random.SeedSequence(12).spawn(count)):
        e = np.random.default_rng(seed).standard_normal(N + SETTLING)
        y = clean + scale * lfilter(noise.numerator, noise.denominator, e)[SETTLING:]
        estimate = identify(Record(u, y, dt=DT), structure, ThreeModel(noise="white"))
        values[k], errors[k] = estimate.theta, estimate.std
        assert "noise-model" in [one.code for one in estimate.findings]
    bound, spread = cramer_rao(u, noise, scale), spread_of_white_weights(u, noise, scale)
    assert np.mean((spread / bound) ** 2) == pytest.approx(2.0, abs=0.1)
    rmse = np.sqrt(np.mean((values - THETA) ** 2, axis=0)) / spread
    sampling = 3.0 / np.sqrt(2.0 * count)
    assert np.all((rmse > 0.9 - sampling) & (rmse < 1.1 + sampling)), rmse
    # never below what holds, nor twice it: of several numbers of blocks the widest counts
    stated = np.median(errors, axis=0) / spread
    assert np.all((stated > 1.0) & (stated < 1.9)), stated
    inside = np.mean(np.abs(values - THETA) < 1.959963985 * errors, axis=0)
    assert np.all(inside > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / count)), inside


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_slow_noise_is_not_taken_for_an_offset():
    """AICc with white weights sees offsets and free states everywhere in slow noise."""
    wrong = {"white": 0, "auto": 0}
    u = register(600)
    clean = respond(THETA, u)
    for seed in range(12):
        e = np.random.default_rng(seed).standard_normal(600 + SETTLING)
        noise = np.sqrt(1 - 0.97**2) * lfilter([1.0], [1.0, -0.97], e)[SETTLING:]
        record = Record(u, clean + 0.3 * np.std(clean) * noise, dt=DT)
        for choice in wrong:
            method = ThreeModel(noise=choice)
            resolved = identify(record, Structure(2, 0), method, throw=False).structure
            wrong[choice] += bool(resolved.offset) or resolved.initial_state != "rest"
    assert wrong["white"] >= 10
    assert wrong["auto"] <= 6
