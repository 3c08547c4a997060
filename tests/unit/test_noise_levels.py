"""Experiments of different noise: levels and coefficients in turn."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import (
    Estimate,
    OutputError,
    Record,
    Structure,
    SvfLeastSquares,
    ThreeModel,
    TransferFunction,
    identify,
    simulate,
    validate,
)
from tridentify.cli.tables import estimate_document
from tridentify.estimation.likelihood.noise.noise_levels import NoiseLevels
from tridentify.report.tables import result_tables

PLANT = TransferFunction([2.0, 3.0], [1.0, 1.1, 4.0])
ORDER = Structure(2, 1)
SEEDS = [21, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (22, 23))]


def recorded(rng, n=200, dt=0.05, noise=0.02):
    u = np.repeat(rng.choice([-1.0, 1.0], n // 8 + 1), 8)[:n]
    y = simulate(PLANT, Record(u, u, dt=dt))[:, 0] + rng.normal()
    return Record(u, y + noise * rng.standard_normal(n), dt=dt)


def two(seed):
    rng = np.random.default_rng(seed)
    return [recorded(rng), recorded(rng, n=150, dt=0.11, noise=0.1)]


@pytest.mark.unjudged
@pytest.mark.parametrize("seed", SEEDS)
def test_as_if_every_experiment_were_divided_by_its_noise(seed):
    records = two(seed)
    found = identify(records, ORDER)
    levels = np.ravel(found.noise_levels)
    assert levels == pytest.approx([0.02, 0.1], rel=0.15)
    pairs = zip(records, levels, strict=True)
    scaled = [Record(one.u / s, one.y / s, dt=one.dt) for one, s in pairs]
    alike = identify(scaled, found.structure)
    assert not alike.noise_levels
    assert np.max(np.abs(found.theta - alike.theta) / found.std) < 1e-3
    assert found.std == pytest.approx(alike.std, rel=1e-3)


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_speaks_against_it_and_files_know_it(seed, tmp_path):
    records = two(seed)
    found = identify(records, ORDER)
    assert not [one for one in found.findings if one.matters]
    loaded = Estimate.load(found.save(tmp_path / "model.json"))
    assert np.array_equal(loaded.noise_levels, found.noise_levels)
    assert validate(loaded, records).ok
    assert f"experiment 2  {np.ravel(found.noise_levels)[1]:.4g}" in found.summary()
    table = next(one for one in result_tables(found) if one.heading.startswith("Noise of each"))
    assert [row[0] for row in table.rows] == ["experiment 1", "experiment 2"]
    assert estimate_document(found, records)["noise_levels"] == [
        one.tolist() for one in found.noise_levels
    ]


@pytest.mark.unjudged
def test_equal_noise_has_one_level():
    rng = np.random.default_rng(24)
    found = identify([recorded(rng), recorded(rng, n=150, dt=0.11)], ORDER)
    assert found.noise_levels == ()
    assert "noise level" not in found.summary()


@pytest.mark.parametrize(
    ("structure", "method"),
    [
        pytest.param(Structure(2, 1, fixed={"a0": 4.0}), None, marks=pytest.mark.slow),
        pytest.param(Structure(2, 1, bounds={"b0": (0.0, None)}), None, marks=pytest.mark.slow),
        pytest.param(Structure(2, 1, delay="free"), None, marks=pytest.mark.slow),
        (ORDER, OutputError()),
    ],
    ids=["fixed", "bounds", "delay", "output-error"],
)
@pytest.mark.unjudged
def test_with_knowledge_with_delays_and_by_output_error(structure, method):
    found = identify(two(21), structure, method)
    assert np.ravel(found.noise_levels) == pytest.approx([0.02, 0.1], rel=0.15)
    errors = [(p.value - v) / p.std for p, v in _beside_truth(found) if p.std]
    assert np.max(np.abs(errors)) < 4.0


def _beside_truth(found):
    true = {"a1": 1.1, "a0": 4.0, "b1": 2.0, "b0": 3.0}
    return [(found.parameters[name], value) for name, value in true.items()]


@pytest.mark.unjudged
@pytest.mark.parametrize(
    "method", [pytest.param(SvfLeastSquares(), marks=pytest.mark.slow), ThreeModel(noise="white")]
)
def test_a_method_that_takes_one_level_says_so(method):
    found = identify(two(21), ORDER, method)
    assert not found.noise_levels
    assert any("one was taken for all" in told for told in found.trace.decisions)


@pytest.mark.unjudged
def test_two_outputs_have_levels_of_their_own():
    rng = np.random.default_rng(25)
    sizes = [(0.02, 0.3), (0.1, 0.1)]
    plant = TransferFunction([[[2.0, 3.0]], [[1.0]]], [[[1.0, 1.1, 4.0]], [[1.0, 1.1, 4.0]]])
    records = []
    for own in sizes:
        u = np.repeat(rng.choice([-1.0, 1.0], 25), 8)
        y = simulate(plant, Record(u, np.zeros((200, 2)), dt=0.05))
        records.append(Record(u, y + rng.standard_normal((200, 2)) * own, dt=0.05))
    found = identify(records, Structure(2, [[1], [0]]))
    assert np.array(found.noise_levels) == pytest.approx(np.array(sizes), rel=0.15)


def test_a_short_experiment_less_its_share_of_the_unknowns():
    rng = np.random.default_rng(26)
    left = [rng.standard_normal((n, 1)) for n in (4000, 40)]
    found = NoiseLevels.of(left, 404.0)
    assert found.freedom.ravel().tolist() == pytest.approx([3600.0, 36.0])
    assert not found.differ.any()
    wide = NoiseLevels.of([left[0], 5.0 * left[1]], 404.0)
    assert wide.differ.all()
    assert NoiseLevels.of([left[0], left[1][:6]], 4.0).known.variance[1] == pytest.approx(
        np.mean(left[0] ** 2), rel=1e-2
    )
