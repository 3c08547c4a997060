"""Several records, of which one differs; another record, of another sign or gain."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate, validate

PLANT = TransferFunction([2.0, 8.0], [1.0, 1.6, 16.0])
ORDER = Structure(2, 1)
SEEDS = [11, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (12, 13, 14))]


def recorded(rng, n=300, gain=1.0, late=0, noise=0.02):
    u = np.repeat(rng.choice([-1.0, 1.0], n // 6 + 1), 6)[:n]
    acted = np.concatenate([np.zeros(late), u])[:n]
    y = gain * simulate(PLANT, Record(acted, acted, dt=0.05))[:, 0]
    return Record(u, y + noise * rng.standard_normal(n), dt=0.05)


def three(seed, **odd):
    rng = np.random.default_rng(seed)
    return [recorded(rng), recorded(rng, **odd), recorded(rng)]


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("odd", "kind", "said"),
    [
        pytest.param({"gain": -1.0}, "opposite", "opposite sign", marks=pytest.mark.slow),
        ({"gain": 1.1}, "gain", "a gain of 1.1"),
        pytest.param({"late": 1}, "late", "an answer later by 0.0", marks=pytest.mark.slow),
    ],
    ids=["sign", "gain", "late"],
)
def test_the_odd_one_is_named_and_in_what_it_differs(odd, kind, said, seed):
    records = three(seed, **odd)
    estimate = identify(records, ORDER, throw=False)
    first = estimate.findings[0]
    assert (first.code, first.kind, first.experiment) == ("disagreeing-experiments", kind, 1)
    assert said in first.message
    assert not validate(estimate, records).ok


@pytest.mark.parametrize("seed", SEEDS)
def test_a_noisy_record_has_no_bad_samples_and_counts_by_its_noise(seed):
    estimate = identify(three(seed, noise=0.15), ORDER)
    assert not [one for one in estimate.findings if one.matters]
    assert np.ravel(estimate.noise_levels) == pytest.approx([0.02, 0.15, 0.02], rel=0.15)
    assert f"experiment 2  {np.ravel(estimate.noise_levels)[1]:.4g}" in estimate.summary()


@pytest.mark.parametrize("seed", SEEDS)
def test_another_record_of_opposite_sign_or_in_other_units(seed):
    rng = np.random.default_rng(seed)
    estimate = identify(recorded(rng), ORDER)
    other = recorded(rng)
    turned = validate(estimate, Record(other.u, -other.y, dt=0.05)).findings[0]
    assert (turned.code, turned.kind) == ("another-system", "opposite")
    degrees = validate(estimate, Record(57.3 * other.u, other.y, dt=0.05)).findings[0]
    assert (degrees.code, degrees.kind) == ("another-system", "gain")
    assert "degrees" in degrees.message


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.slow
def test_another_plant_is_no_delay_and_no_bad_samples(seed):
    rng = np.random.default_rng(seed)
    estimate = identify(recorded(rng), ORDER)
    u = recorded(rng).u
    y = simulate(TransferFunction([6.0], [1.0, 6.0]), Record(u, u, dt=0.05))
    other = Record(u, y + 0.02 * rng.standard_normal(y.shape), dt=0.05)
    found = validate(estimate, other).findings
    assert (found[0].code, found[0].severity) == ("another-system", "error")
    assert not {one.code for one in found} & {"delay", "bad-samples"}
