"""Looks of the judgement that work by running sums, in machine code, or on a part of a record."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.judgement.causes.attempts import fewer
from tridentify.judgement.causes.attempts.told_apart import laws
from tridentify.judgement.causes.signals.surprises import small_surprises
from tridentify.judgement.validation.statistics import columns


@pytest.mark.parametrize("lags", [(0, 1, 2, 3, 7, 20), (0, 1, 2, 3, 5, 6, 40, 70), (0, 1)])
def test_running_sums_give_the_responses_that_convolutions_give(lags):
    u = np.random.default_rng(7).standard_normal(300)
    found = columns._hats(u, lags)
    edges = [lags[0] - 1, *lags, lags[-1] + 1]
    for k, (low, peak, high) in enumerate(zip(edges, edges[1:], edges[2:], strict=False)):
        at = np.arange(high + 1)
        shape = np.interp(at, [low, peak, high], [0.0, 1.0, 0.0])
        expected = np.convolve(u, shape)[:300]
        np.testing.assert_allclose(found[:, k], expected, atol=1e-11)


def test_small_moves_are_those_of_the_robust_fit_in_plain_steps():
    rng = np.random.default_rng(11)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 10) + 0.02 * rng.standard_normal(400)
    (found,) = small_surprises([Record(u, u, dt=1.0)])
    since = u - np.median(u)
    known = np.column_stack([*(since[12 - k : 400 - k] for k in range(1, 13)), np.ones(388)])
    weight = np.ones(388)
    for turn in range(15):
        root = np.sqrt(weight)
        fit = np.linalg.lstsq(known * root[:, None], u[12:] * root, rcond=None)[0]
        left = u[12:] - known @ fit
        scale = 1.4826 * np.median(np.abs(left))
        size = np.abs(left) / scale
        huber, none = 1.0 / np.maximum(size / 1.345, 1.0), np.maximum(1.0 - (size / 4.685) ** 2, 0)
        weight = huber if turn < 7 else none**2
    expected = np.where(np.abs(left) <= 3.0 * scale, left, 0.0)
    np.testing.assert_allclose(found[12:, 0], expected, atol=1e-12)
    assert 0 < np.count_nonzero(expected) < 388


@pytest.mark.parametrize("inputs", [1, 2])
def test_one_late_move_of_the_set_point_of_a_long_loop_is_seen(inputs):
    y = np.random.default_rng(5).standard_normal(20_000)
    u = np.column_stack([0.3 - 0.7 * y, y[::-1]])[:, :inputs]
    assert laws([Record(u, y, dt=0.1)])[0].lags == 0
    u[19_000:, 0] += 20.0
    assert laws([Record(u, y, dt=0.1)])[0].lags is None


def test_an_input_that_moves_by_itself_needs_no_regression_of_all_samples():
    u, y = np.random.default_rng(5).standard_normal((2, 50_000))
    quick, late = laws([Record(u, y, dt=0.1)])[0], laws([Record(u[:1500], y[:1500], dt=0.1)])[0]
    assert quick.lags is late.lags is None
    # not worked out: it was left where nothing of the input is told
    assert quick.share == 1.0 > late.share


@pytest.mark.parametrize(
    ("poles", "hopeless"), [(3, True), pytest.param(4, False, marks=pytest.mark.slow)]
)
def test_fewer_poles_are_fitted_where_a_step_promises_that_they_may_do(
    monkeypatch, poles, hopeless
):
    rng = np.random.default_rng(21)
    u = np.repeat(rng.choice([-1.0, 1.0], 150), 4)
    plant = TransferFunction([9.0], np.polymul([1.0, 1.5], [1.0, 1.2, 6.0]))
    y = simulate(plant, Record(u, u, dt=0.1))[:, 0]
    record = Record(u, y + 0.05 * rng.standard_normal(u.size), dt=0.1)
    ends = []

    def told(*args, hopeless=np.inf, plain=fewer.attempt, **options):
        end = plain(*args, hopeless=hopeless, **options)
        ends.append((hopeless, end))
        return end

    monkeypatch.setattr(fewer, "attempt", told)
    found = identify(record, Structure(poles, poles - 3))
    tried = [end for limit, end in ends if np.isfinite(limit)]
    assert tried
    assert all(end is None for end in tried) == hopeless
    assert any(one.code == "order-high" for one in found.findings) != hopeless
