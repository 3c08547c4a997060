"""Rows that are missing from honest time stamps, and what strikes a system from outside."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate

FURNACE = TransferFunction([0.008], [1.0, 0.04, 0.0002])
DT, N = 5.0, 400
ASKED = Structure(2, 0, offset=True, initial_state="free")


def fired(seed, there_and_back=False):
    """A held input, the output, and rows that a log lost: over moves of the input, or beside."""
    rng = np.random.default_rng(seed)
    u = np.repeat(np.arange(N) % 2, rng.integers(14, 40, N))[:N].astype(float)
    moves = np.flatnonzero(np.diff(u)) + 1
    moves = moves[(moves > 30) & (moves < N - 30)]
    chosen = rng.choice(moves, 4, replace=False)
    if there_and_back:
        for k in chosen:
            u[k + 5 : k + 9] = 1.0 - u[k + 5 : k + 9]
        gaps = [np.arange(k + 4, k + 11) for k in chosen]
    else:
        gaps = [np.arange(k - int(rng.integers(2, 6)), k + 3) for k in chosen]
    y = simulate(FURNACE, Record(u, u, dt=DT))[:, 0]
    y += 20.0 + 0.1 * rng.standard_normal(N)
    return u, y, np.concatenate(gaps), moves


def kept(u, y, lost):
    seen = np.setdiff1d(np.arange(N), lost)
    return Record(u[seen], y[seen], t=DT * seen)


def found_in(record):
    return identify(record, ASKED, throw=False)


def mended(record, times):
    parts = []
    for t in times:
        first, record = record.split(t)
        parts.append(first)
    return found_in([*parts, record])


CASES = [(there, seed) for there in (False, True) for seed in range(10)]


@pytest.mark.slow
@pytest.mark.parametrize(("there_and_back", "seed"), CASES)
def test_an_input_that_moved_in_a_gap_is_named_first_and_the_cut_mends_it(there_and_back, seed):
    u, y, lost, _ = fired(seed, there_and_back)
    record = kept(u, y, lost)
    estimate = found_in(record)
    first = estimate.findings[0]
    assert first.code == "lost-rows", [one.text for one in estimate.findings]
    assert "in a gap of the time stamps" in first.message
    assert "intersample" not in [one.code for one in estimate.findings]
    after = mended(record, first.times)
    assert np.all(np.abs(after.theta - [0.04, 0.0002, 0.008]) < 4.5 * after.std)
    assert not any(one.code == "lost-rows" for one in after.findings)


@pytest.mark.parametrize("seed", range(20, 36))
@pytest.mark.fast("20")
def test_gaps_in_which_nothing_moved_are_left_alone(seed):
    u, y, _, moves = fired(seed)
    lost = [k + 5 + np.arange(5) for k in moves[::2]]
    estimate = found_in(kept(u, y, np.concatenate(lost)))
    assert not any(one.code == "lost-rows" for one in estimate.findings)


def test_an_input_that_was_recorded_while_the_output_was_not_is_no_gap():
    u, y, lost, _ = fired(3, there_and_back=True)
    y[lost] = np.nan
    estimate = found_in(Record(u, y, dt=DT))
    assert not any(one.code == "lost-rows" for one in estimate.findings)


@pytest.mark.slow
def test_what_strikes_from_outside_is_not_said_to_be_lost_rows_alone():
    u, y, _, _ = fired(5)
    t = DT * np.arange(N)
    for k in (120, 250):
        y[k:] -= 4.0 * np.exp(-0.03 * (t[k:] - t[k]))
    first = found_in(Record(u, y, dt=DT)).findings[0]
    assert first.code == "lost-rows"
    assert "something struck the system from outside" in first.message
    assert "as an input" in first.remedy
