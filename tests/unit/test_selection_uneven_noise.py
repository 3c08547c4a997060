"""Where time is not even no noise model is fitted: coloured noise must not buy poles."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, identify
from tridentify.judgement.selection.decide import misleads
from tridentify.judgement.selection.finish_candidates import Entry

STRUCTURE = Structure(1, 0)


def _entry(colour: float, seed: int, even: bool) -> tuple[Entry, Record]:
    """A first-order lag with AR(1) noise over samples."""
    rng = np.random.default_rng(seed)
    steps = np.full(400, 0.1) if even else rng.uniform(0.05, 0.15, 400)
    t = np.concatenate([[0.0], np.cumsum(steps[1:])])
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    y, noise = np.zeros(400), np.zeros(400)
    for k in range(1, 400):
        decay = np.exp(-2.0 * (t[k] - t[k - 1]))
        y[k] = decay * y[k - 1] + (1.0 - decay) * u[k - 1]
        noise[k] = colour * noise[k - 1] + 0.05 * rng.standard_normal()
    record = Record(u, y + noise, t=t, intersample="zoh")
    estimate = identify(record, STRUCTURE)
    return Entry(STRUCTURE, estimate, residuals=(estimate.residual(record),)), record


@pytest.mark.slow
def test_coloured_noise_at_uneven_times_is_seen() -> None:
    for seed in range(5):
        entry, record = _entry(0.9, seed, even=False)
        assert misleads(entry, [record])


def test_white_noise_and_even_time_leave_the_likelihood_its_say() -> None:
    for seed in range(5):
        entry, record = _entry(0.0, seed, even=False)
        assert not misleads(entry, [record])
    entry, record = _entry(0.9, 0, even=True)
    assert not misleads(entry, [record])
