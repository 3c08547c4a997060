"""Stand-ins for long records: what they keep exactly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tridentify import Record, TransferFunction, simulate
from tridentify.estimation.likelihood.cost import evaluate
from tridentify.estimation.likelihood.setup.problem import Problem
from tridentify.estimation.search.stand_ins import (
    LARGE_RECORD,
    SMALL,
    averaged,
    free_variant,
    is_large,
    window,
)
from tridentify.models.regression import Experiment

DT = 0.01
MODEL = TransferFunction([5.0, 7.0], [1.0, 1.0, 3.0])
POLES = np.array([-0.5 + 1j * np.sqrt(2.75), -0.5 - 1j * np.sqrt(2.75)])


def problem(n, hold, *, intersample="zoh", moving=None):
    rng = np.random.default_rng(2)
    u = np.repeat(rng.standard_normal(-(-n // hold)), hold)[:n]
    if moving is not None:
        u[: moving[0]] = u[moving[1] :] = 0.0
    y = simulate(MODEL, Record(u, u, dt=DT, intersample=intersample))
    e = Experiment(u[:, None].copy(), y + 100.0, DT, intersample, False, True, False)
    return Problem.of([e], 2, ((1,),))


def residual(some, poles=POLES):
    """Root mean square of what the true poles leave, relative to the output."""
    point = evaluate(some, poles)
    return float(np.sqrt(point.rss[0] / point.counts[0] / some.power[0]))


def test_long_is_counted_over_all_experiments():
    piece = problem(LARGE_RECORD // 2 + 1, 1).experiments[0]
    assert not is_large(Problem.of([piece], 2, ((1,),)))
    assert is_large(Problem.of([piece, piece], 2, ((1,),)))


def test_averages_are_exact_for_an_input_held_over_the_blocks():
    some = problem(10 * SMALL, 10)
    little = averaged(some)
    e = little.experiments[0]
    assert (e.n_samples, e.dt) == (SMALL, pytest.approx(10 * DT))
    assert np.array_equal(e.y, some.experiments[0].y[::10])
    assert e.u == pytest.approx(some.experiments[0].u[::10])
    assert residual(little) < 1e-9


def test_averages_keep_slow_dynamics_of_a_fast_input():
    little = averaged(problem(10 * SMALL, 1))
    assert residual(little) < 0.05
    assert residual(little, np.array([-0.3 + 1j, -0.3 - 1j])) > 0.2


def test_a_remainder_of_samples_is_left_out():
    e = averaged(problem(3 * SMALL + 7, 1)).experiments[0]
    assert e.n_samples == (3 * SMALL + 7) // 4
    assert e.u.shape == (e.n_samples, 1)


@pytest.mark.parametrize("first", [1, 3])
def test_a_slower_output_is_not_averaged_away(first):
    some = problem(10 * SMALL, 10)
    y = some.experiments[0].y
    y[np.arange(y.shape[0]) % 4 != first] = np.nan
    kept = averaged(some).experiments[0].y
    assert kept.shape[0] >= SMALL // 3
    assert np.isfinite(kept).mean() > 0.2


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_a_window_is_an_exact_record_with_a_free_state(intersample):
    some = problem(5 * SMALL, 3, intersample=intersample)
    piece = window(some)
    e = piece.experiments[0]
    assert (e.n_samples, e.dt, e.intersample) == (SMALL, DT, intersample)
    assert (e.free, e.offset, e.drift) == (True, True, False)
    assert residual(piece) < 1e-9


@pytest.mark.parametrize("at", [0, 3, 7])
def test_the_window_lies_where_the_output_moves(at):
    start = at * SMALL
    some = problem(8 * SMALL, 50, moving=(start, start + SMALL))
    some.experiments[0].y[5::11] = np.nan
    found = window(some).experiments[0]
    assert np.nanstd(found.y) > 0.8 * np.nanstd(some.experiments[0].y[start : start + SMALL])


def test_a_window_is_no_longer_than_the_record_and_comes_from_the_longest():
    short, long = problem(50, 3).experiments[0], problem(400, 3).experiments[0]
    both = Problem.of([short, long], 2, ((1,),))
    assert window(both).experiments[0].n_samples == 400
    assert window(both, 100).experiments[0].n_samples == 100


def test_the_variant_of_a_window_drops_nothing():
    begun, other = window(problem(3 * SMALL, 3)), window(problem(5 * SMALL, 3, moving=(5000, 9000)))
    for piece, free in ((begun, False), (other, True)):
        variant = free_variant(piece)
        assert (variant.free, variant.offset, variant.drift) == (free, True, False)
        assert variant.constants == (None,)


@pytest.mark.parametrize("intersample", ["zoh", "foh"])
def test_the_window_of_a_record_from_rest_is_its_beginning_if_that_moves(intersample):
    some = problem(3 * SMALL, 3, intersample=intersample)
    piece = window(some)
    e = piece.experiments[0]
    assert not e.free
    assert np.array_equal(e.y, some.experiments[0].y[:SMALL])
    assert residual(piece) < 1e-9


def test_the_beginning_is_no_window_without_an_input():
    some = problem(8 * SMALL, 50, moving=(5 * SMALL, 6 * SMALL))
    some.experiments[0].y[:] = 100.0 + np.random.default_rng(0).standard_normal((8 * SMALL, 1))
    assert window(some).experiments[0].free


def test_the_beginning_is_no_known_window_of_a_free_start():
    some = problem(3 * SMALL, 3)
    e = replace(some.experiments[0], free=True)
    assert window(Problem.of([e], 2, ((1,),))).experiments[0].free
