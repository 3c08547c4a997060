"""What other descriptions of an input between its samples add to errors in an unstable loop."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

import tridentify as tri

STEP, BANDWIDTH = 0.125, 4.0
TRUTH = np.array([0.2, -1.2, 2.0])


def continuous_loop(seed: int, n: int = 1000) -> tri.Record:
    """A continuous lead around ``2 / ((s - 1)(s + 1.2))``, what it reads held over an interval."""
    rng = np.random.default_rng(seed)
    r = np.repeat(rng.choice([-1.0, 1.0], n // 20), 20)
    slow, high = 1.0 / (8.0 * BANDWIDTH), (1.4 * BANDWIDTH - 0.2) / 2.0
    low = (BANDWIDTH**2 + 1.2) / 2.0
    direct, rest = high / slow, low - high / slow
    # x'' = -0.2 x' + 1.2 x + 2 u,  u = r - direct (x + v) - rest w,  slow w' = x + v - w
    a = np.array([[-0.2, 1.2 - 2.0 * direct, -2.0 * rest], [1, 0, 0], [0, 1 / slow, -1 / slow]])
    b = np.array([[2.0, -2.0 * direct], [0.0, 0.0], [0.0, 1.0 / slow]])
    whole = scipy.linalg.expm(np.block([[a, b], [np.zeros((2, 5))]]) * STEP)

    def run(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, u, y = np.zeros(3), np.empty(n), np.empty(n)
        for k in range(n):
            y[k] = x[1] + v[k]
            u[k] = r[k] - direct * y[k] - rest * x[2]
            x = whole[:3, :3] @ x + whole[:3, 3:] @ (r[k], v[k])
        return u, y

    clean = run(np.zeros(n))[1]
    u, y = run(0.1 * clean.std() * rng.standard_normal(n))
    return tri.Record(u, y, dt=STEP, reference=r)


@pytest.mark.slow
@pytest.mark.unjudged
@pytest.mark.parametrize("seed", [703, 705])
def test_a_predictor_that_runs_off_is_no_other_description(seed: int) -> None:
    method = tri.ThreeModel(controller="continuous")
    estimate = tri.identify(continuous_loop(seed), tri.Structure(2, 0), method)
    assert np.all(np.abs(estimate.theta - TRUTH) < 4.0 * estimate.std)
    assert np.max(estimate.std) < 3.0
