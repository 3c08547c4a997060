"""How often right models are called wrong, or looked at closely: as often as stated."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.judgement.validation import assess
from tridentify.judgement.validation.residuals import look
from tridentify.judgement.validation.statistics.evidence import examine

PLANT = TransferFunction([2.0, 9.0], [1.0, 1.2, 9.0])
MODEL = Structure(2, 1, offset=False, initial_state="rest")
CALLED = 0.001


def right(n, seed, a=(1.0,)):
    """A record of a linear system: moves of several lengths, 14 dB, noise of a given memory."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 0.5, 1.0], n // 6 + 1), rng.integers(6, 12))[:n]
    y = simulate(PLANT, Record(u, u, dt=0.05))[:, 0]
    noise = lfilter([1.0], a, rng.standard_normal(n + 300))[300:]
    return Record(u, y + 0.2 * np.std(y) * noise / np.std(noise), dt=0.05)


def closely(monkeypatch, seeds):
    """Which of some right records in white noise call for all tests."""
    called, judge = [], assess._judge
    monkeypatch.setattr(assess, "_judge", lambda *given: called.append(1) or judge(*given))
    found = []
    for seed in seeds:
        called.clear()
        identify(right(500, seed), MODEL, throw=False)
        found += [seed] if called else []
    return found


def bent(n, seed):
    """p-value of a right record of noise with much memory being linear."""
    poles = [0.9, 0.8 * np.exp(0.5j), 0.8 * np.exp(-0.5j)]
    record = right(n, seed, np.poly(poles).real)
    estimate = identify(record, MODEL, ThreeModel(noise="ar"), throw=False)
    view = look(estimate, [record.settled(estimate.intersample)], None, own=True)
    return examine(view, 0, estimate, 20, 0.001).linear


@pytest.mark.parametrize(
    ("seeds", "most"), [(range(6), 1), pytest.param(range(40), 2, marks=pytest.mark.slow)]
)
def test_few_right_records_are_looked_at_closely(monkeypatch, seeds, most):
    assert len(closely(monkeypatch, seeds)) <= most


@pytest.mark.slow
def test_few_right_records_are_called_bent_in_noise_with_memory():
    assert sum(bent(300, seed) < CALLED for seed in range(60)) <= 2
