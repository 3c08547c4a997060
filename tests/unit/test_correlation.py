"""Products of two series at every shift: those of scipy, to the last bit, and of a loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import correlate

from tridentify.numerics.correlation import products_at_shifts


@pytest.mark.parametrize("n", [1, 2, 7, 64, 1001])
def test_products_are_those_of_scipy_and_of_a_loop(n):
    one, other = np.random.default_rng(n).standard_normal((2, n))
    found = products_at_shifts(one, other)
    np.testing.assert_array_equal(found, correlate(one, other, method="fft"))
    dense = np.convolve(one, other[::-1])
    np.testing.assert_allclose(found, dense, atol=1e-12 * n)
