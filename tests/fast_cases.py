"""The mark `fast`: which cases of a parametrised test stay in `make test`.

    @pytest.mark.parametrize("key", METHODS)
    @pytest.mark.fast("three-model")
    def test_...(key): ...

The other cases are marked slow: `make test-all` runs them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

import pytest


def matches(case: str, name: str) -> bool:
    """Whether a case is the one named; a star in the name stands for any text."""
    return re.fullmatch(".*".join(map(re.escape, name.split("*"))), case, re.DOTALL) is not None


def case_of(item: pytest.Function) -> str:
    """What stands in brackets behind the name of the test."""
    return item.callspec.id if hasattr(item, "callspec") else ""


def marked(items: Iterable[pytest.Item]) -> dict[str, list[pytest.Function]]:
    """The cases of every test that is marked `fast`, by the name of the test."""
    found: dict[str, list[pytest.Function]] = {}
    for item in items:
        if isinstance(item, pytest.Function) and item.get_closest_marker("fast"):
            found.setdefault(item.nodeid.partition("[")[0], []).append(item)
    return found


def kept(item: pytest.Function) -> Sequence[str]:
    """The names that the mark gives."""
    mark = item.get_closest_marker("fast")
    assert mark is not None
    return mark.args


def unknown(tests: Mapping[str, Sequence[pytest.Function]]) -> list[str]:
    """One line for every name that no case has: without it a test might have no fast case."""
    return [
        f"found mark fast({name!r}) at {test}; expected one of its cases: {[*map(case_of, cases)]}"
        for test, cases in tests.items()
        for name in kept(cases[0])
        if not any(matches(case_of(case), name) for case in cases)
    ]


def contradicted(tests: Mapping[str, Sequence[pytest.Function]]) -> list[str]:
    """One line for every test that names cases to stay, and is slow in each of them."""
    return [
        f"found marks fast and slow at {test}; expected a case that stays, or slow alone"
        for test, cases in tests.items()
        if all(
            case.get_closest_marker("slow")
            for case in cases
            if any(matches(case_of(case), name) for name in kept(case))
        )
    ]


def leave_the_others_to_the_slow_run(items: Iterable[pytest.Item], whole: bool) -> None:
    """Mark what is not named slow; `whole` if items are whole files, so that names can be checked.

    Raises
    ------
    pytest.UsageError
        If a name is none of a case, or no case that is named stays.
    """
    tests = marked(items)
    wrong = [*unknown(tests), *contradicted(tests)] if whole else []
    if wrong:
        raise pytest.UsageError("\n".join(wrong))
    for case in (case for cases in tests.values() for case in cases):
        if not any(matches(case_of(case), name) for name in kept(case)):
            case.add_marker(pytest.mark.slow)
