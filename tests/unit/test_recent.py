"""What was computed from the same numbers is given again; nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from tridentify.numerics.discretize import discretize
from tridentify.numerics.realization import cascade, degree_basis
from tridentify.numerics.recent import LARGEST, recent


@pytest.fixture
def counted():
    calls = []

    @recent(3)
    def function(*args, **kwargs):
        calls.append(args)
        return len(calls)

    return function, calls


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (np.array([1.0, 2.0]), np.array([1.0, np.nextafter(2.0, 3.0)])),
        (np.zeros(2), np.zeros((2, 1))),
        (np.zeros(2), np.zeros(2, dtype=np.complex128)[:1]),
        ((np.ones(1), np.ones(2)), (np.ones(2), np.ones(1))),
        ("zoh", "foh"),
    ],
)
def test_every_bit_of_the_arguments_counts(counted, one, other):
    function, calls = counted
    assert [function(one), function(other), function(one), function(other)] == [1, 2, 1, 2]
    assert len(calls) == 2


def test_no_more_are_kept_than_stated(counted):
    function, calls = counted
    for k in (0, 1, 2, 3, 3, 0):
        function(k)
    assert [one for (one,) in calls] == [0, 1, 2, 3, 0]


@pytest.mark.parametrize("argument", [np.zeros(LARGEST + 1), [1.0], {"a": 1.0}])
def test_what_is_large_or_may_change_is_computed_each_time(counted, argument):
    function, calls = counted
    function(argument)
    function(argument)
    assert len(calls) == 2


def test_a_cascade_does_not_follow_the_poles_it_was_made_of():
    poles = np.array([-1.0 + 2j, -1.0 - 2j, -3.0])
    first = cascade(poles)
    poles[2] = -4.0
    assert first.poles[2] == -3.0
    assert cascade(np.array([-1.0 + 2j, -1.0 - 2j, -3.0])) is first
    assert degree_basis(cascade(poles)).leading != pytest.approx(degree_basis(first).leading)


def test_a_discretisation_is_the_same_to_the_last_bit():
    a, b = np.array([[-2.0, 0.0], [1.0, -3.0]]), np.array([[2.0], [0.5]])
    for between in ("zoh", "foh"):
        plain = discretize.__wrapped__(a, b, 0.1, between)
        for one, other in zip(discretize(a, b, 0.1, between), plain, strict=True):
            assert np.array_equal(one, other)
