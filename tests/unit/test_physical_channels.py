"""Columns are taken for the channels that their names say, whatever their order."""

from __future__ import annotations

import pytest

from tridentify.physical.channels import match_channels


@pytest.mark.parametrize(
    ("channels", "columns", "expected"),
    [
        (("alpha", "q"), ("alpha", "q"), ("alpha", "q")),
        (("alpha", "q"), ("q", "alpha"), ("alpha", "q")),
        (("alpha", "q"), ("y_q", "y_alpha"), ("y_alpha", "y_q")),
        (("alpha", "q"), ("pitch rate q [deg/s]", "AoA"), ("AoA", "pitch rate q [deg/s]")),
        # a letter within a word is no name
        (("alpha", "q"), ("freq", "squat"), ("freq", "squat")),
        # two columns that could be the same channel: the order decides
        (("alpha", "q"), ("q1 alpha", "q2 alpha"), ("q1 alpha", "q2 alpha")),
        (("elevator",), ("u1",), ("u1",)),
        (("speed", "current"), ("Motor_Current", "w"), ("w", "Motor_Current")),
    ],
)
def test_names_say_which_is_which(channels, columns, expected):
    assert match_channels(channels, columns) == dict(zip(channels, expected, strict=True))


def test_a_channel_without_a_column_is_left_out():
    assert match_channels(("alpha", "q"), ("y_q",)) == {"q": "y_q"}
