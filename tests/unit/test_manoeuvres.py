"""Pieces of a long log that are worth identifying, and nothing where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, TransferFunction, simulate
from tridentify.judgement.advice import find_manoeuvres

PLANT = TransferFunction([2.0], [1.0, 2.0, 8.0])
DT, N = 0.05, 6000


def log(moves, *, noise=0.01, input_noise=0.0, seed=0, answered=True):
    """A log with an input that moves from one sample to another by a size."""
    rng = np.random.default_rng(seed)
    u = np.full(N, 3.0)
    for first, last, size in moves:
        u[first:last] += size
    y = simulate(PLANT, Record(u - 3.0, u, dt=DT))[:, 0] if answered else np.zeros(N)
    u = u + input_noise * rng.standard_normal(N)
    return Record(u, y + noise * rng.standard_normal(N), dt=DT)


def places(record):
    return [(m.start / DT, m.stop / DT) for m in find_manoeuvres(record)]


@pytest.mark.parametrize("input_noise", [0.0, 0.01])
def test_every_doublet_is_found_with_quiet_before_and_after(input_noise):
    moves = [(1000, 1030, 1.0), (1030, 1060, -1.0), (4000, 4040, 0.5)]
    found = places(log(moves, input_noise=input_noise))
    assert len(found) == 2
    for (start, stop), (first, last) in zip(found, [(1000, 1060), (4000, 4040)], strict=True):
        assert first - 80 <= start <= first - 40
        assert last + 40 <= stop <= last + 80


def test_a_single_step_is_a_manoeuvre():
    ((start, stop),) = places(log([(3000, N, 1.0)]))
    assert start < 3000 < stop


def test_the_best_one_is_told_with_what_moved_and_what_answered():
    (one,) = find_manoeuvres(log([(1000, 1100, 1.0)]))
    assert one.score > 3.0
    assert "u moves after" in one.why
    assert "y moves" in one.why


@pytest.mark.parametrize(
    "record",
    [
        log([]),
        log([], input_noise=0.01),
        log([(1000, 1100, 1.0)], answered=False),
        log([(1000, 1100, 1.0)], noise=5.0),
    ],
    ids=["at rest", "noise alone", "no answer", "an answer below the noise"],
)
@pytest.mark.fast("noise alone", "an answer below the noise")
def test_nothing_is_offered_where_there_is_nothing(record):
    assert find_manoeuvres(record) == ()


@pytest.mark.slow
def test_a_record_that_is_never_quiet_is_one_piece():
    rng = np.random.default_rng(2)
    for u in (np.repeat(rng.choice([-1.0, 1.0], N // 20), 20), rng.standard_normal(N).cumsum()):
        y = simulate(PLANT, Record(u, u, dt=DT))[:, 0] + 0.01 * rng.standard_normal(N)
        (one,) = find_manoeuvres(Record(u, y, dt=DT))
        assert (one.start, one.stop) == (0.0, pytest.approx(DT * (N - 1)))


def test_missing_samples_and_a_second_output_do_no_harm():
    record = log([(1000, 1100, 1.0)])
    y = np.column_stack([np.full(N, np.nan), record.y[:, 0]])
    y[5:60, 1] = np.nan
    y[0, 0] = 1.0
    assert len(places(Record(record.u, y, dt=DT))) == 1


def test_a_gap_of_ones_own():
    record = log([(1000, 1030, 1.0), (1200, 1230, 1.0)])
    assert len(find_manoeuvres(record)) == 2
    (both,) = find_manoeuvres(record, gap=8.0)
    assert both.start < 1000 * DT
    assert both.stop > 1230 * DT


@pytest.mark.parametrize("hold", [30, 60, 100])
def test_steps_of_one_manoeuvre_stay_together(hold):
    moves, at = [], 2000
    for count, size in ((3, 1.0), (2, -1.0), (1, 1.0), (1, -1.0)):
        moves.append((at, at + count * hold, size))
        at += count * hold
    found = places(log(moves))
    assert len(found) == 1
    assert found[0][0] == pytest.approx(2000, abs=80)
    assert found[0][1] == pytest.approx(at, abs=80)


def test_what_is_held_for_long_is_another_level():
    found = places(log([(1000, 2800, 1.0)]))
    assert len(found) == 2


def sparse(n_samples, period):
    """A long log with a short doublet every so many samples."""
    u = np.zeros(n_samples)
    for first in range(period // 2, n_samples, period):
        u[first : first + 60], u[first + 60 : first + 120] = 1.0, -1.0
    return answered_by_the_plant(u, seed=4)


def answered_by_the_plant(u, seed):
    y = simulate(PLANT, Record(u, u, dt=DT))[:, 0]
    return Record(u, y + 0.01 * np.random.default_rng(seed).standard_normal(u.size), dt=DT)


def test_short_manoeuvres_of_a_long_log_are_found_one_by_one():
    n_samples, period = 60_000, 1500
    found = places(sparse(n_samples, period))
    assert len(found) == n_samples // period
    for (start, stop), first in zip(found, range(period // 2, n_samples, period), strict=True):
        assert first - period / 2 < start < first
        assert first + 120 < stop < first + 120 + period / 2


@pytest.mark.parametrize("hold", [100, 300])
@pytest.mark.slow
def test_a_random_sequence_of_long_steps_stays_one_piece(hold):
    rng = np.random.default_rng(hold)
    steps = 40_000 // hold
    for levels in (rng.choice([-1.0, 1.0], steps), rng.standard_normal(steps)):
        (one,) = find_manoeuvres(answered_by_the_plant(np.repeat(levels, hold), seed=5))
        assert "without a pause" in one.why
