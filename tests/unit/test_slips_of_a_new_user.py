"""What a new user writes at first, and the one line that says what to write instead."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tridentify import (
    Record,
    Structure,
    TransferFunction,
    identify,
    select_structure,
    simulate,
)
from tridentify.errors import (
    CandidateError,
    DataError,
    OptionError,
    OrderError,
    SampleTypeError,
    SamplingError,
    TridentifyError,
)
from tridentify.report import write_report


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(3)
    u = np.sign(np.sin(np.arange(300) ** 1.5))
    y = simulate(TransferFunction([2.0], [1.0, 4.0]), Record(u, u, dt=0.05))
    return Record(u, y + 0.02 * rng.standard_normal((300, 1)), dt=0.05)


@pytest.fixture(scope="module")
def estimate(record):
    return identify(record, (1, 0))


def refused(kind, words, call):
    """The call is refused in one line that holds the words."""
    with pytest.raises(kind) as caught:
        call()
    assert isinstance(caught.value, TridentifyError)
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text


def test_a_report_without_its_path_says_how(estimate, record):
    refused(
        OptionError,
        ("found Record", 'estimate.report("page.html", record)'),
        lambda: estimate.report(record),
    )


def test_a_report_of_swapped_arguments_says_how(estimate, record, tmp_path):
    page = tmp_path / "x.html"
    how = 'write_report(estimate, record, "page.html")'
    refused(
        SampleTypeError, (how, "Record, Estimate"), lambda: write_report(record, estimate, page)
    )
    refused(SampleTypeError, (how,), lambda: write_report(estimate, page, record))
    assert not page.exists()


def test_a_third_argument_of_a_record_has_a_name():
    refused(SamplingError, ("0.02", "dt=0.02"), lambda: Record([0, 1, 1], [0, 1, 2], 0.02))


@pytest.mark.parametrize("pair", [(1, 0), [1, 0], (np.int64(1), 0)])
def test_pairs_stand_for_structures(record, pair):
    found = identify(record, pair).structure
    assert (found.poles, found.zeros) == (1, 0)


def test_pairs_are_candidates(record):
    pairs = select_structure(record, [(1, 0), [2, 0]])
    structures = select_structure(record, [Structure(1, 0), Structure(2, 0)])
    assert [row.structure for row in pairs.rows] == [row.structure for row in structures.rows]
    assert len(select_structure(record, [(1, 0), Structure(1, 0)]).rows) == 1


def test_messages_about_structures_mention_the_pair(record):
    refused(OrderError, ("Structure([2, 1])", "(2, 1)"), lambda: Structure([2, 1]))
    refused(OptionError, ("pair", "(2, 1)"), lambda: identify(record, 2, 1))
    refused(OptionError, ("pair", "select_structure"), lambda: identify(record, [(1, 0), (2, 1)]))
    refused(CandidateError, ("pair", "(2, 1)"), lambda: select_structure(record, [(1, 0), "2, 1"]))


def test_record_and_structure_swapped_are_told_apart(record):
    refused(SampleTypeError, ("swapped",), lambda: identify(Structure(2, 1), record))
    refused(SampleTypeError, ("swapped",), lambda: identify((2, 1), record))


def test_a_file_or_a_frame_is_to_be_read_first(tmp_path):
    frame = pd.DataFrame({"t": [0.0, 0.1], "u": [0, 1], "y": [0, 1]})
    refused(SampleTypeError, ("read_record", "file.csv"), lambda: identify("file.csv", (1, 0)))
    refused(SampleTypeError, ("read_record",), lambda: identify(tmp_path / "a.csv", (1, 0)))
    refused(SampleTypeError, ("record_from_frame",), lambda: identify(frame, (1, 0)))
    refused(DataError, ("record_from_frame",), lambda: select_structure(frame, [(1, 0)]))
