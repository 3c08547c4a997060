"""An angle that goes round, a counter that overflows: undone, and not a bad sample."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, advise, identify, simulate, validate
from tridentify.judgement.cautions.wraps import period_of, undo

PLANT = TransferFunction([2.0, 8.0], [1.0, 1.6, 16.0])
TURNER = TransferFunction([6.0], [1.0, 0.8, 0.0])


def counted(seed: int) -> Record:
    """A response that goes beyond the 16 bits it is counted in."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], 100), 6)
    y = simulate(PLANT, Record(u, u, dt=0.05))[:, 0] + 0.02 * rng.standard_normal(600)
    counts = np.round(y / np.abs(y).max() * 36000).astype(int)
    return Record(u, ((counts + 32768) % 65536 - 32768) / 1000.0, dt=0.05)


@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.slow) for k in (2, 3, 4))])
@pytest.mark.slow
def test_a_counter_that_overflows_is_told_first(seed):
    record = counted(seed)
    estimate = identify(record, Structure(2, 1), throw=False)
    for findings in (estimate.findings, validate(estimate, record).findings):
        first = next(one for one in findings if one.matters)
        assert first.code == "wraps-round"
        assert "wraps round" in first.message
        assert "period=65.536" in first.remedy
        assert "Without them: fit" in first.effect
    assert "wraps round" in advise(record).findings[0].message


def test_undone_it_is_the_record_it_was():
    record = counted(1)
    y = undo(record.y[:, 0], period_of(record.y[:, 0]))
    found = identify(Record(record.u, y, dt=0.05), Structure(2, 1))
    assert not found.cautions
    assert np.all(np.abs(found.theta[:2] - [1.6, 16.0]) < 4.0 * found.std[:2])


def test_a_heading_that_goes_through_south_turns_by_360():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-20.0, 20.0], 40), 15)
    y = simulate(TURNER, Record(u, u, dt=0.1))[:, 0] + 0.3 * rng.standard_normal(600)
    heading = (y + 180.0) % 360.0 - 180.0
    assert np.ptp(y) > 400.0
    assert period_of(heading) == 360.0
    turns = (undo(heading, 360.0) - y) / 360.0
    np.testing.assert_allclose(turns, np.round(turns[0]), atol=1e-9)


@pytest.mark.parametrize("lag", [0.0, 0.6, 0.9])
@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
def test_an_output_that_its_input_throws_about_does_not(lag, noise):
    rng = np.random.default_rng(4)
    for size in (1.0, 180.0, 7.3):
        u = np.repeat(rng.choice([-1.0, 1.0], 60), rng.integers(1, 12))
        y = np.zeros(u.size)
        for k in range(1, u.size):
            y[k] = lag * y[k - 1] + (1.0 - lag) * u[k]
        y = size * (y + noise * rng.standard_normal(u.size))
        assert period_of(y) == 0.0
        assert period_of(np.round(y, 1)) == 0.0
