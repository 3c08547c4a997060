"""What every test may use."""

from __future__ import annotations

import dataclasses
import gc
import os
import sys
import traceback
import warnings
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from _pytest.doctest import DoctestModule

from fast_cases import leave_the_others_to_the_slow_run
from tridentify.errors import DataWarning
from tridentify.estimation.answer.estimate import Estimate
from tridentify.estimation.answer.finding import Finding
from tridentify.judgement import choice
from tridentify.record.formats.apart import isolated, isolation

os.environ.setdefault("MPLBACKEND", "Agg")

# The same examples on every run and no deadline: a first call may compile a kernel.
# HYPOTHESIS_PROFILE=explore looks for new examples; `make test` takes fewer (quick).
hypothesis.settings.register_profile("fixed", deadline=None, derandomize=True)
hypothesis.settings.register_profile("quick", deadline=None, derandomize=True, max_examples=8)
hypothesis.settings.register_profile("explore", deadline=None, max_examples=1000)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))

QUICK = os.environ.get("HYPOTHESIS_PROFILE") == "quick"

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Keep the garbage collector from the hundred thousands of objects that stay to the end.

    It went through all of them, again and again: a third of the time of the collection of tests,
    and a fiftieth of that of the tests themselves.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(20_000)
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path) -> Generator[None, list[pytest.Collector], object]:
    """Look for examples in docstrings of the package alone: a tenth of the time of collection."""
    found = yield
    if file_path.is_relative_to(REPOSITORY / "tests"):
        return [one for one in found if not isinstance(one, DoctestModule)]
    return found


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Before `-m` selects."""
    whole = not any("::" in argument for argument in config.args)
    leave_the_others_to_the_slow_run(items, whole)


@pytest.fixture(scope="session")
def repository() -> Path:
    """The folder of this checkout."""
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder with the public records, which are not part of this repository.

    It is `../shared/data` beside the checkout, or what TRIDENTIFY_SHARED_DATA names.
    """
    named = os.environ.get("TRIDENTIFY_SHARED_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        if named:
            pytest.fail(f"TRIDENTIFY_SHARED_DATA names {named}, which is not a folder")
        pytest.skip("no ../shared/data beside the repository; TRIDENTIFY_SHARED_DATA may name it")
    return folder


@pytest.fixture(autouse=True)
def _no_figure_stays() -> Iterator[None]:
    """Close what a test left open in pyplot, as the end of a cell does in a notebook."""
    yield
    pyplot = sys.modules.get("matplotlib.pyplot")
    if pyplot is not None:
        pyplot.close("all")


def _is_left_unjudged(node: pytest.Item | pytest.Collector, judged: bool) -> bool:
    """Whether a test looks at numbers alone: in `make test`, or always, over hundreds of draws."""
    marked = node.get_closest_marker("unjudged")
    return marked is not None and not judged and (QUICK or marked.kwargs.get("always", False))


def _of_the_method(estimate: Estimate, *_: object) -> Sequence[Finding]:
    return estimate.findings


@pytest.fixture(autouse=True)
def _judged_where_it_counts(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Leave out what `identify` finds to say, where a test looks at numbers alone.

    Half of the time of an identification that is not all right goes there. `make test-all` has it
    as users have, but where hundreds of draws are averaged.
    """
    if _is_left_unjudged(request.node, request.node.get_closest_marker("judged") is not None):
        monkeypatch.setattr(choice, "judged", _of_the_method)


def _blank(_drawing: object, buffer: Any, name: str) -> None:
    text = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1"></svg>'
    buffer.write(text if name == "svg" else text.encode())


def _left_blank(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("tridentify.report.pictures._save", _blank)
    # to find room for labels that nobody sees takes as long as to draw them
    patch.setattr("tridentify.report.sheet.Sheet.settle", lambda sheet: sheet.figure)


@pytest.fixture(autouse=True)
def _drawn_where_it_is_looked_at(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Write blank pictures, where a test looks at other things of a report: most of its time.

    `make test-all` draws them all.
    """
    if QUICK and request.node.get_closest_marker("undrawn"):
        _left_blank(monkeypatch)


class _Nobody:
    """In the place of the process that reads a file."""

    def __init__(self, *_: object) -> None:
        self.source: Any = None
        self.stdin = None

    def end(self) -> None:
        """A process that ends leaves nothing open, and says nothing of it."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)
            self.source = None


def _read_here(file: Any, message: dict[str, Any]) -> tuple[dict[str, Any], Sequence[Any]]:
    """What `isolated.serve` answers, without the process."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", DataWarning)
        try:
            if "module" in message:
                source = file._process.source = isolated.open_here(message["module"], file.path)
                header = {"channels": [dataclasses.asdict(one) for one in source.channels]}
                arrays: Sequence[Any] = ()
            else:
                header, arrays = {}, isolated._arrays(file._process.source, message)
                arrays = [np.ascontiguousarray(one, dtype="<f8").ravel() for one in arrays]
        except BaseException as error:
            traceback.clear_frames(error.__traceback__)  # what they hold open would be told later
            refusal = file._refusal(isolated._described(error))
            raise refusal from None
    return {**header, "said": isolated._said(caught)}, arrays


@pytest.fixture(autouse=True)
def _isolated_where_it_counts(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read files in this process, where a test looks at what is in them.

    To start a process takes a hundred times as long. `make test-all` reads as users do.
    """
    marked = request.node.get_closest_marker
    if QUICK and marked("unisolated") and not marked("isolated"):
        monkeypatch.setattr(isolation, "ChildProcess", _Nobody)
        monkeypatch.setattr(isolation.IsolatedFile, "_ask", _read_here)


@pytest.fixture(scope="module", autouse=True)
def _judged_where_a_file_counts(request: pytest.FixtureRequest) -> Iterator[None]:
    """The same for what the tests of a file share, where none of them reads findings."""
    own = [item for item in request.session.items if item.parent is request.node]
    judged = any(item.get_closest_marker("judged") for item in own)
    with pytest.MonkeyPatch.context() as patch:
        if _is_left_unjudged(request.node, judged):
            patch.setattr(choice, "judged", _of_the_method)
        if QUICK and request.node.get_closest_marker("undrawn"):
            _left_blank(patch)
        yield
