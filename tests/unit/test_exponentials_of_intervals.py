"""Exponentials of intervals of many lengths: machine code against a dense solution."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from tridentify.numerics.intervals import steps

LENGTHS = np.array([0.0, 1e-4, 0.3, 2.0])


def _dense(a: np.ndarray, b: np.ndarray, h: float) -> np.ndarray:
    """``[e^{A h} | p | r / h]`` by the exponential of the whole matrix."""
    q = b.size
    whole = np.zeros((q + 2, q + 2))
    whole[:q, :q], whole[:q, q], whole[q, q + 1] = a * h, b * h, 1.0
    return np.asarray(expm(whole))[:q]


@pytest.mark.parametrize("kind", ["real", "pair", "pair behind", "full"])
@pytest.mark.parametrize("rate", [1e-3, 1.0, 1e3])
def test_tables_are_those_of_the_dense_exponential(kind: str, rate: float) -> None:
    a = np.array([[-1.0, 0.0, 0.0], [0.7, -2.0, 0.0], [0.2, -0.4, -0.5]])
    if kind == "pair":
        a[0, 1] = -3.0
    if kind == "pair behind":
        a[1, 2] = -3.0
    if kind == "full":  # no cascade has it: the way without machine code
        a[0, 1], a[1, 2], a[0, 2] = -3.0, 0.5, 0.1
    a, b = a * rate, np.array([rate, 0.3 * rate, -1.0])
    tables = steps(a, b, LENGTHS, LENGTHS).tables[0]
    for h, table in zip(LENGTHS, tables, strict=True):
        expected = _dense(a, b, h)
        assert np.allclose(table, expected, rtol=1e-11, atol=1e-13 * np.abs(expected).max())
