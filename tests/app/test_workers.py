"""A worker whose turn is awaited says what it waits for; a cancelled task does not begin."""

from __future__ import annotations

import threading

import pytest

from tridentify.app.workers import WAITED, CancelledError, Worker

PATIENCE = 60.0


@pytest.fixture
def preparing():
    """A worker that has only just begun to load what an estimate needs."""
    worker = Worker(warm=True)
    began = threading.Thread(target=worker.start, daemon=True)
    began.start()
    while not worker._doing:
        began.join(0.01)
    yield worker
    worker.stop()
    began.join(PATIENCE)


@pytest.mark.slow
def test_a_task_says_what_it_waits_for(preparing):
    told = []
    preparing.call("prepare", lambda fraction, words: told.append((fraction, words)))
    assert told
    assert all(words.startswith("preparing") for _, words in told)
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert 0.0 < fractions[-1] <= WAITED


def test_a_task_that_is_cancelled_before_its_turn_does_not_begin(preparing):
    waits, ended = threading.Event(), []

    def ask():
        try:
            preparing.call("prepare", lambda fraction, words: waits.set())
        except CancelledError:
            ended.append("cancelled")

    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    assert waits.wait(PATIENCE)
    preparing.cancel()
    asking.join(PATIENCE)
    assert ended == ["cancelled"]
