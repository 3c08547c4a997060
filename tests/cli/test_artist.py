"""Figures drawn in another process are those drawn in this one, and drawn here if it dies."""

from __future__ import annotations

import os
import signal
import time

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate, validate
from tridentify.cli.artist import Beside, hired
from tridentify.cli.run import estimate_model
from tridentify.report.figures import Here


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), 10)
    y = simulate(TransferFunction([9.0], [1.0, 1.2, 9.0]), Record(u, u, dt=0.05))
    record = Record(u, y + 0.05 * rng.standard_normal(y.shape), dt=0.05)
    return record, identify(record, Structure(2, 0))


@pytest.fixture
def _two_processors(monkeypatch):
    monkeypatch.setattr("tridentify.cli.artist.worth_it", lambda: True)


@pytest.mark.slow
@pytest.mark.usefixtures("_two_processors")
@pytest.mark.parametrize("part", ["model", "tests"])
def test_another_process_draws_the_same_pictures(case, part):
    record, estimate = case
    with hired() as artist:
        assert isinstance(artist, Beside)
        if part == "model":
            found = estimate_model(record, Structure(2, 0), artist=artist)
            pictures, here = artist.model(found, [record]), Here().model(estimate, [record])
        else:
            checked = validate(estimate, record)
            pictures, here = artist.tests(checked)(), Here().tests(checked)()
    assert [p.stem for p in pictures] == [p.stem for p in here]
    assert [p.svg for p in pictures] == [p.svg for p in here]


@pytest.mark.slow
@pytest.mark.usefixtures("_two_processors")
@pytest.mark.undrawn
def test_a_process_that_dies_leaves_the_drawing_to_this_one(case):
    record, estimate = case
    with hired() as artist:
        artist.begin(estimate, [record])
        (worker,) = artist._pool._processes.values()
        os.kill(worker.pid, signal.SIGKILL)
        worker.join()
        time.sleep(0.1)
        assert next(p.stem for p in artist.model(estimate, [record])) == "fit"
        assert len(artist.tests(validate(estimate, record))()) == 1


def test_without_a_second_processor_nobody_is_hired():
    with hired() as artist:
        assert artist is None
