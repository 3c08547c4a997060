"""Standard errors where several outputs share their noise."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.estimation.likelihood.shared_noise import no_smaller, shared_covariance

pytestmark = pytest.mark.unjudged

N, DT = 400, 0.05
PLANT = TransferFunction([[[2.0, 3.0]], [[3.0]]], [1.0, 3.0, 9.0])
STRUCTURE = Structure(2, [[1], [0]])


def record(seed: int, correlation: float) -> Record:
    rng = np.random.default_rng([seed, 91])
    u = np.repeat(rng.choice([-1.0, 1.0], N // 12 + 1), 12)[:N]
    y = simulate(PLANT, Record(u, np.zeros((N, 2)), dt=DT))
    own = rng.standard_normal((N, 2))
    own[:, 1] = correlation * own[:, 0] + np.sqrt(1.0 - correlation**2) * own[:, 1]
    return Record(u, y + 0.2 * y.std(axis=0) * own, dt=DT)


def test_a_column_given_twice_has_the_errors_of_one() -> None:
    one = record(0, 0.0).select(outputs=["y1"])
    twice = Record(one.u, np.hstack([one.y, one.y]), dt=DT)
    alone = identify(one, Structure(2, 1))
    both = identify(twice, Structure(2, 1))
    for name in ("a1", "a0"):
        assert both.parameters[name].value == pytest.approx(alone.parameters[name].value, rel=1e-6)
        assert both.parameters[name].std == pytest.approx(alone.parameters[name].std, rel=0.02)
    assert any("noise that outputs share" in one for one in both.trace.decisions)


def test_what_is_shared_is_said_and_independent_noise_changes_nothing() -> None:
    shared, own = (identify(record(1, c), STRUCTURE) for c in (0.9, 0.0))
    assert any("correlation 0.9" in one for one in shared.trace.decisions)
    assert shared.errors == "likelihood"
    assert not any("share" in one for one in own.trace.decisions)


def test_the_covariance_is_that_of_scores_of_shared_noise() -> None:
    """Against many draws of the scores."""
    rng = np.random.default_rng(2)
    g = np.linalg.qr(rng.standard_normal((600, 3)))[0].reshape(300, 2, 3)
    factor = np.linalg.cholesky([[1.0, 0.7], [0.7, 1.0]])
    draws = rng.standard_normal((4000, 300, 2)) @ factor.T
    found = shared_covariance([g], [draws[0]])
    assert found is not None
    scores = np.einsum("tok,nto->nk", g, draws)
    assert found[0] == pytest.approx(np.cov(scores.T), abs=0.12)


def test_no_smaller_in_any_direction() -> None:
    rng = np.random.default_rng(3)
    one, other = (m @ m.T for m in rng.standard_normal((2, 4, 4)))
    wider = no_smaller(one, other)
    for least in (one, other):
        assert np.linalg.eigvalsh(wider - least).min() > -1e-9


@pytest.mark.slow
@pytest.mark.parametrize("correlation", [0.9, -0.6])
def test_intervals_hold_where_noise_is_shared(correlation: float) -> None:
    true = {"a1": 3.0, "a0": 9.0, "b1[y1,u1]": 2.0}
    distances = []
    for seed in range(100):
        found = identify(record(1000 + seed, correlation), STRUCTURE)
        values = [found.parameters[name] for name in found.names]
        distances.append([(p.value - true[p.name]) / p.std for p in values if p.name in true])
    within = np.mean(np.abs(distances) < 1.96)
    assert 0.91 < within < 0.985
