"""What past noise in the inputs costs: against the dense inverse of the joint information."""

from __future__ import annotations

import numpy as np

from tridentify.estimation.likelihood.noise_information import turned, without


def test_the_covariance_is_the_block_of_the_joint_inverse():
    rng = np.random.default_rng(0)
    past = rng.standard_normal((300, 3)) @ rng.standard_normal((3, 3))
    g = np.linalg.qr(rng.standard_normal((300, 2)) + past[:, :2])[0]
    joint = np.hstack([g, past])
    expected = np.linalg.inv(joint.T @ joint)[:2, :2]
    basis = np.linalg.qr(past)[0]
    parts = [g[:100, None], g[100:, None]]
    turn = turned(parts, basis)
    assert np.allclose(turn @ turn.T, expected, rtol=1e-10)
    left = np.vstack([one[:, 0] for one in without([p @ turn for p in parts], basis)])
    assert np.allclose(left.T @ left, np.eye(2), atol=1e-10)
