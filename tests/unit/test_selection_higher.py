"""Structures with more resonances than four poles have."""

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, select_structure, simulate
from tridentify.estimation.methods.three_model import ThreeModel
from tridentify.judgement.selection.higher import higher_candidates
from tridentify.judgement.selection.orders import default_candidates
from tridentify.judgement.selection.stages import Work

pytestmark = pytest.mark.unjudged

DT = 0.02


def resonances(seed: int, n_modes: int, noise: float = 0.05, n_samples: int = 700) -> Record:
    """A displacement of close, lightly damped modes under a random force."""
    rng = np.random.default_rng(seed)
    num, den = np.zeros(1), np.ones(1)
    for k in range(n_modes):
        w = 8.0 * 1.6**k * rng.uniform(0.9, 1.1)
        own = np.array([1.0, 2 * rng.uniform(0.01, 0.03) * w, w * w])
        gain = rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 1.4) * w * w
        num = np.polyadd(np.polymul(num, own), gain * den)
        den = np.polymul(den, own)
    u = rng.standard_normal(n_samples)
    y = simulate(TransferFunction(num, den), Record(u, u, dt=DT))[:, 0]
    return Record(u, y + noise * y.std() * rng.standard_normal(n_samples), dt=DT)


def asked(record: Record) -> list[int]:
    """Numbers of poles that join the candidates."""
    work = Work((record,), ThreeModel(), None, lambda _: None)
    structures = default_candidates([record], Structure(1, 0))
    more = higher_candidates((record,), structures, work.opened(structures).table, ThreeModel())
    return [] if more is None else sorted({one.common_poles for one in more.structures})[4:]


@pytest.mark.parametrize("seed", [0, 2, 4])
@pytest.mark.slow
def test_a_third_resonance_asks_for_six_poles(seed):
    assert asked(resonances(seed, 3)) == [6]


@pytest.mark.parametrize(("n_modes", "noise"), [(2, 0.05), (2, 1.0), (1, 0.05)])
@pytest.mark.slow
def test_nothing_joins_where_four_poles_are_enough(n_modes, noise):
    assert asked(resonances(5, n_modes, noise)) == []


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "n_modes"), [(11, 3), (12, 3), (13, 4)])
def test_all_resonances_are_recommended(seed, n_modes):
    found = select_structure(resonances(seed, n_modes, n_samples=1000)).recommended
    assert found is not None
    assert found.structure.poles == 2 * n_modes
    assert np.all(found.estimate.fit > 90.0)
