"""The sample loop against the same recursion written with matrices."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.numerics.discretize import discretize
from tridentify.numerics.kernels.long_recursions import PART
from tridentify.numerics.propagate import LONG_INPUT, propagate
from tridentify.numerics.realization import cascade

POLES = {
    "real": np.array([-1.0, -2.0, -0.5, -4.0], dtype=complex),
    "pairs": np.array([-1 + 2j, -1 - 2j, -0.5, -3 + 1j, -3 - 1j]),
}
N = 37


@pytest.fixture(params=POLES)
def bank(request):
    return cascade(POLES[request.param])


@pytest.fixture
def u():
    return np.random.default_rng(1).standard_normal((N, 3))


def step(bank, intersample):
    d = discretize(bank.a, bank.b[:, None], 0.2, intersample)
    return d.transition, d.from_current[:, 0], d.from_next[:, 0]


def dense(transition, from_current, from_next, u, initial):
    """(channels, q, n + 1) states; the input stays at its last value after the end."""
    out = np.empty((u.shape[1], transition.shape[0], u.shape[0] + 1))
    following = np.vstack([u[1:], u[-1:]])
    for j in range(u.shape[1]):
        x = initial[j].copy()
        for k in range(u.shape[0]):
            out[j, :, k] = x
            x = transition @ x + from_current * u[k, j] + from_next * following[k, j]
        out[j, :, -1] = x
    return out


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("known_shape", [True, False])
def test_states_are_those_of_the_matrix_recursion(bank, u, intersample, known_shape):
    matrices = step(bank, intersample)
    state = np.random.default_rng(2).standard_normal((3, bank.order))
    expected = dense(*matrices, u, state)
    out = np.empty((3 * bank.order, N))
    upper = int(np.any(bank.poles.imag != 0)) if known_shape else None
    propagate(*matrices, u, state, out, upper=upper)
    assert out.reshape(3, bank.order, N) == pytest.approx(expected[:, :, :-1], rel=1e-12)
    assert state == pytest.approx(expected[:, :, -1], rel=1e-12)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.parametrize("length", [1, 5, N - 1])
def test_chunks_with_the_state_carried_are_the_whole(bank, u, intersample, length):
    """With a first-order hold the last step of a chunk looks at the first sample of the next."""
    matrices = step(bank, intersample)
    whole, carried = np.zeros((3, bank.order)), np.zeros((3, bank.order))
    expected, found = np.empty((3 * bank.order, N)), np.empty((3 * bank.order, N))
    propagate(*matrices, u, whole, expected)
    for start in range(0, N, length):
        stop = min(start + length, N)
        propagate(*matrices, u, carried, found, start=start, stop=stop, column=start)
    assert np.array_equal(found, expected)
    assert np.array_equal(carried, whole)


def test_other_columns_and_rows_of_the_output_are_left_alone(bank, u):
    out = np.full((3 * bank.order + 2, N + 4), np.nan)
    state = np.zeros((3, bank.order))
    propagate(*step(bank, "zoh"), u, state, out, start=10, stop=20, column=3)
    written = np.zeros(out.shape, bool)
    written[: 3 * bank.order, 3:13] = True
    assert np.array_equal(np.isfinite(out), written)


def test_a_read_only_input_is_accepted(bank, u):
    expected, found = np.empty((2, 3 * bank.order, N))
    propagate(*step(bank, "zoh"), u, np.zeros((3, bank.order)), expected)
    u.setflags(write=False)
    propagate(*step(bank, "zoh"), u, np.zeros((3, bank.order)), found)
    assert np.array_equal(found, expected)


ORDERS = {
    "one": np.array([-1.0 + 0j]),
    "three and a pair across the fourth": np.array(
        [-1.0, -2.0, -0.5, -1 + 2j, -1 - 2j, -3 + 1j, -3 - 1j, -4.0]
    ),
    "pairs": np.tile(np.array([-1 + 2j, -1 - 2j]), 4),
    "nine": -np.geomspace(0.1, 9.0, 9).astype(complex),
}


@pytest.mark.parametrize("intersample", [pytest.param("zoh", marks=pytest.mark.slow), "foh"])
@pytest.mark.parametrize("poles", ORDERS.values(), ids=ORDERS)
@pytest.mark.fast("one-foh")
def test_long_records_have_the_same_states(poles, intersample):
    bank = cascade(poles)
    matrices = step(bank, intersample)
    n = LONG_INPUT + 3 * PART + 5
    u = np.random.default_rng(4).standard_normal((n, 2))
    initial = np.random.default_rng(5).standard_normal((2, bank.order))
    expected = dense(*matrices, u, initial)
    upper = int(np.any(poles.imag != 0))
    state, out = initial.copy(), np.empty((2 * bank.order, n))
    propagate(*matrices, u, state, out, upper=upper)
    assert out.reshape(2, bank.order, n) == pytest.approx(expected[:, :, :-1], rel=1e-9, abs=1e-12)
    assert state == pytest.approx(expected[:, :, -1], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
@pytest.mark.slow
def test_chunks_of_a_long_record_are_the_whole(intersample):
    bank = cascade(ORDERS["three and a pair across the fourth"])
    matrices, n = step(bank, intersample), LONG_INPUT + 1
    u = np.random.default_rng(6).standard_normal((n, 2))
    whole, carried = np.zeros((2, bank.order)), np.zeros((2, bank.order))
    expected, found = np.full((2, 2 * bank.order + 1, n), np.nan)
    propagate(*matrices, u, whole, expected, upper=1)
    for start in range(0, n, 700):
        stop = min(start + 700, n)
        propagate(
            *matrices, u, carried, found, start=start, stop=stop, column=start, upper=1
        )  # fmt: skip
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-14, nan_ok=True)
    assert carried == pytest.approx(whole, rel=1e-12, abs=1e-14)
