"""Standard errors from scores where coefficients are held."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import OutputError, Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.knowledge import answer
from tridentify.estimation.knowledge.scores import sensitivities
from tridentify.estimation.likelihood.scores import whitened_scores

pytestmark = pytest.mark.unjudged

DT, N = 0.05, 800
PLANT = TransferFunction([2.0], [1.0, 2.0, 4.0])
DRIVE = TransferFunction([2.0], [1.0, 3.0, 0.0])


def gusts(rng):
    """Coloured, and a few times as strong in some stretches as in others."""
    v = lfilter([1.0], [1.0, -1.9, 0.905], rng.standard_normal(N + 500))[500:]
    size = np.exp(4.0 * lfilter([0.05], [1.0, -0.99], rng.standard_normal(N + 500))[500:])
    return v / v.std() * size / np.sqrt(np.mean(size**2))


def white(rng):
    return rng.standard_normal(N)


def record(seed, disturb, model=PLANT):
    u = np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], N // 10), 10)
    clean = simulate(model, Record(u, u, dt=DT))
    noise = np.column_stack(
        [disturb(np.random.default_rng([seed, 1, i])) for i in range(clean.shape[1])]
    )
    return Record(u, clean + 0.3 * clean.std(axis=0) * noise, dt=DT)


@pytest.mark.parametrize(
    ("model", "structure"),
    [
        (PLANT, Structure(2, 0, fixed={"a1": 2.0})),
        (PLANT, Structure(2, 0, fixed={"b0": 2.0}, initial_state="free", drift=True)),
        (DRIVE, Structure(2, 0, fixed={"a0": 0.0}, initial_state="free", offset=True, drift=True)),
        (
            TransferFunction([[[2.0]], [[1.0, 5.0]]], [[[1.0, 2.0, 4.0]]] * 2),
            Structure(2, [[0], [1]], fixed={"a1": 2.0}, offset=True),
        ),
    ],
    ids=["a coefficient", "a numerator", "an integrator", "two outputs"],
)
@pytest.mark.fast("an integrator")
def test_directions_hold_all_of_the_information_and_nothing_is_left_along_them(
    model, structure, monkeypatch
):
    seen = []

    def look(reached, spread, noise):
        here = reached.fit
        outputs = range(here.problem.n_outputs)
        moved = [sensitivities(here, spread.along, spread.beside, i) for i in outputs]
        pairs = zip(here.problem.experiments, here.over_time(), strict=True)
        left = [experiment.standardised(one) for experiment, one in pairs]
        seen.append(whitened_scores(left, moved, here.problem.noise, noise))

    monkeypatch.setattr(answer, "_scatter", look)
    records = [record(1, white, model), record(2, white, model)]
    identify(records, structure, OutputError(model))
    information = sum(np.einsum("toi,toj->ij", g, g) for g, _ in seen[-1])
    left = sum(np.einsum("toi,to->i", g, e) for g, e in seen[-1])
    assert np.allclose(information, np.eye(len(information)), atol=1e-8)
    assert np.max(np.abs(left)) < 1e-2


@pytest.mark.parametrize(
    ("model", "structure", "truth"),
    [
        (PLANT, Structure(2, 0, fixed={"a1": 2.0}), [2.0, 4.0, 2.0]),
        pytest.param(
            DRIVE,
            Structure(2, 0, fixed={"a0": 0.0}, drift=False),
            [3.0, 0.0, 2.0],
            marks=pytest.mark.slow,
        ),
    ],
    ids=["a coefficient", "an integrator"],
)
@pytest.mark.slow
def test_errors_grow_with_gusts(model, structure, truth, monkeypatch):
    seeds, method = range(6), OutputError(model)
    found = [identify(record(k, gusts, model), structure, method, throw=False) for k in seeds]
    monkeypatch.setattr(answer, "constrained_scatter", lambda *_: None)
    plain = [identify(record(k, gusts, model), structure, method, throw=False) for k in seeds]
    free = found[0].std > 0
    off, before = (
        np.array([np.abs(e.theta - truth)[free] / e.std[free] for e in es]) for es in (found, plain)
    )
    assert sum(e.errors == "scores" for e in found) >= 5
    assert any("scatter of the scores" in told for told in found[0].trace.decisions)
    assert np.mean(before > 1.96) > 0.25
    assert np.mean(off > 1.96) < 0.2
    for one, other in zip(found, plain, strict=True):
        assert np.array_equal(one.theta, other.theta)
        assert np.linalg.eigvalsh(one.cov - other.cov).min() > -1e-9 * np.trace(one.cov)


@pytest.mark.slow
def test_white_noise_keeps_the_likelihood():
    structure = Structure(2, 0, fixed={"a1": 2.0})
    found = [identify(record(k, white), structure, OutputError(PLANT)) for k in range(5)]
    assert all(one.errors == "likelihood" for one in found)


def test_priors_have_no_scores():
    structure = Structure(2, 0, priors={"a0": (4.0, 0.5)})
    assert identify(record(0, gusts), structure, OutputError(PLANT)).errors == "likelihood"
