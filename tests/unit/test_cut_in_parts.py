"""A record cut at several times: no sample in two parts."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify import Record
from tridentify.cli.load import pieces, stretches_from
from tridentify.errors import EmptyRangeError


def record():
    x = np.random.default_rng(8).standard_normal(100)
    return Record(x, x, dt=0.1)


def test_ranges_that_meet_share_no_sample():
    found = pieces(record(), stretches_from("--range", ["0:3", "3:6.2", "6.2:"]))
    assert [one.n_samples for one in found] == [30, 32, 38]
    assert np.array_equal(np.concatenate([one.t for one in found]), record().t)
    (alone,) = pieces(record(), stretches_from("--range", ["1:3"]))
    assert alone.t[-1] == pytest.approx(3.0)


def test_a_record_is_split_at_several_times():
    parts = record().split(6.2, 3.0)
    assert [one.n_samples for one in parts] == [30, 32, 38]
    assert len(record().split(3.0)) == 2
    with pytest.raises(EmptyRangeError):
        record().split(3.0, 3.1)
