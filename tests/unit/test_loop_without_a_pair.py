"""What cannot be laid beside a record of a loop is refused by what is in the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tridentify import Record, Structure, TransferFunction, identify, simulate
from tridentify.errors import UnsupportedError
from tridentify.estimation.answer.loop_taken import LoopTaken
from tridentify.estimation.methods.explained import explained_or_refused


@pytest.mark.parametrize(
    ("route", "taken", "said"),
    [
        ("reference", LoopTaken("sampled"), "a record without a reference"),
        ("direct", LoopTaken("sampled", mirrored=True), "a pole at -2 rad/s, not stable or nearly"),
    ],
)
def test_it_is_said_which_of_the_two(route, taken, said):
    u = np.repeat(np.random.default_rng(1).choice([-1.0, 1.0], 30), 10)
    record = Record(
        u, simulate(TransferFunction([2.0], [1.0, 2.0]), Record(u, u, dt=0.05)), dt=0.05
    )
    estimate = replace(identify(record, Structure(1, 0)), route=route, loop=taken)
    with pytest.raises(UnsupportedError, match=said):
        explained_or_refused(estimate, [record])
