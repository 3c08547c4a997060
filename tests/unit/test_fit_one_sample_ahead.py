"""What is said of a low fit: how far plant and noise tell an output one sample ahead."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tridentify import Estimate, Record, Structure, ThreeModel, TransferFunction, identify, simulate
from tridentify.judgement.direct_findings import LOW, _ahead

pytestmark = pytest.mark.unjudged
PLANT = TransferFunction([2.0], [1.0, 2.0])


def slow_noise(seed: int, size: float, n: int = 600) -> tuple[Record, np.ndarray]:
    """A first-order plant in autoregressive noise of 20 samples; and what no model foresees."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 8 + 1), 8)[:n]
    e = size * rng.standard_normal(n)
    y = simulate(PLANT, Record(u, u, dt=0.1))[:, 0] + lfilter([1.0], [1.0, -0.95], e)
    return Record(u, y, dt=0.1), e


def fitted(record: Record) -> Estimate:
    return identify(record, Structure(1, 0), ThreeModel(noise="ar"))


def test_a_low_fit_is_told_beside_what_is_foreseen_one_sample_ahead() -> None:
    record, e = slow_noise(0, 0.4)
    estimate = fitted(record)
    told = _ahead(estimate, [record])
    fit, known, plain = (float(one) for one in re.findall(r"(-?[\d.]+) %", told))
    y = record.y[:, 0] - record.y.mean()
    assert fit == pytest.approx(float(estimate.fit[0]), abs=0.1)
    # the innovations that were drawn, not those of the estimate
    assert known == pytest.approx(100.0 * (1.0 - np.linalg.norm(e) / np.linalg.norm(y)), abs=1.0)
    last = np.linalg.norm(np.diff(y)) / np.linalg.norm(y)
    assert plain == pytest.approx(100.0 * (1.0 - last), abs=0.1)
    assert fit < LOW < plain < known


@pytest.mark.slow
def test_nothing_is_said_of_a_fit_that_is_not_low_nor_of_two_outputs() -> None:
    record, _ = slow_noise(1, 0.02, 200)
    estimate = fitted(record)
    assert float(estimate.fit[0]) > LOW
    assert _ahead(estimate, [record]) == ""
    loud, _ = slow_noise(2, 0.4, 200)
    two = Record(loud.u, np.hstack([loud.y, loud.y[::-1]]), dt=0.1)
    assert _ahead(identify(two, Structure(1, 0), ThreeModel(noise="ar")), [two]) == ""
    # uneven time has no sample ahead
    uneven = Record(loud.u, loud.y, t=0.1 * np.arange(200) + 0.03 * np.sin(np.arange(200.0)))
    white = identify(uneven, Structure(1, 0))
    assert _ahead(replace(white, fit=np.array([10.0])), [uneven]) == ""
