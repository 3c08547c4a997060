"""Do 95 % intervals hold 95 % of the time, by every route? Slow; run by `make test-all`.

The truth and the records come from a simulation of their own, mode by mode. The benchmark
``benchmarks/interval_coverage.py`` does the same on more systems with more draws.
"""

from __future__ import annotations

import numpy as np
import pytest

from oracles import by_modes
from tridentify import Record, Structure, ThreeModel, identify
from tridentify.uncertainty import (
    bootstrap,
    derived,
    response_band,
    sample,
    sampled_coefficients,
    sampled_derived,
    sampled_response_band,
    sampled_step_band,
    step_band,
)

pytestmark = pytest.mark.unjudged(always=True)

DEN, NUM = np.array([1.0, 1.0, 3.0]), np.array([0.5])
DT = 0.05
DRAWS = 200
TIMES, OMEGA = np.array([0.5, 1.5, 4.0]), np.array([0.5, 1.7, 5.0])


def respond(den, num, u, dt):
    return by_modes(num, den, u, dt)


def truth():
    poles = np.roots(DEN)
    residues = np.polyval(NUM, poles) / np.polyval(np.polyder(DEN), poles)
    step = ((residues / poles) * np.expm1(np.outer(TIMES, poles))).sum(axis=1).real
    bode = np.polyval(NUM, 1j * OMEGA) / np.polyval(DEN, 1j * OMEGA)
    frequency = np.sqrt(3.0)
    named = [1.0, 3.0, 0.5, frequency, 1.0 / (2.0 * frequency), 0.5 / 3.0]
    return np.concatenate([named, step, np.abs(bode), np.angle(bode)])


def ends(rows, steps, bode):
    lows = (steps.low, bode.magnitude_low, bode.phase_low)
    highs = (steps.high, bode.magnitude_high, bode.phase_high)
    low = np.concatenate([[row[0] for row in rows], *(one[:, 0, 0] for one in lows)])
    high = np.concatenate([[row[1] for row in rows], *(one[:, 0, 0] for one in highs)])
    return low, high


def by_delta(estimate):
    rows = [p.interval() for p in (*estimate.parameters.values(), *derived(estimate))]
    return ends(rows, step_band(estimate, TIMES), response_band(estimate, OMEGA))


def by_sampling(estimate, seed):
    drawn = sample(estimate, 1000, seed)
    rows = [(q.low, q.high) for q in sampled_coefficients(drawn) + sampled_derived(drawn)]
    return ends(rows, sampled_step_band(drawn, TIMES), sampled_response_band(drawn, OMEGA))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_delta_and_sampled_intervals_cover():
    rng = np.random.default_rng(50)
    u = np.repeat(rng.choice([-1.0, 1.0], 50), 10)
    clean = respond(DEN, NUM, u, DT)
    structure = Structure(2, 0, offset=False, initial_state="rest")
    expected = truth()
    inside = np.zeros((2, DRAWS, expected.size), dtype=bool)
    for k, seed in enumerate(np.random.SeedSequence(51).spawn(DRAWS)):
        noise = 0.3 * clean.std() * np.random.default_rng(seed).standard_normal(u.size)
        estimate = identify(Record(u, clean + noise, dt=DT), structure)
        for route, (low, high) in enumerate((by_delta(estimate), by_sampling(estimate, k))):
            inside[route, k] = (low <= expected) & (expected <= high)
    share = inside.mean(axis=1)
    # three binomial standard errors of 200 draws, for each of fifteen quantities
    allowed = 3.0 * np.sqrt(0.95 * 0.05 / DRAWS)
    assert np.all(np.abs(share - 0.95) < allowed), share
    # the two routes judge the same draws: where standard errors are small they hardly differ
    assert np.all(np.abs(share[0] - share[1]) < 0.04), share


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_bootstrap_covers_and_its_correction_takes_bias_away():
    """A first-order lag seen through a short, noisy step, where its rate has a skewed error."""
    n_records, truths = 40, np.array([4.0, 2.0])
    u = np.ones(40)
    clean = respond(np.array([1.0, 4.0]), np.array([2.0]), u, DT)
    structure = Structure(1, 0, offset=False, initial_state="rest")
    # the skewed error is that of the likelihood's maximum; the posterior mean has another bias
    method = ThreeModel(noise="white", finish="likelihood")
    inside = {kind: 0 for kind in ("percentile", "bca", "studentized")}
    raw, mended = np.empty((2, n_records, 2))
    for k, seed in enumerate(np.random.SeedSequence(52).spawn(n_records)):
        noise = 0.08 * np.random.default_rng(seed).standard_normal(u.size)
        record = Record(u, clean + noise, dt=DT)
        estimate = identify(record, structure, method)
        copies = bootstrap(estimate, record, method, n_draws=100, seed=k)
        raw[k], mended[k] = estimate.theta, copies.bias_corrected
        for kind in inside:
            low, high = copies.intervals(0.95, kind).T
            inside[kind] += int(np.sum((low <= truths) & (truths <= high)))
    for kind, count in inside.items():
        # both coefficients move together: 40 draws, not 80
        assert abs(count / (2 * n_records) - 0.95) < 3.0 * np.sqrt(0.95 * 0.05 / n_records), kind
    before, after = (np.mean(np.log(x / truths), axis=0) for x in (raw, mended))
    spread = np.std(np.log(raw / truths), axis=0) / np.sqrt(n_records)
    assert np.all(np.abs(after) < np.abs(before) + spread), (before, after)
    assert np.all(np.abs(after) < 3.0 * spread), (before, after)
