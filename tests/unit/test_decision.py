"""What a decision is about: kept with its words, and read off them where a file holds no more."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from tridentify.estimation.answer.decision import DecisionKind, recalled
from tridentify.estimation.answer.encoding.values import decode, encode
from tridentify.estimation.answer.trace import Pass, Trace


@pytest.mark.parametrize("kind", DecisionKind, ids=lambda kind: kind.name)
def test_the_kind_is_read_off_the_words(kind):
    told = kind.told(": some reason")
    assert (told.kind, told.rest) == (kind, "some reason")
    for again in (recalled(str(told)), copy.deepcopy(told), pickle.loads(pickle.dumps(told))):
        assert (again, again.kind) == (told, kind)
    others = [one for one in DecisionKind if one is not kind]
    assert not any(kind.value.startswith(one.value) for one in others)


def test_a_trace_from_a_file_knows_what_its_decisions_are_about():
    white = DecisionKind.NOISE_WHITE.told(": as asked for")
    trace = Trace((Pass(1, (), np.array([1.0]), cost=0.2),), decisions=("no drift", white))
    read = decode(Trace, encode(trace))
    assert read.decisions == trace.decisions == ("no drift", "noise white: as asked for")
    assert read.about(DecisionKind.NOISE_WHITE) == (white,)
    assert read.about(DecisionKind.NOISE_COLOURED) == ()
    assert recalled("no drift") == "no drift"
    assert white.rest == "as asked for"
