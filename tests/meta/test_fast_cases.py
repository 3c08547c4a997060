"""The mark `fast`: what it keeps, and that no test loses all of its cases by a slip of the pen."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from fast_cases import leave_the_others_to_the_slow_run, matches


def item(request: pytest.FixtureRequest, case: str, kept: Sequence[str]) -> tuple[Any, list[str]]:
    """A case of a test that is marked to keep some, and the marks that it is given."""
    given: list[str] = []
    made = pytest.Function.from_parent(
        request.node.parent, name=f"t[{case}]", originalname="t", callobj=lambda: None
    )
    made.callspec = SimpleNamespace(id=case)
    made.add_marker(pytest.mark.fast(*kept))
    made.add_marker = lambda mark: given.append(mark.name)  # type: ignore[method-assign]
    return made, given


def slow(request: pytest.FixtureRequest, cases: Sequence[str], kept: Sequence[str]) -> list[str]:
    """The cases that are left to the slow run."""
    made = [item(request, case, kept) for case in cases]
    leave_the_others_to_the_slow_run([one for one, _ in made], whole=True)
    return [case for case, (_, given) in zip(cases, made, strict=True) if given == ["slow"]]


def test_cases_that_are_not_named_are_slow(request: pytest.FixtureRequest) -> None:
    cases = ["held-1", "held-2", "line-1", "line-2"]
    assert slow(request, cases, ["held-1"]) == cases[1:]
    assert slow(request, cases, ["held-*"]) == cases[2:]
    assert slow(request, cases, ["held-2", "*-1"]) == ["line-2"]


def test_a_name_that_no_case_has_is_an_error(request: pytest.FixtureRequest) -> None:
    with pytest.raises(pytest.UsageError, match=r"fast\('three'\) at .*::t; expected one of .*two"):
        slow(request, ["one", "two"], ["one", "three"])


def test_a_test_that_is_slow_in_the_cases_that_it_names_is_an_error(
    request: pytest.FixtureRequest,
) -> None:
    made = pytest.Function.from_parent(
        request.node.parent, name="t[one]", originalname="t", callobj=lambda: None
    )
    made.callspec = SimpleNamespace(id="one")
    made.add_marker(pytest.mark.fast("one"))
    made.add_marker(pytest.mark.slow)
    with pytest.raises(pytest.UsageError, match=r"fast and slow at .*::t; expected a case"):
        leave_the_others_to_the_slow_run([made], whole=True)


@pytest.mark.parametrize(
    ("case", "name", "expected"),
    [
        ("held-1", "held-1", True),
        ("held-1", "held", False),
        ("a[0]-1", "a[0]-*", True),
        ("0-1", "[0]-1", False),
    ],
)
def test_a_star_is_the_only_letter_of_its_own_kind(case: str, name: str, expected: bool) -> None:
    assert matches(case, name) is expected
