"""A Kalman filter of two outputs goes on learning once the free response is over.

Its columns are left out from then on (here after some 1,150 samples); what stood in them must not
be weighed again and again with the rows of the second output.
"""

import numpy as np

from tridentify import Record, Structure, TransferFunction, online, simulate

DT, N, BEFORE = 0.05, 1400, 1100
PLANT = TransferFunction([[[2.0, 4.0]], [[-4.0, 1.0]]], [1.0, 2.4, 6.3])
TRUTH = np.array([2.4, 6.3, 2.0, 4.0, -4.0, 1.0])


def test_errors_fall_after_the_free_response() -> None:
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([-1.0, 1.0], N // 10), 10)
    y = simulate(PLANT, Record(u, np.zeros((N, 2)), dt=DT))
    y = y + [0.3, 0.02] * rng.standard_normal((N, 2))
    method = online.Kalman(drift=1e-5)
    state = method.init(Structure(2, 1), dt=DT, output_names=("fast", "slow"))
    std = np.zeros(TRUTH.size)
    for k, (u_k, y_k) in enumerate(zip(u.tolist(), y.tolist(), strict=True)):
        state, _ = method.step(state, u_k, y_k)
        if k == BEFORE:
            std = method.estimate(state).std
    found = method.estimate(state)
    # the plant stands still: errors fall nearly as the root of the samples
    assert np.all(found.std < 0.97 * std)
    assert np.all(np.abs(found.theta - TRUTH) < 4.0 * found.std)
